"""Steps of u'' = a(u): velocity Verlet for waves, dynamic relaxation for quasi-static states."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from peri.engine.march.problem import Course, Fields, SecondOrder, Stage, State
from peri.engine.march.stepping import step_towards, time_after
from peri.engine.solvers import ConvergenceError


@dataclass(frozen=True)
class VelocityVerlet:
    """Explicit, second order, symplectic (Swope et al. 1982).

    v' = v + dt/2 a(u),  u' = u + dt v',  v'' = v' + dt/2 a(u').  The problem accepts the new
    displacements (and may break bonds) before the second half of the kick, so that forces act on
    what is left.

    Parameters
    ----------
    step : float, optional
        s; above the stability limit it is refused.  Default: `safety` of the limit.
    safety : float
        Share of the stability limit, 0..1.
    """

    step: float | None = None
    safety: float = 0.8

    def __post_init__(self) -> None:
        if self.step is not None and not (math.isfinite(self.step) and self.step > 0):
            raise ValueError(f"step: {self.step} s; it must be finite and positive")
        if not 0 < self.safety < 1:
            raise ValueError(f"safety: {self.safety}; it must be between 0 and 1")

    def choose_first_step(self, problem: SecondOrder, state: State, end: float) -> float:
        """The step, s; ValueError above the limit."""
        limit = problem.limit(state)
        if self.step is None:
            return self.safety * limit
        if self.step > limit:
            raise ValueError(
                f"step: {self.step} s exceeds the stability limit of {limit:.4g} s at "
                f"{state.time:.4g} s; shorten it or leave it out"
            )
        return self.step

    def advance(self, problem: SecondOrder, course: Course, target: float) -> None:
        """Take one step towards `target` (s), in place."""
        state = course.state
        course.step = self.choose_first_step(problem, state, target)
        step = step_towards(state.time, target, course.step)
        fields = dict(state.fields)
        _kick(problem, fields, problem.acceleration(state), 0.5 * step)
        for name, velocity in problem.motions.items():
            fields[name] = fields[name] + step * fields[velocity]
        time = time_after(state.time, step, target)
        new = State(time, fields, dict(state.numbers))
        problem.accept(new, [Stage(fields)], step)
        _kick(problem, new.fields, problem.acceleration(new), 0.5 * step)
        course.move(new, step, 1)


@dataclass(frozen=True)
class Relaxation:
    """Quasi-static states by adaptive dynamic relaxation (after Kilic and Madenci 2010).

    Each step sets the time (so the load), then damps a fictitious motion of unit mass,
    v' = ((2 - c dt) v + 2 dt a) / (2 + c dt), u' = u + dt v', until |a| is at most `tolerance`
    times the largest |a| at the start of a load step so far.  The damping c = 2 omega is
    critical for the Rayleigh quotient of the motion, omega^2 = v.K v / v.v with
    K v = -(a - a_before) / dt; the paper takes a diagonal estimate of K and u in the place of v.

    Parameters
    ----------
    step : float
        Load step, s.
    tolerance : float
        Relative residual.
    maximum_iterations : int
        ConvergenceError beyond.
    """

    step: float
    tolerance: float = 1e-6
    maximum_iterations: int = 20_000

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step) and self.step > 0):
            raise ValueError(f"step: {self.step} s; it must be finite and positive")
        if not 0 < self.tolerance < 1:
            raise ValueError(f"tolerance: {self.tolerance}; it must be between 0 and 1")

    def choose_first_step(self, problem: SecondOrder, state: State, end: float) -> float:
        """The load step, s."""
        return self.step

    def advance(self, problem: SecondOrder, course: Course, target: float) -> None:
        """Relax at the next load towards `target` (s), in place.

        What the problem accepts (broken bonds) may leave forces out of balance; then the same
        load is relaxed again, until `accept` leaves the state in balance.
        """
        state = course.state
        step = step_towards(state.time, target, self.step)
        new = replace(state, time=time_after(state.time, step, target))
        new = replace(new, fields=dict(new.fields), numbers=dict(new.numbers))
        scale, iterations = state.numbers.get("load", 0.0), 0
        while True:
            scale = max(scale, _norm(problem, problem.acceleration(new)))
            iterations += self._relax(problem, new, scale, self.maximum_iterations - iterations)
            problem.accept(new, [Stage(new.fields)], step)
            if _norm(problem, problem.acceleration(new)) <= self.tolerance * scale:
                break
        new.numbers["load"] = scale
        course.move(new, step, iterations)

    def _relax(self, problem: SecondOrder, state: State, scale: float, most: int) -> int:
        """Bring the forces below tolerance * scale; the iterations it took."""
        dt = 0.9 * problem.limit(state)
        velocity: Fields | None = None
        before: Fields = {}
        for iteration in range(most):
            a = problem.acceleration(state)
            residual = _norm(problem, a)
            if residual <= self.tolerance * scale:
                for name, v in problem.motions.items():
                    state.fields[v] = 0.0 * state.fields[name]
                return iteration
            if velocity is None:
                velocity = {name: 0.5 * dt * a[name] for name in a}
            else:
                c = 2.0 * self._lowest_frequency(problem, a, before, velocity, dt)
                velocity = {
                    name: ((2.0 - c * dt) * velocity[name] + 2.0 * dt * a[name]) / (2.0 + c * dt)
                    for name in a
                }
            for name in a:
                state.fields[name] = state.fields[name] + dt * velocity[name]
            before = a
        raise ConvergenceError(
            f"relaxation: residual {residual / scale:.3g} of the load after "
            f"{self.maximum_iterations} iterations at {state.time:.4g} s, "
            f"{self.tolerance:.3g} wanted"
        )

    def _lowest_frequency(
        self, problem: SecondOrder, a: Fields, before: Fields, velocity: Fields, dt: float
    ) -> float:
        """Rayleigh estimate of the frequency of what still moves, 1/s."""
        stiff = sum(-problem.inner(velocity[n], a[n] - before[n]) / dt for n in a)
        moved = sum(problem.inner(velocity[n], velocity[n]) for n in a)
        if not (moved > 0 and stiff > 0):
            return 0.0
        return min(math.sqrt(stiff / moved), 1.0 / dt)


def _kick(problem: SecondOrder, fields: Fields, acceleration: Fields, time: float) -> None:
    for name, velocity in problem.motions.items():
        fields[velocity] = fields[velocity] + time * acceleration[name]


def _norm(problem: SecondOrder, fields: Fields) -> float:
    return math.sqrt(sum(problem.inner(values, values) for values in fields.values()))
