"""Ions between reservoirs: a liquid whose sides have compositions and potentials of their own.

With side r held at Pi_r and h_r what is 1 on it, 0 on the others and harmonic between (A h_r = 0),

    Pi_e = sum_r Pi_e,r h_r + s_e g + X_e - sum_m nu_me G_m,

everything else as around a metal (nernst_planck.py).  A side is held at a potential, or floats: its
potential is then what lets a given current through it, 0 of a junction that nothing is drawn from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from peri.engine.constants import FARADAY
from peri.engine.influence import Stencil
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.speciation import Solution
from peri.transport.fluxes import migration
from peri.transport.liquid import Held, LiquidSpace, LiquidState
from peri.transport.nernst_planck import QuasiSteadyLiquid
from peri.transport.options import TransportOptions

_HARMONIC = 1e-13
"""Residual of the h_r, of what the sides bring."""
_ROUNDS = 30


@dataclass(frozen=True)
class Side:
    """What a reservoir holds its nodes at.

    solution : of one node, mol/m3
    potential : V; None: it floats
    current : from the liquid into a floating side, A (A/m in two dimensions, A/m2 in one)
    """

    solution: Solution
    potential: float | None = 0.0
    current: float = 0.0

    def __post_init__(self) -> None:
        if self.potential is not None and self.current:
            raise ValueError(
                f"side: a current of {self.current:g} and a potential; one follows from the other"
            )
        for name, value in (("potential", self.potential or 0.0), ("current", self.current)):
            if not math.isfinite(value):
                raise ValueError(f"side: its {name} is {value}; it must be finite")


class HeldSides(LiquidSpace):
    """Liquid nodes between sides that are held at values of their own.

    stencil, capacity : see LiquidSpace
    liquid : bool array of the lattice's shape
    side : int array of the same shape, 0 where nothing is held, else the number of the side from 1

    `held` of the methods is one value for all sides, or one each, (R,).

    exits : (R, n) sum_j w_ij c_j over the nodes of each side, 1/m2

    Raises
    ------
    ValueError
        For numbers of sides that leave one out, or sides that bonds join directly.
    """

    def __init__(
        self,
        stencil: Stencil,
        liquid: np.ndarray,
        side: np.ndarray,
        capacity: np.ndarray | None = None,
    ) -> None:
        super().__init__(stencil, liquid, side > 0, capacity)
        self.sides = int(side.max(initial=0))
        number = self.sum.pad(np.where(liquid, side, 0).astype(float))
        self._side = np.rint(number).astype(np.intp)
        self.exits = np.empty((self.sides, self.n))
        for r in range(self.sides):
            of = self._side == r + 1
            if not of.any():
                raise ValueError(f"side: no liquid node is of side {r + 1} of {self.sides}")
            bonds = self.sum(np.where(of, self.all_volume, 0.0))
            self.exits[r] = self.gather(bonds)
            if (bonds[(self._side > 0) & ~of] > 0).any():
                raise ValueError(
                    f"side: bonds join side {r + 1} to another; they must be a horizon apart"
                )

    def held_field(self, held: Held) -> np.ndarray:
        """Padded field of values held, 0 elsewhere."""
        values = np.concatenate([[0.0], np.broadcast_to(np.asarray(held, float), (self.sides,))])
        return values[self._side]

    def spread(self, values: np.ndarray, held: Held = 0.0) -> np.ndarray:
        """See LiquidSpace."""
        field = self.held_field(held)
        field.ravel()[self.index] = values
        return field

    def crop(self, values: np.ndarray, held: Held = 0.0, elsewhere: float = np.nan) -> np.ndarray:
        """See LiquidSpace."""
        field = np.where(self._side > 0, self.held_field(held), elsewhere)
        field.ravel()[self.index] = values
        return self.sum.crop(field)

    def neighbours(self, values: np.ndarray, held: Held = 0.0) -> np.ndarray:
        """See LiquidSpace."""
        around = super().neighbours(values)
        return around + np.broadcast_to(np.asarray(held, float), (self.sides,)) @ self.exits

    def into_sides(self, inflow: np.ndarray) -> np.ndarray:
        """Sums of a padded field over the sides, times the cells' volumes, (R,)."""
        weighted = (self.all_volume * inflow).ravel()
        sums = np.bincount(self._side.ravel(), weighted, self.sides + 1)[1:]
        return self.cell_volume * sums


class BetweenReservoirs(QuasiSteadyLiquid):
    """The composition of a liquid at rest between reservoirs.

    Parameters
    ----------
    space : HeldSides
    sides : one for each side of the space; the activity coefficients of the first hold everywhere
    releases, surface : see QuasiSteadyLiquid; by default no metal, and no mineral of the surface
    options : TransportOptions; closure "electroneutral"

    `beside` may set ions free, or take them, anywhere: a side that is no reservoir but an electrode
    is the source of its ion, and lets no other through.

    Raises
    ------
    ValueError
        As QuasiSteadyLiquid; for another number of sides, or of another chemistry or with other
        activity coefficients, no side with a potential, or another closure.
    """

    space: HeldSides

    def __init__(
        self,
        space: HeldSides,
        sides: Sequence[Side],
        releases: Mapping[str, float] | None = None,
        surface: np.ndarray | None = None,
        options: TransportOptions | None = None,
    ) -> None:
        if len(sides) != space.sides:
            raise ValueError(f"sides: {len(sides)} for a liquid that has {space.sides}")
        first = sides[0].solution
        for number, side in enumerate(sides, 1):
            if side.solution.chemistry is not first.chemistry:
                raise ValueError(f"sides: side {number} has another chemistry than side 1")
            if not np.allclose(side.solution.ln_gamma, first.ln_gamma, rtol=0, atol=1e-12):
                raise ValueError(
                    f"sides: side {number} has other activity coefficients than side 1, whose hold "
                    "everywhere; speciate it with those ('ideal', or `held`)"
                )
        if all(side.potential is None for side in sides):
            raise ValueError("sides: all of them float; one must have a potential")
        surface = np.zeros(space.n, bool) if surface is None else surface
        super().__init__(space, first, releases or {}, surface, options)
        if self.options.closure != "electroneutral":
            raise ValueError(
                f"closure: '{self.options.closure}' between reservoirs; allowed is electroneutral"
            )
        self.edge = np.column_stack([side.solution.concentration[:, 0] for side in sides])
        weighted = self.chemistry.diffusivity[:, None] * self.edge
        self._held = self.chemistry.stoichiometry.T @ weighted
        self.profile = self._harmonic()
        self.bulk = self._held @ self.profile
        self._floats = np.array([side.potential is None for side in sides])
        self._potential = np.array([side.potential or 0.0 for side in sides])
        self._current = np.array([side.current for side in sides])

    def _harmonic(self) -> np.ndarray:
        """h_r, (R, n); they add up to 1."""
        space = self.space
        out = np.empty((space.sides, space.n))
        for r in range(1, space.sides):
            right = space.volume * space.exits[r]
            start = np.full(space.n, 1.0 / space.sides)
            absolute = _HARMONIC * float(np.linalg.norm(right))
            out[r], _ = space.solve(self.plain, right, start, absolute)
        out[0] = 1.0 - out[1:].sum(axis=0)
        return out

    def rest(self) -> LiquidState:
        """The first reservoir's composition everywhere, the potential that the sides alone make."""
        state = super().rest()
        state.held_psi = self._potential / self.thermal_voltage
        state.psi = state.held_psi @ self.profile
        return state

    def _driven(self, source: np.ndarray) -> float:
        """What the sides' differences bring counts, too."""
        space = self.space
        apart = np.ptp(self._held, axis=1).max() * space.exits
        support = self.chemistry.charge**2 * self.chemistry.diffusivity @ self.edge
        pushed = np.ptp(self._potential) / self.thermal_voltage * support.max() * space.exits
        return max(
            super()._driven(source),
            *(float(np.linalg.norm(space.volume * row)) for row in (*apart, *pushed)),
        )

    def solve(
        self,
        source: np.ndarray,
        start: LiquidState | None = None,
        amounts: np.ndarray | None = None,
        step: float = np.inf,
        *,
        minerals: bool = True,
    ) -> LiquidState:
        """See QuasiSteadyLiquid; the floating sides' potentials by Broyden's method around it.

        Raises ConvergenceError where these do not settle, too.
        """
        state = start or self.rest()
        enough = self.options.tolerance * self._driven(source) * self.space.cell_volume
        floats, sweeps, iterations = np.flatnonzero(self._floats), 0, 0
        slope, change = np.zeros((floats.size, floats.size)), np.zeros(floats.size)
        for _ in range(_ROUNDS):
            state = super().solve(source, state, amounts, step, minerals=minerals)
            sweeps, iterations = sweeps + state.sweeps, iterations + state.iterations
            state.sweeps, state.iterations = sweeps, iterations
            charge = self.received(state)[floats] @ self.chemistry.component_charge
            short = charge - self._current[floats] / FARADAY
            if np.abs(short).max(initial=0.0) <= enough:
                return state
            if change.any():
                slope += np.outer(short, change) / (change @ change)
            else:
                slope = -self._conductance(state)[np.ix_(floats, floats)]
            change = -np.linalg.solve(slope, short)
            # Interior and side move together, as the sides' profiles have it.
            state.held_psi = np.array(state.held_psi)
            state.held_psi[floats] += change
            state.psi = state.psi + change @ self.profile[floats]
        raise ConvergenceError(
            f"sides: the currents of those that float are still off by "
            f"{FARADAY * np.abs(short).max():.2g} after {_ROUNDS} rounds"
        )

    def _conductance(self, state: LiquidState) -> np.ndarray:
        """Charge that flows out of a side per change of psi of another, mol/s, (R, R)."""
        space, chemistry = self.space, self.chemistry
        mobile = (chemistry.charge**2 * chemistry.diffusivity) @ state.concentration
        return np.array(
            [
                [space.total(mobile * (on * (r == q) - on * h)) for q, h in enumerate(self.profile)]
                for r, on in enumerate(space.exits)
            ]
        )

    def received(self, state: LiquidState) -> np.ndarray:
        """What flows from the liquid into every side of every component, mol/s, (R, E)."""
        space, chemistry = self.space, self.chemistry
        psi = space.spread(state.psi, state.held_psi)
        out = np.zeros((space.sides, len(chemistry.components)))
        for e, z, weights in chemistry.charge_groups():
            c = space.spread(weights @ state.concentration, weights @ self.edge)
            moved = migration(
                self.options.flux_form, space.sum, space.all_volume, c, psi, z, space.degree_field
            )
            out[:, e] += space.into_sides(moved)
        total = self.target(state)
        for e, (row, held) in enumerate(zip(total, self._held, strict=True)):
            field = space.spread(row, held)
            around = space.sum(space.all_volume * field)
            out[:, e] += space.into_sides(around - space.degree_field * field)
        return out

    def balance(self, state: LiquidState, source: np.ndarray) -> np.ndarray:
        """See QuasiSteadyLiquid; what moves is what goes through the sides, and what drifts."""
        through = self.received(state)
        left = self.released * self.space.total(source) - self.formed(state) - through.sum(axis=0)
        if np.ndim(self.beside):
            left = left + np.array([self.space.total(row) for row in np.asarray(self.beside)])
        carried = np.array([self.space.total(row) for row in self.migrate(state)])
        moved = np.abs(through).sum(axis=0) + np.abs(carried)
        return np.abs(left) / np.maximum(moved, 1e-6 * moved.max())

    def current(self, state: LiquidState) -> np.ndarray:
        """From the liquid into every side, A (A/m, A/m2 in two and one dimensions), (R,)."""
        return FARADAY * (self.received(state) @ self.chemistry.component_charge)

    def potential(self, state: LiquidState) -> np.ndarray:
        """Of every side, V, (R,)."""
        return self.thermal_voltage * np.asarray(state.held_psi)
