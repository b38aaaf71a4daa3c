"""The corrosion march: from a scene to concentrations at the times asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from peri.corrosion.classes.problem import CellProblem
from peri.corrosion.nodes.problem import COLUMNS, CorrosionProblem, MetalAlone
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import March, TimeStepping, check_times, march
from peri.engine.processes import ONE_PROCESS, OneProcess

HISTORY = ("time", "step", *COLUMNS, "iterations")


@dataclass
class CorrosionResult:
    """Output of `corrode`.

    times : (nt,), s.  concentration : (nt, *lattice.shape), mol/m^3.  volume_loss : (nt,).
    metal : (nt, *lattice.shape) bool, nodes that are still metal.
    history : per step, arrays named as in HISTORY; amounts in mol, balance_error relative to the
    initial metal, step 0 is the initial state.  wall_time : s.  theta : (nt, *lattice.shape),
    saturation factors of the last stage before each time: below 1 under a salt layer, 0 on what was
    metal then and out of its reach; None where no stage has them.
    """

    scene: CorrosionScene
    times: np.ndarray
    concentration: np.ndarray
    metal: np.ndarray
    volume_loss: np.ndarray
    history: dict[str, np.ndarray]
    wall_time: float
    theta: np.ndarray | None = None


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
    alone: bool = False,
) -> CorrosionResult:
    """March a corrosion scene to the times asked for (engine.march.marching.march).

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
    alone : bool
        March the metal alone, in liquid that stays clean (nodes.problem.MetalAlone).

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
    problem = _problem(scene, stepping, solver_tolerance, processes, alone)
    done = _march_coated(
        problem,
        check_times(times),
        stepping,
        checkpoint=checkpoint,
        resume=resume,
        checkpoint_every=checkpoint_every,
        progress=progress,
    )
    concentration, metal, loss = (
        np.array([output[name] for output in done.outputs])
        for name in ("concentration", "metal", "volume_loss")
    )
    layers = [output.get("theta", np.zeros_like(concentration[0])) for output in done.outputs]
    theta = np.array(layers) if any("theta" in output for output in done.outputs) else None
    return CorrosionResult(
        scene, done.times, concentration, metal, loss, done.history, done.wall_time, theta
    )


def file_under_coating(checkpoint: Path) -> Path:
    """Where a march under a coating is kept, beside the checkpoint of what follows."""
    return checkpoint.with_name(f"coated-{checkpoint.name}")


def _march_coated(
    problem: CorrosionProblem | CellProblem,
    moments: np.ndarray,
    stepping: TimeStepping,
    *,
    checkpoint: Path | None,
    progress: Callable[[float, str], None] | None,
    **options: Any,
) -> March:
    """March; under a coating first to its end, then on from there as a march of its own.

    The rate jumps where the coating ends, which no step may straddle and no control of steps
    foresees.
    """
    coating, end = problem.scene.coating, float(moments[-1])
    if coating is None:
        return march(
            problem, moments, stepping, checkpoint=checkpoint, progress=progress, **options
        )
    problem.coat(coating.factor)
    last = min(end, coating.lifetime)
    under = moments[moments < last]

    def so_far(share: float, text: str) -> None:
        if progress is not None:
            progress(share * last / end if end > 0 else 1.0, text)

    first_file = None if checkpoint is None else file_under_coating(checkpoint)
    first = march(
        problem, [*under, last], stepping, checkpoint=first_file, progress=so_far, **options
    )
    problem.coat(1.0)
    if end <= coating.lifetime:
        return first
    problem.initial = lambda: first.state  # type: ignore[method-assign]
    rest = march(
        problem, moments[under.size :], stepping, checkpoint=checkpoint, progress=progress,
        **options,
    )  # fmt: skip
    return March(
        moments,
        [*first.outputs[: under.size], *rest.outputs],
        {n: np.concatenate([v, rest.history[n][1:]]) for n, v in first.history.items()},
        rest.state,
        first.wall_time + rest.wall_time,
    )


def _problem(
    scene: CorrosionScene | None,
    stepping: TimeStepping,
    solver_tolerance: float,
    processes: OneProcess,
    alone: bool = False,
) -> CorrosionProblem | CellProblem:
    """The discrete problem of a scene: by nodes, or by rate classes where it has them."""
    classes = processes.from_root(processes.on_root(lambda: scene.exposure is not None))
    if not classes:
        kind = MetalAlone if alone else CorrosionProblem
        problem = kind(scene, solver_tolerance, processes)
        _check_scheme(problem, stepping)
        return problem
    if alone:
        raise ValueError("alone: metal with rate classes has its liquid marched with it")
    if stepping.scheme == "forward_euler":
        raise ValueError("scheme: 'forward_euler' with rate classes; use backward_euler or sdirk2")
    return CellProblem(scene, solver_tolerance, processes)


def _check_scheme(problem: CorrosionProblem, stepping: TimeStepping) -> None:
    if problem.scene.saturation == "as_published" and stepping.scheme == "sdirk2":
        raise ValueError(
            "scheme: 'sdirk2' with saturation 'as_published'; its switch lasts for a step, so "
            "use backward_euler with a fixed step"
        )
    if problem.scene.saturation == "as_published" and stepping.controlled:
        raise ValueError(
            "step: controlled, with saturation 'as_published'; its switch turns on and off from "
            "step to step however short they are, so give one"
        )
    if problem.scene.pores and stepping.scheme != "backward_euler":
        raise ValueError(
            f"scheme: {stepping.scheme!r} with pores; use backward_euler, as what a cell stores "
            "grows within a step"
        )
    law = problem.scene.dissolution
    if stepping.scheme not in law.schemes:
        raise ValueError(
            f"scheme: {stepping.scheme!r} with dissolution {law.name!r}; allowed: "
            f"{', '.join(law.schemes)} ({law.only})"
        )
