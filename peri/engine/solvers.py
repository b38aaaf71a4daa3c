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

from peri.engine import kernels
from peri.engine.multigrid import LocalMultigrid
from peri.engine.operators import NonlocalSum

log = logging.getLogger(__name__)


class ConvergenceError(ArithmeticError):
    """The linear solver did not reach its tolerance; the message says how far it came."""


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
    def _rows(self) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
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
            r,
            self.inverse,
            coarse,
            tuple(int(f) for f in self.multigrid.factors),
            self.mask,
            z,
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
            norm = float(
                np.sqrt(
                    total(kernels.advance_solution(x, r, p, y, rho / curvature, *self._rows).sum())
                )
            )
            rho_old = rho
            iterations += 1
        return iterations
