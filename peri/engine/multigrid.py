"""Geometric multigrid for the local operator of the same coefficients as a nonlocal one."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from peri.engine import multigrid_kernels

_COARSEST_CELLS = 150
_LONGEST_LINE = 20_000
_SMOOTHING_STEPS = 2
_FIRST_SCALE = 4.0 / 3.0 / 2.0
_INNER = (slice(1, -1),) * 3


class LocalMultigrid:
    """One symmetric cycle for sink_i u_i + sum_faces t (u_i - u_j) = b_i on a box of cells.

    Cells are aggregated by two along the axes of (nearly) the smallest spacing, conductances
    are rediscretised (half the sum of the fine faces), restriction sums and prolongation is
    piecewise constant, hence the W-cycle; Chebyshev smoothing (fourth kind), direct solution of
    the coarsest level.

    Parameters
    ----------
    sink : array (nx, ny, nz)
        Row sums of the operator, >= 0.
    faces : per axis, array with one entry more along that axis
        Conductances t between neighbouring cells, 1/s, the box's own borders included (where
        they are not used: a single process holds the whole lattice).
    spacing : tuple of float
        Cell size per axis, m.
    coarsest_start : float or sequence
        Cells no larger than this (m, per axis) along an axis are aggregated before the first
        level.
    """

    def __init__(
        self,
        sink: np.ndarray,
        faces: Sequence[np.ndarray],
        spacing: Sequence[float],
        coarsest_start: float | np.ndarray = 0.0,
    ) -> None:
        # Of a cell, the face to its successor.
        t = [face[(slice(None),) * a + (slice(1, None),)] for a, face in enumerate(faces)]
        self.extent = sink.shape
        self.factors = np.ones(3, np.int64)
        self._before, between = coarsening_plan(sink.shape, spacing, coarsest_start)
        for grow in self._before:
            sink, t = _coarsen(sink, t, grow)
            self.factors *= np.where(grow, 2, 1)
        self.levels = [_Level(sink, t)]
        self.steps = []
        for grow in between:
            if _is_line(sink.shape) and np.sort(self.factors * sink.shape)[-2] > 2:
                break
            sink, t = _coarsen(sink, t, grow)
            self.steps.append(tuple(int(v) for v in np.where(grow, 2, 1)))
            self.levels.append(_Level(sink, t))
        self.levels[-1].factorise()

    def with_sink(self, sink: np.ndarray) -> LocalMultigrid:
        """The same for other row sums, (nx, ny, nz): conductances and work arrays are shared."""
        other = copy.copy(self)
        for grow in self._before:
            sink, _ = _coarsen(sink, [], grow)
        other.levels = [self.levels[0].with_sink(sink)]
        for step, level in zip(self.steps, self.levels[1:], strict=True):
            sink, _ = _coarsen(sink, [], np.array(step) > 1)
            other.levels.append(level.with_sink(sink))
        other.levels[-1].factorise()
        return other

    def restrict(self, residual: np.ndarray, first: tuple[int, ...]) -> np.ndarray:
        """Sum a fine-lattice residual, whose box begins at `first`, into the first level."""
        level = self.levels[0]
        factors = tuple(int(f) for f in self.factors)
        multigrid_kernels.aggregate(residual, first, self.extent, factors, level.b)
        return level.b

    def cycle(self, index: int = 0) -> np.ndarray:
        """Approximate solution for the right side stored in level `index`."""
        level = self.levels[index]
        if index == len(self.levels) - 1:
            return level.solve()
        level.smooth(from_zero=True)
        visits = 1 if index == 0 else 2
        for _ in range(visits):
            coarse = self.levels[index + 1]
            level.residual()
            multigrid_kernels.aggregate(
                level.r, (1, 1, 1), level.extent, self.steps[index], coarse.b
            )
            multigrid_kernels.prolong_add(
                self.cycle(index + 1), self.steps[index], (1, 1, 1), level.x
            )
            level.smooth(from_zero=False)
        return level.x


def _is_line(shape: Sequence[int]) -> bool:
    """Whether a level is long along one axis only, so that a direct solution is the cheapest.

    On lattices of 25:1 the short spacings are aggregated until the gap is one or two cells wide;
    a W-cycle would visit what follows 2^levels times (128 on a crevice of 512 x 33 nodes).
    """
    return sorted(shape)[-2] <= 2 and max(shape) <= _LONGEST_LINE


def coarsening_plan(
    shape: Sequence[int], spacing: Sequence[float], coarsest_start: float | np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Which axes to aggregate by two, step by step: before the first level, between the levels.

    Each step is a bool array (3,).  Between the levels only axes with (nearly) the smallest
    spacing take part, so that couplings become equal.
    """
    n, h = np.array(shape), np.array(spacing, float)
    before, between = [], []
    # A wave along a longer spacing is no matter of the nodes' diagonal, which short bonds make.
    short = h < 1.5 * h[n > 2].min(initial=np.inf)
    while (grow := (2 * h <= coarsest_start) & (n > 2) & short).any():
        before.append(grow)
        n, h = np.where(grow, -(-n // 2), n), np.where(grow, 2, 1) * h
    while n.prod() > _COARSEST_CELLS and (n > 2).any():
        grow = (n > 2) & (h < 1.5 * h[n > 2].min())
        between.append(grow)
        n, h = np.where(grow, -(-n // 2), n), np.where(grow, 2, 1) * h
    return before, between


def _coarsen(
    sink: np.ndarray, t: list[np.ndarray], grow: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Aggregate cells by two along the axes marked in `grow`."""

    def pairs(values: np.ndarray, a: int, combine: Callable) -> np.ndarray:
        if values.shape[a] % 2:
            width = [(0, 0)] * 3
            width[a] = (0, 1)
            values = np.pad(values, width)
        even, odd = [slice(None)] * 3, [slice(None)] * 3
        even[a], odd[a] = slice(0, None, 2), slice(1, None, 2)
        return combine(values[tuple(even)], values[tuple(odd)])

    for a in np.flatnonzero(grow):
        sink = pairs(sink, a, np.add)
        t = [
            pairs(face, a, (lambda even, odd: 0.5 * odd) if b == a else np.add)
            for b, face in enumerate(t)
        ]
    return sink, t


class _Level:
    """Operator and work arrays of one level."""

    def __init__(self, sink: np.ndarray, t: list[np.ndarray]) -> None:
        self.extent = sink.shape
        shape = tuple(n + 2 for n in sink.shape)
        self.t = []
        for face in t:
            padded = np.zeros(shape)
            padded[_INNER] = face
            self.t.append(padded)
        self._make_diagonal(sink)
        self.x, self.b, self.d, self.r = (np.zeros(shape) for _ in range(4))

    def _make_diagonal(self, sink: np.ndarray) -> None:
        self.diagonal = np.zeros(tuple(n + 2 for n in sink.shape))
        self.diagonal[_INNER] = sink
        for a, face in enumerate(self.t):
            self.diagonal += face + np.roll(face, 1, axis=a)
        filled = self.diagonal > 0
        self.inverse = np.where(filled, 1.0 / np.where(filled, self.diagonal, 1.0), 0.0)

    def with_sink(self, sink: np.ndarray) -> _Level:
        """See LocalMultigrid.with_sink."""
        other = copy.copy(self)
        other._make_diagonal(sink)
        return other

    def smooth(self, from_zero: bool) -> None:
        """Chebyshev steps of the fourth kind for the spectrum (0, 2] of the scaled operator."""
        if from_zero:
            multigrid_kernels.first_step(self.x, self.b, self.inverse, self.d, _FIRST_SCALE)
        for n in range(2 if from_zero else 1, _SMOOTHING_STEPS + 1):
            multigrid_kernels.local_step(
                self.x,
                self.b,
                *self.t,
                self.inverse,
                self.d,
                (2 * n - 3) / (2 * n + 1) if n > 1 else 0.0,
                (8 * n - 4) / (2 * n + 1) / 2.0,  # _FIRST_SCALE for n = 1
            )
            multigrid_kernels.add_to(self.x, self.d)

    def residual(self) -> None:
        multigrid_kernels.local_residual(self.x, self.b, *self.t, self.diagonal, self.r)

    def factorise(self) -> None:
        """Dense inverse of a small operator, sparse factors of a long one."""
        cells = np.flatnonzero(self.diagonal.ravel() > 0)
        number = np.full(self.diagonal.size, -1)
        number[cells] = np.arange(cells.size)
        self.cells, self.factors = cells, None
        entries = [(number[cells], number[cells], self.diagonal.ravel()[cells])]
        for a, face in enumerate(self.t):
            stride = int(np.prod(self.diagonal.shape[a + 1 :]))
            here = np.flatnonzero(face.ravel() > 0)
            one, two = number[here], number[here + stride]
            entries += [(one, two, -face.ravel()[here]), (two, one, -face.ravel()[here])]
        rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
        if cells.size > _COARSEST_CELLS and _is_line([n - 2 for n in self.diagonal.shape]):
            matrix = sparse.csc_matrix((values, (rows, columns)), (cells.size, cells.size))
            self.factors = splu(matrix)
            return
        dense = np.zeros((cells.size, cells.size))
        np.add.at(dense, (rows, columns), values)
        self.matrix_inverse = np.linalg.inv(dense)

    def solve(self) -> np.ndarray:
        right = self.b.ravel()[self.cells]
        solution = (
            self.matrix_inverse @ right if self.factors is None else self.factors.solve(right)
        )
        self.x.ravel()[self.cells] = solution
        return self.x
