"""The problem of rate classes as the engine marches it: states, measures of a step, history."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from peri.corrosion.classes.cells import Cells
from peri.corrosion.classes.laws import CLASS_BONDS
from peri.corrosion.classes.whole import WholeClasses
from peri.corrosion.nodes.problem import COLUMNS
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Attempt, Fields, FirstOrder, Stage, State, moment
from peri.engine.march.stepping import GAMMA
from peri.engine.processes import ONE_PROCESS, OneProcess

_LATE = 1.0
"""Weight of the flux that is handed to others in a step, as a change of the rates: a front that
travels by 1/100 of a horizon hands 9 % over, and errs by 0.1 % of its loss."""


_STILL = 1e-3
"""A cell with less than this share of its metal shows as liquid."""


_OF_THE_LATTICE = ("concentration", "theta")
"""Fields by node; the others are by class."""


class CellProblem(FirstOrder):
    """A corrosion scene with rate classes, discretised and ready to be marched.

    Fields of its states: `concentration` (padded, of the liquid, mol/m^3), `classes` (of the
    metal), `volume` (what is metal of the classes, relative), `ahead` (the same some way
    on, which the rates are for), `life` (of the classes, columns.py) and
    `theta` (padded); `exposed` (of the classes, s: when one first saw liquid, infinite before)
    where the kinetics needs an age.

    Parameters
    ----------
    scene : CorrosionScene
        With an exposure; on the root, elsewhere None.
    solver_tolerance : float
    processes : OneProcess or its like
    """

    columns = COLUMNS
    evolved = ("concentration", "classes", "life")

    def __init__(
        self,
        scene: CorrosionScene | None,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self.processes, self._whole_scene = processes, scene
        self.cells = Cells(scene, solver_tolerance, processes)
        self.scene = self.cells.scene
        metal = None if scene is None else scene.exposure.metal
        self._whole = WholeClasses(metal, self.cells.columns, processes)

    def coat(self, share: float) -> None:
        """See Cells.coat."""
        self.cells.coat(share)

    def key(self) -> str:
        """Hash of the scene and the solver's tolerance."""
        return self.processes.on_root(
            lambda: fingerprint("classes", self._whole_scene, self.cells.tolerance)
        )

    # --- states ---------------------------------------------------------------------------

    def initial(self) -> State:
        """Solid metal in clean liquid."""
        cells = self.cells
        liquid = np.zeros(cells.sum.padded_shape)
        classes = np.full(cells.cell.size, self.scene.solid_concentration)
        metal, _ = cells.amounts(liquid, classes)
        numbers = {"volume_loss": 0.0, "released": 0.0, "initial": metal, "dissolved": 0.0}
        fields = {
            "concentration": liquid, "classes": classes, "volume": cells.volume,
            "ahead": cells.ahead, "life": np.ones(classes.size),
        }  # fmt: skip
        if "age" in self.scene.needs:
            fields["exposed"] = np.where(cells.bond_sum > 0, 0.0, np.inf)
        return State(0.0, fields, numbers)

    def restore(self, state: State) -> None:
        """Take from a state which classes are metal."""
        volume, ahead = state.fields["volume"], state.fields["ahead"]
        same = np.array_equal(volume, self.cells.volume) and ahead is self.cells.ahead
        if self.processes.any(not same):
            self.cells.set_volumes(volume, ahead)

    def begin(self, state: State) -> None:
        """Drop the preconditioner, so that a resumed march is the same."""
        self.cells.forget()

    def pack(self, name: str, values: np.ndarray) -> np.ndarray:
        """The whole lattice's or solid's field on the root."""
        if name in _OF_THE_LATTICE:
            return self.processes.gather(self.cells.sum.crop(values))
        return self._whole.gather(values)

    def unpack(self, name: str, stored: np.ndarray | None) -> np.ndarray:
        """This process's part of a stored field."""
        if name in _OF_THE_LATTICE:
            return self.cells.sum.pad(self.processes.scatter(stored))
        return self._whole.scatter(stored)

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """What is gone of the classes turns liquid."""
        liquid, solid = state.fields["concentration"], self.scene.solid_concentration
        full = liquid.max() > solid * (1 + 1e-12)
        if self.scene.saturation == "none" and self.processes.any(full):
            raise ValueError(
                "saturation: 'none' with dissolution 'faradaic'; the liquid fills beyond the "
                f"metal's concentration at {state.time:.4g} s, use 'complementarity'"
            )
        changed = ("concentration", "classes", "life")
        fields = {name: state.fields[name].copy() for name in changed}
        state.numbers["dissolved"] = self.cells.dissolve(
            *fields.values(), CLASS_BONDS[self.scene.dissolution.name].ahead
        )
        state.fields.update(fields, volume=self.cells.volume, ahead=self.cells.ahead)
        if "exposed" in state.fields:
            since = state.fields["exposed"]
            new = np.isinf(since) & (self.cells.bond_sum > 0)
            state.fields["exposed"] = np.where(new, state.time, since)
        state.numbers["volume_loss"] = self.cells.volume_loss(fields["classes"])

    def row(self, state: State) -> tuple[float, ...]:
        """Amounts and their balance, cells held at C_sat, classes dissolved."""
        numbers, theta = state.numbers, state.fields.get("theta")
        metal, liquid = self.cells.amounts(state.fields["concentration"], state.fields["classes"])
        initial = numbers["initial"]
        error = (metal + liquid + numbers["released"] - initial) / initial if initial else 0.0
        held = 0
        if theta is not None:
            held = int(self.processes.total(int(((theta < 1.0) & self.cells.free).sum())))
        released, dissolved = numbers["released"], numbers["dissolved"]
        return (
            numbers["volume_loss"], metal, liquid, released, error, held, dissolved,
        )  # fmt: skip

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """Concentrations by node, which cells still are metal, and the volume loss.

        A cell that held metal at the start shows that metal's mean, what is gone counting as
        nothing; another cell its liquid's concentration.
        """
        cells = self.cells
        held = cells.scatter(cells.initial_volume)
        left = cells.scatter(cells.volume * state.fields["classes"])
        mean = np.divide(left, held, out=state.fields["concentration"].copy(), where=held > 0)
        metal = cells.sum.crop(cells.scatter(cells.volume)) > _STILL * cells.sum.crop(held)
        return {
            "concentration": self.processes.gather(cells.sum.crop(mean)),
            "metal": self.processes.gather(metal),
            "volume_loss": state.numbers["volume_loss"],
        }

    def describe(self, state: State) -> str:
        """Time and volume loss."""
        lost = 100 * state.numbers["volume_loss"]
        return f"{moment(state.time)}, volume loss {lost:.2f} %"

    # --- stages ---------------------------------------------------------------------------

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """See Cells.stage."""
        if "exposed" in guess.fields:
            self.cells.age = np.maximum(0.0, guess.time - guess.fields["exposed"])
        solved = self.cells.stage(
            old["concentration"], old["classes"], tau, guess.fields["concentration"],
            guess.fields.get("theta"), guess.numbers["volume_loss"], old.get("owed"),
        )  # fmt: skip
        fields = {
            "concentration": solved.liquid, "classes": solved.classes, "theta": solved.theta,
            "life": old["life"] + tau * solved.ageing,
        }  # fmt: skip
        return Stage(
            fields, {"volume_loss": solved.volume_loss}, {"released": solved.release_rate},
            solved.iterations,
        )  # fmt: skip

    def continues(self, first: Stage, right: Fields) -> bool:
        """Whether a second-order step may go on to its last stage.

        Not where a class is empty that gives what it should until then.  Where it gives in
        proportion, a right side below zero (lambda g step > 2.41) is put where the class ends as
        e^(-lambda g step) of what it was; `owed` has what that adds, mol/m^3.
        """
        short = right["classes"] < 0
        if not CLASS_BONDS[self.scene.dissolution.name].by_class:
            return not self.processes.any(short.any())
        if self.processes.any(short.any()):
            after, ratio = first.fields["classes"][short], (1.0 - GAMMA) / GAMMA
            before = (ratio * after - right["classes"][short]) / (ratio - 1.0)
            inverse = np.divide(before, after, out=np.full_like(after, np.inf), where=after > 0)
            decay = np.minimum((inverse - 1.0) / GAMMA, 700.0)
            classes = right["classes"].copy()
            classes[short] = before * np.exp(-decay) * (1.0 + GAMMA * decay)
            right.update(classes=classes, owed=classes - right["classes"])
        return True

    def pace(self, state: State) -> float:
        """The fastest class's relative loss, 1/s."""
        cells = self.cells
        rate, local = cells.interface_rate(0.0)
        fastest = float((local * cells.bond_sum)[cells.volume > 0].max(initial=0.0))
        return rate * self.processes.largest(fastest)

    def bounded(self, fields: Fields) -> Fields:
        """Concentrations from 0 to C_solid."""
        solid = self.scene.solid_concentration
        concentrations = ("concentration", "classes")
        return {**fields, **{name: np.clip(fields[name], 0.0, solid) for name in concentrations}}

    def admissible(self, old: State, stages: Sequence[Stage]) -> bool:
        """Whether no class gained or fell below zero and the liquid kept its bounds."""
        new, solid = stages[-1].fields, self.scene.solid_concentration
        highest = solid if self.scene.saturation == "none" else self.scene.saturation_concentration
        rounding, metal = 1e-12 * solid, self.cells.volume > 0
        classes, liquid = new["classes"][metal], new["concentration"]
        rose = np.any(classes > old.fields["classes"][metal] + rounding)
        over = liquid.max() > highest * (1 + 1e-9)
        under = classes.min(initial=0.0) < 0 or liquid.min() < -rounding
        return not self.processes.any(rose or over or under)

    def change(self, attempt: Attempt) -> float:
        """Relative change of the metal's loss rate in a step, class by class."""
        cells, total = self.cells, self.processes.total
        new = attempt.stages[-1].fields["classes"]
        change = new - attempt.old.fields["classes"]
        progress = total(float(cells.volume @ np.abs(change)))
        least = max(0.1 * cells.tolerance * cells.metal_scale, self._round_off(attempt))
        if progress <= least:
            return 0.0
        away = cells.volume * (change - attempt.expected["classes"])
        by_class = CLASS_BONDS[self.scene.dissolution.name].by_class
        off = abs(total(float((np.abs(away) if by_class else away).sum()))) / progress
        if not by_class and len(attempt.stages) == 1:
            off = min(off, self._off_the_last(attempt) / progress)
        return max(attempt.share * off, _LATE * self.outrun(attempt.stages))

    def _round_off(self, attempt: Attempt) -> float:
        """Amount (over a cell's volume) that round-off moves between cells held at C_sat.

        Liquid at C_sat is known to its last digit, which flows off D_liq w step times in a step.
        """
        new = attempt.stages[-1].fields
        held = (new["theta"] < 1.0) & self.cells.free
        flow = self.cells.free_share * self.cells.neighbour_share * new["concentration"]
        moved = self.processes.total(float(flow[held].sum()))
        return np.finfo(float).eps * attempt.step * self.scene.liquid_diffusivity * moved

    def _off_the_last(self, attempt: Attempt) -> float:
        """How far the metal's loss is off that of the step before, as a first-order step errs.

        The rate at a step's start is no measure where a flux fills what has just turned liquid:
        it does so at once, as much in each step as the one before left, however short steps are.
        """
        old, previous, before = attempt.old, attempt.previous, attempt.previous_step
        if not before > 0:
            return np.inf

        def metal(volume: np.ndarray, classes: np.ndarray) -> float:
            return self.processes.total(float(volume @ classes))

        volume, classes = self.cells.volume, old.fields["classes"]
        lost = metal(volume, classes - attempt.stages[-1].fields["classes"])
        last = metal(previous.fields["volume"], previous.fields["classes"])
        growth = attempt.step / before
        off = abs(lost - growth * (last - metal(volume, classes)))
        return off * growth / (1.0 + growth)

    def outrun(self, stages: Sequence[Stage]) -> float:
        """Share of the interface's flux that a step takes from what goes with it.

        What cells draw is not counted: those next to them carry it from then on.
        """
        cells, last, total = self.cells, stages[-1].fields, self.processes.total
        whole = total(float(cells.volume @ cells.bond_sum))
        lost = cells.volume - cells.left(last["classes"], last["life"])
        return total(float(lost @ cells.own)) / whole if whole > 0 else 0.0
