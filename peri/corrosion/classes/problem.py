"""The problem of rate classes as the engine marches it: states, measures of a step, history."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from peri.corrosion.classes.cells import Cells
from peri.corrosion.nodes.problem import COLUMNS
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Attempt, Fields, FirstOrder, Stage, State

_LATE = 4.0
"""Weight of what a step exposes too late, as for scenes given by nodes."""


class CellProblem(FirstOrder):
    """A corrosion scene with rate classes, discretised and ready to be marched.

    Fields of its states: `concentration` (padded, of the liquid, mol/m^3), `classes` (of the
    metal), `volume` (of the classes, relative; 0 once liquid) and `theta` (padded).

    Parameters
    ----------
    scene : CorrosionScene
        With an exposure.
    solver_tolerance : float
    """

    columns = COLUMNS
    evolved = ("concentration", "classes")

    def __init__(self, scene: CorrosionScene, solver_tolerance: float = 1e-9) -> None:
        self.scene = scene
        self.cells = Cells(scene, solver_tolerance)

    def coat(self, share: float) -> None:
        """See Cells.coat."""
        self.cells.coat(share)

    def key(self) -> str:
        """Hash of the scene and the solver's tolerance."""
        return fingerprint(self.scene, self.cells.tolerance)

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """Solid metal in clean liquid."""
        cells = self.cells
        liquid = np.zeros(cells.sum.padded_shape)
        classes = np.full(cells.cell.size, self.scene.solid_concentration)
        metal, _ = cells.amounts(liquid, classes)
        numbers = {"volume_loss": 0.0, "released": 0.0, "initial": metal, "dissolved": 0.0}
        fields = {"concentration": liquid, "classes": classes, "volume": cells.volume}
        return State(0.0, fields, numbers)

    def restore(self, state: State) -> None:
        """Take from a state which classes are metal."""
        if not np.array_equal(state.fields["volume"], self.cells.volume):
            self.cells.set_volumes(state.fields["volume"])

    def begin(self, state: State) -> None:
        """Drop the preconditioner, so that a resumed march is the same."""
        self.cells.forget()

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """Classes below C_sat turn liquid."""
        liquid = state.fields["concentration"].copy()
        classes = state.fields["classes"].copy()
        state.numbers["dissolved"] = self.cells.dissolve(liquid, classes)
        state.fields.update(concentration=liquid, classes=classes, volume=self.cells.volume)
        state.numbers["volume_loss"] = self.cells.volume_loss(classes)

    def row(self, state: State) -> tuple[float, ...]:
        """Amounts and their balance, cells held at C_sat, classes dissolved."""
        numbers, theta = state.numbers, state.fields.get("theta")
        metal, liquid = self.cells.amounts(state.fields["concentration"], state.fields["classes"])
        initial = numbers["initial"]
        error = (metal + liquid + numbers["released"] - initial) / initial if initial else 0.0
        held = 0 if theta is None else int(((theta < 1.0) & self.cells.free).sum())
        released, dissolved = numbers["released"], numbers["dissolved"]
        return (
            numbers["volume_loss"], metal, liquid, released, error, held, dissolved,
        )  # fmt: skip

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """Concentrations by node, which cells still hold metal, and the volume loss.

        A cell that held metal at the start shows that metal's mean, what is gone counting as
        nothing; another cell its liquid's concentration.
        """
        cells = self.cells
        held = cells.scatter(cells.initial_volume)
        left = cells.scatter(cells.volume * state.fields["classes"])
        mean = np.divide(left, held, out=state.fields["concentration"].copy(), where=held > 0)
        metal = cells.sum.crop(cells.scatter((cells.volume > 0).astype(float)) > 0)
        return {
            "concentration": cells.sum.crop(mean),
            "metal": metal,
            "volume_loss": state.numbers["volume_loss"],
        }

    def describe(self, state: State) -> str:
        """Day and volume loss."""
        lost = 100 * state.numbers["volume_loss"]
        return f"day {state.time / 86400:.1f}, volume loss {lost:.2f} %"

    # --- stages ---------------------------------------------------------------------------

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """See Cells.stage."""
        solved = self.cells.stage(
            old["concentration"], old["classes"], tau, guess.fields["concentration"],
            guess.fields.get("theta"), guess.numbers["volume_loss"],
        )  # fmt: skip
        fields = {
            "concentration": solved.liquid, "classes": solved.classes, "theta": solved.theta,
        }  # fmt: skip
        return Stage(
            fields, {"volume_loss": solved.volume_loss}, {"released": solved.release_rate},
            solved.iterations,
        )  # fmt: skip

    def pace(self, state: State) -> float:
        """The fastest class's relative loss, 1/s."""
        cells = self.cells
        return cells.rate(0.0) * float(cells.bond_sum[cells.volume > 0].max(initial=0.0))

    def bounded(self, fields: Fields) -> Fields:
        """Concentrations from 0 to C_solid."""
        solid = self.scene.solid_concentration
        return {name: np.clip(values, 0.0, solid) for name, values in fields.items()}

    def admissible(self, old: State, stages: Sequence[Stage]) -> bool:
        """Whether no class gained or fell below zero and the liquid kept its bounds."""
        new, solid = stages[-1].fields, self.scene.solid_concentration
        rounding, metal = 1e-12 * solid, self.cells.volume > 0
        classes, liquid = new["classes"][metal], new["concentration"]
        rose = np.any(classes > old.fields["classes"][metal] + rounding)
        saturated = self.scene.saturation_concentration
        over = liquid.max() > saturated * (1 + 1e-9)
        return not (rose or over or classes.min(initial=0.0) < 0 or liquid.min() < -rounding)

    def change(self, attempt: Attempt) -> float:
        """Relative change of the metal's loss rate in a step, class by class."""
        cells, new = self.cells, attempt.stages[-1].fields["classes"]
        change = new - attempt.old.fields["classes"]
        progress = float(cells.volume @ np.abs(change))
        if progress <= 0.1 * cells.tolerance * cells.metal_scale:
            return 0.0
        off = float(cells.volume @ np.abs(change - attempt.expected["classes"])) / progress
        return max(attempt.share * off, _LATE * self._late(attempt.old.fields["classes"], new))

    def _late(self, before: np.ndarray, after: np.ndarray) -> float:
        """Share of the interface that a step should have opened before its end."""
        cells, limit = self.cells, self.scene.saturation_concentration
        going = (cells.volume > 0) & (after < limit) & (before > after)
        if not going.any():
            return 0.0
        last = np.maximum(after[going], 1e-12 * limit)
        share = np.zeros(after.size)
        share[going] = np.log(limit / last) / np.log(before[going] / last)
        opened = cells.near(cells.scatter(share.clip(0.0, 1.0) * cells.volume))
        staying = np.where(going, 0.0, cells.volume * after)
        whole = float(cells.volume @ (before * cells.bond_sum))
        return cells.strength * float(staying @ cells.gather(opened)) / whole if whole else 0.0
