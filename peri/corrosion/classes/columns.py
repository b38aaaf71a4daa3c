"""The classes of a cell as layers below its surface: how they go, and what each of them sees.

A cell's classes are ordered by their rates: the first lies at the surface.  y is the life that is
left of a class, as a share of that of untouched metal: C/C_solid under Faraday's law,
ln(C/C_sat)/ln(C_solid/C_sat) under the proportional one, so that 0 is where metal ends.

How they go.  y grows linearly with depth from a class to the next one below it; what lies above
y = 0 is gone.  With x the thickness that is left of a class, v' that of the one below,

    y = y' x / (2 x + v'),   so  x = v' y / (y' - 2 y)  where that is less than what there was.

The last class of a cell has the profile of a travelling front, y x = int_0^x F (FlatFront.life).

What each sees.  The cell's flux X (of all its metal, per cell) is given.  The classes that are
left keep the share `kept` of what they saw at the start; the rest goes to them in proportion to the
flat front's profile at their depths, the top of the column as deep as X says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.surface.flat_front import FlatFront
from peri.engine.surface.rate_classes import RateClasses

Array = NDArray[np.float64]

_LEAST = 1e-9
"""Of the profile: where the flat front sees nothing, what there is goes to all alike."""


class Columns:
    """Classes by cell, from the surface down.

    Parameters
    ----------
    metal : RateClasses
    height : float
        Of a cell, in horizons.
    front : FlatFront
    processes : OneProcess or its like
        Who holds the classes of other blocks of the lattice.

    cell, volume, exposure : (n,) as in RateClasses, ascending by cell and from the surface down;
    deep metal, which has one class there, has as many equal ones as other cells.
    first : (r,) cell of each column.  row, place : (n,) column and place of each class.
    """

    def __init__(
        self,
        metal: RateClasses,
        height: float,
        front: FlatFront,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self.height, self.front = height, front
        _, which, count = np.unique(metal.cell, return_inverse=True, return_counts=True)
        most = int(processes.largest(int(count.max(initial=1))))
        parts = np.where((count[which] == 1) & (metal.exposure == 0), most, 1)
        cell, volume = np.repeat(metal.cell, parts), np.repeat(metal.volume / parts, parts)
        exposure = np.repeat(metal.exposure, parts)
        order = np.lexsort((-exposure, cell))
        self.cell, self.volume, self.exposure = cell[order], volume[order], exposure[order]
        self.first, start, self.row = np.unique(self.cell, return_index=True, return_inverse=True)
        self.place = np.arange(self.cell.size) - start[self.row]
        self.shape = (self.first.size, most)

    def table(self, values: Array) -> Array:
        """(r, P): the classes' values by column, 0 where a column has fewer."""
        out = np.zeros(self.shape)
        out[self.row, self.place] = values
        return out

    def total(self, values: Array) -> Array:
        """(r,): sums over the columns."""
        return np.bincount(self.row, values, self.first.size).astype(float)

    def thinned(self, volume: Array, life: Array) -> Array:
        """Volumes (n,) that are left of classes with `volume` and the life y (both n,)."""
        v, y = self.table(volume), self.table(life)
        below, its = np.zeros(self.shape), np.zeros(self.shape)
        below[:, :-1], its[:, :-1] = v[:, 1:], y[:, 1:]
        slope = its - 2 * y
        left = np.divide(below * y, slope, out=np.full(self.shape, np.inf), where=slope > 0)
        last = below == 0
        left[last] = self.front.slab(np.maximum(y * v, 0.0)[last] * self.height) / self.height
        left = np.where(y > 0, np.clip(left, 0.0, v), 0.0)
        return left[self.row, self.place]

    def rates(self, volume: Array, flux: Array, strength: float, kept: Array, old: Array) -> Array:
        """Bond sums G (n,) of the classes, 1/m^2.

        Parameters
        ----------
        volume : (n,) that is left.
        flux : (r,) sum of volume G that each column should have, 1/m^2.
        strength : float
            Flux of a flat front over its horizon, S / delta, 1/m^2.
        kept : (r,) share of `old` that still counts.
        old : (n,) G at the start.
        """
        v = self.table(volume)
        old = kept[self.row] * np.where(volume > 0, old, 0.0)
        gained = np.maximum(flux - self.total(volume * old), 0.0)
        bottom = np.cumsum(v, axis=1) * self.height
        top = self.front.top(flux * self.height / strength, bottom[:, -1])
        middle = top[:, None] + bottom - 0.5 * self.height * v
        shape = np.where(v > 0, np.maximum(self.front.profile(middle), _LEAST), 0.0)
        whole = (v * shape).sum(axis=1)
        each = np.divide(gained, whole, out=np.zeros_like(gained), where=whole > 0)
        return old + (each[:, None] * shape)[self.row, self.place]
