"""How long the currents of a couple are kept: the steps of its march."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from peri.coupled.galvanic_march import GalvanicProblem
from peri.engine.march.problem import Course, State
from peri.engine.march.stepping import step_towards, time_after


@dataclass(frozen=True)
class Renewal:
    """Steps with the patches' currents of their beginning; the potential is renewed after each.

    travel : how far the fastest patch may recede in a step, in spacings, 0 to 1.
    longest : of a step, s, beside that.  change : bound of the currents' change, relative to their
    sum, up to which the potential is kept after a step (GalvanicProblem.change_bound); 0 renews it
    after every one, as ions in the liquid do whatever it is.  conductivity : by how much of itself
    the liquid's may change in a step, where ions change it.
    """

    travel: float = 0.1
    longest: float = float("inf")
    change: float = 0.0
    conductivity: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.travel <= 1:
            raise ValueError(f"travel: {self.travel}; it must be above 0 and at most 1 spacing")
        if not 0 <= self.change < 1:
            raise ValueError(f"change: {self.change}; it must be from 0 to below 1")
        if not self.longest > 0:
            raise ValueError(f"longest: {self.longest} s; it must be positive")
        if not 0 < self.conductivity <= 1:
            raise ValueError(f"conductivity: {self.conductivity}; it must be above 0 and at most 1")

    def choose_first_step(self, problem: GalvanicProblem, state: State, end: float) -> float:
        """The first step, s."""
        step = self._step(problem, state, end)
        change = problem.first_conductivity_change(state, step)
        return step * min(1.0, self.conductivity / max(change, 1e-300))

    def _step(self, problem: GalvanicProblem, state: State, end: float) -> float:
        speed = float(problem.rates(state)[2].max(initial=0.0))
        spacing = min(problem.scene.lattice.spacing)
        step = min(self.longest, self.travel * spacing / speed if speed > 0 else np.inf)
        return step if np.isfinite(step) else max(end, 1e-300)

    def advance(self, problem: GalvanicProblem, course: Course, target: float) -> None:
        """Take one step towards `target` (s), in place."""
        state = course.state
        longest = self._step(problem, state, target)
        if problem.scene.ions is not None:
            change, before = (
                problem.conductivity_change(course),
                course.previous_step or course.step,
            )
            if course.previous_step:
                before *= min(2.0, self.conductivity / max(change, 1e-300))
            longest = min(longest, before)
        course.step = longest
        step = step_towards(state.time, target, course.step)
        time, trend = time_after(state.time, step, target), problem.trend(course, step)
        keeps = self.change if problem.scene.ions is None else 0.0
        new, iterations = problem.moved(state, step, time, trend, keeps)
        course.move(new, step, iterations)
