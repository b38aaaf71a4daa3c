"""The flux of each cell's metal from the shares of cells alone, wherever the surface is.

    X_i = f_i sum_j k_ij (1 - f_j) + sum_n c_in f_i f_n (f_n - f_i).

The weights k (share_weights) give every front the continuum's strength.  What a cell draws from
those next to it along the axes these lose, so the flux of all cells stays what it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.scene import CorrosionScene
from peri.engine.operators import NonlocalSum
from peri.engine.processes import OneProcess
from peri.engine.surface.flat_front import FlatFront

Array = NDArray[np.float64]


class ShareFlux:
    """Flux by shares on the lattice of a scene with rate classes; shares are padded arrays.

    Parameters
    ----------
    scene : CorrosionScene
    front : FlatFront
        Of its horizon, kernel exponent and influence.
    rows : bool array of the lattice's shape
        Nodes whose flux is wanted.
    processes : OneProcess or its like

    total : sum of k, 1/m^2.  handed : see ShareBonds.
    """

    def __init__(
        self, scene: CorrosionScene, front: FlatFront, rows: NDArray[np.bool_],
        processes: OneProcess,
    ) -> None:  # fmt: skip
        bonds, shape = scene.cut_cell_bonds(front), scene.lattice.shape
        self._sum = NonlocalSum(bonds.weights, shape, rows, processes=processes)
        self._next = NonlocalSum(bonds.drawing, shape, rows, processes=processes)
        self.total, self.handed = bonds.weights.total, bonds.handed

    def seen(self, share: Array) -> Array:
        """sum_j k_ij f_j, 1/m^2, of shares of metal."""
        return self._sum(share)

    def drawn(self, share: Array) -> Array:
        """sum_n c_in f_i f_n (f_n - f_i), 1/m^2, of shares of metal; it adds up to zero."""
        return share * (self._next(share**2) - share * self._next(share))
