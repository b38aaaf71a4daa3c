"""Internal force and consistent stiffness of all cells, material update included (Numba).

Total Lagrangian weak form sum_q V_q P : grad v with P = tau F^-T; stiffness from
d(P) F^T = d(tau) - tau l^T, so K_ab = sum_q V_q g_a . (c - tau (x) 1) . g_b with spatial gradients
g. With mean dilatation (F-bar, de Souza Neto et al. 1996) F is scaled by r = (Jm/J)^(1/3), Jm the
mean of J over the cell, the stress is that of the scaled F, and the tangent has one term more.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numba import njit

from fem.constitutive.hencky import invert
from fem.constitutive.material import Material, update_point
from fem.discretisation import Discretisation
from fem.quadrature_state import QuadratureState


@dataclass
class Assembled:
    """Result of one assembly on this rank."""

    force: np.ndarray  # (n, 3) internal force, complete on owned nodes [N]
    values: np.ndarray  # stiffness of the owned rows, scalar CSR order [N/m]
    failed: int  # quadrature points without a valid state, owned cells
    stored: float  # elastic energy of the owned cells [J]
    dissipated: float  # plastic work of the step, owned cells [J]


class Assembler:
    """Assembles a Discretisation with a Material; `alive` cells only."""

    def __init__(self, discretisation: Discretisation, material: Material, threads: int) -> None:
        self.discretisation = discretisation
        self.material = material.parameters()
        self.kind, self.hardening = material.hardening.kind, material.hardening.parameters()
        self.alive = np.ones(len(discretisation.cells), bool)
        self.force = np.zeros_like(discretisation.coordinates)
        self.values = np.zeros(9 * len(discretisation.columns))
        self.seconds = 0.0
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def assemble(
        self, displacement: np.ndarray, state: QuadratureState, stiffness: bool = True
    ) -> Assembled:
        """Assemble at a displacement (n, 3) [m], from the old state into the new one."""
        start = time.perf_counter()
        d = self.discretisation
        self.force[:] = 0.0
        if stiffness:
            self.values[:] = 0.0
        slabs = d.slabs
        results = []
        for group in (slabs[0::2], slabs[1::2]):
            jobs = [self._job(first, last, displacement, state, stiffness) for first, last in group]
            if self._pool is None or len(jobs) == 1:
                results += [_assemble_cells(*job) for job in jobs]
            else:
                results += list(self._pool.map(lambda job: _assemble_cells(*job), jobs))
        totals = np.array(results).sum(axis=0)
        self.seconds += time.perf_counter() - start
        return Assembled(self.force, self.values, int(totals[0]), totals[1], totals[2])

    def _job(self, first, last, displacement, state, stiffness):
        d, old, new = self.discretisation, state.old, state.new
        return (
            first, last, d.cells, d.owned, self.alive, d.gradients, d.volumes, displacement,
            old.plastic, old.strain, old.damage,
            new.plastic, new.strain, new.damage, new.mises, new.pressure,
            self.material, self.kind, self.hardening, d.element.mean_dilatation, stiffness,
            d.owned_nodes, d.row_start, d.position, self.force, self.values,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _assemble_cells(
    first, last, cells, owned, alive, gradients, volumes, displacement,
    plastic_old, strain_old, damage_old, plastic_new, strain_new, damage_new, mises, pressure,
    material, kind, hardening, mean_dilatation, stiffness,
    owned_nodes, row_start, position, force, values,
):  # fmt: skip
    """Cells first..last-1; returns (failed points, stored energy, dissipated energy)."""
    nn, nq = cells.shape[1], gradients.shape[1]
    small, dyad, tangent = np.empty((6, 3, 3)), np.empty((9, 9)), np.empty((9, 9))
    stress = np.empty((3, 3))
    deformation, inverse = np.empty((nq, 3, 3)), np.empty((3, 3))
    jacobian, spatial = np.empty(nq), np.empty((nq, nn, 3))
    mean_gradient, column, extra = np.empty((nn, 3)), np.empty((9, 3)), np.empty((nn, 3))
    local_force, local = np.empty((nn, 3)), np.empty((3 * nn, 3 * nn))
    failed, stored, dissipated = 0.0, 0.0, 0.0
    for c in range(first, last):
        if not alive[c]:
            for q in range(nq):
                plastic_new[c, q] = plastic_old[c, q]
                strain_new[c, q], damage_new[c, q] = strain_old[c, q], damage_old[c, q]
                mises[c, q] = pressure[c, q] = 0.0
            continue
        valid = True
        weight_sum, mean = 0.0, 0.0
        for q in range(nq):
            for i in range(3):
                for j in range(3):
                    value = 1.0 if i == j else 0.0
                    for a in range(nn):
                        value += displacement[cells[c, a], i] * gradients[c, q, a, j]
                    deformation[q, i, j] = value
            jacobian[q] = invert(deformation[q], inverse)
            valid = valid and jacobian[q] > 0.0
            for a in range(nn):
                for i in range(3):
                    spatial[q, a, i] = (
                        inverse[0, i] * gradients[c, q, a, 0]
                        + inverse[1, i] * gradients[c, q, a, 1]
                        + inverse[2, i] * gradients[c, q, a, 2]
                    )
            weight_sum += volumes[c, q]
            mean += volumes[c, q] * jacobian[q]
        if not valid:
            if owned[c]:
                failed += 1.0
            continue
        mean /= weight_sum
        if mean_dilatation and stiffness:
            for a in range(nn):
                for i in range(3):
                    value = 0.0
                    for q in range(nq):
                        value += volumes[c, q] * jacobian[q] * spatial[q, a, i]
                    mean_gradient[a, i] = value / (mean * weight_sum)
        local_force[:] = 0.0
        local[:] = 0.0
        for q in range(nq):
            weight = volumes[c, q]
            if mean_dilatation:
                ratio = (mean / jacobian[q]) ** (1.0 / 3.0)
                deformation[q] *= ratio
                weight /= ratio**3
            ok, strain, damage, energy, work, eq, hydrostatic = update_point(
                deformation[q], plastic_old[c, q], strain_old[c, q], damage_old[c, q],
                material, kind, hardening, stiffness, stress, tangent, plastic_new[c, q],
                small, dyad,
            )  # fmt: skip
            strain_new[c, q], damage_new[c, q] = strain, damage
            mises[c, q], pressure[c, q] = eq, hydrostatic
            if not ok:
                if owned[c]:
                    failed += 1.0
                continue
            if owned[c]:
                stored += volumes[c, q] * energy
                dissipated += volumes[c, q] * work
            for a in range(nn):
                for i in range(3):
                    local_force[a, i] += weight * (
                        stress[i, 0] * spatial[q, a, 0]
                        + stress[i, 1] * spatial[q, a, 1]
                        + stress[i, 2] * spatial[q, a, 2]
                    )
            if not stiffness:
                continue
            if mean_dilatation:
                for a in range(nn):
                    for i in range(3):
                        value = 0.0
                        for j in range(3):
                            k = 3 * i + j
                            third = (tangent[k, 0] + tangent[k, 4] + tangent[k, 8]) / 3.0
                            value += (third - stress[i, j]) * spatial[q, a, j]
                        extra[a, i] = weight * value
            for i in range(3):
                for j in range(3):
                    for m in range(3):
                        tangent[3 * i + j, 3 * j + m] -= stress[i, m]
            for b in range(nn):
                for i in range(9):
                    for k in range(3):
                        column[i, k] = weight * (
                            tangent[i, 3 * k] * spatial[q, b, 0]
                            + tangent[i, 3 * k + 1] * spatial[q, b, 1]
                            + tangent[i, 3 * k + 2] * spatial[q, b, 2]
                        )
                for a in range(nn):
                    for i in range(3):
                        for k in range(3):
                            local[3 * a + i, 3 * b + k] += (
                                spatial[q, a, 0] * column[3 * i, k]
                                + spatial[q, a, 1] * column[3 * i + 1, k]
                                + spatial[q, a, 2] * column[3 * i + 2, k]
                            )
            if mean_dilatation:
                for b in range(nn):
                    for k in range(3):
                        change = mean_gradient[b, k] - spatial[q, b, k]
                        for a in range(nn):
                            for i in range(3):
                                local[3 * a + i, 3 * b + k] += extra[a, i] * change
        for a in range(nn):
            row = cells[c, a]
            for i in range(3):
                force[row, i] += local_force[a, i]
            if not stiffness or row >= owned_nodes:
                continue
            start, width = row_start[row], 3 * (row_start[row + 1] - row_start[row])
            for b in range(nn):
                block = position[c, a * nn + b] - start
                for i in range(3):
                    at = 9 * start + i * width + 3 * block
                    for k in range(3):
                        values[at + k] += local[3 * a + i, 3 * b + k]
    return failed, stored, dissipated


@njit(cache=True, nogil=True)
def multiply(row_start, columns, values, vector, result):
    """result = K vector on the owned rows; vector (n, 3) holds ghosts, result (owned, 3)."""
    for row in range(row_start.size - 1):
        start, blocks = row_start[row], row_start[row + 1] - row_start[row]
        for i in range(3):
            total = 0.0
            at = 9 * start + i * 3 * blocks
            for block in range(blocks):
                node = columns[start + block]
                for k in range(3):
                    total += values[at + 3 * block + k] * vector[node, k]
            result[row, i] = total


@njit(cache=True, nogil=True)
def constrain(row_start, columns, values, fixed, scale):
    """Replace rows and columns of fixed unknowns (n, 3 bool) by `scale` on the diagonal.

    Rows without any stiffness (nodes of removed cells only) get the same diagonal.
    """
    for row in range(row_start.size - 1):
        start, blocks = row_start[row], row_start[row + 1] - row_start[row]
        for i in range(3):
            at = 9 * start + i * 3 * blocks
            for block in range(blocks):
                node = columns[start + block]
                for k in range(3):
                    if node == row and k == i:
                        if fixed[row, i]:
                            values[at + 3 * block + k] = scale
                    elif fixed[row, i] or fixed[node, k]:
                        values[at + 3 * block + k] = 0.0
