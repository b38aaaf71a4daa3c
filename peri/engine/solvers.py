"""Krylov solvers for shifted nonlocal operators, with a two-scale preconditioner.

The symbol of the nonlocal operator is D|k|^2 for long waves and levels off at the bond sum for
short ones, so 1/symbol is close to 1/(D|k|^2) + 1/(bond sum).  The preconditioner is that sum:
one multigrid cycle of the *local* operator of the same coefficients plus the inverse of the
nonlocal diagonal.  It needs no product with the nonlocal operator.
"""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable

import numpy as np

from peri.engine import kernels
from peri.engine.multigrid import LocalMultigrid
from peri.engine.operators import Convolution, LocalCoefficients, NonlocalSum, Operator
from peri.engine.walls import Walls, WithWalls

log = logging.getLogger(__name__)

_SMALL_PART = 0.45
"""Of the lattice: a larger part is not cut out for the multigrid, whose cycle takes a sixth to a
quarter of a solution; below it a lacy cover takes 0.8 of the time (MEASURED.md of peri)."""
_LARGE = 50_000
"""Cells of a lattice below which nothing is cut out, since a cycle is cheap."""

Extra = Callable[[np.ndarray, np.ndarray], float]


class ConvergenceError(ArithmeticError):
    """The linear solver did not reach its tolerance; the message says how far it came."""


def _inverse_of(diagonal: np.ndarray) -> np.ndarray:
    """1 over a diagonal where it is positive, else 0."""
    return np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)


def _faces_of(window: tuple[slice, ...], face: np.ndarray, axis: int) -> np.ndarray:
    """The faces of a part of the cells, across an axis."""
    own = window[axis]
    return face[(*window[:axis], slice(own.start, own.stop + 1), *window[axis + 1 :])]


class LinearSystem:
    """(A + shift + extra) u = b on the unknown nodes: conjugate gradients, or BiCGSTAB.

    Conjugate gradients where the matrix is symmetric (it must be positive definite, too),
    BiCGSTAB otherwise; both with the preconditioner of this file's head.  BiCGSTAB rather than
    GMRES, because it keeps eight vectors however many iterations it takes; GMRES keeps one more
    with each, or restarts and forgets.

    Parameters
    ----------
    operator : Operator
    shift : padded array, optional
        What is added to the diagonal, such as a cell's storage c_i / tau.
    sink : padded array, optional
        Row sums of the whole matrix, where the caller knows them better than by cancellation; by
        default the operator's, plus `shift` and `extra_diagonal`.
    extra : callable(u, y), optional
        Adds a further term to y in place and returns its share of u . A u.
    extra_diagonal : padded array, optional
        Diagonal of that term.
    symmetric : bool, optional
        By default what the operator says; False for an `extra` that is not symmetric.
    """

    def __init__(
        self,
        operator: Operator,
        *,
        shift: np.ndarray | None = None,
        sink: np.ndarray | None = None,
        extra: Extra | None = None,
        extra_diagonal: np.ndarray | None = None,
        symmetric: bool | None = None,
    ) -> None:
        self.operator, self.sum = operator, operator.sum
        self.shift, self.extra = shift, extra
        self.symmetric = operator.symmetric if symmetric is None else symmetric
        self.processes = self.sum.processes
        self.mask = operator.unknown
        full = operator.diagonal()
        for part in (shift, extra_diagonal):
            if part is not None:
                full = full + part
        inverse = _inverse_of(full)
        if sink is None:
            local = operator.local()
            row_sums = local.sink
            for part in (shift, extra_diagonal):
                if part is not None:
                    row_sums = row_sums + (part * self.mask)[self.sum.interior]
        else:
            row_sums = (sink * self.mask)[self.sum.interior]
            local = LocalCoefficients(row_sums, operator.faces())
        self._scale, self._inverse, self._unscale = local.scale, inverse, self.mask
        if local.scale is not None:
            self._inverse, self._unscale = inverse * local.scale, self.mask / local.scale
        self._window = self._part_with_rows()
        self.multigrid = (self.processes.multigrid or LocalMultigrid)(
            row_sums[self._window],
            [_faces_of(self._window, face, a) for a, face in enumerate(local.faces)],
            self.sum.spacing,
            coarsest_start=0.5 * np.multiply(self.sum.spacing, self.sum.reach),
        )
        self._work = [np.zeros(self.sum.padded_shape) for _ in range(4 if self.symmetric else 8)]

    def _part_with_rows(self) -> tuple[slice, ...]:
        """The box of the rows that the sum works on where it is small; the multigrid covers that.

        Blocks of one lattice on several processes keep their whole blocks.
        """
        low, high = self.sum.low, self.sum.high
        rows, whole = high > low, tuple(slice(0, n) for n in self.sum.shape)
        large = math.prod(self.sum.shape) >= _LARGE
        if self.processes.multigrid is not None or not (large and rows.any()):
            return whole
        lines = [np.flatnonzero(rows.any(axis=a)) for a in (1, 0)]
        first, second = (slice(int(n[0]), int(n[-1]) + 1) for n in lines)
        part = first, second, slice(int(low[rows].min()), int(high[rows].max()))
        cells = math.prod(w.stop - w.start for w in part)
        return part if cells <= _SMALL_PART * math.prod(self.sum.shape) else whole

    def with_extra(self, extra: Extra, extra_diagonal: np.ndarray) -> None:
        """Take another `extra` and its diagonal, with the multigrid of the one before.

        The matrix is the new one; only its preconditioner is of both.
        """
        full = self.operator.diagonal() + extra_diagonal
        if self.shift is not None:
            full = full + self.shift
        inverse = _inverse_of(full)
        self.extra = extra
        self._inverse = inverse if self._scale is None else inverse * self._scale

    def apply(self, u: np.ndarray, y: np.ndarray, q: np.ndarray | None = None) -> float:
        """y = A u, for u that is zero off the unknowns; returns u . A u.

        q : the operator's `right` times u, where the caller has it.
        """
        product = self.operator.apply(u, y, q)
        if self.shift is not None:
            product += float(kernels.add_shift(u, y, self.shift, *self.sum.rows).sum())
        if self.extra is not None:
            product += self.extra(u, y)
        return self.processes.total(product)

    def residual(self, x: np.ndarray, b: np.ndarray) -> np.ndarray:
        """b - A x on the unknown nodes (a new padded array), x zero elsewhere."""
        out = np.zeros(self.sum.padded_shape)
        self.apply(x, out)
        np.subtract(b, out, out=out)
        out *= self.mask
        return out

    def precondition(self, r: np.ndarray, z: np.ndarray) -> float:
        """z = B r; returns r . z."""
        start = tuple(w.start for w in self._window)
        first = tuple(r + s for r, s in zip(self.sum.reach, start, strict=True))
        self.multigrid.restrict(r if self._scale is None else self._scale * r, first)
        coarse = self.multigrid.cycle()
        product = kernels.add_diagonal_and_coarse(
            r,
            self._inverse,
            coarse,
            tuple(int(f) for f in self.multigrid.factors),
            start,
            self._unscale,
            z,
            *self.sum.rows,
        ).sum()
        return self.processes.total(product)

    def solve(
        self, x: np.ndarray, r: np.ndarray, absolute: float, maximum_iterations: int = 200
    ) -> int:
        """Improve x in place until the residual norm is at most `absolute`.

        r : padded residual b - A x of the starting value, zero off the unknowns; overwritten.
        Returns the number of iterations (of BiCGSTAB: each two products).  Raises
        ConvergenceError.
        """
        method = self._conjugate_gradients if self.symmetric else self._bicgstab
        return method(x, r, absolute, maximum_iterations)

    def _conjugate_gradients(
        self, x: np.ndarray, r: np.ndarray, absolute: float, maximum_iterations: int
    ) -> int:
        z, p, q, y = self._work
        p[:] = 0.0
        total, rows = self.processes.total, self.sum.rows
        right = self.mask if self.operator.right is None else self.operator.right
        norm = self._norm(r)
        rho_old, iterations = 1.0, 0
        while not norm <= absolute:
            self._check(norm, iterations, maximum_iterations, absolute)
            rho = self.precondition(r, z)
            kernels.next_direction(z, p, right, q, rho / rho_old if iterations else 0.0, *rows)
            curvature = self.apply(p, y, q)
            squares = kernels.advance_solution(x, r, p, y, rho / curvature, *rows).sum()
            norm = float(np.sqrt(total(squares)))
            rho_old = rho
            iterations += 1
        return iterations

    def _bicgstab(
        self, x: np.ndarray, r: np.ndarray, absolute: float, maximum_iterations: int
    ) -> int:
        """Van der Vorst 1992, preconditioned from the right; starts afresh when it breaks down.

        The residual is updated, not recomputed; it is checked against A x in the end, and the
        iteration goes on from the true one if they differ.
        """
        p, v, p_hat, s_hat, t, shadow, b, y = self._work
        self.apply(x, y)
        np.add(r, y, out=b)
        norm, iterations, fresh = self._norm(r), 0, True
        rho_old = alpha = omega = 1.0
        while True:
            if norm <= absolute:
                self.apply(x, y)
                np.subtract(b, y, out=r)
                r *= self.mask
                norm = self._norm(r)
                if norm <= 2 * absolute:
                    return iterations
                fresh = True
            self._check(norm, iterations, maximum_iterations, absolute)
            if fresh:
                shadow[:] = r
                p[:] = v[:] = 0.0
                rho_old = alpha = omega = 1.0
            rho = self._dot(shadow, r)
            beta = rho / rho_old * alpha / omega
            p -= omega * v
            p *= beta
            p += r
            self.precondition(p, p_hat)
            self.apply(p_hat, v)
            along = self._dot(shadow, v)
            if along == 0.0:
                fresh = self._restart(fresh, norm, iterations, absolute)
                continue
            alpha = rho / along
            r -= alpha * v
            self.precondition(r, s_hat)
            self.apply(s_hat, t)
            square = self._dot(t, t)
            omega = self._dot(t, r) / square if square > 0 else 0.0
            x += alpha * p_hat
            x += omega * s_hat
            r -= omega * t
            norm, rho_old = self._norm(r), rho
            iterations += 1
            # Too little left of the direction, or no step along the residual: start afresh.
            fresh = omega == 0.0 or abs(rho) <= 1e-14 * norm * self._norm(shadow)

    def _restart(self, fresh: bool, norm: float, iterations: int, absolute: float) -> bool:
        if fresh:
            raise ConvergenceError(
                f"linear solver: breakdown at a residual of {norm:.3g} after {iterations} "
                f"iterations, {absolute:.3g} wanted"
            )
        return True

    def _check(self, norm: float, iterations: int, maximum: int, absolute: float) -> None:
        if not np.isfinite(norm) or iterations == maximum:
            raise ConvergenceError(
                f"linear solver: residual {norm:.3g} after {iterations} iterations, "
                f"{absolute:.3g} wanted"
            )

    def _dot(self, a: np.ndarray, b: np.ndarray) -> float:
        return self.processes.total(float(kernels.inner_product(a, b).sum()))

    def _norm(self, a: np.ndarray) -> float:
        return float(np.sqrt(self.processes.total(kernels.inner_product(a, a).sum())))


class DiffusionSystem(LinearSystem):
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
    walls : Walls, optional
        Conduction along walls that A has, too.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        weight: np.ndarray,
        diagonal: np.ndarray,
        diffusivity: float,
        sink: np.ndarray,
        extra: Extra | None = None,
        extra_diagonal: np.ndarray | None = None,
        walls: Walls | None = None,
    ) -> None:
        self.weight, self.diagonal = weight, diagonal
        operator: Operator = Convolution(
            bond_sum, weight, diagonal=diagonal, coefficient=diffusivity
        )
        super().__init__(
            operator if walls is None else WithWalls(operator, walls),
            sink=sink,
            extra=extra,
            extra_diagonal=extra_diagonal,
        )

    def with_weight(
        self, weight: np.ndarray, extra_diagonal: np.ndarray | None = None
    ) -> DiffusionSystem:
        """The system of other unknown nodes, preconditioned by the multigrid of this one.

        weight, extra_diagonal : as for the class; where few nodes join or leave the unknown ones.
        Work arrays are shared, so the two must not be solved at the same time.

        Raises ValueError for a system with walls.
        """
        if not isinstance(self.operator, Convolution):
            raise ValueError("with_weight: systems without walls")
        other = copy.copy(self)
        other.weight = weight
        other.operator = Convolution(
            self.sum, weight, diagonal=self.diagonal, coefficient=self.operator.coefficient
        )
        other.mask = other._unscale = other.operator.unknown
        full = other.operator.diagonal()
        other._inverse = _inverse_of(full if extra_diagonal is None else full + extra_diagonal)
        return other

    def with_diagonal(self, diagonal: np.ndarray, sink: np.ndarray) -> DiffusionSystem:
        """The system with another diagonal and its row sums, padded arrays; without `extra`.

        All that the diagonal leaves as it is, work arrays too, is shared: 3 arrays of the lattice
        are new instead of 16.  The two must not be solved at the same time.

        Raises ValueError for a system with walls.
        """
        if not isinstance(self.operator, Convolution):
            raise ValueError("with_diagonal: systems without walls")
        other = copy.copy(self)
        other.diagonal, other.operator = diagonal, self.operator.with_diagonal(diagonal)
        other.extra = None
        other._inverse = _inverse_of(other.operator.diagonal())
        sink = (sink * self.mask)[self.sum.interior]
        other.multigrid = self.multigrid.with_sink(sink[self._window])
        return other
