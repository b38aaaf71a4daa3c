"""Equilibrium at a prescribed displacement of the grips: Newton with line search."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fem.assembly import Assembled, Assembler, constrain, multiply
from fem.constitutive.gurson import STIFFENING
from fem.quadrature_state import QuadratureState
from fem.solvers import LinearSolver

log = logging.getLogger(__name__)
_LINE_SEARCH = (1.0, 0.5, 0.25, 0.1, 0.03)
_FIRST_SHARE, _LARGEST_SHARE = 0.01, 0.3  # of the elastic tangent
_ACCEPTED_GROWTH = 0.9  # of the residual; plastic flow may raise it once on the way


@dataclass
class Equilibrium:
    """Outcome of a Newton solution."""

    converged: bool
    iterations: int
    force: float  # sum of the axial forces in the top grip [N]
    stored: float
    dissipated: float
    reason: str = ""


class EquilibriumSolver:
    """Newton iteration for one increment; holds what does not change between increments."""

    def __init__(
        self,
        comm: MPI.Comm,
        assembler: Assembler,
        linear: LinearSolver,
        state: QuadratureState,
        fixed: np.ndarray,
        top: np.ndarray,
        tolerance: float,
        maximum_iterations: int,
    ) -> None:
        """fixed (n, 3): unknowns with prescribed values; top (n,): nodes of the moving grip."""
        self.comm, self.assembler, self.linear, self.state = comm, assembler, linear, state
        self.fixed, self.top = fixed, top
        self.tolerance, self.maximum_iterations = tolerance, maximum_iterations
        self.reference = 0.0  # largest reaction at equilibrium so far [N]
        self.reaction = 0.0  # reaction of the last assembly [N]

    def _sum(self, *values: float) -> np.ndarray:
        return self.comm.allreduce(np.array(values, float))

    def _assemble(self, displacement: np.ndarray) -> tuple[Assembled, float, float, float]:
        """Assembled quantities, number of failed points, residual norm, force of the top grip."""
        result = self.assembler.assemble(displacement, self.state)
        owned = self.assembler.discretisation.owned_nodes
        force, fixed = result.force[:owned], self.fixed[:owned]
        free = np.where(fixed, 0.0, force)
        failed, square, reaction, axial = self._sum(
            result.failed,
            float((free**2).sum()),
            float((np.where(fixed, force, 0.0) ** 2).sum()),
            float(force[self.top[:owned], 2].sum()),
        )
        self.reaction = np.sqrt(reaction)
        return result, failed, np.sqrt(square), axial

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
        diagonal = float(np.abs(result.values).max()) if result.values.size else 0.0
        scale = self.comm.allreduce(diagonal, MPI.MAX)
        constrain(d.row_start, d.columns, result.values, self.fixed, scale)
        self.linear.set_values(result.values)
        step = self.linear.solve(right, tolerance)
        if step is not None and prescribed is not None:
            step = np.where(self.fixed, prescribed, step)
        return step

    def _stiffen(self, factor: float) -> float:
        """Mix more or less of the elastic tangent in, by the step that the line search accepted.

        Porous cells and slivers that soften have directions without stiffness, along which a full
        step runs away; the equilibrium itself does not depend on the tangent. Returns the share if
        the tangent at hand does not have it yet.
        """
        material = self.assembler.material
        share = material[STIFFENING]
        if factor < 0.5:
            material[STIFFENING] = min(_LARGEST_SHARE, max(_FIRST_SHARE, 4.0 * share))
        else:
            material[STIFFENING] = 0.25 * share if share > _FIRST_SHARE else 0.0
        return material[STIFFENING] if material[STIFFENING] > share else 0.0

    def predict(self, displacement: np.ndarray, prescribed: np.ndarray) -> np.ndarray | None:
        """Displacement after a change of the fixed unknowns, by the tangent at the old state."""
        result, failed, _, _ = self._assemble(displacement)
        if failed:
            return None
        step = self._correction(result, prescribed, 1e-4)
        return None if step is None else displacement + step

    def solve(self, displacement: np.ndarray) -> tuple[Equilibrium, np.ndarray]:
        """Iterate from a predicted displacement (fixed unknowns already in place)."""
        result, failed, norm, axial = self._assemble(displacement)
        if failed:
            return Equilibrium(
                False, 0, 0.0, 0.0, 0.0, "inverted cell in the prediction"
            ), displacement
        first = norm
        self.assembler.material[STIFFENING] = 0.0
        for iteration in range(self.maximum_iterations + 1):
            scale = max(self.reference, self.reaction)
            limit = self.tolerance * scale
            log.debug("iteration %d residual %.3e of %.3e", iteration, norm, scale)
            if norm <= limit:
                self.reference = scale
                stored, dissipated = self._sum(result.stored, result.dissipated)
                return Equilibrium(True, iteration, axial, stored, dissipated), displacement
            if iteration == self.maximum_iterations:
                break
            if iteration >= 4 and norm > 10.0 * first:
                break
            # as accurate as this iteration can use: quadratic convergence, but not past the goal
            forcing = min(1e-2, max(0.1 * limit / norm, 0.3 * min(1.0, norm / scale)))
            step = self._correction(result, None, max(forcing, 1e-10))
            if step is None:
                return Equilibrium(False, iteration, 0, 0, 0, "linear solver failed"), displacement
            best_norm, best = np.inf, 0.0
            for factor in _LINE_SEARCH:
                result, failed, trial, axial = self._assemble(displacement + factor * step)
                log.debug("factor %g: %d failed points, residual %.3e", factor, failed, trial)
                if failed == 0 and trial < best_norm:
                    best_norm, best = trial, factor
                if failed == 0 and trial <= _ACCEPTED_GROWTH * norm:
                    break
            if best == 0.0:
                return Equilibrium(False, iteration, 0, 0, 0, "inverted cell"), displacement
            if best != factor:
                result, failed, trial, axial = self._assemble(displacement + best * step)
            displacement = displacement + best * step
            norm = trial
            share = self._stiffen(best)
            if share > 0.0:
                result, failed, norm, axial = self._assemble(displacement)
        return (
            Equilibrium(False, self.maximum_iterations, 0, 0, 0, "no convergence"),
            displacement,
        )
