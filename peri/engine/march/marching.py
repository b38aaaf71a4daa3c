"""The march of a problem through time: outputs, history, checkpoints, resumption, progress.

`march` knows no physics (a Problem has that) and no method (a Stepping has that).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from peri.engine.march import checkpoints
from peri.engine.march.problem import Course, Problem, State
from peri.engine.march.runge_kutta import RungeKutta
from peri.engine.march.stepping import TimeStepping

__all__ = ["Course", "March", "Stepping", "TimeStepping", "march"]

_P = TypeVar("_P", bound=Problem, contravariant=True)
_OWN_COLUMNS = ("time", "step", "iterations")
Output = dict[str, np.ndarray | float]


class Stepping(Protocol[_P]):
    """How a problem is stepped; its repr enters the checkpoint's mark, so it must be complete."""

    def choose_first_step(self, problem: _P, state: State, end: float) -> float:
        """The first step to try, s, of a march to `end`.  May refuse the problem."""

    def advance(self, problem: _P, course: Course, target: float) -> None:
        """Take one accepted step towards `target` (s) and no farther, in place."""


@dataclass
class March:
    """What `march` returns.

    times : (nt,), s.  outputs : per output time what the problem's `snapshot` gave (the root's
    arrays).  history : per step, by name: time, step, the problem's columns, iterations; step 0
    is the initial state.  state : the last one.  wall_time : s.
    """

    times: np.ndarray
    outputs: list[Output]
    history: dict[str, np.ndarray]
    state: State
    wall_time: float


@dataclass
class _Record:
    """History and outputs so far."""

    columns: tuple[str, ...]
    history: dict[str, list[float]] = field(init=False)
    outputs: list[Output] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.history = {name: [] for name in self.columns}

    def add(self, problem: Problem, course: Course, step: float) -> None:
        row = (course.state.time, step, *problem.row(course.state), course.iterations)
        for name, value in zip(self.columns, row, strict=True):
            self.history[name].append(value)


def march(
    problem: _P,
    times: Sequence[float],
    stepping: TimeStepping | Stepping[_P],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    progress: Callable[[float, str], None] | None = None,
) -> March:
    """March a problem to the times asked for.

    Parameters
    ----------
    problem : Problem
    times : sequence of float
        Output times, s, ascending, >= 0; all come from this one march.
    stepping : TimeStepping or Stepping
        The former for a FirstOrder problem; else motion.VelocityVerlet, motion.Relaxation or a
        physics's own.
    checkpoint : path, optional
        File that holds the march's state every `checkpoint_every` seconds of wall time.
    resume : bool
        Continue from the checkpoint if there is one; it must belong to the same march.  The
        resumed march is the same to the last bit (tests/peri/engine/march/test_march.py).
    progress : callable(fraction, text)

    Raises
    ------
    ValueError
        For bad times, or as the problem and its stepping do.
    checkpoints.CheckpointError
        A ValueError, for a checkpoint of another march or one that cannot be read.
    """
    processes, moments = problem.processes, check_times(times)
    method: Any = RungeKutta(stepping) if isinstance(stepping, TimeStepping) else stepping
    started = clock.perf_counter()
    state = problem.initial()
    end = float(moments[-1])
    course = Course(state, state, 0.0, method.choose_first_step(problem, state, end))
    record = _Record(("time", "step", *problem.columns, "iterations"))
    mark = ""
    if checkpoint is not None:
        checkpoint = Path(checkpoint)
        mark = checkpoints.fingerprint(problem.key(), list(moments), repr(method))
    if resume and checkpoint is not None and processes.from_root(checkpoint.exists()):
        course = _restore(problem, checkpoint, mark, record)
    else:
        record.add(problem, course, 0.0)
    saved = clock.perf_counter()
    while True:
        while len(record.outputs) < moments.size and (
            moments[len(record.outputs)] <= course.state.time * (1 + 1e-12)
        ):
            record.outputs.append(problem.snapshot(course.state))
        processes.on_root(lambda: _report(progress, problem, course.state, end))
        if len(record.outputs) == moments.size:
            break
        problem.begin(course.state)
        method.advance(problem, course, float(moments[len(record.outputs)]))
        record.add(problem, course, course.previous_step)
        due = checkpoint is not None and clock.perf_counter() - saved > checkpoint_every
        if processes.from_root(due):
            assert checkpoint is not None
            _save(problem, course, checkpoint, mark, record)
            saved = clock.perf_counter()
    history = {name: np.array(values) for name, values in record.history.items()}
    return March(moments, record.outputs, history, course.state, clock.perf_counter() - started)


def check_times(times: Sequence[float]) -> np.ndarray:
    """Output times as an array; raises ValueError where they do not ascend from >= 0."""
    moments = np.asarray(list(times), float)
    if moments.size == 0 or not np.all(np.isfinite(moments)) or moments[0] < 0:
        raise ValueError(f"times: {moments.tolist()} s; give at least one, finite and not negative")
    if np.any(np.diff(moments) <= 0):
        raise ValueError(f"times: {moments.tolist()} s; they must ascend without repetition")
    return moments


def _report(
    progress: Callable[[float, str], None] | None, problem: Problem, state: State, end: float
) -> None:
    if progress is not None:
        progress(state.time / end if end > 0 else 1.0, problem.describe(state))


# --- checkpoints ------------------------------------------------------------------------------


def _save(problem: Problem, course: Course, path: Path, mark: str, record: _Record) -> None:
    arrays: dict[str, np.ndarray] = {
        "steps": np.array([course.previous_step, course.step]),
        "history": np.array([record.history[name] for name in record.columns], float),
    }
    for name, state in (("state", course.state), ("previous", course.previous)):
        arrays[f"{name}/time"] = np.array(state.time)
        for key, number in state.numbers.items():
            arrays[f"{name}/numbers/{key}"] = np.array(number)
        for key, values in state.fields.items():
            arrays[f"{name}/fields/{key}"] = problem.pack(key, values)
    for n, output in enumerate(record.outputs):
        for key, value in output.items():
            arrays[f"output{n:06d}/{key}"] = np.asarray(value)
    problem.processes.on_root(lambda: checkpoints.write_checkpoint(path, mark, arrays))


def _restore(problem: Problem, path: Path, mark: str, record: _Record) -> Course:
    processes = problem.processes
    arrays: dict[str, np.ndarray] = {}
    processes.on_root(lambda: arrays.update(checkpoints.read_checkpoint(path, mark)))
    names: list[str] = processes.from_root(sorted(arrays))
    # Fields and outputs stay on the root, which deals the former out; everything else is small.
    small = {
        n: values
        for n, values in arrays.items()
        if "/fields/" not in n and (n[:6] != "output" or values.ndim == 0)
    }
    small = processes.from_root(small)

    def state_of(name: str) -> State:
        numbers, fields = f"{name}/numbers/", f"{name}/fields/"
        return State(
            float(small[f"{name}/time"]),
            problem.unpack_fields(
                {n.removeprefix(fields): arrays.get(n) for n in names if n.startswith(fields)}
            ),
            {n.removeprefix(numbers): float(small[n]) for n in names if n.startswith(numbers)},
        )

    previous_step, step = (float(v) for v in small["steps"])
    course = Course(state_of("state"), state_of("previous"), previous_step, step)
    problem.restore(course.state)
    for name, values in zip(record.columns, small["history"], strict=True):
        record.history[name] = list(values)
    outputs: dict[str, dict[str, Any]] = {}
    for n in names:
        if n.startswith("output"):
            moment, key = n.split("/", 1)
            value = arrays.get(n, small.get(n, np.empty(0)))
            outputs.setdefault(moment, {})[key] = value if value.ndim else float(value)
    record.outputs.extend(outputs.values())
    return course
