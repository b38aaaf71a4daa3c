"""Internal force and consistent stiffness of all cells, material update included (Numba).

Total Lagrangian weak form sum_q V_q P : grad v with P = tau F^-T; stiffness from
d(P) F^T = d(tau) - tau l^T, so K_ab = sum_q V_q g_a . (c - tau (x) 1) . g_b with spatial gradients
g. With mean dilatation (F-bar, de Souza Neto et al. 1996; patches of tetrahedra, 2005) F is scaled
by r = (Jm/J)^(1/3), Jm the mean of J over the group (cell or patch); the stress is that of the
scaled F, and the tangent has one term more, which couples all nodes of the group.
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
        groups = discretisation.groups
        sizes = np.diff(groups.cell_start), np.diff(groups.node_start)
        self._largest = tuple(int(size.max()) if size.size else 1 for size in sizes)
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
                results += [_assemble_groups(*job) for job in jobs]
            else:
                results += list(self._pool.map(lambda job: _assemble_groups(*job), jobs))
        totals = np.array(results).sum(axis=0)
        self.seconds += time.perf_counter() - start
        return Assembled(self.force, self.values, int(totals[0]), totals[1], totals[2])

    def _job(self, first, last, displacement, state, stiffness):
        d, g, old, new = self.discretisation, self.discretisation.groups, state.old, state.new
        return (
            first, last, self._largest, stiffness, d.element.mean_dilatation,
            (d.cells, d.owned, self.alive, d.gradients, d.volumes, displacement),
            (g.cell_start, g.node_start, g.nodes, g.place),
            (old.plastic, old.strain, old.damage),
            (new.plastic, new.strain, new.damage, new.mises, new.pressure),
            (self.material, self.kind, self.hardening),
            (d.owned_nodes, d.row_start, g.pair_start, d.position, self.force, self.values),
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _assemble_groups(
    first, last, largest, stiffness, averaged, mesh, groups, old, new, law, target
):
    """Groups first..last-1; returns (failed points, stored energy, dissipated energy)."""
    cells, owned, alive, gradients, volumes, displacement = mesh
    cell_start, node_start, group_nodes, place = groups
    nn, nq = cells.shape[1], gradients.shape[1]
    small, dyad, tangent = np.empty((5, 3, 3)), np.empty((2, 9, 9)), np.empty((9, 9))
    stress, scaled = np.empty((3, 3)), np.empty((3, 3))
    deformation, inverse = np.empty((largest[0], nq, 3, 3)), np.empty((3, 3))
    jacobian, spatial = np.empty((largest[0], nq)), np.empty((largest[0], nq, nn, 3))
    mean_gradient, extra = np.zeros((largest[1], 3)), np.empty((nn, 3))
    local_force, local = np.empty((largest[1], 3)), np.empty((3 * largest[1], 3 * largest[1]))
    failed, stored, dissipated = 0.0, 0.0, 0.0
    for g in range(first, last):
        start, stop = cell_start[g], cell_start[g + 1]
        nodes = node_start[g + 1] - node_start[g]
        wrong, mean, volume = _kinematics(
            start, stop, mesh, deformation, inverse, jacobian, spatial
        )
        if volume == 0.0 or wrong > 0.0:
            failed += wrong
            _keep(start, stop, nq, old, new)
            continue
        for a in range(nodes):
            for i in range(3):
                mean_gradient[a, i] = local_force[a, i] = 0.0
        if averaged and stiffness:
            for c in range(start, stop):
                if not alive[c]:
                    continue
                for q in range(nq):
                    part = volumes[c, q] * jacobian[c - start, q] / (mean * volume)
                    for a in range(nn):
                        for i in range(3):
                            mean_gradient[place[c, a], i] += part * spatial[c - start, q, a, i]
        if stiffness:
            local[: 3 * nodes, : 3 * nodes] = 0.0
        for c in range(start, stop):
            if not alive[c]:
                _keep(c, c + 1, nq, old, new)
                continue
            for q in range(nq):
                ratio = 1.0
                if averaged:
                    ratio = (mean / jacobian[c - start, q]) ** (1.0 / 3.0)
                for i in range(3):
                    for j in range(3):
                        scaled[i, j] = ratio * deformation[c - start, q, i, j]
                weight = volumes[c, q] / ratio**3
                ok, strain, damage, energy, work, mises, pressure = update_point(
                    scaled, old[0][c, q], old[1][c, q], old[2][c, q], law[0], law[1], law[2],
                    stiffness, stress, tangent, new[0][c, q], small, dyad,
                )  # fmt: skip
                new[1][c, q], new[2][c, q], new[3][c, q], new[4][c, q] = (
                    strain, damage, mises, pressure,
                )  # fmt: skip
                if owned[c]:
                    if not ok:
                        failed += 1.0
                    stored += volumes[c, q] * energy
                    dissipated += volumes[c, q] * work
                for a in range(nn):
                    for i in range(3):
                        value = 0.0
                        for j in range(3):
                            value += stress[i, j] * spatial[c - start, q, a, j]
                        local_force[place[c, a], i] += weight * value
                if stiffness:
                    _add_stiffness(
                        weight, averaged, nodes, place[c], spatial[c - start, q], mean_gradient,
                        stress, tangent, extra, local,
                    )  # fmt: skip
        _scatter(g, nodes, group_nodes[node_start[g] :], stiffness, local_force, local, target)
    return failed, stored, dissipated


@njit(cache=True, nogil=True)
def _keep(start, stop, nq, old, new):
    """New state = old state, without stress, for cells that are not evaluated."""
    for c in range(start, stop):
        for q in range(nq):
            for k in range(6):
                new[0][c, q, k] = old[0][c, q, k]
            new[1][c, q], new[2][c, q] = old[1][c, q], old[2][c, q]
            new[3][c, q] = new[4][c, q] = 0.0


@njit(cache=True, nogil=True)
def _kinematics(start, stop, mesh, deformation, inverse, jacobian, spatial):
    """Fill F, J and spatial gradients; return (inverted owned points, mean J, volume)."""
    cells, owned, alive, gradients, volumes, displacement = mesh
    nn, nq = cells.shape[1], gradients.shape[1]
    wrong, total, volume = 0.0, 0.0, 0.0
    for c in range(start, stop):
        if not alive[c]:
            continue
        for q in range(nq):
            target = deformation[c - start, q]
            for i in range(3):
                for j in range(3):
                    target[i, j] = 1.0 if i == j else 0.0
            for a in range(nn):
                node = cells[c, a]
                for i in range(3):
                    for j in range(3):
                        target[i, j] += displacement[node, i] * gradients[c, q, a, j]
            value = invert(target, inverse)
            jacobian[c - start, q] = value
            if not value > 0.0:
                wrong += 1.0 if owned[c] else 1e-9
            for a in range(nn):
                for i in range(3):
                    spatial[c - start, q, a, i] = (
                        inverse[0, i] * gradients[c, q, a, 0]
                        + inverse[1, i] * gradients[c, q, a, 1]
                        + inverse[2, i] * gradients[c, q, a, 2]
                    )
            volume += volumes[c, q]
            total += volumes[c, q] * value
    if volume > 0.0:
        total /= volume
    return wrong, total, volume


@njit(cache=True, nogil=True)
def _add_stiffness(
    weight, averaged, nodes, place, spatial, mean_gradient, stress, tangent, extra, local
):
    """Add one point: g_a . (c - tau (x) 1) . g_b; F-bar adds (c:1/3 - tau) g_a (x) (gm_b - g_b)."""
    nn = place.size
    if averaged:
        for a in range(nn):
            for i in range(3):
                value = 0.0
                for j in range(3):
                    k = 3 * i + j
                    third = (tangent[k, 0] + tangent[k, 4] + tangent[k, 8]) / 3.0
                    value += (third - stress[i, j]) * spatial[a, j]
                extra[a, i] = weight * value
    for i in range(3):
        for j in range(3):
            for m in range(3):
                tangent[3 * i + j, 3 * j + m] -= stress[i, m]
    for a in range(nn):
        row = 3 * place[a]
        x, y, z = weight * spatial[a, 0], weight * spatial[a, 1], weight * spatial[a, 2]
        for i in range(3):
            # t_kl = g_a,j A_ijkl: nine numbers, then one dot product per neighbour
            t0 = x * tangent[3 * i, 0] + y * tangent[3 * i + 1, 0] + z * tangent[3 * i + 2, 0]
            t1 = x * tangent[3 * i, 1] + y * tangent[3 * i + 1, 1] + z * tangent[3 * i + 2, 1]
            t2 = x * tangent[3 * i, 2] + y * tangent[3 * i + 1, 2] + z * tangent[3 * i + 2, 2]
            t3 = x * tangent[3 * i, 3] + y * tangent[3 * i + 1, 3] + z * tangent[3 * i + 2, 3]
            t4 = x * tangent[3 * i, 4] + y * tangent[3 * i + 1, 4] + z * tangent[3 * i + 2, 4]
            t5 = x * tangent[3 * i, 5] + y * tangent[3 * i + 1, 5] + z * tangent[3 * i + 2, 5]
            t6 = x * tangent[3 * i, 6] + y * tangent[3 * i + 1, 6] + z * tangent[3 * i + 2, 6]
            t7 = x * tangent[3 * i, 7] + y * tangent[3 * i + 1, 7] + z * tangent[3 * i + 2, 7]
            t8 = x * tangent[3 * i, 8] + y * tangent[3 * i + 1, 8] + z * tangent[3 * i + 2, 8]
            for b in range(nn):
                column = 3 * place[b]
                u, v, w = spatial[b, 0], spatial[b, 1], spatial[b, 2]
                local[row + i, column] += t0 * u + t1 * v + t2 * w
                local[row + i, column + 1] += t3 * u + t4 * v + t5 * w
                local[row + i, column + 2] += t6 * u + t7 * v + t8 * w
    if averaged:
        for a in range(nn):
            for i in range(3):
                row, value = 3 * place[a] + i, extra[a, i]
                for b in range(nodes):
                    for k in range(3):
                        local[row, 3 * b + k] += value * mean_gradient[b, k]
                for b in range(nn):
                    for k in range(3):
                        local[row, 3 * place[b] + k] -= value * spatial[b, k]


@njit(cache=True, nogil=True)
def _scatter(group, nodes, group_nodes, stiffness, local_force, local, target):
    """Add a group's force and stiffness to those of the rank."""
    owned_nodes, row_start, pair_start, position, force, values = target
    for a in range(nodes):
        row = group_nodes[a]
        for i in range(3):
            force[row, i] += local_force[a, i]
        if not stiffness or row >= owned_nodes:
            continue
        start, width = row_start[row], 3 * (row_start[row + 1] - row_start[row])
        for b in range(nodes):
            block = position[pair_start[group] + a * nodes + b] - start
            for i in range(3):
                at = 9 * start + i * width + 3 * block
                for k in range(3):
                    values[at + k] += local[3 * a + i, 3 * b + k]


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
def multiply_transposed(row_start, columns, values, vector, result):
    """result += K^T vector over the owned rows; vector (n, 3), mostly zero, result (n, 3)."""
    for row in range(row_start.size - 1):
        start, blocks = row_start[row], row_start[row + 1] - row_start[row]
        for i in range(3):
            if vector[row, i] == 0.0:
                continue
            at = 9 * start + i * 3 * blocks
            for block in range(blocks):
                node = columns[start + block]
                for k in range(3):
                    result[node, k] += values[at + 3 * block + k] * vector[row, i]


@njit(cache=True, nogil=True)
def constrain(row_start, columns, values, fixed, scale):
    """Replace rows and columns of fixed unknowns (n, 3 bool) by `scale` on the diagonal."""
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
