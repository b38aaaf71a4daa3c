"""The corrosion march: from a scene to concentrations at the times asked for."""

from __future__ import annotations

import logging
import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from peri.corrosion.bimaterial import BiMaterial, BoundsError, Stage
from peri.corrosion.interface import late_exposure
from peri.corrosion.scene import CorrosionScene
from peri.engine import checkpoints
from peri.engine.marching import GAMMA, TimeStepping, next_step, step_towards
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.solvers import ConvergenceError

log = logging.getLogger(__name__)

_LATE = 4.0
"""Weight of what a step exposes too late (or, under Faraday's law, at an estimated time)."""
_JUMP = 0.7
"""A change that a shorter step leaves at this share is a jump, which no step resolves."""


HISTORY = (
    "time",
    "step",
    "volume_loss",
    "metal_amount",
    "liquid_amount",
    "released_amount",
    "balance_error",
    "saturated_nodes",
    "dissolved_nodes",
    "iterations",
)


@dataclass
class CorrosionResult:
    """Output of `corrode`.

    times : (nt,), s.  concentration : (nt, *lattice.shape), mol/m^3.  volume_loss : (nt,).
    metal : (nt, *lattice.shape) bool, nodes that are still metal.
    history : per step, arrays named as in HISTORY; amounts in mol, balance_error relative to the
    initial metal, step 0 is the initial state.  wall_time : s.
    """

    scene: CorrosionScene
    times: np.ndarray
    concentration: np.ndarray
    metal: np.ndarray
    volume_loss: np.ndarray
    history: dict[str, np.ndarray]
    wall_time: float


@dataclass
class _State:
    """Everything the march carries from step to step (and a checkpoint stores)."""

    time: float
    concentration: np.ndarray
    previous: np.ndarray
    previous_step: float
    step: float
    theta: np.ndarray | None
    volume_loss: float
    released: float = 0.0
    history: dict[str, list] = field(default_factory=lambda: {name: [] for name in HISTORY})


def corrode(
    scene: CorrosionScene,
    times: Sequence[float],
    stepping: TimeStepping | None = None,
    *,
    solver_tolerance: float = 1e-9,
    progress: Callable[[float, str], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    processes: OneProcess = ONE_PROCESS,
) -> CorrosionResult:
    """March a corrosion scene to the times asked for.

    Conserved: metal + free liquid + released amount, to the linear solver's tolerance relative
    to the initial metal (history["balance_error"]; tests/peri/corrosion/test_run.py).

    Parameters
    ----------
    scene : CorrosionScene
    times : sequence of float
        Output times, s, ascending, >= 0; all come from this one march.
    stepping : TimeStepping
    solver_tolerance : float
        Relative residual of the linear solutions.
    progress : callable(fraction, text)
    checkpoint : path, optional
        File that holds the march's state every `checkpoint_every` seconds of wall time.
    resume : bool
        Continue from the checkpoint if there is one; it must belong to the same march.
    processes : OneProcess or its like
        Who holds which block of the lattice (ranks.corrode gives it); progress, files
        and the result's fields are the root's.

    Raises
    ------
    ValueError
        For bad times, an explicit step above its limit (which changes as nodes turn liquid;
        without `step` the march follows it), or liquid without saturation that a Faradaic flux
        fills beyond the metal's concentration.
    checkpoints.CheckpointError
        A ValueError, for a checkpoint of another march or one that cannot be read.
    """
    stepping = stepping or TimeStepping()
    times = _check_times(times)
    started = clock.perf_counter()
    problem = BiMaterial(scene, solver_tolerance, processes)
    if problem.scene.saturation == "as_published" and stepping.scheme == "sdirk2":
        raise ValueError(
            "scheme: 'sdirk2' with saturation 'as_published'; its switch lasts for a step, so "
            "use backward_euler with a fixed step"
        )
    if problem.faradaic and stepping.scheme == "forward_euler":
        raise ValueError(
            "scheme: 'forward_euler' with dissolution 'faradaic'; use backward_euler or sdirk2, "
            "which know when a node is empty"
        )
    mark = processes.on_root(
        lambda: checkpoints.fingerprint(scene, times, stepping, solver_tolerance)
    )
    if stepping.scheme == "forward_euler":
        _explicit_step(problem, stepping)
    outputs: list[tuple[np.ndarray, np.ndarray, float]] = []
    if resume and checkpoint is not None and processes.from_root(Path(checkpoint).exists()):
        state = _restore(problem, Path(checkpoint), mark, outputs)
    else:
        state = _initial(problem, stepping, times)
        _record(problem, state, 0.0, None, 0)
    saved = clock.perf_counter()
    end = times[-1]
    while True:
        while len(outputs) < times.size and times[len(outputs)] <= state.time * (1 + 1e-12):
            outputs.append(
                (
                    processes.gather(problem.sum.crop(state.concentration)),
                    processes.gather(problem.sum.crop(problem.metal)),
                    state.volume_loss,
                )
            )
        processes.on_root(lambda: _report(progress, state, end))
        if len(outputs) == times.size:
            break
        _advance(problem, state, stepping, times[len(outputs)])
        due = checkpoint is not None and clock.perf_counter() - saved > checkpoint_every
        if processes.from_root(due):
            _save(problem, state, Path(checkpoint), mark, outputs)
            saved = clock.perf_counter()
    return CorrosionResult(
        scene,
        times,
        np.array([c for c, _, _ in outputs]),
        np.array([m for _, m, _ in outputs]),
        np.array([v for _, _, v in outputs]),
        {name: np.array(values) for name, values in state.history.items()},
        clock.perf_counter() - started,
    )


def _report(progress, state: _State, end: float) -> None:
    if progress is not None:
        progress(
            state.time / end if end > 0 else 1.0,
            f"day {state.time / 86400:.1f}, volume loss {100 * state.volume_loss:.2f} %",
        )


def _check_times(times) -> np.ndarray:
    times = np.asarray(list(times), float)
    if times.size == 0 or not np.all(np.isfinite(times)) or times[0] < 0:
        raise ValueError(f"times: {times.tolist()} s; give at least one, finite and not negative")
    if np.any(np.diff(times) <= 0):
        raise ValueError(f"times: {times.tolist()} s; they must ascend without repetition")
    return times


def _explicit_step(problem: BiMaterial, stepping: TimeStepping, now: float = 0.0) -> float:
    """The explicit step for the present phases, s: the one given, which must be stable, or a limit.

    The limit is that of stability and, for accuracy where all liquid is held and only the metal
    limits the step, rate_change over the fastest metal rate.
    """
    limit = 1.0 / max(problem.fastest_rate(), 1e-300)
    if stepping.step is None:
        return min(limit, stepping.rate_change / max(problem.fastest_rates()[1], 1e-300))
    if stepping.step > limit:
        raise ValueError(
            f"step: {stepping.step} s exceeds the explicit stability limit of {limit:.4g} s "
            f"at {now:.4g} s; shorten it, leave it out, or use an implicit scheme"
        )
    return stepping.step


def _initial(problem: BiMaterial, stepping: TimeStepping, times) -> _State:
    concentration = problem.initial_concentration.copy()
    if stepping.scheme == "forward_euler":
        step = _explicit_step(problem, stepping)
    elif stepping.step is not None:
        step = stepping.step
    elif stepping.first_step is not None:
        step = stepping.first_step
    else:
        rate = problem.processes.largest(float(problem.metal_rates().max(initial=0.0)))
        rate *= problem.scene.kinetics.factor(0.0)
        step = min(0.01 * times[-1], 0.1 * stepping.rate_change / max(rate, 1e-300))
    return _State(0.0, concentration, concentration.copy(), 0.0, max(step, 1e-300), None, 0.0)


# --- steps ------------------------------------------------------------------------------------


def _advance(problem: BiMaterial, state: _State, stepping: TimeStepping, target: float) -> None:
    """One accepted step, in place."""
    problem.forget()  # so that a step depends on the state alone, and a resumed march is the same
    rejected = math.inf
    if stepping.scheme == "forward_euler":  # its limit changes when nodes turn liquid
        state.step = _explicit_step(problem, stepping, state.time)
    while True:
        step = step_towards(state.time, target, state.step)
        try:
            new, stages, change = _try_step(problem, state, stepping.scheme, step)
        except ConvergenceError as error:
            if step < 1e-9 * target:
                raise
            log.info("step of %.3g s rejected: %s", step, error)
            state.step = 0.25 * step
            continue
        if stepping.step is None and stepping.scheme != "forward_euler":
            jump = change > _JUMP * rejected
            if change > 2.5 * stepping.rate_change and step > 1e-9 * target and not jump:
                state.step, rejected = next_step(step, change, stepping.rate_change), change
                continue
            proposal = step if jump else next_step(step, change, stepping.rate_change)
            # A step shortened to hit an output time says nothing against the longer one.
            state.step = max(proposal, state.step if step < state.step else 0.0)
            state.step = min(state.step, 2.0 * max(step, 0.5 * state.step))
        elif stepping.step is not None:
            state.step = stepping.step
        break
    last = stages[-1]
    solid = problem.scene.solid_concentration
    if problem.faradaic and problem.processes.any(new.max() > solid * (1 + 1e-12)):
        raise ValueError(
            "saturation: 'none' with dissolution 'faradaic'; the liquid fills beyond the metal's "
            f"concentration at {state.time + step:.4g} s, use 'complementarity'"
        )
    state.previous, state.previous_step = state.concentration, step
    state.concentration, state.theta = new, last.theta
    state.time = target if abs(state.time + step - target) < 1e-9 * step else state.time + step
    if stepping.scheme == "sdirk2" and len(stages) == 2:
        rate = (1 - GAMMA) * stages[0].release_rate + GAMMA * stages[1].release_rate
    else:
        rate = last.release_rate
    state.released += step * rate
    dissolved = problem.dissolve(new, last.emptied)
    state.volume_loss = problem.volume_loss(new)
    _record(problem, state, step, stages, dissolved)


def _try_step(problem: BiMaterial, state: _State, scheme: str, step: float):
    """New concentration, its stages, and the relative change of the loss rate in the step."""
    old = state.concentration
    if scheme == "forward_euler":
        new, release, theta = problem.explicit_step(old, step, state.volume_loss)
        return new, [Stage(new, theta, state.volume_loss, release, 0, 1)], 0.0
    growth = (step / state.previous_step) if state.previous_step else 0.0
    slope = old - state.previous
    if scheme == "backward_euler":
        guess = _guess(problem, old, slope, growth)
        share = 1.0 / (1.0 + 1.0 / growth) if growth else 1.0
        return _first_order(problem, state, step, guess, growth * slope, share)
    guess = _guess(problem, old, slope, GAMMA * growth)
    first = problem.implicit_stage(old, GAMMA * step, guess, state.theta, state.volume_loss)
    rate = (first.concentration - old) / GAMMA
    right = old + (1.0 - GAMMA) * rate
    if problem.faradaic and problem.processes.any(right.min() < 0 or first.emptied.any()):
        return _first_order(problem, state, step, guess, rate)
    guess = _guess(problem, old, rate, 1.0)
    try:
        second = problem.implicit_stage(right, GAMMA * step, guess, first.theta, first.volume_loss)
        new = second.concentration
        if problem.faradaic and problem.processes.any(second.emptied.any()):
            pass
        elif problem.faradaic and not _out_of_bounds(problem, old, new):
            change = _faradaic_change(problem, state, step, second)
            return new, [first, second], change
        elif not _out_of_bounds(problem, old, new):
            change = _relative_change(problem, new - old, rate)
            return new, [first, second], max(change, _late_change(problem, old, new))
    except (BoundsError, ConvergenceError) as error:
        # A right side above C_sat may have no solution at all, which a round of the active set
        # cannot tell from slow progress; a first-order step always has one.
        log.debug("first-order step of %.3g s: %s", step, error)
    # The second-order method is not positive for steps that empty or fill a node; this one is.
    return _first_order(problem, state, step, guess, rate)


def _first_order(problem: BiMaterial, state: _State, step: float, guess, expected, share=1.0):
    """A backward Euler step; see _try_step.

    expected : change of the concentrations that a constant rate would bring.  share : of the
    difference from it that counts as a change of the rate.
    """
    old = state.concentration
    stage = problem.implicit_stage(old, step, guess, state.theta, state.volume_loss)
    if problem.faradaic:
        change = _faradaic_change(problem, state, step, stage)
    else:
        change = share * _relative_change(problem, stage.concentration - old, expected)
        change = max(change, _late_change(problem, old, stage.concentration))
    return stage.concentration, [stage], change


def _guess(problem: BiMaterial, old, slope, factor):
    """Extrapolated liquid concentrations within their bounds."""
    return np.clip(old + factor * slope, 0.0, problem.scene.solid_concentration)


def _relative_change(problem: BiMaterial, change, expected) -> float:
    """Difference of the metal's change from the expected one, node by node, over their loss."""
    metal = problem.metal
    volume, total = problem.capacity[metal], problem.processes.total
    progress = total(float((volume * np.abs(change[metal])).sum()))
    # What the solver's tolerance moves says nothing about the rate.
    if progress <= 0.1 * problem.tolerance * problem.metal_scale:
        return 0.0
    return total(float((volume * np.abs(change - expected)[metal]).sum())) / progress


def _late_change(problem: BiMaterial, old, new) -> float:
    """What nodes that turn liquid within a step expose too late, as a change of the rate."""
    return _LATE * late_exposure(problem, old, new) if problem.box is not None else 0.0


def _faradaic_change(problem: BiMaterial, state: _State, step: float, stage: Stage) -> float:
    """The same under Faraday's law, in sum: a moving front hands its rate from node to node."""
    past = state.history["volume_loss"]
    lost = stage.volume_loss - state.volume_loss
    change = 0.0
    if len(past) > 1 and lost > 0.1 * problem.tolerance:
        expected = step / state.previous_step * (past[-1] - past[-2])
        change = abs(lost - expected) / lost
    return max(change, _LATE * stage.late)


def _out_of_bounds(problem: BiMaterial, old, new) -> bool:
    rounding = 1e-12 * problem.scene.solid_concentration
    metal = problem.metal
    out = np.any(new[metal] > old[metal] + rounding) or new.min() < -rounding
    if problem.scene.saturation == "complementarity":
        # The stages watch the liquid within reach of the metal; beyond it only this does.
        liquid = new[problem.free].max(initial=0.0)
        out |= liquid > problem.scene.saturation_concentration * (1 + 1e-9)
    return problem.processes.any(out)


def _record(problem, state: _State, step, stages, dissolved) -> None:
    metal, liquid = problem.amounts(state.concentration)
    history = state.history
    initial = metal if not history["time"] else history["metal_amount"][0]
    error = (metal + liquid + state.released - initial) / initial if initial else 0.0
    saturated = 0
    if state.theta is not None:
        held = (state.theta < 1.0) & (problem.box_free_volume > 0)
        saturated = problem.processes.total(int(held.sum()))
    row = (
        state.time,
        step,
        state.volume_loss,
        metal,
        liquid,
        state.released,
        error,
        saturated,
        dissolved,
        sum(s.iterations for s in stages) if stages else 0,
    )
    for name, value in zip(HISTORY, row, strict=True):
        history[name].append(value)


# --- checkpoints ------------------------------------------------------------------------------


def _save(problem, state: _State, path: Path, fingerprint: str, outputs) -> None:
    gather, crop = problem.processes.gather, problem.sum.crop
    arrays = {
        "concentration": gather(crop(state.concentration)),
        "previous": gather(crop(state.previous)),
        "metal": gather(crop(problem.metal)),
        "history": np.array([state.history[name] for name in HISTORY], float),
        "scalars": np.array(
            [state.time, state.previous_step, state.step, state.volume_loss, state.released]
        ),
    }
    if state.theta is not None:
        arrays["theta"] = gather(crop(problem.put(state.theta)))
    for n, (concentration, metal, loss) in enumerate(outputs):
        arrays[f"output{n}/concentration"] = concentration
        arrays[f"output{n}/metal"] = metal
        arrays[f"output{n}/volume_loss"] = np.array(loss)
    problem.processes.on_root(lambda: checkpoints.write_checkpoint(path, fingerprint, arrays))


def _restore(problem, path: Path, fingerprint: str, outputs) -> _State:
    processes, arrays = problem.processes, {}
    processes.on_root(lambda: arrays.update(checkpoints.read_checkpoint(path, fingerprint)))

    def field_of(name: str) -> np.ndarray:
        return problem.sum.pad(processes.scatter(arrays.get(name)))

    numbers = {name: arrays.get(name) for name in ("scalars", "history")}
    losses = [arrays[f"output{n}/volume_loss"] for n in range(_count_outputs(arrays))]
    numbers, losses, limited = processes.from_root((numbers, losses, "theta" in arrays))
    now, previous_step, step, loss, released = numbers["scalars"]
    problem.metal = field_of("metal") > 0
    problem.update_phase()
    state = _State(
        now,
        field_of("concentration"),
        field_of("previous"),
        previous_step,
        step,
        problem.take(field_of("theta")) if limited else None,
        loss,
        released,
    )
    for name, values in zip(HISTORY, numbers["history"], strict=True):
        state.history[name] = list(values)
    for n, loss in enumerate(losses):
        fields = (arrays.get(f"output{n}/{name}") for name in ("concentration", "metal"))
        outputs.append((*fields, float(loss)))
    return state


def _count_outputs(arrays) -> int:
    return sum(name.endswith("/volume_loss") for name in arrays)
