"""The block of a corrosion scene that one of several processes computes."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.processes import OneProcess
from peri.engine.surface.rate_classes import CellExposure, RateClasses

_ARRAYS = ("metal", "domain", "liquid", "metal_fraction", "phase", "renewed", "exposure")


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
    if processes.on_root(lambda: scene.exposure is not None):
        mine["liquid"] = None  # clean at the start
        mine["exposure"] = _block_exposure(scene.exposure if scene else None, processes)
    return _BlockScene(lattice=block, **common, **mine)


def _block_exposure(exposure: CellExposure | None, processes: OneProcess) -> CellExposure:
    """The classes and shares of this process's block; in each cell in the whole's order."""
    most, shares = processes.on_root(
        lambda: (
            int(np.bincount(exposure.metal.cell).max(initial=0)),
            [n for n in ("inside", "held") if getattr(exposure, n) is not None],
        )
    )
    place: np.ndarray | None = None
    if processes.is_root:
        cell = exposure.metal.cell
        place = np.arange(cell.size) - np.searchsorted(cell, cell)

    def dealt(name: str) -> np.ndarray:
        """(cells, most): the classes' values by the block's cell, 0 where a cell has fewer."""
        parts = []
        for p in range(most):
            field = None
            if processes.is_root:
                field = np.zeros(exposure.metal.fraction.shape)
                here = place == p
                field.ravel()[exposure.metal.cell[here]] = getattr(exposure.metal, name)[here]
            parts.append(processes.scatter(field).ravel())
        return np.stack(parts, axis=1)

    def block(values: np.ndarray | None) -> np.ndarray:
        return processes.scatter(values)

    volume, rate = dealt("volume"), dealt("exposure")
    there = volume > 0
    fraction = block(exposure.metal.fraction if processes.is_root else None)
    metal = RateClasses(np.nonzero(there)[0], volume[there], rate[there], fraction)
    liquid = block(exposure.liquid if processes.is_root else None)
    given = {n: block(getattr(exposure, n) if processes.is_root else None) for n in shares}
    return CellExposure(metal, liquid, **given)


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
