"""Tensor bonds: forces along the bond, (xi (x) xi) / |xi|^2, as convolutions.

Linear bond-based mechanics moves node i by sum_j k_ij n (n . (u_j - u_i)), n the bond's direction.
The products n_a n_a are even in every axis, n_a n_b is odd in both: each component of the tensor
is a stencil of its own and a fast sum.
"""

from __future__ import annotations

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.schemes.broken import BrokenBonds, BrokenSum


def tensor_stencils(stencil: Stencil) -> dict[tuple[int, int], Stencil]:
    """w n_a n_b for the pairs of axes a <= b, n the bond's direction; of an even stencil.

    Their sum over a = b is the stencil itself.
    """
    d = stencil.dimension
    position = np.meshgrid(
        *[h * np.arange(n) for h, n in zip(stencil.spacing, stencil.octant.shape, strict=True)],
        indexing="ij",
    )
    squared = sum(x**2 for x in position)
    squared = np.where(squared > 0, squared, 1.0)
    return {
        (a, b): Stencil(
            stencil.octant * position[a] * position[b] / squared,
            stencil.spacing,
            tuple(-1 if a != b and axis in (a, b) else 1 for axis in range(d)),
        )
        for a in range(d)
        for b in range(a, d)
    }


class TensorConvolution:
    """(A u)_i = c_i sum_j w_ij c_j n (n . (u_i - u_j)) for vector fields; symmetric, >= 0.

    Fields are padded arrays with the component first, (d, *padded shape).

    Parameters
    ----------
    stencil : Stencil
        Even weights w.
    shape : tuple of int
        Nodes of the lattice per axis.
    capacity : array of `shape`
        c, 0 where nodes do not exist.
    broken : BrokenBonds, optional
        Of the same stencil and shape.
    processes : OneProcess or its like
        Not with broken bonds.
    """

    symmetric = True

    def __init__(
        self,
        stencil: Stencil,
        shape: tuple[int, ...],
        capacity: np.ndarray,
        broken: BrokenBonds | None = None,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        if broken is not None and processes is not ONE_PROCESS:
            raise ValueError("broken: broken bonds need the whole lattice in one process")
        wanted = np.asarray(capacity) > 0
        self.sums: dict[tuple[int, int], NonlocalSum] = {}
        for pair, part in tensor_stencils(stencil).items():
            self.sums[pair] = (
                NonlocalSum(part, shape, wanted, processes=processes)
                if broken is None
                else BrokenSum(part, shape, broken, wanted)
            )
        self.sum = self.sums[0, 0]
        self.dimension = stencil.dimension
        self.capacity = self.sum.pad(capacity)
        self.blocks = {pair: self.capacity * s(self.capacity) for pair, s in self.sums.items()}
        self._scaled, self._part = (np.zeros(self.sum.padded_shape) for _ in range(2))

    def apply(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        """out = A u; u and out (d, *padded shape), u zero in the ghosts."""
        out[:] = 0.0
        axes = range(self.dimension)
        for b in axes:
            np.multiply(self.capacity, u[b], out=self._scaled)
            for a in axes:
                pair = (min(a, b), max(a, b))
                self.sums[pair](self._scaled, self._part)
                out[a] += self.blocks[pair] * u[b] - self.capacity * self._part
        return out

    def diagonal_blocks(self) -> np.ndarray:
        """(d, d, *padded shape): the symmetric block of each node with itself."""
        d = self.dimension
        out = np.zeros((d, d, *self.sum.padded_shape))
        for (a, b), block in self.blocks.items():
            out[a, b] = out[b, a] = block
        return out
