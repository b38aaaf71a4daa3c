"""Steps of y' = F(y): explicit and implicit Euler, an L-stable SDIRK method, and their control."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from peri.engine.march.problem import Attempt, BoundsError, Course, Fields, FirstOrder, Stage, State
from peri.engine.march.stepping import GAMMA, TimeStepping, next_step, step_towards, time_after
from peri.engine.solvers import ConvergenceError

log = logging.getLogger(__name__)

_JUMP = 0.7
"""A change that a shorter step leaves at this share is a jump, which no step resolves."""
_SHORTEST = 1e-9
"""Steps below this share of the time asked for are not shortened any more."""
_OUTRUN = 0.1
"""Target of fixed steps: the share of the rates that may go with what a step takes away.  A lower
one costs steps and errs less (peri/MEASURED.md, surfaces that move)."""


@dataclass(frozen=True)
class RungeKutta:
    """The schemes of a TimeStepping at work."""

    stepping: TimeStepping

    def choose_first_step(self, problem: FirstOrder, state: State, end: float) -> float:
        """The first step of a march to `end`, s; ValueError for an explicit one above its limit."""
        stepping = self.stepping
        if stepping.scheme == "forward_euler":
            step = _explicit_step(problem, state, stepping)
        elif stepping.step is not None:
            step = stepping.step
        elif stepping.first_step is not None:
            step = stepping.first_step
        else:
            step = min(0.01 * end, 0.1 * stepping.rate_change / max(problem.pace(state), 1e-300))
        return max(step, 1e-300)

    def advance(self, problem: FirstOrder, course: Course, target: float) -> None:
        """Take one accepted step towards `target` (s), in place."""
        stepping = self.stepping
        rejected = math.inf
        if stepping.scheme == "forward_euler":  # its limit changes with the state
            course.step = _explicit_step(problem, course.state, stepping)
        while True:
            step = step_towards(course.state.time, target, course.step)
            try:
                stages, change = _try_step(problem, course, stepping.scheme, step)
            except (BoundsError, ConvergenceError) as error:
                if step < _SHORTEST * target:
                    raise
                log.info("step of %.3g s rejected: %s", step, error)
                course.step = 0.25 * step
                continue
            wanted = stepping.rate_change
            if not stepping.controlled:
                change, wanted = problem.outrun(stages), _OUTRUN
            jump = change > _JUMP * rejected
            proposal = next_step(step, change, wanted)
            if change > 2.5 * wanted and step > _SHORTEST * target and not jump:
                course.step, rejected = proposal, change
                continue
            # A step shortened to hit an output time says nothing against the longer one.
            kept = course.step if step < course.step else 0.0
            course.step = max(step if jump else proposal, kept)
            if stepping.step is not None:
                course.step = min(stepping.step, course.step)
            break
        new = _reached(problem, course.state, stages, step, target)
        problem.accept(new, stages, step)
        course.move(new, step, sum(stage.iterations for stage in stages))


def _explicit_step(problem: FirstOrder, state: State, stepping: TimeStepping) -> float:
    """The explicit step for the present state, s: the one given, which must be stable, or a limit.

    The limit is that of stability and, for accuracy, rate_change over the fastest rate.
    """
    limit, fastest = problem.limits(state)
    if stepping.step is None:
        return min(limit, stepping.rate_change / max(fastest, 1e-300))
    if stepping.step > limit:
        raise ValueError(
            f"step: {stepping.step} s exceeds the explicit stability limit of {limit:.4g} s "
            f"at {state.time:.4g} s; shorten it, leave it out, or use an implicit scheme"
        )
    return stepping.step


def _reached(
    problem: FirstOrder, old: State, stages: list[Stage], step: float, target: float
) -> State:
    """The state that a step's stages lead to."""
    last = stages[-1]
    numbers = {**old.numbers, **last.numbers}
    for name, rate in last.rates.items():
        if len(stages) == 2:
            rate = (1 - GAMMA) * stages[0].rates[name] + GAMMA * rate
        numbers[name] = old.numbers.get(name, 0.0) + step * rate
    return State(time_after(old.time, step, target), {**old.fields, **last.fields}, numbers)


def _try_step(
    problem: FirstOrder, course: Course, scheme: str, step: float
) -> tuple[list[Stage], float]:
    """The stages of a step, and the relative change of the rates in it."""
    state, names = course.state, problem.evolved
    if scheme == "forward_euler":
        return [problem.explicit(state, step)], 0.0
    old, previous = {name: state.fields[name] for name in names}, course.previous.fields
    growth = (step / course.previous_step) if course.previous_step else 0.0

    def trend(factor: float) -> Fields:
        return {name: factor * (old[name] - previous[name]) for name in names}

    def foreseen(factor: float) -> Fields:
        fields = _extrapolated(problem, old, trend(factor))
        return fields | problem.foreseen(state.fields, previous, factor)

    if scheme == "backward_euler":
        guess = foreseen(growth)
        share = 1.0 / (1.0 + 1.0 / growth) if growth else 1.0
        # The trend is worked out when it is needed: a large problem has no room for it before.
        return _first_order(problem, course, step, guess, lambda: trend(growth), share)
    guess = foreseen(GAMMA * growth)
    middle = state.time + GAMMA * step
    first = problem.stage(old, GAMMA * step, _start(state, guess, middle))
    rate = {name: (first.fields[name] - old[name]) / GAMMA for name in names}
    right = {name: old[name] + (1.0 - GAMMA) * rate[name] for name in names}
    if not problem.continues(first, right):
        return _first_order(problem, course, step, guess, lambda: rate)
    guess = _extrapolated(problem, old, rate)
    try:
        passed = State(middle, {**state.fields, **first.fields}, {**state.numbers, **first.numbers})
        start = _start(passed, guess, state.time + step)
        stages = [first, problem.stage(right, GAMMA * step, start)]
        if problem.admissible(state, stages):
            return stages, problem.change(_attempt(course, step, stages, rate))
    except (BoundsError, ConvergenceError) as error:
        # A right side outside the bounds may have no solution at all, which the iterations of a
        # stage cannot tell from slow progress; a first-order step always has one.
        log.debug("first-order step of %.3g s: %s", step, error)
    # The second-order method is not positive for steps that empty or fill a node; this one is.
    return _first_order(problem, course, step, guess, lambda: rate)


def _first_order(
    problem: FirstOrder,
    course: Course,
    step: float,
    guess: Fields,
    expected: Callable[[], Fields],
    share: float = 1.0,
) -> tuple[list[Stage], float]:
    """A backward Euler step; share, and what `expected` gives, as in Attempt."""
    state = course.state
    old = {name: state.fields[name] for name in problem.evolved}
    stages = [problem.stage(old, step, _start(state, guess, state.time + step))]
    return stages, problem.change(_attempt(course, step, stages, expected(), share))


def _attempt(
    course: Course, step: float, stages: list[Stage], expected: Fields, share: float = 1.0
) -> Attempt:
    return Attempt(
        course.state, course.previous, course.previous_step, step, stages, expected, share
    )


def _extrapolated(problem: FirstOrder, old: Fields, change: Fields) -> Fields:
    """Evolved fields, extrapolated and moved within their bounds."""
    return problem.bounded({name: old[name] + change[name] for name in old})


def _start(state: State, guess: Fields, time: float) -> State:
    """Starting values of a stage: the guess of the evolved fields, the state's others."""
    return replace(state, time=time, fields={**state.fields, **guess})
