"""The block of a corrosion scene that one of several processes computes."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.processes import OneProcess

_ARRAYS = ("metal", "domain", "liquid", "metal_fraction", "phase", "renewed")


def block_scene(scene: CorrosionScene | None, processes: OneProcess) -> CorrosionScene:
    """The scene of this process's block, from the root's (used there only)."""
    if processes.whole:
        return scene
    common = processes.on_root(
        lambda: {f.name: getattr(scene, f.name) for f in fields(scene) if f.name not in _ARRAYS}
    )
    lattice, lead = common.pop("lattice"), 3 - len(processes.shape)
    start = processes.start[lead:]
    origin = np.add(lattice.origin, np.multiply(start, lattice.spacing))
    whole: dict[str, np.ndarray] = {}
    processes.on_root(lambda: whole.update(
        metal=scene.metal, domain=scene.domain, cell_capacity=scene.capacity(),
        held=scene.refreshed(), phase=scene.phases(), liquid=scene.start_liquid(),
    ))  # fmt: skip
    names = ("metal", "domain", "cell_capacity", "held", "phase", "liquid")
    mine = {name: processes.scatter(whole.pop(name, None)) for name in names}
    block = Lattice(tuple(origin), lattice.spacing, processes.block_shape)
    return _BlockScene(lattice=block, **common, **mine)


@dataclass(frozen=True)
class _BlockScene(CorrosionScene):
    """A rank's block of a scene; what needs the whole lattice was computed on rank 0."""

    cell_capacity: np.ndarray | None = field(default=None, repr=False)
    held: np.ndarray | None = field(default=None, repr=False)

    def capacity(self) -> np.ndarray:
        """Relative volumes of the block's cells."""
        return self.cell_capacity

    def refreshed(self) -> np.ndarray:
        """The block's nodes held at zero."""
        return self.held
