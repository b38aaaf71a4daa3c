"""Metal and liquid in one march: bi-material corrosion with the ions, pH and minerals around it.

The metal's kinetics does not read the liquid's composition, so the metal is that of the bi-material
problem, step by step and bit by bit; the liquid is quasi-steady at every stage (it relaxes in
minutes) and the minerals are what evolves beside the metal.  Where no mineral can form, nothing of
the liquid evolves and it is computed at the output times only.

Left out, with its bound: what a node still holds when it turns liquid (at most C_sat / C_solid of
the metal) is not handed to the ions; the liquid's own content (its relaxation time over the time in
which the release changes).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from peri.corrosion.nodes.problem import COLUMNS, CorrosionProblem
from peri.corrosion.scene import CorrosionScene
from peri.coupled.surroundings import HYDROGEN_PER_METAL, Surroundings
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import BoundsError, Fields, Stage, State
from peri.engine.march.stepping import GAMMA
from peri.transport.chemistry.composition import CompositionError
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidState
from peri.transport.nernst_planck import TransportOptions

_LIQUID_FIELDS = (
    "ln_component", "release", "extents", "migrated", "rates", "psi",
)  # fmt: skip


class Degradation(CorrosionProblem):
    """A corrosion scene in a medium whose ions are followed.

    Fields of its states beside those of CorrosionProblem, while minerals are followed: `minerals`
    (M, padded lattice), mol/m3 of liquid, and `liquid_...`, the scalar fields of the LiquidState,
    which later solutions start from.

    Parameters
    ----------
    scene : CorrosionScene
    medium : Solution of one node: what the refreshed layer holds
    options : TransportOptions
    solver_tolerance : of the metal's march (CorrosionProblem)
    minerals : follow the minerals in time; None: only if one could form at the first release,
        which is the largest

    Raises
    ------
    ValueError
        As Surroundings does.
    """

    def __init__(
        self,
        scene: CorrosionScene,
        medium: Solution,
        options: TransportOptions | None = None,
        solver_tolerance: float = 1e-9,
        minerals: bool | None = None,
    ) -> None:
        super().__init__(scene, solver_tolerance)
        self.medium, self.options = medium, options or TransportOptions()
        self._surroundings: Surroundings | None = None
        self._at_start: np.ndarray | None = None
        self.first = self._first_liquid()
        self.follows_minerals = self._any_forms() if minerals is None else minerals
        names = [m.name for m in medium.chemistry.minerals]
        self.columns = {**COLUMNS, "hydrogen_amount": "mol"}
        self.evolved = ("concentration",)
        if self.follows_minerals:
            self.evolved = ("concentration", "minerals")
            self.columns |= {"highest_ph": "1", **{f"{n}_amount": "mol" for n in names}}

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
            self.follows_minerals,
        )  # fmt: skip

    # --- the liquid -----------------------------------------------------------------------

    @property
    def surroundings(self) -> Surroundings:
        """The liquid of the present phases."""
        if self._surroundings is None:
            self._surroundings = Surroundings(self.discrete, self.medium, self.options)
        return self._surroundings

    def _first_liquid(self) -> LiquidState:
        """The liquid at the first release, without minerals."""
        around = self.surroundings
        source = around.source(self.discrete.initial_concentration, None, 0.0)
        return around.liquid.solve(source, minerals=False)

    def _any_forms(self) -> bool:
        """Whether a mineral passes its nucleation index at the first, largest release."""
        around = self.surroundings
        return any(
            bool((m.region & (m.ln_omega(self.first.ln_component) > m.ln_nucleation)).any())
            for m in around.liquid.minerals
        )

    def liquid_at(self, state: State) -> LiquidState:
        """The liquid of a state of the march."""
        if self.follows_minerals and state.time > 0:
            # As the last stage left it: its minerals' rates are those of that stage.
            return self._read(state.fields)
        return self.surroundings.liquid.solve(self._source(state), minerals=self.follows_minerals)

    def _source(self, state: State) -> np.ndarray:
        return self.surroundings.source(
            state.fields["concentration"], state.fields.get("theta"), state.numbers["volume_loss"]
        )

    def _read(self, fields: Fields) -> LiquidState:
        around = self.surroundings
        state = around.liquid.rest()
        for name in _LIQUID_FIELDS:
            setattr(state, name, fields[f"liquid_{name}"].copy())
        state.active = [row > 0 for row in fields["liquid_active"]]
        liquid = around.liquid
        state.concentration = liquid.composer.concentrations(state.ln_component, liquid.b)
        state.net_charge = liquid.chemistry.charge @ state.concentration
        return state

    def _write(self, state: LiquidState) -> Fields:
        fields = {f"liquid_{name}": getattr(state, name) for name in _LIQUID_FIELDS}
        rows = np.array(state.active, float).reshape(len(state.active), self.surroundings.space.n)
        return {**fields, "liquid_active": rows}

    def _amounts(self, minerals: np.ndarray) -> np.ndarray:
        return minerals.reshape(len(minerals), self.discrete.metal.size)[
            :, self.surroundings.space.index
        ]

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """Solid metal in the medium, no minerals."""
        state = super().initial()
        if self.follows_minerals:
            count = len(self.medium.chemistry.minerals)
            state.fields["minerals"] = np.zeros((count, *self.discrete.sum.padded_shape))
            state.fields |= self._write(self.surroundings.liquid.rest())
        return state

    def restore(self, state: State) -> None:
        """Take the phases from a state."""
        super().restore(state)
        self._surroundings = None

    def pack(self, name: str, values: np.ndarray) -> np.ndarray:
        """Fields of the liquid as they are; the others as CorrosionProblem does."""
        if name == "minerals" or name.startswith("liquid_"):
            return values
        return super().pack(name, values)

    def unpack(self, name: str, stored: np.ndarray | None) -> np.ndarray:
        """This process's field."""
        if name == "minerals" or name.startswith("liquid_"):
            assert stored is not None
            return stored
        return super().unpack(name, stored)

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """Metal that is used up turns liquid; the liquid's fields move to the new nodes."""
        super().accept(state, stages, step)
        if not state.numbers["dissolved"]:
            return
        if not self.follows_minerals:
            self._surroundings = None
            return
        older, liquid = self.surroundings, self._read(state.fields)
        self._surroundings = None
        state.fields |= self._write(self.surroundings.carried_over(liquid, older))

    def begin(self, state: State) -> None:
        """Note the minerals at the start of the step, which its stages may fall back to."""
        super().begin(state)
        self._at_start = state.fields.get("minerals")

    def bounded(self, fields: Fields) -> Fields:
        """Concentrations of the metal's march from 0 to C_solid."""
        return {**fields, **super().bounded(fields)}

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """The metal's stage, then liquid and minerals for what it releases, solved as one."""
        stage = super().stage(old, tau, guess)
        if not self.follows_minerals:
            return stage
        around = self.surroundings
        source = around.source(
            stage.fields["concentration"], stage.fields.get("theta"), stage.numbers["volume_loss"]
        )
        held, span = old["minerals"], tau
        if self._at_start is not None and held is not self._at_start and held.min(initial=0.0) < 0:
            # The second stage of a step in which a mineral vanishes: this one field is taken from
            # the start of the step at first order, which is positive; the metal keeps its order.
            held, span = self._at_start, tau / GAMMA
        amounts = self._amounts(held)
        try:
            liquid = around.liquid.solve(source, self._read(guess.fields), amounts, span)
        except CompositionError as error:
            raise BoundsError(str(error)) from error
        minerals = held.copy()
        left = amounts + span * liquid.rates
        left[liquid.rates == -amounts / span] = 0.0  # all of it is gone, to the last digit
        minerals.reshape(len(minerals), self.discrete.metal.size)[:, around.space.index] = left
        stage.fields |= {"minerals": minerals, **self._write(liquid)}
        stage.iterations += liquid.iterations
        return stage

    # --- what is written ------------------------------------------------------------------

    def row(self, state: State) -> tuple[float, ...]:
        """The metal's row, hydrogen and, while minerals are followed, pH and their amounts."""
        metal = super().row(state)
        dissolved = state.numbers["initial"] - metal[1]
        row = (*metal, HYDROGEN_PER_METAL * max(dissolved, 0.0))
        if not self.follows_minerals:
            return row
        around = self.surroundings
        ph = around.liquid.ph(self._read(state.fields)).max(initial=-np.inf)
        amounts = self._amounts(state.fields["minerals"])
        return (*row, float(ph), *(around.space.total(a) for a in amounts))

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """The metal's snapshot, and the liquid's composition on the lattice.

        `ph`, `potential` (V), `species` (K, ...) in mol/m3 and `minerals` (M, ...), float32, NaN
        off the computed liquid; `balance` (largest relative error of a component), `net_charge`
        (over the ionic strength), `lowest` (concentration, mol/m3), `pockets`, `pocket_share`,
        `largest_potential` (V; its bound where it is left
        out) and `index_<mineral>`, the highest saturation index.
        """
        around = self.surroundings
        liquid, space = around.liquid, around.space
        found = self.liquid_at(state)
        source = self._source(state)
        concentration = liquid.neutral_concentration(found)
        edge = self.medium.concentration[:, 0]
        strength = 0.5 * liquid.chemistry.charge**2 @ concentration
        charge = np.abs(liquid.chemistry.charge @ concentration) / strength
        out = super().snapshot(state)
        volt = liquid.thermal_voltage
        out["ph"] = space.crop(liquid.ph(found), float(self.medium.ph[0])).astype(np.float32)
        out["potential"] = space.crop(volt * found.psi, 0.0).astype(np.float32)
        out["species"] = np.array(
            [space.crop(c, e) for c, e in zip(concentration, edge, strict=True)], np.float32
        )
        amounts = np.zeros((len(self.medium.chemistry.minerals), space.n))
        if self.follows_minerals:
            amounts = self._amounts(state.fields["minerals"])
        out["minerals"] = np.array([space.crop(a, 0.0) for a in amounts], np.float32).reshape(
            len(amounts), *space.sum.lattice_shape
        )
        # Phases may have changed after the last stage; then its balance is that of the step before.
        known = not self.follows_minerals or not state.numbers["dissolved"]
        balance = float(liquid.balance(found, source).max()) if source.any() and known else 0.0
        out |= {
            "balance": balance,
            "net_charge": float(charge.max(initial=0.0)),
            "lowest": float(concentration.min(initial=np.inf)),
            "pockets": float(around.pockets),
            "pocket_share": around.pocket_share,
            "largest_potential": max(
                liquid.potential_bound(found) if self.options.closure == "none" else 0.0,
                float(np.abs(volt * found.psi).max(initial=0.0)),
            ),
            "released": space.total(source),
        }
        for mineral in liquid.minerals:
            index = mineral.ln_omega(found.ln_component) / np.log(10.0)
            highest = float(index[mineral.region].max(initial=-np.inf))
            out[f"index_{mineral.name}"] = highest
        return out
