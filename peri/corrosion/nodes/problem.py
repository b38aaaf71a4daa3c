"""The bi-material problem as the engine marches it: states, measures of a step, history."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from peri.corrosion.kinetics import Exposed
from peri.corrosion.metal.bond_damage import cut_off, dissolve_islands
from peri.corrosion.nodes import stage as bimaterial_stage
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Attempt, Fields, FirstOrder, Stage, State, moment
from peri.engine.processes import ONE_PROCESS, OneProcess

COLUMNS = {
    "volume_loss": "1",
    "metal_amount": "mol",
    "liquid_amount": "mol",
    "released_amount": "mol",
    "balance_error": "1",
    "saturated_nodes": "1",
    "dissolved_nodes": "1",
}
"""What corrosion adds to a march's history, and the unit of each."""


class CorrosionProblem(FirstOrder):
    """A corrosion scene, discretised and ready to be marched.

    Fields of its states: `concentration` (padded lattice, mol/m^3), `metal` (padded, bool) and,
    after an implicit stage, `theta` (padded box, the saturation factors); `exposed` (padded box,
    s: when a metal node first saw liquid, infinite before) where the kinetics needs an age; `pores`
    (padded, mol/m^3: what the emptied share of a metal node holds) where the scene has them.
    Numbers:
    `volume_loss`, `released` (mol), `initial` (metal at the start, mol), `start` (liquid's amount
    then, where there is any, mol), `dissolved` (nodes in the last step).

    Parameters
    ----------
    scene : CorrosionScene
        On the root; elsewhere None.
    solver_tolerance : float
        Relative residual of the linear solutions.
    processes : OneProcess or its like
    given : names of quantities
        What a coupled problem puts into `discrete.surface` before each step (the potential).

    discrete : BiMaterial, the discrete equations.
    """

    columns = COLUMNS
    evolved = ("concentration",)
    of_the_box: tuple[str, ...] = ("theta", "exposed")
    """Fields that live on the box around the metal."""

    def __init__(
        self,
        scene: CorrosionScene | None,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
        given: Collection[str] = (),
    ) -> None:
        self.processes, self._whole_scene = processes, scene
        self.discrete = BiMaterial(scene, solver_tolerance, processes)
        self.scene = self.discrete.scene
        if self.scene.pores:
            self.evolved = ("concentration", "pores")
        if self.scene.detached == "dissolve" and not processes.whole:
            raise ValueError("detached: 'dissolve' is done in one process, not on ranks")
        known = {"volume_loss", "phase", "concentration", "age", "lost", *given}
        missing = self.scene.needs - known
        if missing:
            raise ValueError(
                f"kinetics: it needs {', '.join(sorted(missing))}, which a march of corrosion "
                "alone does not have"
            )

    def coat(self, share: float) -> None:
        """See InterfaceRates.coat."""
        self.discrete.coat(share)

    def key(self) -> str:
        """Hash of the scene and the solver's tolerance."""
        return self.processes.on_root(
            lambda: fingerprint(self._whole_scene, self.discrete.tolerance)
        )

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """Solid metal in the liquid of the start."""
        discrete = self.discrete
        concentration = discrete.initial_concentration.copy()
        metal, liquid = discrete.amounts(concentration)
        numbers = {"volume_loss": 0.0, "released": 0.0, "initial": metal, "dissolved": 0.0}
        if liquid:
            numbers["start"] = liquid
        fields = {"concentration": concentration, "metal": discrete.metal}
        if self._ages:
            fields["exposed"] = np.where(self._exposed(), 0.0, np.inf)
        if self.scene.pores:
            fields["pores"] = np.zeros_like(concentration)
        return State(0.0, fields, numbers)

    @property
    def _ages(self) -> bool:
        return "age" in self.scene.needs and self.discrete.box is not None

    def _exposed(self) -> np.ndarray:
        """Metal nodes of the box that see liquid."""
        return self.discrete.box_metal & (self.discrete.box_neighbour_liquid > 0)

    def _surround(self, state: State) -> None:
        """Tell the kinetics how old the surface is at the time of a state."""
        if self._ages:
            self.discrete.surface["age"] = np.maximum(0.0, state.time - state.fields["exposed"])

    def restore(self, state: State) -> None:
        """Take the phases from a state."""
        self.discrete.metal = state.fields["metal"]
        self.discrete.update_phase()

    def begin(self, state: State) -> None:
        """Drop the preconditioner, so that a resumed march is the same; open walls to liquid."""
        self.discrete.forget()
        if self.scene.pores:
            self.discrete.open_walls(state.fields["concentration"])

    def pack(self, name: str, values: np.ndarray) -> np.ndarray:
        """The whole lattice's field on the root."""
        if name in self.of_the_box:
            values = self.discrete.put(values)
        return self.processes.gather(self.discrete.sum.crop(values))

    def unpack(self, name: str, stored: np.ndarray | None) -> np.ndarray:
        """This process's padded field."""
        values = self.discrete.sum.pad(self.processes.scatter(stored))
        if name == "metal":
            return values > 0
        return self.discrete.take(values) if name in self.of_the_box else values

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """Metal that is used up turns liquid."""
        concentration, law = state.fields["concentration"], self.scene.dissolution
        law.check(self.discrete, concentration, state.time)
        gone = law.gone(self.discrete, concentration, stages[-1].extra.emptied)
        dissolved = self.discrete.dissolve(gone)
        if dissolved and self.scene.detached == "dissolve":
            dissolved += self._dissolve_islands(state)
        state.fields["metal"] = self.discrete.metal
        state.numbers["dissolved"] = dissolved
        if self._ages and dissolved:
            new = self._exposed() & np.isinf(state.fields["exposed"])
            state.fields["exposed"] = np.where(new, state.time, state.fields["exposed"])
        state.numbers["volume_loss"] = self.discrete.volume_loss(concentration)

    def _dissolve_islands(self, state: State) -> int:
        """Metal that is cut off turns liquid; returns the nodes.

        What the liquid has no room for below C_sat leaves as debris, with what is released.
        """
        discrete, scene = self.discrete, self.scene
        islands = cut_off(scene.metal, discrete.sum.crop(discrete.metal) > 0)
        if not islands.any():
            return 0
        field = discrete.sum.crop(state.fields["concentration"])
        liquid = discrete.sum.crop(discrete.free) > 0
        field, left = dissolve_islands(field, islands, liquid, scene.saturation_concentration)
        state.fields["concentration"] = discrete.sum.pad(field)
        state.numbers["released"] += left * scene.lattice.cell_volume
        return discrete.dissolve(discrete.sum.pad(islands > 0) > 0)

    def row(self, state: State) -> tuple[float, ...]:
        """Amounts and their balance, nodes held at C_sat, nodes dissolved."""
        numbers, fields = state.numbers, state.fields
        metal, liquid = self.discrete.amounts(fields["concentration"], fields.get("pores"))
        initial = numbers["initial"]
        scale = initial + numbers.get("start", 0.0)
        error = (metal + liquid + numbers["released"] - scale) / scale if scale else 0.0
        saturated = self._held(state)
        released, dissolved = numbers["released"], numbers["dissolved"]
        return (
            numbers["volume_loss"], metal, liquid, released, error, saturated, dissolved,
        )  # fmt: skip

    def _held(self, state: State) -> int:
        """Nodes held at C_sat."""
        theta = state.fields.get("theta")
        if theta is None:
            return 0
        held = (theta < 1.0) & (self.discrete.box_free_volume > 0)
        return self.processes.total(int(held.sum()))

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """Concentrations, phases, the volume loss, and theta while there is a salt layer."""
        held = self._held(state)
        layer = {"theta": self.pack("theta", state.fields["theta"])} if held else {}
        return {
            **layer,
            "concentration": self.pack("concentration", state.fields["concentration"]),
            "metal": self.pack("metal", state.fields["metal"]),
            "volume_loss": state.numbers["volume_loss"],
        }

    def describe(self, state: State) -> str:
        """Time and volume loss."""
        lost = 100 * state.numbers["volume_loss"]
        return f"{moment(state.time)}, volume loss {lost:.2f} %"

    # --- stages ---------------------------------------------------------------------------

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """See BiMaterial.implicit_stage."""
        self._surround(guess)
        solved = self.discrete.implicit_stage(
            old["concentration"],
            tau,
            guess.fields["concentration"],
            guess.fields.get("theta"),
            guess.numbers["volume_loss"],
            old.get("pores"),
        )
        return self._stage(solved)

    def explicit(self, old: State, step: float) -> Stage:
        """See BiMaterial.explicit_step."""
        self._surround(old)
        loss = old.numbers["volume_loss"]
        new, release, theta = self.discrete.explicit_step(old.fields["concentration"], step, loss)
        return self._stage(bimaterial_stage.Stage(new, theta, loss, release, 0, 1))

    def _stage(self, solved: bimaterial_stage.Stage) -> Stage:
        fields = {"concentration": solved.concentration}
        if solved.theta is not None:
            fields["theta"] = solved.theta
        if solved.pores is not None:
            fields["pores"] = solved.pores
        numbers = {"volume_loss": solved.volume_loss}
        rates = {"released": solved.release_rate}
        return Stage(fields, numbers, rates, solved.iterations, solved)

    def limits(self, state: State) -> tuple[float, float]:
        """Stability of the explicit step, and the fastest metal node (1/s)."""
        self._surround(state)
        rates = self.discrete.fastest_rates(state.fields["concentration"])
        return 1.0 / max(*rates, 1e-300), rates[1]

    def pace(self, state: State) -> float:
        """The fastest metal node's relative loss, 1/s."""
        if not self.scene.one_rate:
            return self.limits(state)[1]
        rate = self.processes.largest(float(self.discrete.metal_rates().max(initial=0.0)))
        return rate * self.scene.kinetics.rate(Exposed(0.0))

    def bounded(self, fields: Fields) -> Fields:
        """Concentrations from 0 to C_solid."""
        clipped = np.clip(fields["concentration"], 0.0, self.scene.highest_concentration)
        return {"concentration": clipped}

    # --- measures of a step ---------------------------------------------------------------

    def continues(self, first: Stage, right: Fields) -> bool:
        """As the law of the bonds says."""
        return self.scene.dissolution.continues(self.discrete, first, right)

    def admissible(self, old: State, stages: Sequence[Stage]) -> bool:
        """Whether the law is content, no metal gained and no liquid passed its bounds."""
        if not self.scene.dissolution.admissible(self.discrete, stages):
            return False
        new, before = stages[-1].fields["concentration"], old.fields["concentration"]
        highest = self.scene.highest_concentration
        rounding = 1e-12 * highest
        metal = self.discrete.metal
        out = np.any(new[metal] > before[metal] + rounding) or new.min() < -rounding
        out |= new.max() > highest + rounding
        if self.scene.saturation == "complementarity":
            # The stages watch the liquid within reach of the metal; beyond it only this does.
            liquid = new[self.discrete.free].max(initial=0.0)
            out |= liquid > self.scene.saturation_concentration * (1 + 1e-9)
        return not self.processes.any(out)

    def change(self, attempt: Attempt) -> float:
        """Relative change of the metal's loss rate in a step, as the law measures it."""
        return self.scene.dissolution.change(self.discrete, attempt)


class MetalAlone(CorrosionProblem):
    """A corrosion scene whose liquid stays clean: what its metal loses is released at once.

    For metal that dissolves by Faraday's law where neither a salt layer nor a law of the rate looks
    at the liquid (omissions.activation).  Parameters as CorrosionProblem.

    Raises
    ------
    ValueError
        For bonds that follow their metal's content, and liquid that holds something at the start.
    """

    def __init__(
        self,
        scene: CorrosionScene,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        super().__init__(scene, solver_tolerance, processes)
        if self.scene.dissolution.name != "faradaic" or self.scene.saturation != "none":
            raise ValueError(
                "dissolution: metal is marched alone by Faraday's law without saturation only"
            )
        if processes.any(self.scene.liquid is not None and self.scene.liquid.any()):
            raise ValueError("liquid: metal is marched alone in clean liquid only")

    def key(self) -> str:
        """Hash of the scene, and of what is left out."""
        return self.processes.on_root(
            lambda: fingerprint(self._whole_scene, self.discrete.tolerance, "alone")
        )

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """See StageSolver.alone."""
        self._surround(guess)
        loss = guess.numbers["volume_loss"]
        return self._stage(self.discrete.stage_alone(old["concentration"], tau, loss))
