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
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.solvers import ConvergenceError, Extra, LinearSystem
from peri.engine.walls import Walls, WithWalls
from peri.transport.potential.patches import Patches
from peri.transport.potential.placement import WIDEST, Electrode, NoSinkError, place
from peri.transport.potential.polarization import surface_potential

__all__ = ["Electrode", "NoSinkError", "PotentialField", "PotentialProblem"]

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
    processes : OneProcess or its like
        Who holds which block of the lattice; arrays of the whole lattice are given and found on
        the root (elsewhere None and empty), currents of the patches everywhere.

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
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self.electrodes, self.processes = list(electrodes), processes

        def check() -> None:
            kappa = np.broadcast_to(np.asarray(conductivity, float), lattice.shape)
            if not (np.isfinite(kappa[liquid]).all() and (kappa[liquid] > 0).all()):
                raise ValueError("conductivity: it must be positive in the whole liquid, S/m")

        processes.on_root(check)
        there = place(stencil, liquid, electrodes, held, processes)
        self.patches, self._pool_of_patch = there.patches, there.pool_of_patch
        self._floating, self._laws, self.liquid = there.floating, there.laws, there.liquid
        self.sum = NonlocalSum(stencil, self.liquid.shape, processes=processes)
        pad, fixed = self.sum.pad, np.isfinite(there.held)
        self._pool = pad(there.pool).astype(int)
        self.unknown = pad(self.liquid & ~fixed)
        self.held = pad(-np.nan_to_num(there.held))
        self.volume = float(np.prod(stencil.spacing))
        self._columns = np.flatnonzero(np.diff(there.shares.tocsc().indptr))
        self._shares = there.shares[:, self._columns].tocsr()
        self._free = self.unknown.ravel()[self._columns] > 0
        self._voltage = there.potentials[self.patches.electrode]
        self._along = Walls(self.sum) if walls and operator is None else None
        self._forget()
        self.conduct(conductivity, operator)

    def conduct(
        self, conductivity: float | np.ndarray | None, operator: Operator | None = None
    ) -> None:
        """Let the liquid conduct by kappa (of the lattice's shape, S/m) from now on.

        operator : its bonds, where they are not the default's; surfaces are where they were at the
        start until `recede` says where they are.
        """
        kappa = self._dealt(conductivity)
        if operator is None:
            root = self.sum.pad(np.sqrt(np.where(self.liquid, kappa, 0.0)))
            operator = Convolution(self.sum, self.unknown * root, root, symmetric=True)
            if self._along is not None:
                self._along.update(self.liquid, kappa)
                operator = WithWalls(operator, self._along)
        self.operator = operator
        local = self.sum.pad(np.where(np.isfinite(kappa) & (kappa > 0), kappa, 1.0))
        self._at_patch = self._see(local)
        self.recede(np.zeros(len(self.patches.area)))
        self._system: LinearSystem | None = None
        self._row_sums = operator.row_sums()
        self._weight = self.volume * operator.diagonal()

    def _dealt(self, values: float | np.ndarray | None) -> np.ndarray:
        """This process's block of what the root has of the whole lattice, or for every node."""
        one = self.processes.on_root(lambda: float(values) if np.ndim(values) == 0 else None)
        if one is not None:
            return np.broadcast_to(one, self.liquid.shape)
        return self.processes.scatter(None if values is None else np.asarray(values, float))

    def recede(self, depth: np.ndarray) -> None:
        """Put the surface of each patch deeper, (n,) in m: what its metal has lost already."""
        self._resistance = (self.patches.distance + depth) / self._at_patch

    def _see(self, u: np.ndarray) -> np.ndarray:
        """u_s = sum_j a_sj u_j of every patch."""
        return self.processes.added(self._shares @ u.ravel()[self._columns])

    def _norm(self, values: np.ndarray) -> float:
        return float(np.sqrt(self._dot(values, values)))

    def _dot(self, one: np.ndarray, other: np.ndarray) -> float:
        """Of two padded fields, over all processes."""
        return self.processes.total(float(np.dot(one.ravel(), other.ravel())))

    def _phi(self, u: np.ndarray) -> np.ndarray:
        """phi of the whole lattice on the root, NaN off the liquid."""
        return self.processes.gather(np.where(self.liquid, -self.sum.crop(u), np.nan))

    def _spread(self, values: np.ndarray) -> np.ndarray:
        """sum_s a_si values_s on the unknown nodes, padded."""
        out = np.zeros(self.sum.padded_shape)
        out.ravel()[self._columns] = np.where(self._free, self._shares.T @ values, 0.0)
        return out

    def _currents(
        self, seen: np.ndarray, part: np.ndarray | slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E, i and di/du_s of every patch, or of a part of them that sees `seen`.

        Each begins at its E of the last time, which `_forget` drops.
        """
        surface, density, slope = (np.zeros_like(seen) for _ in range(3))
        electrode_of, voltage = self.patches.electrode[part], self._voltage[part]
        resistance, before = self._resistance[part], self._surface[part]
        for number, law in enumerate(self._laws):
            of = electrode_of == number
            if of.any():
                surface[of], density[of], slope[of] = surface_potential(
                    law, (voltage + seen)[of], resistance[of], before[of]
                )
        self._surface[part] = surface
        return surface, density, slope

    def _forget(self) -> None:
        """Start from nothing, so that what is found does not depend on what was before."""
        self._surface = np.full(len(self.patches.area), np.nan)

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
                if reach > 16 * WIDEST:
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
        if self.processes.on_root(lambda: guess is not None):
            start = np.nan_to_num(self._dealt(guess))
            try:
                return self._newton(self.unknown * self.sum.pad(-start), tolerance)
            except ConvergenceError as error:
                # Where hardly any current is left, a guess has flows that nothing takes up.
                log.info("potential: from the guess: %s", error)
        return self._newton(np.zeros(self.sum.padded_shape), tolerance)

    def level(self) -> PotentialField:
        """The currents where the liquid has one potential in each pool: no field is computed.

        Raises ValueError where nodes are held.
        """
        if not self._floating[1:].any() or self.processes.any((self.held != 0).any()):
            raise ValueError("held: a liquid with held nodes has no level of its own")
        self._forget()
        shifts = self._balancing_shifts(np.zeros(len(self.patches.area)))
        surface, density, slope = self._currents(shifts[self._pool_of_patch])
        imbalance = self._imbalance(surface, density, slope)
        u = self.unknown * shifts[self._pool]
        return PotentialField(self._phi(u), self.patches, density, surface, imbalance, 0, 0)

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
        # What is left of currents that balance is none: a pool of one node takes up nothing.
        noise = 1e-12 * self._norm(self._spread(self.patches.area * np.abs(density))) / self.volume
        system.solve(u, right.copy(), max(1e-6 * self._norm(right), noise))
        pools, largest = self._pool[self.unknown > 0], self.processes.largest
        high, low = (np.full(len(self._floating), -np.inf) for _ in range(2))
        np.maximum.at(high, pools, u[self.unknown > 0])
        np.maximum.at(low, pools, -u[self.unknown > 0])
        ranges = [largest(float(h)) + largest(float(v)) for h, v in zip(high, low, strict=True)]
        return max([r for r in ranges if np.isfinite(r)], default=0.0)

    def ohmic_shares(self, found: PotentialField | None) -> np.ndarray:
        """By electrode: its current's largest relative change over a relative change of kappa.

        First order, wherever kappa changes: with A the bonds and v the change of u by a change of
        the electrode's potential, dI = <v, dA u>, at most d kappa / kappa sqrt(<u, A u> <v, A v>);
        what lies between patch and surface is part of both.  Of one pair of electrodes it is the
        share of the voltage that the liquid takes.  infinite where no current flows.
        """
        phi = np.nan_to_num(self._dealt(None if found is None else found.potential))
        u = self.held - self.unknown * self.sum.pad(phi)
        _, density, slope = self._currents(self._see(u))
        area, apart = self.patches.area, self._resistance
        power = self._dot(self._flux(u), u) + float((area * apart * density**2).sum())
        shares = []
        for number in range(len(self._laws)):
            own = (self.patches.electrode == number).astype(float)
            current = abs(float((own * area * density).sum()))
            right, follows = self._spread(area * slope * own), (area * slope * own).any()
            if not current > 0 or not follows:
                shares.append(np.inf if follows else 0.0)
                continue
            v = self._newton_direction(right, slope, 1e-6)[0]
            through = slope * (own - self._see(v))
            other = self._dot(self._flux(v), v) + float((area * apart * through**2).sum())
            shares.append(np.sqrt(max(power, 0.0) * max(other, 0.0)) / current)
        return np.array(shares)

    def _newton(self, start: np.ndarray, tolerance: float) -> PotentialField:
        """`solve` from a starting value of u, 0 off the unknowns."""
        self._forget()
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
            size, norm = self._norm(flux), self._norm(residual)
            # Round-off of the sums over bonds, which a fine lattice makes large beside currents.
            rounding = self.patches.area * slope * np.maximum(np.abs(surface), np.abs(seen))
            noise = 1e-15 * (self._norm(self._weight * u) + self._norm(self._spread(rounding)))
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
        return PotentialField(self._phi(u), self.patches, density, surface, imbalance, steps, total)

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
            return float((conductance * seen**2).sum()) if self.processes.is_root else 0.0

        sink = np.maximum(self._row_sums, 0.0) + self._spread(conductance)
        # Electrodes without slope leave a level open that the coarsest grid could not solve for.
        sink += 1e-14 * self.unknown * self._weight / self.volume
        right = residual / self.volume
        wanted = reduction * self._norm(right)
        if self._system is None:
            self._system = LinearSystem(
                self.operator, sink=sink, extra=patches, extra_diagonal=diagonal
            )
        else:
            self._system.with_extra(patches, diagonal)
        step, system = np.zeros(self.sum.padded_shape), self._system
        try:
            count = system.solve(step, right.copy(), wanted)
        except ConvergenceError:
            self._system = None
            return (*self._held_direction(right, wanted, sink, patches, diagonal), True)
        finally:
            system.extra = None  # it holds this problem, whose arrays would outlive it in a circle
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
        bonds = -self._dot(residual, step) - start
        curvature = self._dot(self._flux(step), step)

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
