"""Equilibrium at a prescribed displacement of the grips: Newton with line search."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fem.assembly import (
    Assembled,
    Assembler,
    constrain,
    largest_amount,
    multiply,
    multiply_transposed,
)
from fem.constitutive.gurson import STIFFENING
from fem.loading import MovingGrip
from fem.quadrature_state import QuadratureState
from fem.solvers import LinearSolver

log = logging.getLogger(__name__)
INVERTED_PREDICTION = "inverted cell in the prediction"
_TRIALS = 8  # of the line search
_FIRST_SHARE, _LARGEST_SHARE = 0.01, 0.3  # of the elastic tangent
_RESPONSE_TOLERANCE = 1e-4  # of the response to a translation of the grip
_ENOUGH = 0.5  # a step is long enough once the force along it has fallen to this share


@dataclass
class Equilibrium:
    """Outcome of a Newton solution.

    unbalanced: the forces on all free nodes added up by amount, times how far the grip moves them
    at most by unit of its motion. Were they put on as loads, this would be an equilibrium; taken
    away, they change the reaction of a sound solid by less (measured on a bar: by 0.37 at most,
    `tests/fem/test_tearing.py`). inf where Newton's method broke off.
    """

    converged: bool
    iterations: int
    reaction: float  # of the top grip: force [N], torque or moment [N m]
    stored: float
    dissipated: float
    reason: str = ""
    unbalanced: float = np.inf  # [N or N m]


class EquilibriumSolver:
    """Newton iteration for one increment; holds what does not change between increments."""

    def __init__(
        self,
        comm: MPI.Comm,
        assembler: Assembler,
        linear: LinearSolver,
        state: QuadratureState,
        fixed: np.ndarray,
        grip: MovingGrip,
        tolerance: float,
        maximum_iterations: int,
    ) -> None:
        """fixed (n, 3) bool: unknowns with prescribed values, those of the moving grip included."""
        self.comm, self.assembler, self.linear, self.state = comm, assembler, linear, state
        self.fixed, self.grip = fixed, grip
        self._translations = grip.translations()
        self._direction = grip.derivative(0.0)  # that the reaction belongs to
        # how far the grip moves at most by unit of its amount
        lever = float(np.linalg.norm(self._direction, axis=1).max(initial=0.0))
        self._lever = comm.allreduce(lever, MPI.MAX)
        self.tolerance, self.maximum_iterations = tolerance, maximum_iterations
        self.reference = 0.0  # largest reaction at equilibrium so far [N]
        self.reaction = 0.0  # norm of the nodal reactions of the last assembly [N]
        self.unbalanced = 0.0  # sum of the free nodes' forces, likewise [N]

    def _sum(self, *values: float) -> np.ndarray:
        return self.comm.allreduce(np.array(values, float))

    def _assemble(self, displacement: np.ndarray) -> tuple[Assembled, float, float, float]:
        """Assembled quantities, number of failed points, residual norm, reaction of the grip.

        To the residual of the free nodes that of a floating grip is added, its total force.
        """
        result = self.assembler.assemble(displacement, self.state)
        owned = self.assembler.discretisation.owned_nodes
        force, fixed = result.force[:owned], self.fixed[:owned]
        free = np.where(fixed, 0.0, force)
        square = (free**2).sum(axis=1)
        failed, square, unbalanced, reaction, conjugate, *total = self._sum(
            result.failed,
            float(square.sum()),
            float(np.sqrt(square).sum()),
            float((np.where(fixed, force, 0.0) ** 2).sum()),
            float((force * self._direction[:owned]).sum()),
            *np.tensordot(self._translations[:, :owned], force),
        )
        self.reaction, self.unbalanced = np.sqrt(reaction), unbalanced
        return result, failed, np.sqrt(square + np.dot(total, total)), conjugate

    def _correction(
        self, result: Assembled, prescribed: np.ndarray | None, tolerance: float
    ) -> np.ndarray | None:
        """Newton step from an assembly; `prescribed` (n, 3) are changes of the fixed unknowns."""
        d = self.assembler.discretisation
        right = -result.force[: d.owned_nodes].copy()
        if prescribed is not None:
            product = np.empty_like(right)
            multiply(d.row_start, d.columns, result.values, prescribed, product)
            right -= product
        right[self.fixed[: d.owned_nodes]] = 0.0
        floating = self._floating_rows(result)
        diagonal = largest_amount(result.values)
        scale = self.comm.allreduce(diagonal, MPI.MAX)
        constrain(d.row_start, d.columns, result.values, self.fixed, scale)
        self.linear.set_values(result.values)
        step = self.linear.solve(right, tolerance)
        if step is not None and prescribed is not None:
            step = np.where(self.fixed, prescribed, step)
        if step is not None and len(self._translations):
            step = self._float(step, *floating, tolerance)
        return step

    def _floating_rows(self, result: Assembled) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `_float` needs of the unconstrained stiffness K and the force, E the translations.

        Total force E^T f (k,), sides -K E of the free unknowns (k, owned, 3), E^T K (k, n, 3).
        """
        d, count = self.assembler.discretisation, len(self._translations)
        sides, rows = np.empty((count, d.owned_nodes, 3)), np.zeros((count, *self.fixed.shape))
        for k, unit in enumerate(self._translations):
            multiply(d.row_start, d.columns, result.values, unit, sides[k])
            multiply_transposed(d.row_start, d.columns, result.values, unit, rows[k])
        sides[:, self.fixed[: d.owned_nodes]] = 0.0
        owned = self._translations[:, : d.owned_nodes]
        return np.tensordot(owned, result.force[: d.owned_nodes]), -sides, rows

    def _float(
        self, step: np.ndarray, total: np.ndarray, sides: np.ndarray, rows: np.ndarray,
        tolerance: float,
    ) -> np.ndarray | None:  # fmt: skip
        """Add the translation of the grip that makes the linearised total force vanish.

        One solution per direction with the matrix at hand, then a system of their number.
        """
        responses = []
        for side, unit in zip(sides, self._translations, strict=True):
            response = self.linear.solve(side, min(_RESPONSE_TOLERANCE, tolerance))
            if response is None:
                return None
            responses.append(np.where(self.grip.held, unit, response))
        reduced = np.array([[float((row * z).sum()) for z in responses] for row in rows])
        right = total + np.tensordot(rows, step)
        reduced, right = self.comm.allreduce(reduced), self.comm.allreduce(right)
        try:
            shift = np.linalg.solve(reduced, right)
        except np.linalg.LinAlgError:
            return None
        return step - np.tensordot(shift, responses, axes=1)

    def _along(self, force: np.ndarray, step: np.ndarray) -> float:
        """Force of the free unknowns, a floating grip's translation included, along a step [J]."""
        owned = self.assembler.discretisation.owned_nodes
        still = self.fixed[:owned]
        if len(self._translations):
            still = still & ~self.grip.held[:owned]
        free = np.where(still, 0.0, force[:owned])
        return float(self._sum(float((free * step[:owned]).sum()))[0])

    def _search(
        self, displacement: np.ndarray, step: np.ndarray, start: float, norm: float
    ) -> tuple[float, tuple[Assembled, float, float, float]]:
        """Length of a step: where the force along it, `start` at its beginning, has nearly gone.

        Plastic flow that turns its direction overshoots, and the residual may grow on the way to
        equilibrium, so that it alone is no guide; with f lagged the force along the step is the
        slope of a potential. Returns the factor and the assembly there, failed points included.
        """
        factor, shrink = 1.0, 1.0
        for _ in range(_TRIALS):
            factor *= shrink
            state = self._assemble(displacement + factor * step)
            result, failed, trial, _ = state
            if failed:
                shrink = 0.5
                continue
            here = self._along(result.force, step)
            log.debug(
                "factor %.3g: residual %.3e, force along the step %.2e of %.2e",
                factor, trial, here, start,
            )  # fmt: skip
            short = here * start > 0.0
            if short or abs(here) <= _ENOUGH * abs(start) or trial <= 0.9 * norm:
                break
            shrink = min(max(start / (start - here), 0.1), 0.9)
        return factor, state

    def _stiffen(self, factor: float) -> bool:
        """Mix more or less of the elastic tangent in, by the step that the line search accepted.

        Porous cells and slivers have directions with hardly any stiffness, along which a full step
        runs away; the equilibrium itself does not depend on the tangent. True if the share grew, so
        that the tangent at hand does not have it yet.
        """
        shares = self.assembler.laws.parameters[:, STIFFENING]  # the same in all materials
        share = float(shares[0])
        if factor < 0.5:
            shares[:] = min(_LARGEST_SHARE, max(_FIRST_SHARE, 4.0 * share))
        else:
            shares[:] = 0.25 * share if share > _FIRST_SHARE else 0.0
        return bool(shares[0] > share)

    def predict(
        self, displacement: np.ndarray, amount: float, change: float, stiff: bool = False
    ) -> np.ndarray | None:
        """Displacement after a change of the grip's amount, by the tangent at the old state.

        stiff: with the largest share of the elastic tangent, where the plain one turns cells that
        hardly resist inside out.
        """
        self.assembler.laws.parameters[:, STIFFENING] = _LARGEST_SHARE if stiff else 0.0
        result, failed, _, _ = self._assemble(displacement)
        if failed:
            return None
        step = self._correction(result, change * self.grip.derivative(amount), 1e-4)
        return None if step is None else displacement + step

    def solve(self, displacement: np.ndarray, amount: float) -> tuple[Equilibrium, np.ndarray]:
        """Iterate from a predicted displacement; the grip is put where `amount` has it."""
        displacement = self.grip.place(displacement, amount)
        self._direction = self.grip.derivative(amount)
        result, failed, norm, conjugate = self._assemble(displacement)
        if failed:
            return Equilibrium(False, 0, 0.0, 0.0, 0.0, INVERTED_PREDICTION), displacement
        first = norm
        self.assembler.laws.parameters[:, STIFFENING] = 0.0
        for iteration in range(self.maximum_iterations + 1):
            scale = max(self.reference, self.reaction)
            limit = self.tolerance * scale
            log.debug("iteration %d residual %.3e of %.3e", iteration, norm, scale)
            if norm <= limit:
                self.reference = scale
                stored, dissipated = self._sum(result.stored, result.dissipated)
                unbalanced = self.unbalanced * self._lever
                return Equilibrium(
                    True, iteration, conjugate, stored, dissipated, "", unbalanced
                ), displacement  # fmt: skip
            if iteration == self.maximum_iterations:
                break
            if iteration >= 4 and norm > 10.0 * first:
                break
            # as accurate as this iteration can use: quadratic convergence, but not past the goal
            forcing = min(1e-2, max(0.1 * limit / norm, 0.3 * min(1.0, norm / scale)))
            step = self._correction(result, None, max(forcing, 1e-10))
            if step is None:
                return Equilibrium(False, iteration, 0, 0, 0, "linear solver failed"), displacement
            along = self._along(result.force, step)
            factor, (result, failed, norm, conjugate) = self._search(
                displacement, step, along, norm
            )
            if failed:
                return Equilibrium(False, iteration, 0, 0, 0, "inverted cell"), displacement
            displacement = displacement + factor * step
            if self._stiffen(factor):
                result, failed, norm, conjugate = self._assemble(displacement)
        stored, dissipated = self._sum(result.stored, result.dissipated)
        unbalanced = self.unbalanced * self._lever
        return (
            Equilibrium(
                False, iteration, conjugate, stored, dissipated, "no convergence", unbalanced
            ),
            displacement,
        )
