"""Where metal and liquid are on a lattice, and the box around the metal with its own arrays.

Padded arrays as in engine.operators.  What depends on the phases is recomputed by `update_phase`
alone, so that a march cannot have one array of an old phase.
"""

from __future__ import annotations

import copy
import math
from typing import Self

import numpy as np

from peri.corrosion.blocks import block_scene
from peri.corrosion.scene import CorrosionScene
from peri.engine.operators import NonlocalSum
from peri.engine.processes import ONE_PROCESS, OneProcess, box_in_reach
from peri.engine.walls import Walls

_SMALLER = 0.8
"""Of the box: a part that is larger is not worth arrays of its own, some 100 bytes a node."""


class Phases:
    """Metal, liquid and held nodes of a scene, on padded arrays.

    Parameters
    ----------
    scene : CorrosionScene
        On the root; elsewhere None.
    processes : OneProcess or its like
        Who holds which block of the lattice; `self.scene` and all arrays are those of the block.

    sum, flow, box : sums over bonds on the lattice, on its rows' ranges with liquid, and on the box
    around the initial metal (None without metal), within reach of liquid.  capacity : relative
    volume of each cell.  metal, fixed, free : bool, nodes that are metal, held at zero, and unknown
    liquid.  largest_sum : of the bonds of a node to liquid, 1/m^2.
    walls : conduction along walls, or None.  solid : uint8, which of the scene's solids (from 1) a
    node was at the start.  box_* : the same on the box; box_seen_liquid, box_seen_metal : sums of a
    node's interface bonds to liquid and to metal; box_of_fixed : the box's sum on the rows of held
    nodes.
    """

    def __init__(self, scene: CorrosionScene | None, processes: OneProcess = ONE_PROCESS) -> None:
        self.processes = processes
        self.scene = scene = block_scene(scene, processes)
        lattice, stencil = scene.lattice, scene.stencil
        self.sum = NonlocalSum(stencil, lattice.shape, scene.domain, processes=processes)
        fixed = scene.refreshed()
        self.fixed = self.sum.pad(fixed) > 0
        self.is_open = processes.any(fixed.any())
        self.domain = self.sum.pad(scene.domain) > 0
        self.capacity = self.sum.pad(scene.capacity())
        self.metal = self.sum.pad(scene.metal) > 0
        self.initial_metal = self.metal.copy()
        self.solid = self.sum.pad(scene.phases()).astype(np.uint8)
        self._rates: tuple[float, float] | None = None
        self._beside: Self | None = None
        self.walls = Walls(self.sum) if scene.walls else None
        self._make_box(self._around(self.metal, 1))
        self.update_phase()

    def of_solids(self, values: list[float]) -> np.ndarray:
        """A padded array with one value per solid on the initial metal, zero elsewhere."""
        out = np.zeros(self.sum.padded_shape)
        for number, value in enumerate(values, 1):
            out[self.solid == number] = value
        return out

    def volumes(self) -> list[float]:
        """Relative volume of the initial metal of each solid, in cells, over all processes."""
        return [
            self.processes.total(float(self.capacity[self.solid == number].sum()))
            for number in range(1, len(self.scene.solids) + 1)
        ]

    def _make_box(self, window: tuple[slice, ...] | None) -> None:
        """The box on a part of the lattice."""
        if window is None:
            self.box = None
            return
        shape = tuple(w.stop - w.start for w in window)[3 - self.sum.stencil.dimension :]
        self.box = NonlocalSum(
            self.scene.interface_stencil, shape, processes=self.processes, window=window
        )
        reach = self.sum.reach
        self.window = tuple(
            slice(w.start + r, w.stop + r) for w, r in zip(window, reach, strict=True)
        )

    def _around(self, metal: np.ndarray, reaches: int) -> tuple[slice, ...] | None:
        """The part of the lattice within some reaches of metal (padded, bool)."""
        reach = tuple(reaches * r for r in self.sum.reach)
        return box_in_reach(metal[self.sum.interior], reach, self.processes)

    def take(self, values: np.ndarray) -> np.ndarray:
        """The box's part of a padded field, padded itself."""
        out = np.zeros(self.box.padded_shape)
        out[self.box.interior] = values[self.window]
        return out

    def put(self, values: np.ndarray) -> np.ndarray:
        """A padded field that is zero but for the box's padded values."""
        out = np.zeros(self.sum.padded_shape)
        out[self.window] = values[self.box.interior]
        return out

    def update_phase(self) -> None:
        """Recompute what depends on which nodes are metal."""
        liquid = self.domain & ~self.metal
        self.free = liquid & ~self.fixed
        self.flow = self.sum.on_rows_of(liquid)
        self.liquid_volume = np.where(liquid, self.capacity, 0.0)
        self.free_volume = np.where(self.free, self.capacity, 0.0)
        self.neighbour_liquid = self.sum(self.liquid_volume)
        self.largest_sum = self.processes.largest(float(self.neighbour_liquid.max()))
        self._rates = self._beside = None
        if self.walls is not None:
            volume = self.sum.crop(self.liquid_volume)
            self.walls.update(volume, self.scene.liquid_diffusivity * volume)
        if self.box is not None:
            self._update_box()

    def _update_box(self) -> None:
        self.box = self.box.on_rows_of(self.take(self.liquid_volume) > 0, around=True)
        self.box_metal = self.take(self.metal) > 0
        self.box_phase = np.where(self.box_metal, self.take(self.solid), 0).astype(np.uint8)
        self.box_metal_volume = self.take(np.where(self.metal, self.capacity, 0.0))
        self.box_liquid_volume = self.take(self.liquid_volume)
        self.box_free_volume = self.take(self.free_volume)
        self.box_neighbour_liquid = self.take(self.neighbour_liquid)
        self.box_seen_metal = self.box(self.box_metal_volume)
        self.box_fixed_volume = self.take(np.where(self.fixed, self.capacity, 0.0))
        self.box_of_fixed = self.box.on_rows_of(self.box_fixed_volume > 0)
        self.box_seen_liquid = self.box_neighbour_liquid
        if self.box.stencil is not self.sum.stencil:
            self.box_seen_liquid = self.box(self.box_liquid_volume)

    def beside_liquid(self) -> Self:
        """The same with a box no larger than the law of the bonds needs (InterfaceLaw.reaches).

        box_far : bool, nodes of it beyond a reach of the metal that sees liquid, by the enclosing
        box: if a stage empties one, what it exposes lies off the box.
        """
        if self._beside is None:
            exposed = self.put(self.box_metal & (self.box_seen_liquid > 0)) > 0
            near, wide = (self._around(exposed, n) for n in (1, self.scene.dissolution.reaches))
            if near is None or wide is None:
                return self
            window = _common(wide, self.window, self.sum.reach)
            cells = math.prod(w.stop - w.start for w in window)
            if not self.processes.any(cells < _SMALLER * math.prod(self.box.shape)):
                return self
            part = copy.copy(self)
            part._make_box(window)
            part._update_box()
            far = np.ones(self.sum.padded_shape)
            far[self.sum.interior][near] = 0.0
            part.box_far = part.take(far) > 0
            self._beside = part
        return self._beside

    def to_part(self, part: Phases, values: np.ndarray) -> np.ndarray:
        """A padded field of this box on that of `beside_liquid`."""
        if part is self:
            return values
        out = np.zeros(part.box.padded_shape)
        out[part.box.interior] = values[self._place(part)]
        return out

    def from_part(self, part: Phases, values: np.ndarray, elsewhere: np.ndarray) -> np.ndarray:
        """The other way; off the smaller box the field is `elsewhere` (padded)."""
        if part is self:
            return values
        out = elsewhere.astype(float)
        out[self._place(part)] = values[part.box.interior]
        return out

    def _place(self, part: Phases) -> tuple[slice, ...]:
        """Where the nodes of a smaller box are in padded arrays of this one."""
        return tuple(
            slice(p.start - w.start + r, p.stop - w.start + r)
            for p, w, r in zip(part.window, self.window, self.box.reach, strict=True)
        )

    def dissolve(self, gone: np.ndarray | None) -> int:
        """Turn metal nodes into liquid; returns how many (over all processes)."""
        if gone is None:
            return 0
        count = int(self.processes.total(int(gone.sum())))
        if count:
            self.metal = self.metal & ~gone
            self.update_phase()
        return count


def _common(
    window: tuple[slice, ...], padded: tuple[slice, ...], reach: tuple[int, ...]
) -> tuple[slice, ...]:
    """What a part of the lattice has in common with one in places of padded arrays."""
    return tuple(
        slice(max(w.start, p.start - r), min(w.stop, p.stop - r))
        for w, p, r in zip(window, padded, reach, strict=True)
    )
