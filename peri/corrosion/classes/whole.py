"""The classes of the whole solid on the root: what a checkpoint holds, whatever the ranks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.columns import Columns
from peri.engine.processes import OneProcess
from peri.engine.surface.rate_classes import RateClasses

Array = NDArray[np.float64]


class WholeClasses:
    """Values by class from and to the blocks of a lattice.

    They travel as lattice arrays: the first class of every cell, the second, and so on.

    Parameters
    ----------
    metal : RateClasses
        Of the whole solid, on the root; elsewhere None.
    columns : Columns
        Of this process's block.
    processes : OneProcess or its like
    """

    def __init__(self, metal: RateClasses | None, columns: Columns, processes: OneProcess) -> None:
        self.columns, self.processes = columns, processes
        self.whole: Columns | None = None
        if metal is not None and not processes.whole:
            self.whole = Columns(metal, columns.height, columns.front)

    def gather(self, values: Array) -> Array:
        """(n,) of the whole solid on the root, from those of the blocks; elsewhere empty."""
        if self.processes.whole:
            return values
        out = np.empty(0 if self.whole is None else self.whole.cell.size)
        for place in range(self.columns.shape[1]):
            field = np.zeros(self.processes.block_shape)
            here = self.columns.place == place
            field.ravel()[self.columns.cell[here]] = values[here]
            field = self.processes.gather(field)
            if self.whole is not None:
                there = self.whole.place == place
                out[there] = field.ravel()[self.whole.cell[there]]
        return out

    def scatter(self, stored: Array | None) -> Array:
        """(n,) of this process's block, from the whole solid's on the root."""
        if self.processes.whole:
            assert stored is not None
            return stored
        out = np.empty(self.columns.cell.size)
        for place in range(self.columns.shape[1]):
            field = None
            if self.whole is not None:
                assert stored is not None
                there = self.whole.place == place
                field = np.zeros(self.processes.shape)
                field.ravel()[self.whole.cell[there]] = stored[there]
            field = self.processes.scatter(field)
            here = self.columns.place == place
            out[here] = field.ravel()[self.columns.cell[here]]
        return out
