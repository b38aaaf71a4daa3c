"""How a fit is searched, and how far a surrogate can be trusted: losses, evaluations, errors.

Mg-5Gd with Table 5.1 on the reference screw at 100 um, in clean liquid, where an evaluation takes a
millisecond and the truth is known.  Volume losses at 1, 2, 3, 4 and 8 weeks are synthetic.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.distance import pdist
from scipy.stats import qmc

from pipeline.calibration.models import SEARCHED, Implant, ReducedModel, constants
from pipeline.calibration.surrogate import Box, Surrogate, design
from pipeline.record.run_folder import write_text
from pipeline.scene.resolve import resolve_scene
from pipeline.studies.optimisers import cma_es, swarm
from pipeline.studies.workshop import AS_PRINTED

Array = NDArray[np.float64]

ALLOY = "Mg-5Gd"
WEEKS = np.array([1, 2, 3, 4, 8]) * 604800.0
NAMES = ("interface_diffusivity", "volume_loss_scale")
SCATTER = 0.01
SEEDS = (0, 1)
PARTICLES, ITERATIONS = 20, 150
CMA_EVALUATIONS = 1000
COUNTS = (10, 30, 100, 300, 1000, 3000)
"""Evaluations at which the best loss so far is printed."""

NEAR = 1.01
"""Over the least loss: where a search counts as having arrived."""

KRIGING_BOX = Box(NAMES, (1e-17, 0.05), (1e-12, 1.0))
POINTS = (10, 20, 30, 40, 60)
CHECKS = 400
"""Points, even in the logarithms, at which a surrogate is compared with the model itself."""


@dataclass(frozen=True)
class Search:
    """One search: best loss after each evaluation (n,), and its processor time (s)."""

    method: str
    box: str
    seed: int
    losses: Array
    seconds: float

    def arrived(self, least: float) -> int | None:
        """The evaluation from which on the best loss is within `NEAR` of the least one."""
        near = np.flatnonzero(self.losses <= NEAR * least)
        return int(near[0]) + 1 if near.size else None


@dataclass(frozen=True)
class Kriging:
    """Errors of a surrogate of V_L after 56 days: leave-one-out mean (5.36) and worst, and the
    worst against the model."""

    inputs: str
    points: int
    mean: float
    worst: float
    true_worst: float


class Problem:
    """The loss (5.15) of synthetic data, every evaluation counted."""

    def __init__(self) -> None:
        scene = resolve_scene([ALLOY], ["8w"], **AS_PRINTED)
        self.model = ReducedModel(scene, ALLOY, Implant(scene), NAMES)
        values = constants(scene, ALLOY)
        self.truth = np.log([values[name] for name in NAMES])
        scatter = SCATTER * np.random.default_rng(1).standard_normal(len(WEEKS))
        self.measured = self.model(WEEKS, self.truth)[0] + scatter
        solid = scene.alloy(ALLOY).corrosion.solid_concentration
        bounds = np.array([SEARCHED[name].bounds(solid) for name in NAMES])
        self.lower, self.upper = bounds.T
        self.best: list[float] = []

    def residuals(self, logs: Array) -> Array:
        """Predicted less measured; counts as an evaluation."""
        found = self.model(WEEKS, logs)[0] - self.measured
        loss = float(found @ found)
        self.best.append(min(loss, self.best[-1] if self.best else np.inf))
        return found

    def logarithmic(self, place: Array) -> float:
        """Loss at a place of the unit cube that stands for the logarithms of the ranges."""
        low, high = np.log(self.lower), np.log(self.upper)
        found = self.residuals(low + place * (high - low))
        return float(found @ found)

    def linear(self, place: Array) -> float:
        """The same with the ranges as they are printed, l up to 1/eps, and even in the values."""
        upper = np.array([self.upper[0], 1.0 / np.finfo(float).eps])
        found = self.residuals(np.log(self.lower + place * (upper - self.lower)))
        return float(found @ found)

    def gradient(self, seed: int) -> None:
        """Least squares with the exact derivatives from a random place of the ranges."""
        low, high = np.log(self.lower), np.log(self.upper)
        start = low + np.random.default_rng(seed).random(len(low)) * (high - low)
        for _ in range(20):  # where all or nothing is dissolved there is no slope to follow
            loss, slopes = self.model(WEEKS, start)
            if np.abs(slopes).max() > 1e-2 * np.abs(loss - self.measured).max():
                break
            start = 0.5 * (start + np.log(np.sqrt([3e-15 * 3e-14, 0.1 * 1.0])))
        least_squares(
            self.residuals, start, jac=lambda logs: self.model(WEEKS, logs)[1], bounds=(low, high),
            ftol=1e-14, xtol=1e-12, gtol=1e-14,
        )  # fmt: skip


def searches(problem: Problem, say: Callable[[str], None] = print) -> list[Search]:
    """Every method with every seed."""
    methods: list[tuple[str, str, Callable[[int], object]]] = [
        ("gradient", "logarithmic", problem.gradient),
        ("CMA-ES", "logarithmic", lambda s: cma_es(problem.logarithmic, 2, CMA_EVALUATIONS, s)),
        ("swarm", "logarithmic", lambda s: swarm(problem.logarithmic, 2, PARTICLES, ITERATIONS, s)),
        ("swarm", "linear", lambda s: swarm(problem.linear, 2, PARTICLES, ITERATIONS, s)),
    ]
    found = []
    for method, box, work in methods:
        for seed in SEEDS:
            problem.best = []
            begun = time.process_time()
            work(seed)
            seconds = time.process_time() - begun
            found.append(Search(method, box, seed, np.array(problem.best), seconds))
            say(f"{method}, {box} box, seed {seed}: {len(problem.best)} evaluations")
    return found


def krigings(problem: Problem, points: tuple[int, ...] = POINTS) -> list[Kriging]:
    """Surrogates of V_L after 56 days, on designs even in the values or in the logarithms."""
    box = KRIGING_BOX

    def evaluate(at: Array) -> Array:
        return np.array([problem.model(WEEKS[-1:], np.log(row))[0][0] for row in at])

    checks = design(box, CHECKS, seed=99)
    truth = evaluate(checks)
    found = []
    for inputs in ("raw", "logarithmic"):
        for count in points:
            at = design(box, count) if inputs == "logarithmic" else _even(box, count)
            surrogate = Surrogate(box, at, evaluate(at), logarithms=inputs == "logarithmic")
            errors = surrogate.leave_one_out()
            off = np.abs(surrogate(checks)[0] - truth)
            found.append(Kriging(inputs, count, errors.mean, errors.worst, float(off.max())))
    return found


def _even(box: Box, count: int) -> Array:
    """A maximin hypercube even in the values themselves."""
    random = np.random.default_rng(0)
    cubes = [qmc.LatinHypercube(len(box.names), seed=random).random(count) for _ in range(200)]
    low, high = np.asarray(box.lower), np.asarray(box.upper)
    return low + max(cubes, key=lambda cube: pdist(cube).min()) * (high - low)


def search_lines(found: list[Search]) -> list[str]:
    """The searches as a table: best loss after some evaluations, when they arrive, seconds."""
    least = min(float(search.losses[-1]) for search in found)
    heads = [f"{count}" for count in COUNTS]
    lines = [
        f"Best loss (5.15) after so many evaluations; arrived: within {100 * (NEAR - 1):.0f} % of "
        f"the least, {least:.4e}.",
        "",
        f"| search | box | seed | {' | '.join(heads)} | evaluations | arrived | seconds |",
        "| --- | --- | ---: |" + " ---: |" * (len(COUNTS) + 3),
    ]
    for search in found:
        cells = [f"{search.losses[min(c, len(search.losses)) - 1]:.3g}" for c in COUNTS]
        arrived = search.arrived(least)
        lines.append(
            f"| {search.method} | {search.box} | {search.seed} | {' | '.join(cells)} | "
            f"{len(search.losses)} | {'not' if arrived is None else arrived} | "
            f"{search.seconds:.2f} |"
        )
    return lines


def kriging_lines(found: list[Kriging]) -> list[str]:
    """The surrogates as a table."""
    lines = [
        "Kriging of V_L after 56 days over D_int from 1e-17 to 1e-12 m^2/s and l from 0.05 to 1.",
        "Mean (5.36) and worst of leaving one point out, and the worst error against the model at "
        f"{CHECKS} other points, of V_L.",
        "",
        "| inputs | points | mean | worst | worst against the model |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    return lines + [
        f"| {k.inputs} | {k.points} | {k.mean:.2g} | {k.worst:.2g} | {k.true_worst:.2g} |"
        for k in found
    ]


def study_calibration(out: Path | None, say: Callable[[str], None] = print) -> None:
    """Do the study, print its tables, and write calibration.csv and .png where `out` is given."""
    problem = Problem()
    found = searches(problem, say)
    surrogates = krigings(problem)
    for line in ("", *search_lines(found), "", *kriging_lines(surrogates)):
        say(line)
    if out is None:
        return
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["method", "box", "seed", "evaluations", "best_loss", "processor_seconds"])
    for search in found:
        count = len(search.losses)
        shown = sorted({*np.unique(np.geomspace(1, count, 40).astype(int)), count})
        for n in shown:
            seconds = f"{search.seconds * n / count:.4g}"
            row = [search.method, search.box, search.seed, n, f"{search.losses[n - 1]:.6g}"]
            writer.writerow([*row, seconds])
    for path, text in (
        (out / "calibration.csv", buffer.getvalue()),
        (
            out / "calibration.txt",
            "\n".join([*search_lines(found), "", *kriging_lines(surrogates)]),
        ),
    ):
        write_text(path, text if text.endswith("\n") else text + "\n")
        say(str(path))
    say(str(_plot(found, out / "calibration.png")))


def _plot(found: list[Search], path: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    colours = {"gradient": "#009e73", "CMA-ES": "#b3558d", "swarm": "#0072b2"}
    for search in found:
        label = f"{search.method}, {search.box}" if search.seed == SEEDS[0] else None
        style = "--" if search.box == "linear" else "-"
        counts = np.arange(1, len(search.losses) + 1)
        axes.loglog(counts, search.losses, style, color=colours[search.method], label=label)
    axes.set_xlabel("Evaluations")
    axes.set_ylabel("Best loss so far (sum of squares)")
    axes.legend(frameon=False)
    axes.grid(color="#dddddd", lw=0.6)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path
