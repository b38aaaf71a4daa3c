"""Internal force and consistent stiffness of all cells, material update included (Numba).

Total Lagrangian weak form sum_q V_q P : grad v with P = tau F^-T; stiffness from
d(P) F^T = d(tau) - tau l^T, which is C : d - tau d - d tau + l tau with the tangent C of the
corotational rate and l = d + w. So K = sum_q V_q (B^T D B + g_a . tau g_b 1) with spatial gradients
g, B that makes d of them, and D = C - tau d - d tau, (6, 6). With mean dilatation (F-bar, de Souza
Neto et al. 1996; patches of tetrahedra, 2005) F is scaled by r = (Jm/J)^(1/3), Jm the mean of J
over the group (cell or patch); the stress is that of the scaled F, and the tangent has one term
more, which couples all nodes of the group.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from fem.constitutive.compiled import kernel
from fem.constitutive.hencky import invert
from fem.constitutive.laws import Laws
from fem.constitutive.material import update_point
from fem.discretisation import Discretisation
from fem.quadrature_state import QuadratureState

_LANES = 8  # numbers in a vector register: rows of a cell's matrices are a multiple of it


@dataclass
class Assembled:
    """Result of one assembly on this rank."""

    force: np.ndarray  # (n, 3) internal force, complete on owned nodes [N]
    values: np.ndarray  # stiffness of the owned rows, scalar CSR order [N/m]
    failed: int  # quadrature points without a valid state, owned cells
    stored: float  # elastic energy of the owned cells [J]
    dissipated: float  # plastic work of the step, owned cells [J]


class Assembler:
    """Assembles a Discretisation with the materials of its cells; `alive` cells only.

    averaged (nc,): cells whose change of volume F-bar averages; all, unless some are taken out.
    """

    def __init__(self, discretisation: Discretisation, laws: Laws, threads: int) -> None:
        self.discretisation, self.laws = discretisation, laws
        self.alive = np.ones(len(discretisation.cells), bool)
        self.averaged = np.full(len(self.alive), discretisation.element.mean_dilatation)
        groups = discretisation.groups
        sizes = np.diff(groups.cell_start), np.diff(groups.node_start)
        self._largest = tuple(int(size.max()) if size.size else 1 for size in sizes)
        self.force = np.zeros_like(discretisation.coordinates)
        self.values = np.zeros(9 * len(discretisation.columns))
        self.seconds, self.count = 0.0, 0
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
        self.count += 1
        return Assembled(self.force, self.values, int(totals[0]), totals[1], totals[2])

    def _job(self, first, last, displacement, state, stiffness):
        d, g, old, new = self.discretisation, self.discretisation.groups, state.old, state.new
        laws = self.laws
        return (
            first, last, self._largest, stiffness, self.averaged,
            (d.cells, d.owned, self.alive, d.gradients, d.volumes, displacement),
            (g.cell_start, g.node_start, g.nodes, g.place),
            (old.plastic, old.strain, old.damage, state.acting),
            (new.plastic, new.strain, new.damage, new.mises, new.pressure),
            (laws.parameters, laws.kinds, laws.starts, laws.hardening, laws.of_cell),
            (d.owned_nodes, d.row_start, g.pair_start, d.position, self.force, self.values),
        )  # fmt: skip


@kernel
def _assemble_groups(
    first, last, largest, stiffness, averages, mesh, groups, old, new, law, target
):
    """Groups first..last-1; returns (failed points, stored energy, dissipated energy)."""
    cells, owned, alive, gradients, volumes, displacement = mesh
    cell_start, node_start, group_nodes, place = groups
    parameters, kinds, starts, hardenings, of_cell = law
    nn, nq = cells.shape[1], gradients.shape[1]
    scratch, tangent = np.empty((13, 6)), np.empty((6, 6))
    deformation, jacobian = np.empty((largest[0], nq, 9)), np.empty((largest[0], nq))
    spatial = np.empty((largest[0], nq, 3 * nn))
    mean_gradient, extra = np.zeros(3 * largest[1]), np.empty(3 * largest[1])
    columns = _LANES * ((3 * nn + _LANES - 1) // _LANES)
    rates, image = np.zeros((6, columns)), np.empty((6, columns))
    block, initial = np.empty((3 * nn, columns)), np.empty((nn, nn))
    local_force = np.empty(3 * largest[1])
    # of a group's stiffness; that of a single cell needs no summation
    local = block if largest[0] == 1 else np.empty((3 * largest[1], 3 * largest[1]))
    failed, stored, dissipated = 0.0, 0.0, 0.0
    for g in range(first, last):
        start, stop = cell_start[g], cell_start[g + 1]
        nodes = node_start[g + 1] - node_start[g]
        averaged = averages[start]
        wrong, mean, volume = _kinematics(start, stop, mesh, deformation, jacobian, spatial)
        if volume == 0.0 or wrong > 0.0:
            failed += wrong
            _keep(start, stop, nq, old, new)
            continue
        mean_gradient[: 3 * nodes] = extra[: 3 * nodes] = local_force[: 3 * nodes] = 0.0
        if averaged and stiffness:
            _average(start, stop, mean * volume, mesh, place, jacobian, spatial, mean_gradient)
        if stiffness and largest[0] > 1:
            local[: 3 * nodes, : 3 * nodes] = 0.0
        for c in range(start, stop):
            if not alive[c]:
                _keep(c, c + 1, nq, old, new)
                continue
            row = of_cell[c]
            material, kind = parameters[row], kinds[row]
            hardening = hardenings[starts[row] : starts[row + 1]]
            if stiffness:
                block[:], initial[:] = 0.0, 0.0
            for q in range(nq):
                ratio = 1.0
                if averaged:
                    ratio = (mean / jacobian[c - start, q]) ** (1.0 / 3.0)
                weight = volumes[c, q] / ratio**3
                ok, stress, plastic, strain, damage, energy, work, mises, pressure = update_point(
                    _scaled(deformation, c - start, q, ratio), _six(old[0], c, q), old[1][c, q],
                    old[2][c, q], old[3][c, q], material, kind, hardening, stiffness, tangent,
                    scratch,
                )  # fmt: skip
                for k in range(6):
                    new[0][c, q, k] = plastic[k]
                new[1][c, q], new[2][c, q], new[3][c, q], new[4][c, q] = (
                    strain, damage, mises, pressure,
                )  # fmt: skip
                if owned[c]:
                    if not ok:
                        failed += 1.0
                    stored += volumes[c, q] * energy
                    dissipated += volumes[c, q] * work
                gradient = spatial[c - start, q]
                _add_force(weight, stress, gradient, place[c], stiffness, local_force, initial)
                if stiffness:
                    if averaged:
                        _mean_dilatation(weight, stress, gradient, place[c], tangent, extra)
                    _add_stiffness(weight, stress, tangent, gradient, rates, image, block)
            if stiffness:
                _add_initial(initial, block)
                if largest[0] > 1:
                    _place_block(place[c], block, local)
        if averaged and stiffness:
            _add_product(extra[: 3 * nodes], mean_gradient[: 3 * nodes], local)
        _scatter(g, nodes, group_nodes[node_start[g] :], stiffness, local_force, local, target)
    return failed, stored, dissipated


@kernel
def _average(start, stop, volume, mesh, place, jacobian, spatial, mean_gradient):
    """Add the spatial gradients of a group, averaged over its present volume."""
    cells, _, alive, gradients, volumes, _ = mesh
    for c in range(start, stop):
        if not alive[c]:
            continue
        for q in range(gradients.shape[1]):
            part = volumes[c, q] * jacobian[c - start, q] / volume
            for a in range(cells.shape[1]):
                for i in range(3):
                    mean_gradient[3 * place[c, a] + i] += part * spatial[c - start, q, 3 * a + i]


@kernel
def _add_product(rows, columns, local):
    for row in range(rows.size):
        for column in range(columns.size):
            local[row, column] += rows[row] * columns[column]


@kernel
def _scaled(deformation, c, q, ratio):
    return (
        ratio * deformation[c, q, 0], ratio * deformation[c, q, 1], ratio * deformation[c, q, 2],
        ratio * deformation[c, q, 3], ratio * deformation[c, q, 4], ratio * deformation[c, q, 5],
        ratio * deformation[c, q, 6], ratio * deformation[c, q, 7], ratio * deformation[c, q, 8],
    )  # fmt: skip


@kernel
def _three(gradient, a):
    return gradient[3 * a], gradient[3 * a + 1], gradient[3 * a + 2]


@kernel
def _six(tensors, c, q):
    return (
        tensors[c, q, 0], tensors[c, q, 1], tensors[c, q, 2],
        tensors[c, q, 3], tensors[c, q, 4], tensors[c, q, 5],
    )  # fmt: skip


@kernel
def _keep(start, stop, nq, old, new):
    """New state = old state, without stress, for cells that are not evaluated."""
    for c in range(start, stop):
        for q in range(nq):
            for k in range(6):
                new[0][c, q, k] = old[0][c, q, k]
            new[1][c, q], new[2][c, q] = old[1][c, q], old[2][c, q]
            new[3][c, q] = new[4][c, q] = 0.0


@kernel
def _kinematics(start, stop, mesh, deformation, jacobian, spatial):
    """Fill F, J and spatial gradients; return (inverted owned points, mean J, volume)."""
    cells, owned, alive, gradients, volumes, displacement = mesh
    nn, nq = cells.shape[1], gradients.shape[1]
    wrong, total, volume = 0.0, 0.0, 0.0
    for c in range(start, stop):
        if not alive[c]:
            continue
        for q in range(nq):
            f00 = f11 = f22 = 1.0
            f01 = f02 = f10 = f12 = f20 = f21 = 0.0
            for a in range(nn):
                node = cells[c, a]
                u, v, w = displacement[node, 0], displacement[node, 1], displacement[node, 2]
                x, y, z = gradients[c, q, a, 0], gradients[c, q, a, 1], gradients[c, q, a, 2]
                f00, f01, f02 = f00 + u * x, f01 + u * y, f02 + u * z
                f10, f11, f12 = f10 + v * x, f11 + v * y, f12 + v * z
                f20, f21, f22 = f20 + w * x, f21 + w * y, f22 + w * z
            all_nine = (f00, f01, f02, f10, f11, f12, f20, f21, f22)
            for k in range(9):
                deformation[c - start, q, k] = all_nine[k]
            value, (i00, i01, i02, i10, i11, i12, i20, i21, i22) = invert(all_nine)
            jacobian[c - start, q] = value
            if not value > 0.0:
                wrong += 1.0 if owned[c] else 1e-9
            for a in range(nn):
                x, y, z = gradients[c, q, a, 0], gradients[c, q, a, 1], gradients[c, q, a, 2]
                spatial[c - start, q, 3 * a] = i00 * x + i10 * y + i20 * z
                spatial[c - start, q, 3 * a + 1] = i01 * x + i11 * y + i21 * z
                spatial[c - start, q, 3 * a + 2] = i02 * x + i12 * y + i22 * z
            volume += volumes[c, q]
            total += volumes[c, q] * value
    if volume > 0.0:
        total /= volume
    return wrong, total, volume


@kernel
def _add_force(weight, stress, gradient, place, stiffness, force, initial):
    """Add one point's tau g_a to the force and g_a . tau g_b to the initial stiffness."""
    s00, s11, s22, s01, s02, s12 = stress
    for a in range(place.size):
        x, y, z = _three(gradient, a)
        u = weight * (s00 * x + s01 * y + s02 * z)
        v = weight * (s01 * x + s11 * y + s12 * z)
        w = weight * (s02 * x + s12 * y + s22 * z)
        force[3 * place[a]] += u
        force[3 * place[a] + 1] += v
        force[3 * place[a] + 2] += w
        if stiffness:
            for b in range(place.size):
                x, y, z = _three(gradient, b)
                initial[a, b] += u * x + v * y + w * z


@kernel
def _mean_dilatation(weight, stress, gradient, place, tangent, extra):
    """F-bar adds X g_a (x) (gm_b - g_b) with X = C:1/3 - tau: add X g_a and subtract X (x) 1."""
    t00, t11, t22, t01, t02, t12 = _thirds(tangent, stress)
    for a in range(place.size):
        x, y, z = _three(gradient, a)
        extra[3 * place[a]] += weight * (t00 * x + t01 * y + t02 * z)
        extra[3 * place[a] + 1] += weight * (t01 * x + t11 * y + t12 * z)
        extra[3 * place[a] + 2] += weight * (t02 * x + t12 * y + t22 * z)
    for j in range(3):
        tangent[0, j] -= t00
        tangent[1, j] -= t11
        tangent[2, j] -= t22
        tangent[3, j] -= t01
        tangent[4, j] -= t02
        tangent[5, j] -= t12


@kernel
def _thirds(c, stress):
    return (
        (c[0, 0] + c[0, 1] + c[0, 2]) / 3.0 - stress[0],
        (c[1, 0] + c[1, 1] + c[1, 2]) / 3.0 - stress[1],
        (c[2, 0] + c[2, 1] + c[2, 2]) / 3.0 - stress[2],
        (c[3, 0] + c[3, 1] + c[3, 2]) / 3.0 - stress[3],
        (c[4, 0] + c[4, 1] + c[4, 2]) / 3.0 - stress[4],
        (c[5, 0] + c[5, 1] + c[5, 2]) / 3.0 - stress[5],
    )


@kernel
def _add_stiffness(weight, stress, tangent, gradient, rates, image, block):
    """Add one point's B^T D B, D = C - tau d - d tau; `rates` is B, zeros in place, `image` D B."""
    s00, s11, s22, s01, s02, s12 = stress
    for at in range(0, gradient.size, 3):
        x, y, z = gradient[at], gradient[at + 1], gradient[at + 2]
        rates[0, at] = rates[3, at + 1] = rates[4, at + 2] = x
        rates[1, at + 1] = rates[3, at] = rates[5, at + 2] = y
        rates[2, at + 2] = rates[4, at] = rates[5, at + 1] = z
    tangent[0, 0] -= 2.0 * s00
    tangent[1, 1] -= 2.0 * s11
    tangent[2, 2] -= 2.0 * s22
    tangent[3, 3] -= 0.5 * (s00 + s11)
    tangent[4, 4] -= 0.5 * (s00 + s22)
    tangent[5, 5] -= 0.5 * (s11 + s22)
    for i, j, value in (
        (0, 3, s01), (0, 4, s02), (1, 3, s01), (1, 5, s12), (2, 4, s02), (2, 5, s12),
        (3, 4, 0.5 * s12), (3, 5, 0.5 * s02), (4, 5, 0.5 * s01),
    ):  # fmt: skip
        tangent[i, j] -= value
        tangent[j, i] -= value
    for i in range(6):
        t0, t1, t2 = weight * tangent[i, 0], weight * tangent[i, 1], weight * tangent[i, 2]
        t3, t4, t5 = weight * tangent[i, 3], weight * tangent[i, 4], weight * tangent[i, 5]
        for j in range(image.shape[1]):
            image[i, j] = (
                t0 * rates[0, j] + t1 * rates[1, j] + t2 * rates[2, j]
                + t3 * rates[3, j] + t4 * rates[4, j] + t5 * rates[5, j]
            )  # fmt: skip
    for at in range(0, gradient.size, 3):
        x, y, z = gradient[at], gradient[at + 1], gradient[at + 2]
        for j in range(image.shape[1]):
            block[at, j] += x * image[0, j] + y * image[3, j] + z * image[4, j]
        for j in range(image.shape[1]):
            block[at + 1, j] += y * image[1, j] + x * image[3, j] + z * image[5, j]
        for j in range(image.shape[1]):
            block[at + 2, j] += z * image[2, j] + x * image[4, j] + y * image[5, j]


@kernel
def _add_initial(initial, block):
    for a in range(initial.shape[0]):
        for b in range(initial.shape[0]):
            for i in range(3):
                block[3 * a + i, 3 * b + i] += initial[a, b]


@kernel
def _place_block(place, block, local):
    """Add a cell's stiffness to that of its group."""
    for a in range(place.size):
        for b in range(place.size):
            row, column = 3 * place[a], 3 * place[b]
            for i in range(3):
                for k in range(3):
                    local[row + i, column + k] += block[3 * a + i, 3 * b + k]


@kernel
def _scatter(group, nodes, group_nodes, stiffness, local_force, local, target):
    """Add a group's force and stiffness to those of the rank."""
    owned_nodes, row_start, pair_start, position, force, values = target
    for a in range(nodes):
        row = group_nodes[a]
        for i in range(3):
            force[row, i] += local_force[3 * a + i]
        if not stiffness or row >= owned_nodes:
            continue
        start, width = row_start[row], 3 * (row_start[row + 1] - row_start[row])
        first = pair_start[group] + a * nodes
        for b in range(nodes):
            at = 9 * start + 3 * (position[first + b] - start)
            for i in range(3):
                # loaded before anything is stored: the arrays might overlap, for all LLVM knows
                x, y, z = values[at], values[at + 1], values[at + 2]
                u, v, w = _three(local[3 * a + i], b)
                values[at], values[at + 1], values[at + 2] = x + u, y + v, z + w
                at += width


def largest_amount(values: np.ndarray) -> float:
    """Largest absolute value, 0 of nothing; without a copy of a stiffness of many megabytes."""
    return max(float(values.max()), -float(values.min())) if values.size else 0.0


@kernel
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


@kernel
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


@kernel
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
