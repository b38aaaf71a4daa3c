"""Quasi-steady transport, reaction and precipitation of a liquid around a dissolving metal.

At rest the transport of every component e reads, with Pi_e = sum_k nu_ke D_k C_k,

    c_i sum_j c_j w_ij (Pi_e,i - Pi_e,j) = c_i (s_e q_i + N_e,i - sum_m nu_me r_m,i),

q the metal's release (mol/m3/s), s_e what it sets free of component e per mole, N_e what migration
adds to diffusion (fluxes.py) and r_m the growth of mineral m.  The left side is linear in Pi
whatever the equilibria, so the release is one scalar field g, each mineral one extent G_m:

    Pi_e = Pi_e(medium) + s_e g + X_e - sum_m nu_me G_m,  A g = q,  A G_m = r_m,  A X_e = N_e,

and the composition follows from Pi node by node (composition.py).  Transport, reactions and
minerals are one system: solved one after the other they would be wrong by the ratio of the step
to the liquid's relaxation time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np

from peri.engine.constants import FARADAY, GAS_CONSTANT
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.activity import conditional_constants, mineral_constants
from peri.transport.chemistry.composition import Composer, CompositionError
from peri.transport.chemistry.minerals import MineralField, SunkSystem, settle
from peri.transport.chemistry.speciation import Solution
from peri.transport.chemistry.species import LN10, MOLAR
from peri.transport.fluxes import LARGEST_SQRA_STEP, largest_bond_step
from peri.transport.liquid import LiquidSpace, LiquidState
from peri.transport.migration import Migration
from peri.transport.options import TransportOptions
from peri.transport.permittivity import permittivity_of_water

log = logging.getLogger(__name__)

PUBLISHED_CONDUCTIVITY = 6.1e6
"""S/m, Tables 3.7 and 5.4 of the dissertation; that of a metal, kept for `as_published`."""

_MAXIMUM_SWEEPS = 60
_LOOSE_BEGINNING = 1e-6
"""Of the release: to which minerals are brought in balance before the first sweep."""
_MINERALS_BEHIND = 1e-2
"""Of the ions' residual in a sweep: to which they are in it; a sweep leaves about as much of it."""
_THINNEST = 1e-3
"""Of the tolerance: to which ions are solved for where fluxes are found and only charge is left."""
_MAXIMUM_HALVINGS = 8
_TOO_LITTLE = "the liquid holds too little salt for this release"
_RESOLVED = 1e-11
"""Share of its largest change below which a component that the medium lacks counts as absent."""
_BARELY = 1e-6
"""The same while the solution is looser than that (`unresolved`), at most."""


class QuasiSteadyLiquid:
    """The composition of the liquid that a given release and the minerals keep up.

    Parameters
    ----------
    space : LiquidSpace
    medium : Solution of one node: what the refreshed layer holds; its activity coefficients hold
        everywhere ("fixed")
    releases : moles of each species set free per mole of metal dissolved, for instance
        {"Mg": 1, "OH": 2}
    surface : (n,) bool, nodes beside the metal, where minerals of the region "surface" may form
    options : TransportOptions

    beside : (E, n) or 0, set before `solve`: what is set free of every component besides the
        release, mol/m3/s.  It may carry a charge from node to node, a current, which the potential
        then drives through the liquid.

    Raises
    ------
    ValueError
        For nodes that the refreshed layer cannot reach (they have no steady state), a medium of
        more than one node, or a release that carries a charge.
    """

    needs_a_way_out = True

    def __init__(
        self,
        space: LiquidSpace,
        medium: Solution,
        releases: Mapping[str, float],
        surface: np.ndarray,
        options: TransportOptions | None = None,
    ) -> None:
        if medium.ln_component.shape[1] != 1:
            raise ValueError("medium: it must be the solution of one node")
        chemistry = medium.chemistry
        self.space, self.medium, self.chemistry = space, medium, chemistry
        self.options = options or TransportOptions()
        self.relative = self.options.tolerance
        lost = space.count(space.cut_off()) if self.needs_a_way_out else 0
        if lost:
            raise ValueError(
                f"liquid: {lost} nodes are cut off from the refreshed medium; a quasi-steady "
                "liquid needs a way out for what dissolves"
            )
        nu, d = chemistry.stoichiometry, chemistry.diffusivity
        self.released = sum(
            (amount * nu[chemistry.index(name)] for name, amount in releases.items()),
            np.zeros(nu.shape[1]),
        )
        charge = float(self.released @ chemistry.component_charge)
        if abs(charge) > 1e-12:
            raise ValueError(
                f"releases: they carry a charge of {charge:+g} per mole of metal; what an anode "
                "and its cathode set free together is neutral"
            )
        self.b = conditional_constants(chemistry, medium.ln_gamma, medium.ln_water)
        self._mineral_constant = mineral_constants(chemistry, medium.ln_gamma, medium.ln_water)
        self.composer = Composer(nu, d)
        self.hold(medium.concentration[:, 0])
        self.minerals = [
            MineralField(
                mineral.name,
                mineral.stoichiometry,
                float(self._mineral_constant[i, 0]),
                np.ones(space.n, bool) if mineral.region == "liquid" else surface,
                mineral.rate,
                LN10 * mineral.nucleation_index,
            )
            for i, mineral in enumerate(chemistry.minerals)
        ]
        self.unresolved = np.zeros(nu.shape[1])
        self.sunk: dict[int, SunkSystem] = {}
        self.migration = Migration(self.options.flux_form, space, chemistry)
        if self.needs_a_way_out:
            self.plain = space.system()
        self.inert = medium.inert_ion()
        self.beside: np.ndarray | float = 0.0

    def hold(self, concentration: np.ndarray) -> None:
        """Give the refreshed layer another composition, (K,), mol/m3; it must be neutral."""
        self.edge = np.array(concentration)
        chemistry = self.chemistry
        weighted = chemistry.diffusivity * self.edge
        self.bulk = (chemistry.stoichiometry.T @ weighted)[:, None]

    def rest(self) -> LiquidState:
        """The medium everywhere: the state to start from."""
        n, e = self.space.n, len(self.chemistry.components)
        m = np.repeat(self.medium.ln_component, n, axis=1)
        zero, none = np.zeros(n), np.zeros((len(self.minerals), n))
        return LiquidState(
            m, np.repeat(self.medium.concentration, n, axis=1), zero, none, np.zeros((e, n)),
            none, zero, zero, active=[np.zeros(n, bool) for _ in self.minerals],
        )  # fmt: skip

    # --- pieces ---------------------------------------------------------------------------

    def target(self, state: LiquidState, nodes: np.ndarray | None = None) -> np.ndarray:
        """Pi, (E, n) or at some nodes; exactly 0 for a component that the medium lacks where none
        is resolved."""
        return self._target_of(state)(slice(None) if nodes is None else nodes)

    def _target_of(self, state: LiquidState) -> Callable[[np.ndarray | slice], np.ndarray]:
        """`target` of a state, as it is, at nodes that are named later."""

        def change(e: int | slice, at: np.ndarray | slice) -> np.ndarray:
            out = (
                np.multiply.outer(self.released[e], state.release[at]) + state.migrated[e][..., at]
            )
            for mineral, extent in zip(self.minerals, state.extents, strict=True):
                if mineral.nu[e].any():
                    out -= np.multiply.outer(mineral.nu[e], extent[at])
            return out

        lacking = (self.bulk == 0).all(axis=1) & self.composer.only_positive
        unresolved = {}
        for e in np.flatnonzero(lacking):
            largest = self.space.largest(np.abs(change(int(e), slice(None))))
            round_ = min(self.unresolved[e], _BARELY * largest)
            unresolved[int(e)] = max(_RESOLVED * largest, round_)

        def target(nodes: np.ndarray | slice) -> np.ndarray:
            bulk = self.bulk if self.bulk.shape[1] == 1 else self.bulk[:, nodes]
            found = bulk + change(slice(None), nodes)
            for e, amount in unresolved.items():
                found[e, np.abs(found[e]) <= amount] = 0.0
            return found

        return target

    def compose(self, state: LiquidState, nodes: np.ndarray | None = None) -> None:
        """Composition and net charge from the scalar fields, in place; everywhere or at nodes."""
        together = self.space.processes.together
        if nodes is None:
            wanted = self._target_of(state)
            together(
                lambda: self.composer.fill(wanted, self.b, state.ln_component, state.concentration)
            )
            state.net_charge = self.chemistry.charge @ state.concentration
            return
        m, target = state.ln_component[:, nodes], self.target(state, nodes)
        found = together(lambda: self.composer.solve(target, self.b, m))
        state.ln_component[:, nodes] = m
        state.concentration[:, nodes] = found

    def migrate(self, state: LiquidState) -> np.ndarray:
        """N_e, (E, n): what migration adds to the inflow of each component, mol/m3/s."""
        return self.migration.inflow(state.concentration, self.edge, state.psi, state.held_psi)

    def inflow(self, state: LiquidState) -> np.ndarray:
        """What diffusion has to carry off besides the release, (E, n): migration and `beside`."""
        migrated = self.migrate(state)
        return migrated + self.beside if np.ndim(self.beside) else migrated

    def _check_current(self) -> None:
        if np.ndim(self.beside) and self.options.closure not in ("electroneutral", "poisson"):
            raise ValueError(f"closure: '{self.options.closure}' drives no current")

    # --- the solution ---------------------------------------------------------------------

    def solve(
        self,
        source: np.ndarray,
        start: LiquidState | None = None,
        amounts: np.ndarray | None = None,
        step: float = np.inf,
        *,
        minerals: bool = True,
    ) -> LiquidState:
        """Return the liquid that a release keeps up.

        Parameters
        ----------
        source : (n,) metal released into each node, mol/m3/s
        start : a state to begin with
        amounts : (M, n) minerals that are there, mol/m3; what dissolves is limited by them
        step : s, the time over which no more than `amounts` can dissolve
        minerals : False keeps all minerals from forming

        Raises
        ------
        ConvergenceError
            When minerals or potential do not settle.
        CompositionError
            When a node has no composition.
        """
        space, options = self.space, self.options
        state = (start or self.rest()).copy()
        there = np.zeros((len(self.minerals), space.n)) if amounts is None else amounts
        right = space.volume * source
        scale = self._driven(source)
        state.iterations = state.sweeps = 0
        if scale == 0.0:
            scale = space.norm(space.volume) * 1e-12
        self._check_current()
        absolute = options.tolerance * scale
        before = state.release
        state.release, used = space.solve(self.plain, right, before, 0.1 * absolute)
        state.iterations += used
        there = there if minerals else None
        for mineral, active in zip(self.minerals, state.active, strict=True):
            if not mineral.in_equilibrium:
                active[:] = False  # what is there is open in any case
        self.sunk.clear()
        within = absolute if options.closure == "none" else max(absolute, _LOOSE_BEGINNING * scale)
        self._begin(state, before, there, step, within)
        if options.closure != "none":
            self._close(state, there, step, absolute, within)
        return state

    def _driven(self, source: np.ndarray) -> float:
        """What drives the liquid, against which residuals count: norm per cell, mol/m3/s."""
        space = self.space
        rows = np.atleast_2d(np.asarray(self.beside, float)) * space.volume
        return max(space.norm(space.volume * source), float(space.row_norms(rows).max()))

    def _begin(
        self,
        state: LiquidState,
        before: np.ndarray,
        there: np.ndarray | None,
        step: float,
        absolute: float,
    ) -> None:
        """A first composition: what the start holds of minerals and migration, scaled with g.

        Pi is linear in the three, so a start that has a composition keeps one when all change
        alike; where they do not, minerals and migration start from zero, which always has one.
        """
        old, new = self.space.norm(before), self.space.norm(state.release)
        ratio = new / old if old > 0 else float(new == 0.0)
        composition = state.ln_component.copy()
        state.extents *= ratio
        state.migrated *= ratio
        state.psi *= ratio
        try:
            settle(self, state, there, step, absolute)
        except CompositionError:
            state.extents[:] = 0.0
            state.migrated[:] = 0.0
            state.psi[:] = 0.0
            state.ln_component = composition
            settle(self, state, there, step, absolute)

    def _close(
        self,
        state: LiquidState,
        there: np.ndarray | None,
        step: float,
        absolute: float,
        within: float,
    ) -> None:
        """Sweep: potential from the net charge at each node, then the ions' migration in it.

        within : residual norm to which the minerals are in balance; it follows that of the ions
        """
        space, chemistry = self.space, self.chemistry
        z2 = chemistry.charge**2
        # The printed flux moves ions twice as far, so half the potential does.
        gain = 2.0 if self.options.flux_form == "as_published" else 1.0
        thermal = GAS_CONSTANT * chemistry.temperature / FARADAY
        published = self.options.closure == "as_published"
        permittivity = 0.0
        if self.options.closure == "poisson":
            permittivity = permittivity_of_water(chemistry.temperature)
        charge_scale = permittivity * thermal / FARADAY
        mobility = self.migration.mobility(self.edge)
        for sweep in range(1, _MAXIMUM_SWEEPS + 1):
            support = z2 @ state.concentration
            old_psi = state.psi
            if published:
                right = (
                    space.volume * state.net_charge * (FARADAY / (PUBLISHED_CONDUCTIVITY * thermal))
                )
                size = max(space.norm(right), 1e-300)
                psi, used = space.solve(self.plain, right, 0 * state.psi, 1e-10 * size)
                state.iterations += used
                state.psi = psi
            else:
                excess = state.net_charge - charge_scale * (space.outflow(state.psi) / space.volume)
                update = excess / (gain * support + charge_scale * space.degree)
                # A potential that follows round-off would only stir the ions.
                if space.largest(np.abs(excess / support)) > 0.1 * self.options.neutrality:
                    state.psi = state.psi + update
            inflow = self.inflow(state)
            residual = max(
                space.norm(space.volume * inflow[e] - space.outflow(state.migrated[e]))
                for e in range(inflow.shape[0])
            )
            excess_now = space.largest(np.abs(state.net_charge) / (0.5 * support))
            state.sweeps = sweep
            settled = self.options.closure != "electroneutral" or (
                excess_now <= self.options.neutrality
            )
            if residual <= absolute and within <= absolute and settled:
                break
            if sweep == _MAXIMUM_SWEEPS or not np.isfinite(residual):
                raise ConvergenceError(
                    f"potential: net charge {excess_now:.2g} of the ionic strength after {sweep} "
                    f"sweeps, {self.options.neutrality:g} wanted (the ions' fluxes change by "
                    f"{residual:.2g}, {absolute:.2g} wanted); {_TOO_LITTLE}"
                )
            share = 0.1 if residual > absolute else _THINNEST
            tight = max(share * absolute, 1e-4 * residual)
            within = max(absolute, _MINERALS_BEHIND * residual)
            before = state.migrated.copy()
            # In a uniform liquid a change of psi moves X_e by as much.
            moved = state.psi - old_psi
            for e in range(inflow.shape[0]):
                state.migrated[e], used = space.solve(
                    self.plain, space.volume * inflow[e], before[e] - mobility[e] * moved, tight
                )
                state.iterations += used
            del inflow  # large, and no more needed
            try:
                self._grow_between(state, before, there, step, within)
            except CompositionError as error:
                raise CompositionError(f"potential: {error}; {_TOO_LITTLE}") from error
        largest = float(np.abs(chemistry.charge).max()) * largest_bond_step(
            space.spread(state.psi, state.held_psi), space.all_volume, space.sum
        )
        said = largest > LARGEST_SQRA_STEP and self.options.flux_form != "sg"
        if said and space.processes.is_root:
            log.warning(
                "the potential steps by up to %.2g RT/F along a bond, above %g: use the flux "
                "form 'sg'", largest, LARGEST_SQRA_STEP,
            )  # fmt: skip

    def _grow_between(
        self,
        state: LiquidState,
        before: np.ndarray,
        there: np.ndarray | None,
        step: float,
        absolute: float,
    ) -> None:
        """Compose, minerals too; half the way back to the last migration while a node has none.

        Without supporting salt a sweep may ask for more of an ion than there is.
        """
        for _ in range(_MAXIMUM_HALVINGS):
            start, extents = state.ln_component.copy(), state.extents.copy()
            try:
                settle(self, state, there, step, absolute)
            except CompositionError:
                state.ln_component, state.extents = start, extents
                state.migrated = 0.5 * (state.migrated + before)
                continue
            return
        settle(self, state, there, step, absolute)

    # --- what is seen ---------------------------------------------------------------------

    def potential_bound(self, state: LiquidState) -> float:
        """Bound of |phi| left out, V: net charge over sum z^2 C, the first and largest update."""
        support = self.chemistry.charge**2 @ state.concentration
        return self.thermal_voltage * self.space.largest(np.abs(state.net_charge / support))

    @property
    def thermal_voltage(self) -> float:
        """R T / F, V."""
        return GAS_CONSTANT * self.chemistry.temperature / FARADAY

    def neutral_concentration(self, state: LiquidState) -> np.ndarray:
        """Concentrations, (K, n), with the inert ion as neutrality wants it (closure "none").

        Raises ValueError where the inert ion would become negative or there is none.
        """
        if self.options.closure != "none":
            return state.concentration
        if self.inert < 0:
            raise ValueError("closure: 'none' needs an inert ion that takes up the charge")
        concentration = state.concentration.copy()
        concentration[self.inert] -= state.net_charge / self.chemistry.charge[self.inert]
        if self.space.any(concentration[self.inert] < 0):
            raise ValueError(
                f"closure: 'none' makes {self.chemistry.names[self.inert]} negative; "
                "use 'electroneutral'"
            )
        return concentration

    def ph(self, state: LiquidState) -> np.ndarray:
        """-log10 of the activity of H, (n,)."""
        h = self.chemistry.components.index("H")
        return -(state.ln_component[h] - np.log(MOLAR) + self.medium.ln_gamma[h, 0]) / LN10

    def saturation_index(self, state: LiquidState, number: int) -> np.ndarray:
        """log10(Omega) of one mineral, (n,)."""
        return self.minerals[number].ln_omega(state.ln_component) / LN10

    def leaving(self, state: LiquidState) -> np.ndarray:
        """What leaves of every component through the bonds to the refreshed layer, mol/s, (E,)."""
        space = self.space
        change = self.target(state) - self.bulk
        diffused = np.array([space.total(space.exit * c) for c in change])
        return diffused - np.array([space.total(v) for v in self.migrate(state)])

    def balance(self, state: LiquidState, source: np.ndarray) -> np.ndarray:
        """Relative error of the balance of every component, (E,).

        Released - precipitated - what leaves through the bonds to the refreshed layer, over what
        moves of the component (released, precipitated, diffused and migrated, each positive).
        """
        space = self.space
        change = self.target(state) - self.bulk
        gained = self.released * space.total(source)
        if np.ndim(self.beside):
            gained = gained + np.array([space.total(row) for row in np.asarray(self.beside)])
        formed = self.formed(state)
        moved = np.array([space.total(space.exit * c) for c in change])
        carried = np.array([space.total(v) for v in self.migrate(state)])
        scale = np.abs(gained) + np.abs(formed) + np.abs(moved) + np.abs(carried)
        reference = max(space.total(np.abs(source)), 1e-300)
        return np.abs(gained + carried - formed - moved) / np.maximum(scale, reference)

    def formed(self, state: LiquidState) -> np.ndarray:
        """What the minerals take of every component, mol/s, (E,)."""
        return sum(
            (m.nu * self.space.total(r) for m, r in zip(self.minerals, state.rates, strict=True)),
            np.zeros(self.released.shape),
        )
