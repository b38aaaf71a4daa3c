"""How a lattice is shared out: the hooks through which the same solvers run on one or many ranks.

A rank holds a block of the lattice.  Everything outside this file works on local padded arrays
whose ghosts hold zero, so that a sum over an array counts every node once; the nonlocal sum
alone asks for the neighbours' values (`with_ghosts`), and every number that steers the march
goes through `total`, `largest` or `any`.  Here they do nothing, for one process that holds the
whole lattice; parallel/ranks.py has the same methods for MPI ranks.

A number that an array of nodes is reduced to steers every process alike only if it is reduced over
all of them, and an error that one process raises must be raised by all (`together`): else some wait
for an exchange that the others do not come to.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeVar

import numpy as np

T = TypeVar("T")
Number = TypeVar("Number", float, np.ndarray)

LEAST_SINGULAR = 1e-12
"""Of the largest singular value of a least-squares problem: what lies below counts as zero."""

_IMBALANCE = 0.1
"""How far a cut between two blocks may move to suit the coarse levels, as a share of its width:
a larger share gives the multigrid more common levels and the ranks less even work."""


class OneProcess:
    """One process holds the whole lattice: nothing to exchange, nothing to reduce.

    is_root : whether results and progress belong to this process.
    whole : whether this process holds the whole lattice.
    start : index of the block's first node in the whole lattice, on three axes.
    multigrid : what replaces engine.multigrid.LocalMultigrid, or None.
    """

    is_root = True
    whole = True
    start = (0, 0, 0)
    multigrid = None

    def extent(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Nodes per axis of the whole array of which this process holds `shape`."""
        return shape

    def with_ghosts(self, values: np.ndarray, window: tuple[slice, ...] | None) -> np.ndarray:
        """A padded field with the neighbours' values in its ghosts.

        window: the part of the block that `values` covers (None: all of it); nodes outside
        every process's window count as zero.  The array is good until the next exchange.
        """
        return values

    def total(self, value: float) -> float:
        """Sum over the processes."""
        return value

    def added(self, values: np.ndarray) -> np.ndarray:
        """Sums over the processes of each entry of an array of numbers, not of nodes."""
        return values

    def largest(self, value: Number) -> Number:
        """Maximum over the processes, of an array entry by entry."""
        return value

    def norm(self, values: np.ndarray) -> float:
        """Root of the sum of squares of a field over the processes."""
        return float(np.linalg.norm(values))

    def row_norms(self, rows: np.ndarray) -> np.ndarray:
        """The same of every row of (R, n), (R,)."""
        return np.linalg.norm(rows, axis=1)

    def least_squares(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        """x (k,) of least |matrix x - right| over the processes' rows, (n, k) and (n,)."""
        return np.linalg.lstsq(matrix, right, rcond=LEAST_SINGULAR)[0]

    def any(self, flag: bool) -> bool:
        """Whether the flag holds on any process."""
        return bool(flag)

    def first(self, flag: bool) -> bool:
        """Whether this is the first of the processes that the flag holds on."""
        return bool(flag)

    def from_root(self, value: T) -> T:
        """The root's value (any Python object)."""
        return value

    def on_root(self, action: Callable[[], T]) -> T:
        """The result of an action that the root takes; what it raises is raised everywhere."""
        return action()

    def together(self, action: Callable[[], T]) -> T:
        """The result of an action that each process takes by itself, without exchange.

        An ArithmeticError that it raises on any process is raised on all.
        """
        return action()

    def gather(self, values: np.ndarray) -> np.ndarray:
        """The whole lattice's array on the root (elsewhere an empty array)."""
        return values

    def scatter(self, values: np.ndarray) -> np.ndarray:
        """This process's block of the root's array."""
        return values


ONE_PROCESS = OneProcess()


def box_in_reach(
    cells: np.ndarray, reach: tuple[int, ...], processes: OneProcess
) -> tuple[slice, ...] | None:
    """This process's part of the box within reach of the marked cells of all processes.

    cells : (nx, ny, nz) bool, of the block.  A block that lies off the box takes part with one
    layer of nodes.  None where no process has marked cells.
    """
    window, largest = [], processes.largest
    for a, (width, start) in enumerate(zip(reach, processes.start, strict=True)):
        present = np.flatnonzero(cells.any(axis=tuple(b for b in range(3) if b != a)))
        first = -largest(-(present[0] + start) if present.size else -np.inf)
        last = largest(present[-1] + start if present.size else -np.inf)
        if first > last:
            return None
        n = cells.shape[a]
        low = min(max(0, int(first) - width - start), n - 1)
        window.append(slice(low, max(low + 1, min(n, int(last) + width + 1 - start))))
    return tuple(window)


def work_per_plane(domain: np.ndarray) -> list[np.ndarray]:
    """Nodes per plane along every axis; empty ones count a little (they are still swept over)."""
    axes = range(domain.ndim)
    return [
        domain.sum(axis=tuple(b for b in axes if b != a)) + 0.1 * domain.size / domain.shape[a]
        for a in axes
    ]


def share_out(work: list[np.ndarray], width: int, ranks: int) -> list[list[int]]:
    """Cut a lattice into one block per rank: the edges of the blocks along each axis.

    The cuts give every slab equal work, nearly: they are moved to the next multiple of a power
    of two, as high as it can be, so that coarser levels of the lattice have whole cells.

    Parameters
    ----------
    work : per axis, (n,) work of each plane of nodes
    width : narrowest block along a divided axis
    ranks : number of blocks

    Raises
    ------
    ValueError
        If there is no such cut.
    """
    shape = tuple(w.size for w in work)
    candidates = []
    for parts in itertools.product(range(1, ranks + 1), repeat=len(shape)):
        if np.prod(parts) != ranks:
            continue
        cuts = [_cut(w, p, width) for w, p in zip(work, parts, strict=True)]
        edges = [cut for cut in cuts if cut is not None]
        if len(edges) < len(cuts):
            continue
        # Nodes next to a cut; of equals, the one that keeps the rows long.
        surface = sum((p - 1) * np.prod(shape) / n for p, n in zip(parts, shape, strict=True))
        candidates.append((float(surface), parts[::-1], edges))
    if not candidates:
        raise ValueError(
            f"ranks: {ranks} for a lattice of {' x '.join(map(str, shape))} nodes; every rank's "
            f"block must be at least as wide as the stencil reaches, {width} nodes, so use fewer"
        )
    return min(candidates)[2]


def _cut(work: np.ndarray, parts: int, width: int) -> list[int] | None:
    """Edges of `parts` slabs of equal work, at least `width` wide; None if there are none."""
    n = work.size
    if parts == 1:
        return [0, n]
    if parts * width > n:
        return None
    done = np.concatenate([[0.0], np.cumsum(work)])
    ideal = np.interp(np.arange(1, parts) / parts * done[-1], done, np.arange(n + 1))
    multiple = 1
    while 2 * multiple <= n // parts:
        multiple *= 2
    while multiple:
        edges = [0]
        for p, place in enumerate(ideal, 1):
            edge = multiple * round(place / multiple)
            if multiple == 1:
                edge = min(max(edge, edges[-1] + width), n - (parts - p) * width)
            edges.append(edge)
        edges.append(n)
        off = np.abs(np.array(edges[1:-1]) - ideal).max()
        if multiple == 1 or (np.diff(edges).min() >= width and off <= _IMBALANCE * n / parts):
            return edges
        multiple //= 2
    return None
