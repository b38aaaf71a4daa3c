"""A liquid with a content of its own: transients, pockets, and closed vessels.

A step of length tau from the totals T_old of every component to T = sum_k nu_k C_k solves

    c (T - T_old) / tau + c A Pi = c (s q + N - sum_m nu_m r_m),     Pi = sum_k nu_k D_k C_k

(nernst_planck.py without the first term is its limit for long steps).  T is no linear function of
Pi, but lies between Pi over the largest and the smallest diffusivity, so a shift sigma = 1/(D tau)
with a D between them takes most of it:

    (A + sigma_e) X_e = N_e - (T_e - T_e,old) / tau + sigma (Pi_e - Pi_e,medium)
                        + (sigma_e - sigma) X_e,
    Pi = Pi_medium + s g + X - sum_m nu_m G_m,   (A + sigma) g = q,   (A + sigma) G_m = r_m.

Minerals are solved as at rest, with A + sigma in the place of A.  What the right side of X still
takes from the last round is iterated, with Anderson's mixing (Walker and Ni 2011): without it the
error of the slowest component falls by no more than (K - 1) / (K + 1) a round, K the ratio of the
largest to the smallest diffusivity.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from peri.engine.operators import Convolution, ConvolutionSum
from peri.engine.solvers import ConvergenceError, LinearSystem
from peri.transport.chemistry.composition import CompositionError
from peri.transport.chemistry.minerals import settle
from peri.transport.chemistry.speciation import Solution
from peri.transport.fluxes import largest_bond_step
from peri.transport.liquid import LiquidSpace, LiquidState
from peri.transport.mixing import Mixing
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions

_MAXIMUM_ROUNDS = 200
_ROUND_OFF = 5e-14
"""Of the largest content per step: a residual below this is round-off (measured 2e-14 in sbf)."""

_LOOSE = 1e-3
"""Of the shift, left in the operator for psi, or 1 / L^2 (L the lattice's diagonal) if that is
less: without any it is singular in closed vessels, and with _LOOSE sigma alone the longest wave of
psi, that of a current between electrodes, takes rounds as _LOOSE sigma L^2 (in steps of 1 ms,
plates 1 mm apart, 1e3)."""

_STRONG = 1.0
"""RT/F along a bond above which the bonds conduct by cosh(u/2) more in the equation for psi."""
_FARTHEST = 1e3
"""RT/F (25 V) in the whole liquid: rounds that get there have lost their way."""
_HELD = 1e-6
"""Of a node's bonds, what holds the level of psi then."""

_BOND_ROUND_OFF = 1e-15
_SATURATION = 2e-12
"""To which share the composition of a saturated node is known (speciation.saturate)."""


class StoredLiquid(QuasiSteadyLiquid):
    """The composition of the liquid after a step, from its content before.

    Parameters and errors as QuasiSteadyLiquid, but no node needs a way out; closures
    "electroneutral" and "none"; the medium needs an ion that takes part in no reaction.  Where
    nothing is refreshed, `medium` is what the liquid was made from: its activity coefficients hold
    everywhere.
    """

    needs_a_way_out = False

    def __init__(
        self,
        space: LiquidSpace,
        medium: Solution,
        releases: Mapping[str, float],
        surface: np.ndarray,
        options: TransportOptions | None = None,
    ) -> None:
        super().__init__(space, medium, releases, surface, options)
        if self.options.closure not in ("electroneutral", "none"):
            raise ValueError(
                f"closure: '{self.options.closure}' with a liquid that stores; allowed are "
                "electroneutral, none"
            )
        if self.inert < 0:
            raise ValueError(
                "medium: it holds no ion that takes part in no reaction, which a liquid that "
                "stores needs to be neutral"
            )
        self._open_space = space
        # What minerals hold may be far more than what moves.
        self.relative = 1e-2 * self.options.tolerance
        self._slowness, self._slowness_of = self._slownesses()

    def _slownesses(self) -> tuple[float, np.ndarray]:
        """1/D of the shift of release and minerals, and of that of every component, (E,), s/m2.

        A component that moves with one diffusivity takes a round.  One that the medium lacks is
        next to nothing far from the metal; it stays positive in a round if neither its own shift
        nor that of release and minerals is below 1/D of any of its species.
        """
        d, nu = self.chemistry.diffusivity, self.chemistry.stoichiometry
        slowest = np.array([1.0 / d[column != 0].min() for column in nu.T])
        fastest = np.array([1.0 / d[column != 0].max() for column in nu.T])
        lacking = (self.bulk == 0).all(axis=1) & self.composer.only_positive
        between = 0.5 * (1.0 / d.min() + 1.0 / d.max())
        return (
            float(slowest[lacking].max(initial=0.0)) or between,
            np.where(lacking, slowest, 0.5 * (slowest + fastest)),
        )

    def content(self, state: LiquidState) -> np.ndarray:
        """Totals of the components, (E, n), mol/m3."""
        return self.chemistry.stoichiometry.T @ state.concentration

    def _shift(self, step: float) -> None:
        """Put A + sigma in the place of A."""
        space = copy.copy(self._open_space)
        sigma = self._slowness / step
        space.degree = space.degree + sigma
        space.exit = space.exit + sigma
        self.space, self.sigma, self.plain = space, sigma, space.system()
        self._shift_of = self._slowness_of / step
        systems = {
            shift: self._open_space.system(sink=np.full(space.n, shift))
            for shift in set(self._shift_of)
        }
        self._plain_of = [systems[shift] for shift in self._shift_of]
        unshifted = np.full(space.n, min(_LOOSE * sigma, 1.0 / self._open_space.extent**2))
        self._step = step
        self._loose = self._open_space.system(sink=unshifted)

    def advance(
        self,
        source: np.ndarray,
        content: np.ndarray,
        step: float,
        start: LiquidState,
        amounts: np.ndarray | None = None,
        *,
        span: float | None = None,
    ) -> LiquidState:
        """Return the liquid after a step.

        Parameters
        ----------
        source : (n,) metal released into each node, mol/m3/s
        content : (E, n) totals before, mol/m3
        step : s
        start : a state to begin with
        amounts : (M, n) minerals before, mol/m3
        span : s, the time over which no more than `amounts` can dissolve (default: step)

        Raises
        ------
        ConvergenceError, CompositionError
            Where a shorter step will do.
        """
        self._check_current()
        self._shift(step)
        self.sunk.clear()
        self.unresolved[:] = 0.0
        space, options = self.space, self.options
        there = np.zeros((len(self.minerals), space.n)) if amounts is None else amounts
        state = start.copy()
        offset = self.target(state) - self.bulk
        right = space.volume * source
        held = space.largest(np.abs(content)) + sum(
            np.abs(mineral.nu).max() * space.largest(amount)
            for mineral, amount in zip(self.minerals, there, strict=True)
        )
        floor = _ROUND_OFF * held * space.norm(space.volume) / step
        absolute = max(options.tolerance * space.norm(right), floor)
        state.release, used = space.solve(self.plain, right, start.release, 0.1 * absolute)
        state.iterations += used
        # The same composition in the new split: what is not release or mineral is X.
        state.migrated = offset - self.released[:, None] * state.release
        state.extents[:] = 0.0
        for i, mineral in enumerate(self.minerals):
            if not mineral.in_equilibrium:
                state.active[i][:] = False
        span = step if span is None else span
        settle(self, state, there, span, 0.1 * absolute)
        self._iterate(state, source, content, step, there, span, absolute)
        return state

    def _iterate(
        self,
        state: LiquidState,
        source: np.ndarray,
        content: np.ndarray,
        step: float,
        there: np.ndarray,
        span: float,
        absolute: float,
    ) -> None:
        """Rounds of X and the potential, until every component's residual is small."""
        space, neutral = self.space, self.options.closure == "electroneutral"
        z2 = self.chemistry.charge**2
        wanted = np.full(content.shape[0], absolute)
        if np.any(self.beside):
            # What anodes give and cathodes take may cancel: next to nothing is left to balance.
            given = self.released[:, None] * source + self.beside
            moved = space.row_norms(space.volume * given)
            moved += space.row_norms(space.volume * content) / step
            wanted = np.minimum(wanted, self.options.tolerance * moved)
        for mineral, amount in zip(self.minerals, there, strict=True):
            moved = space.norm(space.volume * amount) / span
            wanted = np.maximum(wanted, 10.0 * self.relative * np.abs(mineral.nu) * moved)
        inert = self.chemistry.diffusivity[self.inert]
        closed = not space.any(self._open_space.exit)
        stiffness = space.norm(space.volume * space.degree)
        mixing = Mixing(space.processes)
        size = space.largest_of_rows(np.abs(self.content(state))) / self._slowness
        size = np.maximum(size, 1e-6 * size.max())
        for round_ in range(_MAXIMUM_ROUNDS):
            support = z2 @ state.concentration
            # What it does to the inert ion's balance if that takes up the charge that is left.
            charge = space.norm(space.outflow(inert * state.net_charge))
            psi = state.psi
            # A potential that follows round-off would only stir the ions.
            if neutral and charge > 0.1 * absolute:
                psi = psi + self._potential_of(state, state.net_charge / support)
                if closed:
                    psi = psi - space.mean(psi)
            trial = copy.copy(state)
            trial.psi = psi
            inflow = self.inflow(trial)
            change = self.target(state) - self.bulk
            right = space.volume * (
                inflow - (self.content(state) - content) / step + self.sigma * change
            )
            residual = np.array(
                [
                    space.norm(r - space.outflow(x))
                    for r, x in zip(right, state.migrated, strict=True)
                ]
            )
            state.sweeps = round_ + 1
            # Sums over bonds are exact to so much of their terms.
            moved_by_psi = change + self.bulk if neutral else change
            terms = space.largest_of_rows(np.maximum(np.abs(state.migrated), np.abs(moved_by_psi)))
            noise = _BOND_ROUND_OFF * stiffness * terms
            for mineral, active in zip(self.minerals, state.active, strict=True):
                if mineral.in_equilibrium and space.any(active):
                    held = space.largest_of_rows(np.abs(change + self.bulk))
                    scarcest = held[mineral.nu != 0].min()
                    limit = _SATURATION * stiffness * scarcest
                    noise = np.maximum(noise, np.abs(mineral.nu) * limit)
            enough = np.maximum(wanted, noise)
            balanced = (residual <= enough).all()
            if balanced and not (neutral and charge > enough[self.inert]):
                state.psi = psi
                if neutral:
                    self._neutralise(state)
                return
            new = np.empty_like(state.migrated)
            smallest = space.lowest(space.volume)
            for e, r in enumerate(right):
                # Where only the charge is left, it takes more than the ions' balances do.
                tight = max((1e-3 if balanced else 0.1) * enough[e], 1e-3 * residual[e])
                more = self._shift_of[e] - self.sigma
                r = r + more * space.volume * state.migrated[e]
                new[e], used = space.solve(self._plain_of[e], r, state.migrated[e], tight)
                state.iterations += used
                # (A + shift)^-1 is nowhere more than 1 / shift.
                self.unresolved[e] = tight / (self._shift_of[e] * smallest)
            old = np.vstack([state.migrated / size[:, None], state.psi])
            found = np.vstack([new / size[:, None], psi])
            mixed = mixing.next(old.ravel(), found.ravel()).reshape(old.shape)
            before = state.migrated.copy()
            state.migrated, state.psi = mixed[:-1] * size[:, None], mixed[-1]
            try:
                self._grow_between(state, before, there, span, 0.1 * absolute)
            except CompositionError:
                state.migrated, state.psi = new, psi
                mixing = Mixing(space.processes)
                self._grow_between(state, before, there, span, 0.1 * absolute)
        raise ConvergenceError(
            f"liquid: the balance of a component is still off by {residual.max():.2g} after "
            f"{_MAXIMUM_ROUNDS} rounds, {wanted.max():.2g} wanted ({charge:.2g} from "
            "its charge); a shorter step will do"
        )

    def _potential_of(self, state: LiquidState, excess: np.ndarray) -> np.ndarray:
        """The change of psi that takes away net charge over sum z^2 C, (n,).

        At rest it is the excess itself; in a short step the ions follow a wave of psi by
        A / (A + sigma) only, so that psi has to rise by (A + sigma) / A times as much.
        """
        right = self.space.outflow(excess)
        space, system = self._open_space, self._loose
        size = space.norm(right)
        field = space.spread(state.psi)
        if largest_bond_step(field, space.all_volume, space.sum) <= _STRONG:
            found, used = space.solve(system, right, excess, 1e-3 * size)
            state.iterations += used
            return found
        return excess + self._driven_apart(state, field)

    def _driven_apart(self, state: LiquidState, field: np.ndarray) -> np.ndarray:
        """What takes the net charge away in a step if the ions only conduct, in a strong field.

        A bond conducts sqrt(kappa_i kappa_j) cosh(u/2), as `sqra` does: two convolutions.
        """
        drop = self.space.range(state.psi)
        if not drop < _FARTHEST:
            raise ConvergenceError(
                f"potential: {drop:.2g} RT/F in the liquid; a shorter step or a "
                "smaller current will do"
            )
        space, chemistry = self._open_space, self.chemistry
        mobile = chemistry.charge**2 * chemistry.diffusivity
        root = np.sqrt(mobile @ state.concentration), float(np.sqrt(mobile @ self.edge))
        right = space.all_volume * space.spread(*root)
        unknown, grown = space.spread(np.ones(space.n)), np.exp(0.5 * field)
        operator = ConvolutionSum(
            [
                Convolution(space.sum, unknown * right * a, right / a, coefficient=0.5)
                for a in (grown, 1.0 / grown)
            ],
            symmetric=True,
        )
        held = _HELD * unknown * operator.diagonal()
        system = LinearSystem(operator, shift=held)
        charge = space.spread(space.volume * state.net_charge / self._step)
        found = np.zeros_like(charge)
        size = space.processes.norm(charge)
        state.iterations += system.solve(found, charge, 1e-3 * size)
        return space.gather(found)

    def _neutralise(self, state: LiquidState) -> None:
        """Let the inert ion take up what charge is left: less than its balance is good for."""
        e, z = self.inert, self.chemistry.charge[self.inert]
        state.migrated[e] -= self.chemistry.diffusivity[e] * state.net_charge / z
        self.compose(state)

    def leaving(self, state: LiquidState) -> np.ndarray:
        """See QuasiSteadyLiquid; nothing where nothing is refreshed."""
        shifted, self.space = self.space, self._open_space
        try:
            return super().leaving(state)
        finally:
            self.space = shifted

    def conserved(
        self, state: LiquidState, source: np.ndarray, content: np.ndarray, step: float
    ) -> np.ndarray:
        """The totals after a step as what came and went makes them, (E, n), mol/m3.

        They differ from `content(state)` by the residual of the solution, which then does not add
        up over many steps: what one bond brings another node loses, to the last digits.
        """
        shifted, self.space = self.space, self._open_space
        space = self.space
        change = self.target(state) - self.bulk
        rate = self.released[:, None] * source + self.inflow(state)
        for mineral, growth in zip(self.minerals, state.rates, strict=True):
            rate -= mineral.nu[:, None] * growth
        rate -= np.array([space.outflow(c) / space.volume for c in change])
        self.space = shifted
        return content + step * rate

    def stored_balance(
        self, state: LiquidState, source: np.ndarray, content: np.ndarray, step: float
    ) -> np.ndarray:
        """Relative error of every component's balance over a step, (E,).

        Released - precipitated - gained by the liquid - left through the boundary, over the sum
        of their magnitudes, or over what the liquid holds where that is more.
        """
        space = self._open_space
        gained = self.released * space.total(source)
        formed, left = self.formed(state), self.leaving(state)
        stored = np.array([space.total(v) for v in (self.content(state) - content) / step])
        scale = np.abs(gained) + np.abs(formed) + np.abs(left) + np.abs(stored)
        held = np.array([space.total(np.abs(v)) for v in content]) / step
        reference = np.maximum(held, space.total(np.abs(source)))
        return np.abs(gained - formed - left - stored) / np.maximum(scale, reference)
