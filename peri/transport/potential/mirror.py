"""The potential with mirror nodes behind electrodes: Zhao et al. 2021, Appendix A, corrected.

A metal node x within the horizon of the liquid gets a potential of its own, such that half-way to
its mirror image x^R in the liquid the electrode's law holds (Eq. A3, whose last term counts once):

    u(x) = u(x^R) - (d / kappa) i(V + (u(x) + u(x^R)) / 2),      d = |x - x^R|,  u = -phi.

For a law of Tafel i_0 10^((E - E_0) / beta) that is u(x) = u(x^R) - W(w_0) / b with Lambert's W,
w_0 = i_0 ln 10 d / (2 kappa beta) 10^((V + u(x^R) - E_0) / beta) and b = ln 10 / (2 beta)
(`lambert_value`; Eqs A4 and A5 print the unknown on the right of w_0, and do not say b).  Here the
root is found for any law.

Beside a plane that lies along the lattice this is exact where the bond form of
potential.electrostatics is.  Elsewhere what the law gives at the surface is not what the bonds
carry: a mirror node gives each of its neighbours a current of its own, so that by the law anodes
and cathodes do not balance.  It is here to be compared with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree
from scipy.special import lambertw

from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import NonlocalSum, signed_bonds
from peri.engine.solvers import ConvergenceError
from peri.transport.potential.electrostatics import Electrode, PotentialField, PotentialProblem
from peri.transport.potential.polarization import surface_potential

_NEWTON_STEPS = 60
_HALVINGS = 30


def lambert_value(
    seen: np.ndarray, distance: np.ndarray, exchange: float, slope: float, rest: float, kappa: float
) -> np.ndarray:
    """The mirror node's potential E behind a law of Tafel, V (Eqs A4 and A5, corrected).

    Parameters
    ----------
    seen : array
        V + u(x^R), V.
    distance : array
        d, m.
    exchange, slope, rest : i_0 (A/m^2, the sign of i), beta (V per decade, falling for a cathode)
        and E_0 (V) of i_0 10^((E - E_0) / beta).
    kappa : S/m.
    """
    b = np.log(10.0) / (2.0 * slope)
    # ln w_0 in the place of w_0, which overflows; W(w) by its own equation where w is large.
    size = abs(exchange) * np.log(10.0) * distance / (2.0 * kappa * abs(slope))
    logarithm = np.log(size) + np.log(10.0) * (seen - rest) / slope
    small = np.minimum(logarithm, 300.0)
    y = np.real(lambertw(np.exp(small)))
    for _ in range(20):
        y = np.where(logarithm > 300.0, np.maximum(logarithm - np.log(np.maximum(y, 1.0)), 1.0), y)
    return seen - y / b


@dataclass(frozen=True)
class MirrorField:
    """Potential with mirror nodes.

    potential : phi of the liquid, of the lattice's shape, V; NaN elsewhere.  currents : of each
    electrode into the liquid along the bonds, A (A/m in 2D, A/m^2 in 1D).  by_law : the same by
    its law at the faces of metal and liquid, their area that of a plane of their normal.
    imbalance : sum of `by_law` over the sum of sizes.  newton : steps.
    """

    potential: np.ndarray
    currents: np.ndarray
    by_law: np.ndarray
    imbalance: float
    newton: int


class MirrorPotential:
    """Liquid, electrodes and bonds of one geometry, with mirror nodes behind the electrodes.

    Parameters
    ----------
    lattice : Lattice
    stencil : Stencil
        Of unit diffusivity.
    liquid : bool array of the lattice's shape
    electrodes : sequence of Electrode
    conductivity : float
        kappa, S/m.

    Raises
    ------
    ValueError
        For electrodes that touch no liquid, and a conductivity that is not positive.
    """

    def __init__(
        self,
        lattice: Lattice,
        stencil: Stencil,
        liquid: np.ndarray,
        electrodes: Sequence[Electrode],
        conductivity: float,
    ) -> None:
        if not (np.isfinite(conductivity) and conductivity > 0):
            raise ValueError(f"conductivity: {conductivity} S/m; it must be finite and positive")
        self.lattice, self.kappa = lattice, float(conductivity)
        self.electrodes, self.liquid = list(electrodes), np.asarray(liquid, bool)
        bond_sum = NonlocalSum(stencil, lattice.shape)
        number = np.full(bond_sum.padded_shape, -1)
        number[bond_sum.interior] = np.where(self.liquid, 0, -1).reshape(bond_sum.shape)
        wet = np.flatnonzero(number.ravel() == 0)
        number.ravel()[wet] = np.arange(wet.size)
        which = np.full(bond_sum.padded_shape, -1)
        for n, electrode in enumerate(self.electrodes):
            which[bond_sum.interior][electrode.metal.reshape(bond_sum.shape)] = n
        offsets, weights = signed_bonds(bond_sum)
        _, rows, columns = bond_sum.padded_shape
        shifts = offsets @ np.array([rows * columns, columns, 1])
        self._matrix, self._behind, behind = self._bonds(
            number.ravel(), which.ravel(), wet, shifts, weights
        )
        if not behind.size:
            raise ValueError("electrodes: none of them touches the liquid")
        self._electrode = which.ravel()[behind]
        h = np.array(bond_sum.spacing)
        place = np.stack(np.unravel_index(wet, bond_sum.padded_shape), axis=1) * h
        metal = np.stack(np.unravel_index(behind, bond_sum.padded_shape), axis=1) * h
        there = number.ravel()[behind[:, None] + shifts] >= 0
        normal = there @ (offsets * h)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        nearest = cKDTree(place)
        reach = nearest.query(metal)[0] - 0.5 * min(lattice.spacing)
        image = metal + 2.0 * reach[:, None] * normal
        # Of images between nodes the first of the nearest, whatever the round-off.
        away, near = nearest.query(image, k=min(4, wet.size))
        away, near = away.reshape(behind.size, -1), near.reshape(behind.size, -1)
        level = away[:, :1] * (1 + 1e-9) + 1e-9 * min(lattice.spacing)
        self._image = np.where(away <= level, near, wet.size).min(axis=1)
        self._distance = 2.0 * reach
        self._voltage = np.array([e.potential for e in self.electrodes])
        self._faces = self._surface(
            number, which, bond_sum, behind, normal[:, 3 - lattice.dimension :]
        )

    @staticmethod
    def _bonds(
        number: np.ndarray, which: np.ndarray, wet: np.ndarray, shifts: np.ndarray, weights
    ) -> tuple[sparse.csr_matrix, sparse.csr_matrix, np.ndarray]:
        """Bonds among liquid (with their sums), from liquid to metal, and the metal nodes."""
        other = wet[:, None] + shifts
        node, bond = np.nonzero(number[other] >= 0)
        to = number[other[node, bond]]
        size = wet.size
        among = sparse.csr_matrix((weights[bond], (node, to)), (size, size))
        row, out = np.nonzero(which[other] >= 0)
        behind, index = np.unique(other[row, out], return_inverse=True)
        across = sparse.csr_matrix((weights[out], (row, index)), (size, max(behind.size, 1)))
        total = np.asarray(among.sum(axis=1) + across.sum(axis=1)).ravel()
        return sparse.csr_matrix(sparse.diags(total) - among), across, behind

    def _surface(
        self,
        number: np.ndarray,
        which: np.ndarray,
        bond_sum: NonlocalSum,
        behind: np.ndarray,
        normal: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Faces between liquid and metal: liquid node, electrode, area, distance of the nodes."""
        volume = self.lattice.cell_volume
        facing = (np.abs(normal) * np.array(self.lattice.spacing)).sum(axis=1) / volume
        area = np.zeros(number.size)
        area[behind] = 1.0 / np.where(facing > 0, facing, np.inf)
        area = area.reshape(number.shape)
        found = []
        for a, h in enumerate(bond_sum.spacing):
            if bond_sum.shape[a] == 1 and a < 3 - self.lattice.dimension:
                continue
            low, high = [slice(None)] * 3, [slice(None)] * 3
            low[a], high[a] = slice(0, -1), slice(1, None)
            for wet, metal in ((low, high), (high, low)):
                here, there = tuple(wet), tuple(metal)
                both = (number[here] >= 0) & (which[there] >= 0)
                size = int(both.sum())
                found.append(
                    (number[here][both], which[there][both], area[there][both], np.full(size, h))
                )
        return tuple(np.concatenate(part) for part in zip(*found, strict=True))  # type: ignore[return-value]

    def _behind_each(
        self, seen: np.ndarray, electrode: np.ndarray, distance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Surface potential E, current density, and dE/d(seen)."""
        surface, density, follows = (np.zeros_like(seen) for _ in range(3))
        for n, one in enumerate(self.electrodes):
            of = electrode == n
            if of.any():
                resistance = 0.5 * distance[of] / self.kappa
                surface[of], density[of], slope = surface_potential(
                    one.law, one.potential + seen[of], resistance
                )
                follows[of] = 1.0 - resistance * slope
        return surface, density, follows

    def mirror_values(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u of each mirror node for the liquid's u, and its derivative by its image's."""
        seen = u[self._image]
        surface, _, follows = self._behind_each(seen, self._electrode, self._distance)
        return 2.0 * (surface - self._voltage[self._electrode]) - seen, 2.0 * follows - 1.0

    def residual(self, u: np.ndarray) -> np.ndarray:
        """sum_j w_ij (u_i - u_j) over liquid and mirror nodes, V/m^2."""
        return self._matrix @ u - self._behind @ self.mirror_values(u)[0]

    def solve(self, tolerance: float = 1e-11, guess: np.ndarray | None = None) -> MirrorField:
        """The potential by Newton's method with a shortened step where the residual grows.

        tolerance : residual over its terms, 2-norms.  guess : phi to start with, V.

        Raises
        ------
        ConvergenceError
            Where no step lessens the residual, or the steps do not reach the tolerance.
        """
        u = np.zeros(self._matrix.shape[0])
        if guess is not None:
            u = -np.nan_to_num(guess[self.liquid])
        diagonal = self._matrix.diagonal()
        norm = np.inf
        for steps in range(_NEWTON_STEPS + 1):
            values, follows = self.mirror_values(u)
            residual = self._matrix @ u - self._behind @ values
            norm = float(np.linalg.norm(residual))
            scale = float(np.linalg.norm(diagonal * u) + np.linalg.norm(self._behind @ values))
            if norm <= tolerance * scale:
                return self._field(u, steps)
            if steps == _NEWTON_STEPS:
                break
            images = sparse.csr_matrix(
                (follows, (np.arange(follows.size), self._image)), (follows.size, u.size)
            )
            step = -spsolve(sparse.csc_matrix(self._matrix - self._behind @ images), residual)
            share = 1.0
            for _ in range(_HALVINGS):
                if np.linalg.norm(self.residual(u + share * step)) < norm:
                    break
                share *= 0.5
            else:
                raise ConvergenceError(f"potential: no step lessens its residual after {steps}")
            u = u + share * step
        raise ConvergenceError(f"potential: residual {norm:.3g} after {_NEWTON_STEPS} steps")

    def _field(self, u: np.ndarray, steps: int) -> MirrorField:
        wet, electrode, area, distance = self._faces
        density = self._behind_each(u[wet], electrode, distance)[1]
        count = len(self.electrodes)
        by_law = np.bincount(electrode, area * density, count)
        size = float(np.abs(by_law).sum())
        into = (
            self._behind.T @ u
            - np.asarray(self._behind.sum(axis=0)).ravel() * (self.mirror_values(u)[0])
        )
        currents = np.bincount(self._electrode, into, count) * self.kappa * self.lattice.cell_volume
        phi = np.full(self.lattice.shape, np.nan)
        phi[self.liquid] = -u
        share = float(by_law.sum()) / size if size > 0 else 0.0
        return MirrorField(phi, currents, by_law, share, steps)


class MirrorProblem(PotentialProblem):
    """A potential problem whose liquid is solved with mirror nodes.

    Patches are those of the bond form: each carries what its law gives at the potential that it
    sees in that liquid, so that the currents of all need not balance (`imbalance`), and a surface
    stays where its nodes are until they are empty, as published.  Parameters as PotentialProblem;
    `conductivity` is one number.
    """

    def __init__(
        self,
        lattice: Lattice,
        stencil: Stencil,
        liquid: np.ndarray,
        electrodes: Sequence[Electrode],
        conductivity: float,
    ) -> None:
        super().__init__(lattice, stencil, liquid, electrodes, conductivity)
        self._mirror = MirrorPotential(lattice, stencil, self.liquid, electrodes, conductivity)

    def recede(self, depth: np.ndarray) -> None:
        """Nothing: mirror nodes lie behind the faces of the lattice."""
        super().recede(np.zeros_like(depth))

    def solve(self, guess: np.ndarray | None = None, tolerance: float = 1e-9) -> PotentialField:
        """As PotentialProblem.solve; ConvergenceError as MirrorPotential.solve."""
        found = self._mirror.solve(tolerance, guess)
        seen = self._see(self.unknown * self.sum.pad(-np.nan_to_num(found.potential)))
        surface, density, slope = self._currents(seen)
        imbalance = self._imbalance(surface, density, slope)
        return PotentialField(
            found.potential, self.patches, density, surface, imbalance, found.newton, 0
        )
