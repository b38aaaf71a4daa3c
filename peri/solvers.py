"""Conjugate gradients for shifted nonlocal diffusion, with a two-scale preconditioner.

The symbol of the nonlocal operator is D|k|^2 for long waves and levels off at the bond sum for
short ones, so 1/symbol is close to 1/(D|k|^2) + 1/(bond sum).  The preconditioner is that sum:
one multigrid cycle of the *local* operator of the same coefficients plus the inverse of the
nonlocal diagonal.  It needs no product with the nonlocal operator.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from peri import kernels
from peri.operators import NonlocalSum

log = logging.getLogger(__name__)

_COARSEST_CELLS = 150
_SMOOTHING_STEPS = 2


class ConvergenceError(ArithmeticError):
    """The linear solver did not reach its tolerance; the message says how far it came."""


class LocalMultigrid:
    """One symmetric cycle for sink_i u_i + sum_faces t (u_i - u_j) = b_i on a box of cells.

    Cells are aggregated by two along the axes of (nearly) the smallest spacing, conductances
    are rediscretised (half the sum of the fine faces), restriction sums and prolongation is
    piecewise constant, hence the W-cycle; Chebyshev smoothing (fourth kind), direct solution of
    the coarsest level.

    Parameters
    ----------
    capacity : array (nx, ny, nz)
        Relative volume of the cells of the finest *lattice*, 0 for cells that are no unknowns.
    sink : array (nx, ny, nz)
        Row sums of the operator, >= 0.
    conductance : tuple of float
        D / dx_a^2 per axis, 1/s.
    spacing : tuple of float
        Cell size per axis, m.
    coarsest_start : float or sequence
        Cells no larger than this (m, per axis) along an axis are aggregated before the first
        level.
    """

    def __init__(self, capacity, sink, conductance, spacing, coarsest_start=0.0) -> None:
        t = []
        for a in range(3):
            face = np.zeros_like(capacity)
            here, after = [slice(None)] * 3, [slice(None)] * 3
            here[a], after[a] = slice(0, -1), slice(1, None)
            face[tuple(here)] = conductance[a] * capacity[tuple(here)] * capacity[tuple(after)]
            t.append(face)
        self.factors = np.ones(3, np.int64)
        before, between = coarsening_plan(sink.shape, spacing, coarsest_start)
        for grow in before:
            sink, t = _coarsen(sink, t, grow)
            self.factors *= np.where(grow, 2, 1)
        self.levels = [_Level(sink, t)]
        self.steps = []
        for grow in between:
            sink, t = _coarsen(sink, t, grow)
            self.steps.append(tuple(int(v) for v in np.where(grow, 2, 1)))
            self.levels.append(_Level(sink, t))
        self.levels[-1].factorise()

    def restrict(self, residual: np.ndarray, reach) -> np.ndarray:
        """Sum a padded fine-lattice residual into the right side of the first level."""
        level = self.levels[0]
        kernels.aggregate(residual, reach, tuple(int(f) for f in self.factors), level.b)
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
            kernels.aggregate(level.r, (1, 1, 1), self.steps[index], coarse.b)
            kernels.prolong_add(self.cycle(index + 1), self.steps[index], (1, 1, 1), level.x)
            level.smooth(from_zero=False)
        return level.x


def coarsening_plan(shape, spacing, coarsest_start):
    """Which axes to aggregate by two, step by step: before the first level, between the levels.

    Each step is a bool array (3,).  Between the levels only axes with (nearly) the smallest
    spacing take part, so that couplings become equal.
    """
    shape, spacing = np.array(shape), np.array(spacing, float)
    before, between = [], []
    while (grow := (2 * spacing <= coarsest_start) & (shape > 2)).any():
        before.append(grow)
        shape, spacing = np.where(grow, -(-shape // 2), shape), np.where(grow, 2, 1) * spacing
    while shape.prod() > _COARSEST_CELLS and (shape > 2).any():
        grow = (shape > 2) & (spacing < 1.5 * spacing[shape > 2].min())
        between.append(grow)
        shape, spacing = np.where(grow, -(-shape // 2), shape), np.where(grow, 2, 1) * spacing
    return before, between


def _coarsen(sink, t, grow):
    """Aggregate cells by two along the axes marked in `grow`."""

    def pairs(values, a, combine):
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

    def __init__(self, sink, t) -> None:
        shape = tuple(n + 2 for n in sink.shape)
        inner = (slice(1, -1),) * 3
        self.t = []
        self.diagonal = np.zeros(shape)
        self.diagonal[inner] = sink
        for a, face in enumerate(t):
            padded = np.zeros(shape)
            padded[inner] = face
            self.t.append(padded)
            self.diagonal += padded + np.roll(padded, 1, axis=a)
        filled = self.diagonal > 0
        self.inverse = np.where(filled, 1.0 / np.where(filled, self.diagonal, 1.0), 0.0)
        self.x, self.b, self.d, self.r = (np.zeros(shape) for _ in range(4))

    def smooth(self, from_zero: bool) -> None:
        """Chebyshev steps of the fourth kind for the spectrum (0, 2] of the scaled operator."""
        if from_zero:
            self.x[:] = 0.0
        for n in range(1, _SMOOTHING_STEPS + 1):
            kernels.local_step(
                self.x, self.b, *self.t, self.inverse, self.d,
                (2 * n - 3) / (2 * n + 1) if n > 1 else 0.0,
                (8 * n - 4) / (2 * n + 1) / 2.0,
            )
            kernels.add_to(self.x, self.d)

    def residual(self) -> None:
        kernels.local_residual(self.x, self.b, *self.t, self.diagonal, self.r)

    def factorise(self) -> None:
        """Dense inverse of the (small) operator."""
        cells = np.flatnonzero(self.diagonal.ravel() > 0)
        number = np.full(self.diagonal.size, -1)
        number[cells] = np.arange(cells.size)
        matrix = np.diag(self.diagonal.ravel()[cells])
        for a, face in enumerate(self.t):
            stride = int(np.prod(self.diagonal.shape[a + 1 :]))
            here = np.flatnonzero(face.ravel() > 0)
            one, two = number[here], number[here + stride]
            matrix[one, two] -= face.ravel()[here]
            matrix[two, one] -= face.ravel()[here]
        self.cells, self.matrix_inverse = cells, np.linalg.inv(matrix)

    def solve(self) -> np.ndarray:
        self.x.ravel()[self.cells] = self.matrix_inverse @ self.b.ravel()[self.cells]
        return self.x


class DiffusionSystem:
    """The symmetric positive definite system of one implicit diffusion stage.

    (A u)_i = weight_i (diagonal_i u_i - D sum_j w_ij weight_j u_j) + extra(u)_i, weight the
    cells' relative volumes on the unknown nodes and zero elsewhere.

    Parameters
    ----------
    bond_sum : NonlocalSum
    weight, diagonal : padded arrays
    diffusivity : float
        m^2/s.
    sink : padded array
        Row sums of A (used by the preconditioner).
    extra : callable(u, y), optional
        Adds a symmetric positive semidefinite term to y in place and returns its share of u . A u.
    extra_diagonal : padded array, optional
        Diagonal of that term.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        weight: np.ndarray,
        diagonal: np.ndarray,
        diffusivity: float,
        sink: np.ndarray,
        extra: Callable[[np.ndarray, np.ndarray], float] | None = None,
        extra_diagonal: np.ndarray | None = None,
    ) -> None:
        self.sum, self.weight, self.diagonal = bond_sum, weight, diagonal
        self.diffusivity, self.extra = diffusivity, extra
        full = weight * diagonal
        if extra_diagonal is not None:
            full = full + extra_diagonal
        self.mask = (weight > 0).astype(float)
        self.inverse = np.where(full > 0, 1.0 / np.where(full > 0, full, 1.0), 0.0)
        spacing = (1.0,) * (3 - len(bond_sum.stencil.spacing)) + bond_sum.stencil.spacing
        horizon = np.multiply(spacing, bond_sum.reach)
        self.processes = bond_sum.processes
        self.multigrid = (self.processes.multigrid or LocalMultigrid)(
            weight[bond_sum.interior],
            (sink * self.mask)[bond_sum.interior],
            [diffusivity / h**2 for h in spacing],
            spacing,
            coarsest_start=0.5 * horizon,
        )
        self._work = [np.zeros(bond_sum.padded_shape) for _ in range(4)]

    @property
    def _rows(self):
        return self.sum.low, self.sum.high, self.sum.reach

    def apply(self, u: np.ndarray, y: np.ndarray, q: np.ndarray) -> float:
        """y = A u for q = weight u; returns u . A u."""
        self.sum(q, y)
        product = kernels.diffusion_rows(
            u, y, self.weight, self.diagonal, self.diffusivity, *self._rows
        ).sum()
        if self.extra is not None:
            product += self.extra(u, y)
        return self.processes.total(product)

    def precondition(self, r: np.ndarray, z: np.ndarray) -> float:
        """z = B r; returns r . z."""
        self.multigrid.restrict(r, self.sum.reach)
        coarse = self.multigrid.cycle()
        product = kernels.add_diagonal_and_coarse(
            r, self.inverse, coarse, tuple(int(f) for f in self.multigrid.factors), self.mask, z,
            *self._rows,
        ).sum()
        return self.processes.total(product)

    def solve(
        self, x: np.ndarray, r: np.ndarray, absolute: float, maximum_iterations: int = 200
    ) -> int:
        """Improve x in place until the residual norm is at most `absolute`.

        r : padded residual b - A x of the starting value, zero off the unknowns; overwritten.
        Returns the number of iterations.  Raises ConvergenceError.
        """
        z, p, q, y = self._work
        p[:] = 0.0
        total = self.processes.total
        norm = float(np.sqrt(total(kernels.inner_product(r, r).sum())))
        rho_old, iterations = 1.0, 0
        while not norm <= absolute:
            if not np.isfinite(norm) or iterations == maximum_iterations:
                raise ConvergenceError(
                    f"linear solver: residual {norm:.3g} after {iterations} iterations, "
                    f"{absolute:.3g} wanted"
                )
            rho = self.precondition(r, z)
            kernels.next_direction(
                z, p, self.weight, q, rho / rho_old if iterations else 0.0, *self._rows
            )
            curvature = self.apply(p, y, q)
            norm = float(np.sqrt(total(kernels.advance_solution(
                x, r, p, y, rho / curvature, *self._rows
            ).sum())))
            rho_old = rho
            iterations += 1
        return iterations
