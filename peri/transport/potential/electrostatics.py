"""The electric potential of a conducting liquid between electrodes, and their currents.

With u = -phi (phi the liquid's potential, V) charge conservation reads

    dV sum_j kappa_ij w_ij (u_i - u_j) + sum_s I_s a_si = 0,        I_s = A_s i(V_s + u at s),

one row a liquid node i; A_s, a_si are area and shares of a patch s of an electrode held at V_s,
i its polarization law, positive where current enters the liquid.  Electrodes at equal V are
joined by a wire.  All else is insulated, or held.

A patch is a metal node beside liquid.  The bonds from metal to liquid are what the sum over
liquid nodes misses, so they carry the patch's current: with q_sj = dV sum_m w_mj (xi . n_s)+ over
the metal nodes m nearest to s, the area is A_s = sum_j q_sj and the share a_sj = q_sj / A_s.  A
flat wall then feeds each node what a uniform field lacks there, exactly, and the second moment of
the stencil makes the area of a plane of any direction right on average.  The surface lies in the
middle of the bonds: the patch sees u_s = sum_j a_sj u_j from the distance z_s = sum q (xi . n) /
(2 A_s), and its own potential is V_s + u_s - z_s i / kappa.

The rows are the derivative of a convex function (di/dE >= 0), so Newton's method with an exact
search along each direction always converges; the currents of all patches balance to round-off.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import Convolution, NonlocalSum, Operator, signed_bonds
from peri.engine.solvers import ConvergenceError, LinearSystem
from peri.transport.potential.polarization import Polarization, surface_potential
from peri.transport.potential.walls import WithWalls

log = logging.getLogger(__name__)

_NEWTON_STEPS = 40
_WIDEST = 100.0
"""Potential, V, at which a set of electrodes without any zero of its total current is given up."""


@dataclass(frozen=True)
class Electrode:
    """Metal nodes (bool, of the lattice's shape), their law, and the metal's potential V, V."""

    metal: np.ndarray
    law: Polarization
    potential: float = 0.0


@dataclass(frozen=True)
class Patches:
    """The surface of the electrodes, patch by patch.

    electrode (n,): which one.  node (n, d): index of the metal node.  normal (n, d): from metal to
    liquid.  area (n,): m^2 (m in 2D, 1 in 1D).  distance (n,): z of the head of this file, m.
    shares (n, padded nodes): a, rows sum to 1.  drawn (n, nodes of the lattice): where behind the
    patch its current comes from, rows sum to 1; a node stands behind one patch, the nearest.
    """

    electrode: np.ndarray
    node: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    distance: np.ndarray
    shares: sparse.csr_matrix
    drawn: sparse.csr_matrix


@dataclass(frozen=True)
class PotentialField:
    """What `solve_potential` finds.

    potential : liquid's phi of the lattice's shape, V; NaN off the liquid and where no electrode
        and no held node reaches.
    patches : Patches.  density (n,): i of each patch, A/m^2.  surface (n,): E of each patch, V.
    imbalance : sum of all currents over the sum of their sizes, where nothing is held.
    newton, iterations : Newton steps, and linear iterations in all.
    """

    potential: np.ndarray
    patches: Patches
    density: np.ndarray
    surface: np.ndarray
    imbalance: float
    newton: int
    iterations: int

    def current(self, electrode: int) -> float:
        """Current that an electrode gives to the liquid, A (A/m in 2D, A/m^2 in 1D)."""
        of = self.patches.electrode == electrode
        return float((self.density * self.patches.area)[of].sum())


def surface_patches(
    bond_sum: NonlocalSum, liquid: np.ndarray, electrodes: Sequence[np.ndarray]
) -> Patches:
    """The patches of metal nodes (bool arrays of the lattice's shape) against liquid nodes.

    Raises ValueError if a node belongs to two of liquid and electrodes, or no metal touches liquid.
    """
    taken = np.asarray(liquid, bool).astype(int)
    for metal in electrodes:
        taken += np.asarray(metal, bool)
    if (taken > 1).any():
        raise ValueError(f"electrodes: {int((taken > 1).sum())} nodes are named twice")
    d = len(bond_sum.lattice_shape)
    spacing = np.array(bond_sum.spacing[3 - d :])
    volume = float(np.prod(spacing))
    offsets, weights = signed_bonds(bond_sum)
    bonds = offsets[:, 3 - d :] * spacing
    wet = bond_sum.pad(liquid).ravel()
    _, rows, columns = bond_sum.padded_shape
    shifts = offsets @ np.array([rows * columns, columns, 1])
    all_metal = taken.astype(bool) & ~np.asarray(liquid, bool)
    exposed_faces, raw_area, normals = _surface(bond_sum, np.asarray(liquid, bool), all_metal)
    sees = bond_sum.crop(bond_sum(bond_sum.pad(liquid))) > 0
    parts = []
    for number, metal in enumerate(electrodes):
        exposed = np.argwhere(np.asarray(metal, bool) & (exposed_faces > 0))
        if not len(exposed):
            continue
        behind = np.argwhere(np.asarray(metal, bool) & sees)
        nearest = cKDTree(exposed * spacing).query(behind * spacing)[1]
        flat = _padded_index(bond_sum, behind)
        on = wet[flat[:, None] + shifts] > 0
        node, bond = np.nonzero(on)
        normal = normals[tuple(exposed.T)]
        along = (bonds[bond] * normal[nearest[node]]).sum(axis=1)
        along = np.where(
            normal.any(axis=1)[nearest[node]],
            np.maximum(along, 0.0),
            np.linalg.norm(bonds, axis=1)[bond],
        )
        carried = volume * weights[bond] * along
        carrying = np.bincount(nearest[node], carried, len(exposed))
        reach = np.bincount(nearest[node], carried * along, len(exposed))
        entries = sparse.coo_matrix(
            (carried, (nearest[node], flat[node] + shifts[bond])), (len(exposed), wet.size)
        ).tocsr()
        keep = carrying > 0
        scale = sparse.diags(1.0 / carrying[keep])
        # Faradaic bonds carry their current in proportion to 1/|xi| (Zhao et al. 2021, Eq. 16).
        here = weights[bond] * np.linalg.norm(bonds, axis=1)[bond] * (along > 0)
        place = np.ravel_multi_index(tuple(behind.T), liquid.shape)
        drawn = sparse.coo_matrix(
            (np.bincount(node, here, len(behind)), (nearest, place)), (len(exposed), liquid.size)
        ).tocsr()[keep]
        drawn.eliminate_zeros()
        whole = np.asarray(drawn.sum(axis=1)).ravel()
        # Area of a plane of that normal per exposed face: 1 / sum_a |n_a| / (area of a face).
        facing = (np.abs(normal) * spacing / volume).sum(axis=1)
        raw = raw_area[tuple(exposed.T)]
        count = exposed_faces[tuple(exposed.T)]
        area = np.where(facing > 0, count / np.where(facing > 0, facing, 1.0), raw)
        parts.append(
            (
                np.full(int(keep.sum()), number),
                exposed[keep],
                normal[keep],
                area[keep],
                0.5 * reach[keep] / carrying[keep],
                scale @ entries[keep],
                sparse.diags(1.0 / whole) @ drawn,
            )
        )
    if not parts:
        raise ValueError("electrodes: none of them touches the liquid")
    electrode, node_of, directions, areas, distances, shares, behind_it = zip(*parts, strict=True)
    return Patches(
        np.concatenate(electrode),
        np.concatenate(node_of),
        np.concatenate(directions),
        np.concatenate(areas),
        np.concatenate(distances),
        sparse.csr_matrix(sparse.vstack(shares)),
        sparse.csr_matrix(sparse.vstack(behind_it)),
    )


def _surface(
    bond_sum: NonlocalSum, liquid: np.ndarray, metal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces to liquid of each metal node: their number, their raw area, and the smoothed normal.

    The normal is the mean direction of the faces of all metal nodes within the horizon, without
    those that look away from a node's own: a plane has them in proportion to its normal.  It is
    zero for nodes that look to both sides of all axes.
    """
    d, stencil = metal.ndim, bond_sum.stencil
    volume = float(np.prod(stencil.spacing))
    ball = np.where(stencil.octant > 0, 1.0, 0.0)
    ball.flat[0] = 1.0
    near = NonlocalSum(Stencil(ball, stencil.spacing), metal.shape)
    count, raw = np.zeros(metal.shape, int), np.zeros(metal.shape)
    normals = np.zeros((*metal.shape, d))
    for a in range(d):
        low = (slice(None),) * a + (slice(0, -1),)
        high = (slice(None),) * a + (slice(1, None),)
        ahead, back = np.zeros(metal.shape, bool), np.zeros(metal.shape, bool)
        ahead[low] = metal[low] & liquid[high]
        back[high] = metal[high] & liquid[low]
        count += ahead.astype(int) + back
        raw += (ahead.astype(int) + back) * volume / stencil.spacing[a]
        up, down = (np.rint(near.crop(near(near.pad(side)))) for side in (ahead, back))
        normals[..., a] = np.where(ahead & ~back, up, np.where(back & ~ahead, -down, up - down))
    # The faces of an axis lie closer where the others' spacing is short: per area, not per face.
    normals /= np.array(stencil.spacing)
    normals[(count == 0)] = 0.0
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return count, raw, normals / np.where(length > 0, length, 1.0)


def _padded_index(bond_sum: NonlocalSum, nodes: np.ndarray) -> np.ndarray:
    """Flat indices in a padded array of nodes (n, d)."""
    d = nodes.shape[1]
    place = np.zeros((len(nodes), 3), np.int64)
    place[:, 3 - d :] = nodes
    return np.ravel_multi_index(tuple((place + np.array(bond_sum.reach)).T), bond_sum.padded_shape)


def _reached(liquid: np.ndarray, touched: np.ndarray) -> np.ndarray:
    """The connected parts of the liquid (across faces) that hold a touched node."""
    number, _ = ndimage.label(liquid)
    return np.isin(number, np.unique(number[touched & liquid])) & liquid


class PotentialProblem:
    """Liquid, electrodes and bonds of one geometry; solved for many laws or states.

    Parameters
    ----------
    lattice : Lattice
    stencil : Stencil
        Of unit diffusivity (influence.diffusion_stencil).
    liquid : bool array of the lattice's shape
    electrodes : sequence of Electrode
        Metal nodes are exclusive.
    conductivity : float or array of the lattice's shape
        kappa, S/m.
    operator : Operator, optional
        Bonds of the liquid (kappa w_ij, of harmonic means, say); by default the geometric mean of
        both nodes' conductivities, a convolution.
    held : float array of the lattice's shape, optional
        phi of liquid nodes that are held, V; NaN elsewhere.
    walls : bool
        Whether walls conduct along themselves as the rest does (transport.potential.walls); for
        the default operator.

    Raises
    ------
    ValueError
        For a conductivity that is not positive in the liquid, electrodes that share nodes or do
        not touch the liquid.
    """

    def __init__(
        self,
        lattice: Lattice,
        stencil: Stencil,
        liquid: np.ndarray,
        electrodes: Sequence[Electrode],
        conductivity: float | np.ndarray,
        operator: Operator | None = None,
        held: np.ndarray | None = None,
        walls: bool = True,
    ) -> None:
        self.electrodes = list(electrodes)
        kappa = np.broadcast_to(np.asarray(conductivity, float), lattice.shape)
        if not (np.isfinite(kappa[liquid]).all() and (kappa[liquid] > 0).all()):
            raise ValueError("conductivity: it must be positive in the whole liquid, S/m")
        fixed = np.zeros(lattice.shape, bool) if held is None else np.isfinite(held) & liquid
        self.sum = NonlocalSum(stencil, lattice.shape)
        pad = self.sum.pad
        self.patches = surface_patches(self.sum, liquid, [e.metal for e in self.electrodes])
        seen = np.asarray(self.patches.shares.sum(axis=0)).reshape(self.sum.padded_shape)
        self.liquid = _reached(liquid, (self.sum.crop(seen) > 0) | fixed)
        dropped = int((liquid & ~self.liquid).sum())
        if dropped:
            log.info(
                "%d liquid nodes are cut off from all electrodes: they have no potential", dropped
            )
        self.unknown = pad(self.liquid & ~fixed)
        self.held = pad(np.where(fixed, -np.nan_to_num(held if held is not None else 0.0), 0.0))
        self.any_held = bool(fixed.any())
        if operator is None:
            root = pad(np.sqrt(np.where(self.liquid, kappa, 0.0)))
            operator = Convolution(self.sum, self.unknown * root, root, symmetric=True)
            if walls:
                operator = WithWalls(operator, self.liquid, kappa)
        self.operator = operator
        self.volume = lattice.cell_volume
        self._columns = np.flatnonzero(np.diff(self.patches.shares.tocsc().indptr))
        self._shares = self.patches.shares[:, self._columns].tocsr()
        self._free = self.unknown.ravel()[self._columns] > 0
        local = np.where(np.isfinite(kappa) & (kappa > 0), kappa, 1.0)
        self._at_patch = self._shares @ pad(local).ravel()[self._columns]
        self.recede(np.zeros(len(self.patches.area)))
        self._voltage = np.array([e.potential for e in self.electrodes])[self.patches.electrode]
        self._row_sums = operator.row_sums()
        self._weight = self.volume * operator.diagonal()

    def recede(self, depth: np.ndarray) -> None:
        """Put the surface of each patch deeper, (n,) in m: what its metal has lost already."""
        self._resistance = (self.patches.distance + depth) / self._at_patch

    def _see(self, u: np.ndarray) -> np.ndarray:
        """u_s = sum_j a_sj u_j of every patch."""
        return self._shares @ u.ravel()[self._columns]

    def _spread(self, values: np.ndarray) -> np.ndarray:
        """sum_s a_si values_s on the unknown nodes, padded."""
        out = np.zeros(self.sum.padded_shape)
        out.ravel()[self._columns] = np.where(self._free, self._shares.T @ values, 0.0)
        return out

    def _currents(self, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E, i and di/du_s of every patch."""
        surface, density, slope = (np.zeros_like(seen) for _ in range(3))
        for number, electrode in enumerate(self.electrodes):
            of = self.patches.electrode == number
            if of.any():
                surface[of], density[of], slope[of] = surface_potential(
                    electrode.law, (self._voltage + seen)[of], self._resistance[of]
                )
        return surface, density, slope

    def _net(self, seen: np.ndarray, shift: float) -> float:
        return float((self.patches.area * self._currents(seen + shift)[1]).sum())

    def _balancing_shift(self, seen: np.ndarray) -> float:
        """The uniform change of u after which the patches' currents add up to nothing.

        Raises ValueError where no potential does that.
        """
        if self._net(seen, 0.0) == 0.0:
            return 0.0
        reach = 1e-6
        while True:
            low, high = self._net(seen, -reach), self._net(seen, reach)
            if low < 0.0 < high:
                root, _ = brentq(
                    lambda c: self._net(seen, c), -reach, reach,
                    xtol=1e-17, rtol=1e-15, maxiter=300, full_output=True, disp=False,
                )  # fmt: skip
                return float(root)
            reach *= 4.0
            if reach > _WIDEST:
                raise ValueError(
                    "electrodes: their currents have one sign at every potential; a current "
                    "needs a sink (a cathode, or a held potential)"
                )

    def solve(self, guess: np.ndarray | None = None, tolerance: float = 1e-9) -> PotentialField:
        """The potential for the electrodes' laws.

        Parameters
        ----------
        guess : array of the lattice's shape, optional
            phi to start with, such as that of the time before, V.
        tolerance : float
            Residual of the nodes' charge balances relative to the patches' currents (2-norms).

        Raises
        ------
        ValueError
            Where all currents have one sign, or a law's current falls as the potential rises.
        ConvergenceError
            Where Newton's method does not reach the tolerance.
        """
        u = self.held.copy()
        if guess is not None:
            u += self.unknown * self.sum.pad(-np.nan_to_num(guess))
        if not self.any_held:
            u += self.unknown * self._balancing_shift(self._see(u))
        total = 0
        for steps in range(_NEWTON_STEPS + 1):
            seen = self._see(u)
            surface, density, slope = self._currents(seen)
            flux = self._spread(self.patches.area * density)
            inside = self._flux(u)
            residual = -(inside + flux)
            size = float(np.linalg.norm(flux))
            norm = float(np.linalg.norm(residual))
            # Round-off of the sums over bonds, which a fine lattice makes large beside currents.
            rounding = self.patches.area * slope * np.maximum(np.abs(surface), np.abs(seen))
            noise = 1e-15 * float(
                np.linalg.norm(self._weight * u) + np.linalg.norm(self._spread(rounding))
            )
            if norm <= max(tolerance * size, noise):
                break
            if steps == _NEWTON_STEPS:
                raise ConvergenceError(
                    f"potential: residual {norm / size:.3g} of the currents after {steps} Newton "
                    f"steps, {tolerance:.3g} wanted"
                )
            step, count = self._newton_direction(
                residual, slope, max(1e-3, 0.3 * tolerance * size / norm)
            )
            total += count
            u += self._search(u, step, residual) * step
        imbalance = 0.0
        if not self.any_held:
            shift = self._balancing_shift(seen)
            u += shift * self.unknown
            surface, density, _ = self._currents(seen + shift)
            currents = self.patches.area * density
            imbalance = float(currents.sum() / max(np.abs(currents).sum(), 1e-300))
        phi = np.where(self.liquid, -self.sum.crop(u), np.nan)
        return PotentialField(phi, self.patches, density, surface, imbalance, steps, total)

    def _flux(self, u: np.ndarray) -> np.ndarray:
        """dV sum_j kappa w_ij (u_i - u_j) on the unknown nodes, held neighbours included."""
        gain = self.operator.gain(u, np.zeros(self.sum.padded_shape))
        return (self._weight * u - self.volume * gain) * self.unknown

    def _newton_direction(
        self, residual: np.ndarray, slope: np.ndarray, reduction: float
    ) -> tuple[np.ndarray, int]:
        conductance = self.patches.area * slope / self.volume
        squares = self._shares.multiply(self._shares)
        diagonal = np.zeros(self.sum.padded_shape)
        diagonal.ravel()[self._columns] = np.where(self._free, squares.T @ conductance, 0.0)

        def patches(v: np.ndarray, y: np.ndarray) -> float:
            seen = self._see(v)
            y += self._spread(conductance * seen)
            return float((conductance * seen**2).sum())

        sink = np.maximum(self._row_sums, 0.0) + self._spread(conductance)
        system = LinearSystem(self.operator, sink=sink, extra=patches, extra_diagonal=diagonal)
        step, right = np.zeros(self.sum.padded_shape), residual / self.volume
        wanted = reduction * float(np.linalg.norm(right))
        return step, system.solve(step, right, wanted)

    def _search(self, u: np.ndarray, step: np.ndarray, residual: np.ndarray) -> float:
        """The share of a step at which the convex function is least along it."""
        seen, change = self._see(u), self._see(step)
        area = self.patches.area
        start = float((area * self._currents(seen)[1] * change).sum())
        bonds = -float((residual * step).sum()) - start
        curvature = float((self._flux(step) * step).sum())

        def slope(share: float) -> float:
            density = self._currents(seen + share * change)[1]
            return bonds + share * curvature + float((area * density * change).sum())

        at_start = slope(0.0)
        if at_start >= 0.0:
            return 1.0  # round-off: there is nothing left to gain
        if abs(slope(1.0)) <= 0.1 * abs(at_start):
            return 1.0
        high = 1.0
        while slope(high) < 0.0:
            high *= 2.0
            if high > 1e6:
                return high
        return float(brentq(slope, 0.0, high, xtol=1e-12, rtol=1e-3))
