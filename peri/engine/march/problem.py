"""What a physics tells the march: its state, its stages, and how they are judged.

A problem owns the discrete equations; the march owns time, outputs, files and resumption
(engine.march.marching), and a stepping owns the steps (engine.march.stepping,
engine.march.motion).  A physics is one class: `FirstOrder` for y' = F(y), with algebraic fields
where it has some, `SecondOrder` for u'' = a(u), or plain `Problem` with a stepping of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from peri.engine.processes import ONE_PROCESS, OneProcess

Fields = dict[str, np.ndarray]
"""Arrays by name; a field may live on nodes, on cells and rate classes, or on bonds."""


class BoundsError(ArithmeticError):
    """A stage cannot respect the bounds of its fields (its right side lies outside them)."""


@dataclass
class State:
    """What a problem is at one time: everything that its next step depends on.

    time : s.  fields, numbers : by name, as the problem defines them; a checkpoint stores both.
    """

    time: float
    fields: Fields
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass
class Stage:
    """Solution of one stage Y = old + tau F(Y), or of one explicit step.

    fields, numbers : what the stage found; they replace those of the state, and start the next
    stage.  rates : by the name of a number that adds up over the steps (an amount released), how
    fast it grows, 1/s.  iterations : of the linear solver.  extra : what the problem's own hooks
    want to know of the stage.
    """

    fields: Fields
    numbers: dict[str, float] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    extra: object = None


@dataclass
class Attempt:
    """A step that has been solved and waits to be judged.

    old, previous : states at its start and before the step that led there (`previous_step` s
    long, 0 at the first step).  step : s.  stages : of the method, in order.  expected : the
    change of the evolved fields that a constant rate would bring.  share : of the difference
    from it that counts as a change of the rate.
    """

    old: State
    previous: State
    previous_step: float
    step: float
    stages: Sequence[Stage]
    expected: Fields
    share: float = 1.0


@dataclass
class Course:
    """Where a march is: the state, the one before it, and the steps between and ahead, s.

    iterations : of the linear solver, in the last step.
    """

    state: State
    previous: State
    previous_step: float
    step: float
    iterations: int = 0

    def move(self, state: State, step: float, iterations: int) -> None:
        """Go on to the next state."""
        self.previous, self.previous_step = self.state, step
        self.state, self.iterations = state, iterations


def moment(time: float) -> str:
    """A time (s) for the progress bar: seconds, hours or days."""
    if time < 3600.0:
        return f"{time:.3g} s"
    return f"hour {time / 3600:.1f}" if time < 2 * 86400.0 else f"day {time / 86400:.1f}"


class Problem(ABC):
    """A physics to be marched; see `march`.

    processes : who holds which block of the lattice.
    columns : name and unit of each number that `row` gives ("1" where it has none).
    """

    processes: OneProcess = ONE_PROCESS
    columns: Mapping[str, str] = {}

    def key(self) -> str:
        """Hash of everything that determines the problem (checkpoints.fingerprint)."""
        raise NotImplementedError(f"{type(self).__name__} has no key, which checkpoints need")

    @abstractmethod
    def initial(self) -> State:
        """The state at time 0."""

    def restore(self, state: State) -> None:
        """Bring whatever the problem derives from its state in line with a state read back."""
        return None

    def begin(self, state: State) -> None:
        """Forget what earlier steps left behind, so that a step depends on the state alone."""
        return None

    def accept(self, state: State, stages: Sequence[Stage], step: float) -> None:
        """Take an accepted step of `step` s: phases, broken bonds, numbers, in `state`.

        `state` is the new one.  May raise ValueError where the physics ends.
        """
        return None

    def row(self, state: State) -> tuple[float, ...]:
        """One number per column."""
        return ()

    def snapshot(self, state: State) -> dict[str, np.ndarray | float]:
        """What an output time keeps; whole arrays on the root, copies."""
        return {name: self.pack(name, values).copy() for name, values in state.fields.items()}

    def pack(self, name: str, values: np.ndarray) -> np.ndarray:
        """A field as a checkpoint stores it: the whole one, on the root."""
        if not self.processes.whole:
            raise ValueError(f"{type(self).__name__} cannot be shared out among processes")
        return values

    def unpack(self, name: str, stored: np.ndarray | None) -> np.ndarray:
        """This process's part of a stored field (None except on the root)."""
        assert stored is not None
        return stored

    def unpack_fields(self, stored: Mapping[str, np.ndarray | None]) -> Fields:
        """The fields of one stored state (None except on the root), each by `unpack`."""
        return {name: self.unpack(name, values) for name, values in stored.items()}

    def describe(self, state: State) -> str:
        """A few words for the progress bar."""
        return moment(state.time)


class FirstOrder(Problem):
    """y' = F(y): implicit stages, explicit steps, and the measures that control them.

    evolved : names of the fields that have a rate; the state's other fields and numbers are
    starting values for the next stage.
    """

    evolved: tuple[str, ...] = ()

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """Solve Y = old + tau F(Y).

        Parameters
        ----------
        old : fields
            Right side, evolved fields only.
        tau : float
            s.
        guess : State
            Starting values of all fields and numbers, at the time that the stage is for.

        Raises
        ------
        ConvergenceError, BoundsError
            Where a shorter step will do.
        """
        raise NotImplementedError(f"{type(self).__name__} has no implicit stage")

    def explicit(self, old: State, step: float) -> Stage:
        """One forward Euler step."""
        raise NotImplementedError(f"{type(self).__name__} has no explicit step")

    def limits(self, state: State) -> tuple[float, float]:
        """The longest stable explicit step, s, and the fastest rate that accuracy heeds, 1/s."""
        raise NotImplementedError(f"{type(self).__name__} has no explicit step")

    def pace(self, state: State) -> float:
        """The fastest relative rate of change, 1/s, for the first controlled step."""
        return 0.0

    def bounded(self, fields: Fields) -> Fields:
        """Extrapolated evolved fields, moved within their bounds."""
        return fields

    def foreseen(self, now: Fields, before: Fields, factor: float) -> Fields:
        """Better starting values than the present ones for fields that do not evolve.

        now, before : the present state's fields and those before the last step;  factor : how far
        ahead the values are for, in last steps
        """
        return {}

    def continues(self, first: Stage, right: Fields) -> bool:
        """Whether a second-order step may go on from its first stage to this right side."""
        return True

    def admissible(self, old: State, stages: Sequence[Stage]) -> bool:
        """Whether a second-order step is within bounds; else a first-order one is taken."""
        return True

    def outrun(self, stages: Sequence[Stage]) -> float:
        """Share of the rates that goes with what a step takes away; shortens fixed steps, too."""
        return 0.0

    def change(self, attempt: Attempt) -> float:
        """Relative change of the rates within a step: the quantity that the control holds.

        By default the difference of the evolved fields' change from the expected one over the
        change itself, in the sum of magnitudes, the largest over the fields.
        """
        total, worst = self.processes.total, 0.0
        for name in self.evolved:
            change = attempt.stages[-1].fields[name] - attempt.old.fields[name]
            moved = total(float(np.abs(change).sum()))
            if moved > 0:
                off = total(float(np.abs(change - attempt.expected[name]).sum()))
                worst = max(worst, attempt.share * off / moved)
        return worst


class SecondOrder(Problem):
    """u'' = a(u, t): waves, mechanics; stepped by engine.march.motion.

    motions : the field of velocities of each field of displacements, by name.
    """

    motions: Mapping[str, str] = {}

    @abstractmethod
    def acceleration(self, state: State) -> Fields:
        """a by displacement field, for the state's displacements, time and (mid-step) velocities.

        Zero where a displacement is held.
        """

    @abstractmethod
    def limit(self, state: State) -> float:
        """The longest stable step of velocity Verlet, s: 2 over the highest frequency."""

    def inner(self, a: np.ndarray, b: np.ndarray) -> float:
        """Inner product of two fields over all processes."""
        return self.processes.total(float(np.vdot(a, b)))
