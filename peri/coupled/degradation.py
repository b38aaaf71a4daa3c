"""Metal and liquid in one march: bi-material corrosion with the ions, pH and minerals around it.

Where the metal's kinetics does not read the liquid's composition, the metal is that of the
bi-material problem, step by step and bit by bit; where it does (feedback.py), metal and liquid of
every stage are brought in line with each other, so that the order in the step is that of the
method.  The liquid is at rest at every stage where that is bounded (it relaxes in minutes), else
its content evolves, too: always in closed vessels.  Where the liquid is at rest, not read, and no
mineral can form, nothing of it evolves and it is computed at the output times.

A metal node that turns liquid still holds metal (less than C_sat).  That rest is no ion: it goes
on dissolving as Mg2+ + 2 OH- + H2, with the time constant REST_TIME, and the node's pore is filled
with the mean of the liquid around it, which is booked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.problem import COLUMNS
from peri.corrosion.nodes.stage import Stage as MetalStage
from peri.corrosion.scene import CorrosionScene
from peri.coupled.bath import Bath, BathLiquid
from peri.coupled.booking import element_error
from peri.coupled.charge_balance import ELECTRONS, ChargeBalance, check_one_piece
from peri.coupled.feedback import (
    OF_THE_LIQUID,
    Agreement,
    beside_metal,
    components_of,
    medium_beside,
)
from peri.coupled.kept_fields import LAYOUT, KeptFields
from peri.coupled.liquid_fields import foreseen_liquid
from peri.coupled.outputs import composition
from peri.coupled.surroundings import (
    HYDROGEN_PER_METAL,
    Surroundings,
    outside_of,
    relaxation_time,
)
from peri.engine.constants import FARADAY
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Attempt, BoundsError, Fields, Stage, State
from peri.engine.march.stepping import GAMMA
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.composition import CompositionError
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidState
from peri.transport.nernst_planck import TransportOptions
from peri.transport.stored import StoredLiquid

REST_TIME = 86400.0
"""s, assumed: longer than the steps in which nodes dissolve, which keep their order then; the rest
is at most C_sat / C_solid of the metal."""

STORAGE_LIMIT = 0.05
"""Bound of what a liquid at rest errs by (Degradation.storage_bound) above which its content is
followed."""


class Degradation(KeptFields):
    """A CorrosionScene in a medium whose ions are followed as TransportOptions say.

    Fields of its states beside those of CorrosionProblem, while the liquid is followed: `minerals`
    (M, padded lattice), mol/m3 of liquid; `rest` (padded), mol/m3 of metal in nodes that turned
    liquid; `liquid_...`, the scalar fields of the LiquidState, which later solutions start from;
    with storage `content` (E, padded), mol/m3, totals of the components; `seen_...` (padded box),
    what the metal's kinetics read of the liquid in the last stage.

    Parameters
    ----------
    medium : Solution of one node: what the refreshed layer holds
    solver_tolerance : of the metal's march (CorrosionProblem)
    minerals : follow the minerals in time; None: only if one could form at the first release,
        which is the largest
    storage : follow the liquid's content; None: without a refreshed layer, and where the bound
        of leaving it out exceeds STORAGE_LIMIT
    bath : of finite volume, which what leaves stays in; None: always fresh medium
    processes : who holds which block of the lattice; the scene is the root's, all else is alike

    potential_left_out : bound of |phi| at the first release, V, where it is left out

    Raises
    ------
    ValueError
        As Surroundings and ChargeBalance do; for a closure or a bath that a current excludes.
    """

    def __init__(
        self,
        scene: CorrosionScene | None,
        medium: Solution,
        options: TransportOptions | None = None,
        solver_tolerance: float = 1e-9,
        minerals: bool | None = None,
        storage: bool | None = None,
        bath: Bath | None = None,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        balanced = processes.on_root(lambda: ChargeBalance.of(scene) is not None)
        given = OF_THE_LIQUID | ({"potential"} if balanced else set())
        super().__init__(scene, solver_tolerance, processes, given=given)
        scene = self.scene  # this process's block
        self.charge_balance = ChargeBalance.of(scene)
        reads = scene.needs & given if self.discrete.box is not None else ()
        self._reads = tuple(sorted(reads))
        self.of_the_box = (*self.of_the_box, "switch", *(f"seen_{name}" for name in self._reads))
        self._components = components_of(scene, medium)
        self.discrete.surface |= medium_beside(medium, self._components)
        if self.charge_balance is not None:
            self.discrete.surface["potential"] = self.charge_balance.rest
        self.medium, self.options = medium, options or TransportOptions()
        self._surroundings: Surroundings | None = None
        self._at_start: np.ndarray | None = None
        self.stores = self._must_store() if storage is None else storage
        if self.stores:
            # The liquid's balance is no better than that of what the metal releases into it.
            self.discrete.tolerance = min(solver_tolerance, 1e-12)
        if self.charge_balance is not None:
            self.charge_balance.check(self.options.closure, bath is not None, self.discrete.is_open)
            self.charge_balance.begin(self.surroundings)
        first = self._first_liquid()
        self.potential_left_out = self.surroundings.liquid.potential_bound(first)
        self.bath = None if bath is None else BathLiquid(bath, medium)
        if bath is not None and not self.discrete.is_open:
            raise ValueError(
                f"bath: the scene's boundary is '{scene.boundary}', which nothing leaves through; "
                "a bath needs 'refreshed'"
            )
        evolves = self.stores or bath is not None or bool(self._reads)
        form = self._any_forms(first) if minerals is None else minerals
        self.follows_minerals = evolves or form
        names = [m.name for m in medium.chemistry.minerals]
        self.columns = {**COLUMNS, "hydrogen_amount": "mol"}
        self.evolved = ("concentration",)
        if self.follows_minerals:
            self.evolved = ("concentration", "minerals", "rest")
            self.columns |= {"highest_ph": "1", **{f"{n}_amount": "mol" for n in names}}
        if self.stores:
            self.evolved = (*self.evolved, "content")
        if self.bath is not None:
            self.evolved = (*self.evolved, "bath")
            self.columns |= {"bath_ph": "1"}
        if self.charge_balance is not None:
            self.columns |= {"metal_potential": "V", "applied_charge": "C"}
        if self.stores or bath is not None:
            self.columns |= {"element_error": "1"}

    def key(self) -> str:
        """Hash of the scene, the medium, its chemistry and the options."""
        chemistry = self.medium.chemistry
        minerals = [
            (m.name, m.stoichiometry, m.ln_k, m.kind, m.region, m.rate, m.nucleation_index)
            for m in chemistry.minerals
        ]
        return fingerprint(
            super().key(), self.medium.concentration, self.medium.ln_gamma, chemistry.names,
            chemistry.stoichiometry, chemistry.ln_k, chemistry.diffusivity, minerals, self.options,
            self.follows_minerals, self.stores, self.bath and self.bath.bath, LAYOUT,
        )  # fmt: skip

    # --- the liquid -----------------------------------------------------------------------

    @property
    def surroundings(self) -> Surroundings:
        """The liquid of the present phases."""
        if self._surroundings is None:
            self._surroundings = Surroundings(self.discrete, self.medium, self.options, self.stores)
            if self.charge_balance is not None:
                check_one_piece(self._surroundings.space)
        return self._surroundings

    def _must_store(self) -> bool:
        """Whether a liquid at rest would err by too much, or has no state at all."""
        if not self.discrete.is_open:
            return True
        return self.options.closure in ("electroneutral", "none") and (
            self.storage_bound() > STORAGE_LIMIT
        )

    def storage_bound(self) -> float:
        """Relative error of a release at rest: what it changes by while the liquid relaxes.

        relaxation_time (|d ln g / dV_L| dV_L/dt + the fastest node's loss rate).
        """
        scene = self.scene
        time, (outside, nodes) = self.processes.on_root(
            lambda: (relaxation_time(self._whole_scene, self.medium), outside_of(self._whole_scene))
        )
        pace = self.pace(super().initial())
        if scene.one_rate:
            first, later = (scene.kinetics.rate(Exposed(v)) for v in (0.0, 1e-6))
            steepness = abs(later / first - 1) / 1e-6 if first else 0.0
            pace *= 1.0 + steepness * outside / nodes
        return time * pace

    def _first_liquid(self) -> LiquidState:
        """The liquid at the first release, without minerals; with storage as it begins."""
        around = self.surroundings
        if self.stores:
            return around.liquid.rest()
        source = around.source(self.discrete.initial_concentration, None, 0.0)
        self._carry({"concentration": self.discrete.initial_concentration})
        return around.liquid.solve(source, minerals=False)

    def _any_forms(self, first: LiquidState) -> bool:
        """Whether a mineral passes its nucleation index at the first, largest release."""
        return any(
            self.surroundings.space.any(
                m.region & (m.ln_omega(first.ln_component) > m.ln_nucleation)
            )
            for m in self.surroundings.liquid.minerals
        )

    def liquid_at(self, state: State) -> LiquidState:
        """The liquid of a state of the march."""
        if self.bath is not None:
            self._hold(state.fields["bath"])
        self._carry(state.fields)
        if self.stores or (self.follows_minerals and state.time > 0):
            # As the last stage left it: its minerals' rates are those of that stage.
            return self.on_nodes.read(state.fields)
        return self.surroundings.liquid.solve(self._source(state), minerals=self.follows_minerals)

    def _carry(self, fields: Fields) -> np.ndarray | None:
        """Give the liquid the charge that anodes and cathodes set free apart, mol/m3/s, (n,)."""
        if self.charge_balance is None:
            return None
        return self.charge_balance.give(self.surroundings, fields)

    def _source(self, state: State) -> np.ndarray:
        """What the liquid takes up per node, mol/m3/s: from the interface, and of the rest."""
        fields, around = state.fields, self.surroundings
        around.switch = fields.get("switch", 1.0)
        source = around.source(
            fields["concentration"], fields.get("theta"), state.numbers["volume_loss"]
        )
        rest = fields.get("rest")
        return source if rest is None else source + self.on_nodes.at(rest) / REST_TIME

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """Solid metal in the medium, no minerals."""
        state = super().initial()
        for name in self._reads:
            medium = float(self.discrete.surface[name])
            state.fields[f"seen_{name}"] = np.full(self.discrete.box.padded_shape, medium)
        if self.charge_balance is not None:
            potential = float(self.discrete.surface["potential"])
            state.numbers |= {"metal_potential": potential, "charge": 0.0}
        if self.follows_minerals:
            count = len(self.medium.chemistry.minerals)
            shape = self.discrete.sum.padded_shape
            state.fields["minerals"] = np.zeros((count, *shape))
            state.fields["rest"] = np.zeros(shape)
            liquid = self.surroundings.liquid.rest()
            state.fields |= self.on_nodes.write(liquid)
        names = self.medium.chemistry.components
        if self.bath is not None:
            state.fields["bath"] = self.bath.fresh.copy()
        if self.stores or self.bath is not None:
            state.numbers |= {"taken": 0.0, **{f"left_{n}": 0.0 for n in names}}
        if self.stores:
            totals = self.medium.chemistry.stoichiometry.T @ liquid.concentration
            empty = np.zeros((len(totals), *shape))
            state.fields["content"] = self.on_nodes.put(empty, totals)
            state.numbers |= {
                f"given_{n}": self.surroundings.space.total(t)
                for n, t in zip(names, totals, strict=True)
            }
        return state

    def restore(self, state: State) -> None:
        """Take the phases from a state."""
        super().restore(state)
        self._surroundings = None

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """Metal that is used up turns liquid; the liquid's fields move to the new nodes."""
        before = self.discrete.metal.copy()
        super().accept(state, stages, step)
        if not state.numbers["dissolved"]:
            return
        if not self.follows_minerals:
            self._surroundings = None
            return
        older, liquid = self.surroundings, self.on_nodes.read(state.fields)
        totals = self.on_nodes.at(state.fields["content"]) if self.stores else None
        self._surroundings = None
        around = self.surroundings
        state.fields |= self.on_nodes.write(around.carried_over(liquid, older))
        new = self.discrete.sum.pad(np.ones(self.scene.lattice.shape)) > 0
        new &= before & ~self.discrete.metal
        rest = np.where(new, state.fields["concentration"], 0.0)
        state.fields["rest"] = state.fields["rest"] + rest
        if totals is not None:
            fresh = ~np.isin(around.space.index, older.space.index)
            moved = around.moved(totals, older)
            state.fields["content"] = self.on_nodes.put(state.fields["content"], moved)
            for name, row in zip(self.medium.chemistry.components, moved, strict=True):
                state.numbers[f"given_{name}"] += around.space.total(np.where(fresh, row, 0.0))

    def begin(self, state: State) -> None:
        """Note the minerals, which the stages may fall back to; exchange the bath where due."""
        super().begin(state)
        if self.bath is not None and self.bath.bath.due(state.time):
            state.fields["bath"] = self.bath.fresh.copy()
        self._at_start = state.fields.get("minerals")

    def change(self, attempt: Attempt) -> float:
        """Relative change of the rates of metal and minerals (LiquidFields.change)."""
        change = super().change(attempt)
        if not self.follows_minerals:
            return change
        before, after = attempt.old.fields["concentration"], attempt.stages[-1].fields
        metal, capacity = self.discrete.metal, self.discrete.capacity
        lost = float((capacity * (before - after["concentration"]))[metal].sum())
        lost = self.processes.total(lost)
        return max(change, self.on_nodes.change(attempt, lost))

    def foreseen(self, now: Fields, before: Fields, factor: float) -> Fields:
        """The liquid as its last change goes on, once there is one to go by."""
        return foreseen_liquid(now, before, factor, self.processes)

    def continues(self, first: Stage, right: Fields) -> bool:
        """Where elements are booked, a mineral that vanishes takes a first-order step."""
        booked = self.stores or self.bath is not None
        if booked and self.processes.any(right["minerals"].min(initial=0.0) < 0):
            return False
        return super().continues(first, right)

    def _surround(self, state: State) -> None:
        """Tell the kinetics what a state says of the liquid beside the metal."""
        super()._surround(state)
        for name in self._reads:
            if f"seen_{name}" in state.fields:
                self.discrete.surface[name] = state.fields[f"seen_{name}"]

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """Metal and liquid that agree: what the metal reads is the liquid that it makes."""
        if not self._reads:
            return self._joined(old, tau, guess)
        balance, iterations = self.charge_balance, 0
        begin = {n: guess.fields[f"seen_{n}"] for n in self._reads}
        rounds = Agreement if balance is None else balance.agreement
        agreement = rounds(self.discrete, begin)
        while True:
            seen = {f"seen_{name}": values for name, values in agreement.seen.items()}
            fields = {**guess.fields, **seen}
            try:
                stage = self._joined(old, tau, State(guess.time, fields, guess.numbers))
            except (BoundsError, ConvergenceError):
                if not agreement.go_back():
                    raise
                continue
            stage.fields |= seen
            iterations += stage.iterations
            around, nodes = self.surroundings, self.on_nodes
            liquid, amounts = nodes.read(stage.fields), nodes.at(stage.fields["minerals"])
            found = beside_metal(around, liquid, amounts, self._components)
            if balance is not None:
                new, theta = stage.fields["concentration"], stage.fields.get("theta")
                read = agreement.seen
                metal, found["potential"] = balance.find(around, new, theta, found, read, liquid)
                stage.numbers["metal_potential"] = metal
            if agreement.with_(found, stage.numbers["volume_loss"]):
                stage.iterations = iterations
                return stage
            guess = State(guess.time, fields | stage.fields, guess.numbers | stage.numbers)

    def _joined(self, old: Fields, tau: float, guess: State) -> Stage:
        """The metal's stage, then liquid and minerals for what it releases, solved as one."""
        stage = super().stage(old, tau, guess)
        if not self.follows_minerals:
            return stage
        self.discrete.set_aside()  # what is as large as the liquid's, which is solved now
        assert isinstance(stage.extra, MetalStage)
        if stage.extra.switch is not None and self.scene.saturation != "complementarity":
            stage.fields["switch"] = stage.extra.switch
        around, nodes, rest = self.surroundings, self.on_nodes, old["rest"]
        stage.fields["rest"] = nodes.put(rest, nodes.at(rest) / (1.0 + tau / REST_TIME))
        source = self._source(State(guess.time, stage.fields, stage.numbers))
        charge = self._carry(stage.fields)
        if charge is not None:
            stage.rates["charge"] = around.space.total(charge)
        held, span = old["minerals"], tau
        second = self._at_start is not None and held is not self._at_start
        if second and self.processes.any(held.min(initial=0.0) < 0):
            # The second stage of a step in which a mineral vanishes: this one field is taken from
            # the start of the step at first order, which is positive; the metal keeps its order.
            held, span = self._at_start, tau / GAMMA
        amounts = nodes.at(held)

        def solve(start: LiquidState) -> LiquidState:
            if isinstance(around.liquid, StoredLiquid):
                content = nodes.at(old["content"])
                return around.liquid.advance(source, content, tau, start, amounts)
            return around.liquid.solve(source, start, amounts, span)

        try:
            start = nodes.read(guess.fields, composed=False)
            if self.bath is None:
                liquid = solve(start)
            else:
                liquid, stage.fields["bath"] = self.bath.share(
                    around.liquid, solve, start, old["bath"], tau
                )
        except CompositionError as error:
            raise BoundsError(str(error)) from error
        if isinstance(around.liquid, StoredLiquid):
            totals = around.liquid.conserved(liquid, source, nodes.at(old["content"]), tau)
            stage.fields["content"] = nodes.put(old["content"], totals)
        if self.stores or self.bath is not None:
            left = around.liquid.leaving(liquid)
            names = self.medium.chemistry.components
            stage.rates |= {f"left_{n}": v for n, v in zip(names, left, strict=True)}
            stage.rates["taken"] = around.space.total(source)
        grown = amounts + span * liquid.rates
        grown[liquid.rates == -amounts / span] = 0.0  # all of it is gone, to the last digit
        stage.fields |= {"minerals": nodes.put(held, grown), **nodes.write(liquid)}
        stage.iterations += liquid.iterations
        return stage

    # --- the bath -------------------------------------------------------------------------

    def _hold(self, totals: np.ndarray) -> Solution:
        """Give the refreshed layer the composition of the bath; returns that."""
        assert self.bath is not None
        return self.bath.hold(self.surroundings.liquid, totals)

    # --- what is written ------------------------------------------------------------------

    def row(self, state: State) -> tuple[float, ...]:
        """The metal's row, hydrogen and, while minerals are followed, pH and their amounts."""
        metal = super().row(state)
        dissolved = self._dissolved(state, metal[1])
        # Electrons that an applied current takes away reduce no water.
        electrons = state.numbers.get("charge", 0.0) / ELECTRONS
        row = (*metal, HYDROGEN_PER_METAL * (dissolved - electrons))
        if not self.follows_minerals:
            return row
        around = self.surroundings
        ph = around.liquid.ph(self.on_nodes.read(state.fields, composed=False))
        amounts = self.on_nodes.at(state.fields["minerals"])
        row = (*row, -around.space.lowest(-ph), *(around.space.total(a) for a in amounts))
        if self.bath is not None:
            row = (*row, float(self._hold(state.fields["bath"]).ph[0]))
        if self.charge_balance is not None:
            row = (*row, state.numbers["metal_potential"], FARADAY * state.numbers["charge"])
        booked = self.stores or self.bath is not None
        return (*row, self._element_error(state)) if booked else row

    def _dissolved(self, state: State, metal: float) -> float:
        """Metal that has become ions, mol: neither metal nor rest of a node that turned liquid."""
        lost = max(state.numbers["initial"] - metal, 0.0)
        rest = state.fields.get("rest")
        if rest is None:
            return lost
        return lost - self.surroundings.space.total(self.on_nodes.at(rest))

    def _element_error(self, state: State) -> float:
        """See booking.element_error."""
        around, fields = self.surroundings, state.fields
        held = np.zeros((len(self.medium.chemistry.components), around.space.n))
        if self.stores and state.numbers["dissolved"]:
            held = self.on_nodes.at(fields["content"])  # new pores have no composition yet
        elif self.stores:
            held = self.medium.chemistry.stoichiometry.T @ self.on_nodes.read(fields).concentration
        amounts = self.on_nodes.at(fields["minerals"])
        return element_error(around.liquid, held, amounts, state.numbers, self.stores)

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """The metal's snapshot, and the liquid's composition on the lattice (outputs.composition).

        `balance` : largest relative error of a component;  `released` : metal, mol/s.
        """
        around = self.surroundings
        self._surround(state)
        found, source = self.liquid_at(state), self._source(state)
        amounts = np.zeros((len(self.medium.chemistry.minerals), around.space.n))
        if self.follows_minerals:
            amounts = self.on_nodes.at(state.fields["minerals"])
        bath = self.medium if self.bath is None else self._hold(state.fields["bath"])
        out = super().snapshot(state) | composition(around, found, amounts, bath)
        # Phases may have changed after the last stage; then its balance is that of the step before.
        known = not self.follows_minerals or not state.numbers["dissolved"]
        balance = 0.0
        if self.stores or self.bath is not None:
            balance = self._element_error(state)
        elif around.space.any(source) and known:
            balance = float(around.liquid.balance(found, source).max())
        return out | {"balance": balance, "released": around.space.total(source)}
