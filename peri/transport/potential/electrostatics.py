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
from scipy.optimize import brentq

from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import Convolution, NonlocalSum, Operator
from peri.engine.solvers import ConvergenceError, Extra, LinearSystem
from peri.engine.walls import Walls, WithWalls
from peri.transport.potential.patches import Patches, surface_patches
from peri.transport.potential.polarization import Polarization, surface_potential
from peri.transport.potential.pools import by_pool, label_pools

log = logging.getLogger(__name__)

_NEWTON_STEPS = 40
_INNER = 1e-2
"""Reduction of the residual within a Newton step: 1e-3 spared a step of six and took a fifth more
processor time from scratch, as much from a potential that is near (2.6e5 nodes)."""
_MANY_ITERATIONS = 12
"""Of a Newton step beyond which the next one has a multigrid of its own; 4 to 6 are usual."""
_HELD_LEVELS = (1e-12, 1e-9, 1e-6)
"""Of a node's bonds, what holds levels that electrodes without slope leave open; larger ones take
more Newton steps."""
_WIDEST = 100.0
"""Potential, V, at which a set of electrodes without any zero of its total current is given up."""


class NoSinkError(ValueError):
    """The currents of all electrodes have one sign at every potential."""


@dataclass(frozen=True)
class Electrode:
    """Metal nodes (bool, of the lattice's shape), their law, and the metal's potential V, V."""

    metal: np.ndarray
    law: Polarization
    potential: float = 0.0


@dataclass(frozen=True)
class PotentialField:
    """What `solve_potential` finds.

    potential : liquid's phi of the lattice's shape, V; NaN off the liquid and where no electrode
        and no held node reaches.
    patches : Patches.  density (n,): i of each patch, A/m^2.  surface (n,): E of each patch, V.
    imbalance : sum of currents over the sum of their sizes, in the pool (that is not held) where
        it is largest; over 1e-4 of slope times potential where that is more, because currents that
        are small beside it are known to its round-off only.
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
        Whether walls conduct along themselves as the rest does (engine.walls); for
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
        pool = label_pools(self.sum, np.asarray(liquid, bool))
        self.patches, of_patch = by_pool(self.patches, pad(pool))
        alive, self._floating = self._working_pools(pool, of_patch, fixed)
        kept = alive[of_patch]
        self.patches, self._pool_of_patch = self.patches.only(kept), of_patch[kept]
        self.liquid = np.asarray(liquid, bool) & alive[pool]
        dropped = int((liquid & ~self.liquid).sum())
        if dropped:
            log.info("%d liquid nodes have no anode or no cathode: no potential", dropped)
        self._pool = pad(np.where(self.liquid, pool, 0)).astype(int)
        self.unknown = pad(self.liquid & ~fixed)
        self.held = pad(np.where(fixed, -np.nan_to_num(held if held is not None else 0.0), 0.0))
        self.volume = lattice.cell_volume
        self._columns = np.flatnonzero(np.diff(self.patches.shares.tocsc().indptr))
        self._shares = self.patches.shares[:, self._columns].tocsr()
        self._free = self.unknown.ravel()[self._columns] > 0
        self._voltage = np.array([e.potential for e in self.electrodes])[self.patches.electrode]
        self._along = Walls(self.sum) if walls and operator is None else None
        self.conduct(kappa, operator)

    def conduct(self, conductivity: np.ndarray, operator: Operator | None = None) -> None:
        """Let the liquid conduct by kappa (of the lattice's shape, S/m) from now on.

        operator : its bonds, where they are not the default's; surfaces are where they were at the
        start until `recede` says where they are.
        """
        if operator is None:
            root = self.sum.pad(np.sqrt(np.where(self.liquid, conductivity, 0.0)))
            operator = Convolution(self.sum, self.unknown * root, root, symmetric=True)
            if self._along is not None:
                self._along.update(self.liquid, conductivity)
                operator = WithWalls(operator, self._along)
        self.operator = operator
        there = np.isfinite(conductivity) & (conductivity > 0)
        local = self.sum.pad(np.where(there, conductivity, 1.0))
        self._at_patch = self._shares @ local.ravel()[self._columns]
        self.recede(np.zeros(len(self.patches.area)))
        self._system: LinearSystem | None = None
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

    def _working_pools(
        self, pool: np.ndarray, of_patch: np.ndarray, fixed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which pools (from 1) carry currents, and which of these are not held; bool.

        A pool whose currents have one sign at every potential carries none, and one that nothing
        touches has no potential.

        Raises NoSinkError where no pool is left.
        """
        count = int(pool.max(initial=0)) + 1
        held, touched = np.zeros(count, bool), np.zeros(count, bool)
        held[np.unique(pool[fixed])] = True
        touched[of_patch] = True
        nets = []
        for shift in (-_WIDEST, 0.0, _WIDEST):
            density = np.array(
                [float(e.law.current(np.array(e.potential + shift))) for e in self.electrodes]
            )[self.patches.electrode]
            nets.append(np.bincount(of_patch, self.patches.area * density, count))
        balanced = (nets[0] < 0) & (nets[2] > 0) | (nets[1] == 0)
        alive = held | (touched & balanced)
        alive[0] = False
        if not alive.any():
            raise NoSinkError(
                "electrodes: their currents have one sign at every potential; a current "
                "needs a sink (a cathode, or a held potential)"
            )
        return alive, alive & ~held

    def _currents(
        self, seen: np.ndarray, part: np.ndarray | slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E, i and di/du_s of every patch, or of a part of them that sees `seen`."""
        surface, density, slope = (np.zeros_like(seen) for _ in range(3))
        electrode_of, voltage = self.patches.electrode[part], self._voltage[part]
        resistance = self._resistance[part]
        for number, electrode in enumerate(self.electrodes):
            of = electrode_of == number
            if of.any():
                surface[of], density[of], slope[of] = surface_potential(
                    electrode.law, (voltage + seen)[of], resistance[of]
                )
        return surface, density, slope

    def _balancing_shifts(self, seen: np.ndarray) -> np.ndarray:
        """By pool (from 1): the change of u after which its patches' currents add up to nothing."""
        shifts = np.zeros(len(self._floating))
        for pool in np.flatnonzero(self._floating):
            part = np.flatnonzero(self._pool_of_patch == pool)
            area, here = self.patches.area[part], seen[part]

            def net(shift: float, part=part, area=area, here=here) -> float:
                return float((area * self._currents(here + shift, part)[1]).sum())

            reach = 1e-6
            if net(0.0) == 0.0:
                continue
            while not net(-reach) < 0.0 < net(reach):
                reach *= 4.0
                if reach > 16 * _WIDEST:
                    raise ConvergenceError("potential: no level balances the currents of a pool")
            shifts[pool] = brentq(
                net,
                -reach,
                reach,
                xtol=1e-17,
                rtol=1e-15,
                maxiter=300,
                full_output=True,
                disp=False,
            )[0]
        return shifts

    def _imbalance(self, surface: np.ndarray, density: np.ndarray, slope: np.ndarray) -> float:
        """The largest of the pools that are not held; see PotentialField."""
        count, of, area = len(self._floating), self._pool_of_patch, self.patches.area
        total = np.bincount(of, area * density, count)
        size = np.bincount(of, area * np.abs(density), count)
        known = np.bincount(of, area * slope * np.abs(surface), count)
        share = (total / np.maximum(np.maximum(size, 1e-4 * known), 1e-300))[self._floating]
        return float(share[np.abs(share).argmax()]) if share.size else 0.0

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
        if guess is not None:
            try:
                return self._newton(self.unknown * self.sum.pad(-np.nan_to_num(guess)), tolerance)
            except ConvergenceError as error:
                # Where hardly any current is left, a guess has flows that nothing takes up.
                log.info("potential: from the guess: %s", error)
        return self._newton(np.zeros(self.sum.padded_shape), tolerance)

    def level(self) -> PotentialField:
        """The currents where the liquid has one potential in each pool: no field is computed.

        Raises ValueError where nodes are held.
        """
        if not self._floating[1:].any() or (self.held != 0).any():
            raise ValueError("held: a liquid with held nodes has no level of its own")
        shifts = self._balancing_shifts(np.zeros(len(self.patches.area)))
        surface, density, slope = self._currents(shifts[self._pool_of_patch])
        imbalance = self._imbalance(surface, density, slope)
        u = self.unknown * shifts[self._pool]
        phi = np.where(self.liquid, -self.sum.crop(u), np.nan)
        return PotentialField(phi, self.patches, density, surface, imbalance, 0, 0)

    def drop(self, density: np.ndarray) -> float:
        """The range of the potential that currents (n,) A/m^2 make, V: one linear solution.

        The currents must balance in every pool.
        """
        right = -self._spread(self.patches.area * density) / self.volume
        shift = _HELD_LEVELS[1] * self.unknown * self._weight / self.volume
        system = LinearSystem(
            self.operator, shift=shift, sink=np.maximum(self._row_sums, 0.0) + shift
        )
        u = np.zeros(self.sum.padded_shape)
        system.solve(u, right.copy(), 1e-6 * float(np.linalg.norm(right)))
        pools = self._pool[self.unknown > 0]
        high, low = (np.full(pools.max(initial=0) + 1, sign * np.inf) for sign in (-1, 1))
        np.maximum.at(high, pools, u[self.unknown > 0])
        np.minimum.at(low, pools, u[self.unknown > 0])
        return float((high - low)[np.isfinite(high)].max(initial=0.0))

    def ohmic_shares(self, found: PotentialField) -> np.ndarray:
        """By electrode: its current's largest relative change over a relative change of kappa.

        First order, wherever kappa changes: with A the bonds and v the change of u by a change of
        the electrode's potential, dI = <v, dA u>, at most d kappa / kappa sqrt(<u, A u> <v, A v>);
        what lies between patch and surface is part of both.  Of one pair of electrodes it is the
        share of the voltage that the liquid takes.  infinite where no current flows.
        """
        u = self.held - self.unknown * self.sum.pad(np.nan_to_num(found.potential))
        _, density, slope = self._currents(self._see(u))
        area, apart = self.patches.area, self._resistance
        power = float((self._flux(u) * u).sum()) + float((area * apart * density**2).sum())
        shares = []
        for number in range(len(self.electrodes)):
            own = (self.patches.electrode == number).astype(float)
            current = abs(float((own * area * density).sum()))
            right = self._spread(area * slope * own)
            if not current > 0 or not right.any():
                shares.append(np.inf if right.any() else 0.0)
                continue
            v = self._newton_direction(right, slope, 1e-6)[0]
            through = slope * (own - self._see(v))
            other = float((self._flux(v) * v).sum()) + float((area * apart * through**2).sum())
            shares.append(np.sqrt(max(power, 0.0) * max(other, 0.0)) / current)
        return np.array(shares)

    def _newton(self, start: np.ndarray, tolerance: float) -> PotentialField:
        """`solve` from a starting value of u, 0 off the unknowns."""
        u = self.held + start
        total, open_level = 0, True
        for steps in range(_NEWTON_STEPS + 1):
            if open_level:
                u += self.unknown * self._balancing_shifts(self._see(u))[self._pool]
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
                    f"potential: residual {norm / max(size, 1e-300):.3g} of the currents after "
                    f"{steps} Newton steps, {tolerance:.3g} wanted"
                )
            step, count, open_level = self._newton_direction(
                residual, slope, max(_INNER, 0.3 * tolerance * size / norm)
            )
            total += count
            u += self._search(u, step, residual) * step
        shifts = self._balancing_shifts(seen)
        u += self.unknown * shifts[self._pool]
        surface, density, slope = self._currents(seen + shifts[self._pool_of_patch])
        imbalance = self._imbalance(surface, density, slope)
        phi = np.where(self.liquid, -self.sum.crop(u), np.nan)
        return PotentialField(phi, self.patches, density, surface, imbalance, steps, total)

    def _flux(self, u: np.ndarray) -> np.ndarray:
        """dV sum_j kappa w_ij (u_i - u_j) on the unknown nodes, held neighbours included."""
        gain = self.operator.gain(u, np.zeros(self.sum.padded_shape))
        return (self._weight * u - self.volume * gain) * self.unknown

    def _newton_direction(
        self, residual: np.ndarray, slope: np.ndarray, reduction: float
    ) -> tuple[np.ndarray, int, bool]:
        """The step, its linear iterations, and whether it says nothing of the liquid's level."""
        conductance = self.patches.area * slope / self.volume
        squares = self._shares.multiply(self._shares)
        diagonal = np.zeros(self.sum.padded_shape)
        diagonal.ravel()[self._columns] = np.where(self._free, squares.T @ conductance, 0.0)

        def patches(v: np.ndarray, y: np.ndarray) -> float:
            seen = self._see(v)
            y += self._spread(conductance * seen)
            return float((conductance * seen**2).sum())

        sink = np.maximum(self._row_sums, 0.0) + self._spread(conductance)
        # Electrodes without slope leave a level open that the coarsest grid could not solve for.
        sink += 1e-14 * self.unknown * self._weight / self.volume
        right = residual / self.volume
        wanted = reduction * float(np.linalg.norm(right))
        if self._system is None:
            self._system = LinearSystem(
                self.operator, sink=sink, extra=patches, extra_diagonal=diagonal
            )
        else:
            self._system.with_extra(patches, diagonal)
        step = np.zeros(self.sum.padded_shape)
        try:
            count = self._system.solve(step, right.copy(), wanted)
        except ConvergenceError:
            self._system = None
            return (*self._held_direction(right, wanted, sink, patches, diagonal), True)
        if count > _MANY_ITERATIONS:
            self._system = None  # the slopes have moved away from those of its multigrid
        return step, count, False

    def _held_direction(
        self,
        right: np.ndarray,
        wanted: float,
        sink: np.ndarray,
        patches: Extra,
        diagonal: np.ndarray,
    ) -> tuple[np.ndarray, int]:
        """A Newton direction where electrodes without slope leave the level of some liquid open.

        The smallest addition to the diagonal that lets the solver converge; the level is found by
        itself after the step, from the currents that must balance.
        """
        for held in _HELD_LEVELS:
            shift = held * self.unknown * self._weight / self.volume
            system = LinearSystem(
                self.operator,
                shift=shift,
                sink=sink + shift,
                extra=patches,
                extra_diagonal=diagonal,
            )
            step = np.zeros(self.sum.padded_shape)
            try:
                return step, system.solve(step, right.copy(), wanted)
            except ConvergenceError as error:
                log.info("potential: held by %g of its bonds: %s", held, error)
        raise ConvergenceError("potential: no Newton direction, however the level is held")

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
