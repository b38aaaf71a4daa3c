"""How a lattice is shared out: the hooks through which the same solvers run on one or many ranks.

A rank holds a block of the lattice.  Everything outside this file works on local padded arrays
whose ghosts hold zero, so that a sum over an array counts every node once; the nonlocal sum
alone asks for the neighbours' values (`with_ghosts`), and every number that steers the march
goes through `total`, `largest` or `any`.  Here they do nothing, for one process that holds the
whole lattice; petsc_backend.py has the same methods for MPI ranks.
"""

from __future__ import annotations

import numpy as np


class OneProcess:
    """One process holds the whole lattice: nothing to exchange, nothing to reduce.

    is_root : whether results and progress belong to this process.
    start : index of the block's first node in the whole lattice, on three axes.
    multigrid : what replaces solvers.LocalMultigrid, or None.
    """

    is_root = True
    start = (0, 0, 0)
    multigrid = None

    def local_scene(self, scene):
        """The scene of this process's block."""
        return scene

    def with_ghosts(self, values: np.ndarray, window: tuple[slice, ...] | None) -> np.ndarray:
        """A padded field with the neighbours' values in its ghosts.

        window: the part of the block that `values` covers (None: all of it); nodes outside
        every process's window count as zero.
        """
        return values

    def total(self, value: float) -> float:
        """Sum over the processes."""
        return value

    def largest(self, value: float) -> float:
        """Maximum over the processes."""
        return value

    def any(self, flag: bool) -> bool:
        """Whether the flag holds on any process."""
        return bool(flag)

    def from_root(self, value):
        """The root's value (any Python object)."""
        return value

    def gather(self, values: np.ndarray) -> np.ndarray:
        """The whole lattice's array on the root (elsewhere an empty array)."""
        return values

    def scatter(self, values: np.ndarray) -> np.ndarray:
        """This process's block of the root's array."""
        return values


ONE_PROCESS = OneProcess()
