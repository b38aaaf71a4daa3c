"""Bands where the liquid counts: Kriging through a few marches and tests instead of all samples.

Volume loss and strength left at each time are functions of the constants that the data determine;
a surrogate of each is learned in the box of the samples, at points that are added where any of
them is least sure.  Its worst error of leaving one point out is reported, and above 0.03 refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.models import with_constants
from pipeline.calibration.surrogate import WORST_ALLOWED, Box, Surrogate, design
from pipeline.campaigns.banded import Banded, Samples, Strength
from pipeline.campaigns.doubts import CANDIDATES
from pipeline.campaigns.strength import take_over
from pipeline.geometry.surface import Solid
from pipeline.life_cycle import StagedRun
from pipeline.record.doubts import Source
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene, SceneError
from pipeline.scene.units import ImmersionTime
from pipeline.stages.pulls import Crew

Array = NDArray[np.float64]

FOLDER = "surrogate"
FIRST = 8
"""Points that a surrogate begins with."""

_CHECKS = 500
"""Points of the box at which the doubt is looked for."""


class Learned:
    """Values (n, q) of a march and its tests at points (n, np), and a surrogate of each value."""

    def __init__(self, box: Box, evaluate: Callable[[Array], Array]):
        self.box, self.evaluate = box, evaluate
        self.points = design(box, FIRST)
        self.values = np.array([evaluate(point) for point in self.points])
        self._fit()

    def _fit(self) -> None:
        self.surrogates = [Surrogate(self.box, self.points, v) for v in self.values.T]
        self.worst = np.array([s.leave_one_out().worst for s in self.surrogates])

    def learn(self, most: int, wanted: float) -> None:
        """Add points where the doubt is largest until the worst error is `wanted`, or `most`."""
        while self.worst.max() > wanted and len(self.points) < most:
            candidates = design(self.box, _CHECKS, len(self.points))
            doubt = np.max([s(candidates)[1] for s in self.surrogates], axis=0)
            point = candidates[int(np.argmax(doubt))]
            self.points = np.concatenate([self.points, point[None, :]])
            self.values = np.concatenate([self.values, self.evaluate(point)[None, :]])
            self._fit()

    def __call__(self, points: Array) -> Array:
        """Predictions (m, q) at points (m, np) of the box."""
        return np.stack([s(points)[0] for s in self.surrogates], axis=1)


class MarchedSamples:
    """Marches and mechanical tests of one alloy at points of its constants.

    run: the folder of the scene's own run, whose geometry and intact solid are taken; most: points
    at most; crew: children for the tests.
    """

    def __init__(
        self,
        scene: Scene,
        alloy: str,
        samples: Samples,
        run: RunFolder,
        most: int,
        tolerance: float,
        ranks: int = 1,
        workers: int = 1,
        progress: Progress | None = None,
        crew: Crew | None = None,
    ):
        self.scene, self.alloy, self.samples, self.run = scene, alloy, samples, run
        self.most, self.tolerance = most, tolerance
        self.progress = progress or Progress()
        self.how = {"ranks": ranks, "workers": workers, "progress": progress, "crew": crew}
        self.later = [m for m in scene.with_intact() if m.seconds > 0]
        weeks = {604800.0 * week: f"{week}w" for week in CANDIDATES}
        known = {moment.seconds: moment for moment in self.later}
        every = {s: known.get(s, ImmersionTime(label, s)) for s, label in weeks.items()} | known
        self.moments = tuple(every[seconds] for seconds in sorted(every))
        self._intact = {hold.name: self._peak(run, scene, hold.name) for hold in scene.holds}

    def _peak(self, folder: RunFolder, scene: Scene, hold: str, label: str = "") -> float:
        label = label or scene.with_intact()[0].label
        record = folder.read_record(folder.test(self.alloy, label, hold), "pull")
        if record is None:
            raise SceneError(f"the test of {self.alloy} at {label} held by {hold} is not there")
        return float(record.numbers[f"peak_{LOADS[scene.tensile.load].reaction}"])

    def evaluate(self, point: Array) -> Array:
        """V_L at all moments, then the strength left by way of holding and later time."""
        values = dict(zip(self.samples.names, map(float, point), strict=True))
        scene = replace(
            with_constants(self.scene, self.alloy, values), immersion=self.moments, ions=None
        )
        scene = replace(scene, alloys=(scene.alloy(self.alloy),))
        name = "-".join(f"{value:.4g}" for value in point)
        folder = RunFolder(self.run.path / self.alloy / FOLDER / name)
        if not folder.geometry.exists():
            take_over(self.run.geometry, folder.geometry)
        cycle = StagedRun(scene, folder, **self.how)
        cycle.geometry()
        losses = cycle.corrode(self.alloy).numbers["volume_loss"][1:]
        tests = [(self.alloy, m, hold) for hold in scene.holds for m in self.later]
        for test in tests:
            cycle.map(*test)
        cycle.pull(tests)
        left = [
            self._peak(folder, scene, hold.name, m.label) / self._intact[hold.name]
            for hold in scene.holds
            for m in self.later
        ]
        return np.array([*losses, *left])

    def banded(self, solid: Solid) -> Banded:
        """The samples by surrogates; SceneError where their worst error stays above 0.03."""
        values = self.samples.values
        box = Box(self.samples.names, tuple(values.min(axis=0)), tuple(values.max(axis=0)))
        learned = Learned(box, self.evaluate)
        learned.learn(self.most, self.tolerance)
        worst = float(learned.worst.max())
        self.progress.note(
            f"surrogate of {self.alloy}: {len(learned.points)} marches, worst error of leaving "
            f"one out {100 * worst:.2g} %-points"
        )
        if worst > WORST_ALLOWED:
            raise SceneError(
                f"surrogate of {self.alloy}: {len(learned.points)} marches leave a worst error of "
                f"{worst:.3g}; it must be at most {WORST_ALLOWED:g}, with more --surrogate"
            )
        found = learned(values)
        at = {moment.seconds: n for n, moment in enumerate(self.moments)}
        times = self.scene.with_intact()
        losses = np.stack(
            [found[:, at[m.seconds]] if m.seconds > 0 else np.zeros(len(found)) for m in times],
            axis=1,
        )
        candidates = found[:, [at[604800.0 * week] for week in CANDIDATES]]
        strengths = {}
        for n, hold in enumerate(self.scene.holds):
            start = len(self.moments) + n * len(self.later)
            columns = slice(start, start + len(self.later))
            left = np.concatenate(
                [np.ones((len(found), len(times) - len(self.later))), found[:, columns]], axis=1
            )
            error = float(learned.worst[columns].max())
            strengths[hold.name] = Strength(
                left,
                error,
                Source(
                    "surrogate", error / np.sqrt(3.0), None, None,
                    f"a point left out of {len(learned.points)} errs by {100 * error:.2g} %-points",
                ),
                _slope(losses[:, -1], left[:, -1]),
                len(learned.points) * len(self.later),
            )  # fmt: skip
        return Banded(self.scene, self.alloy, solid, self.samples, losses, candidates, strengths)


def _slope(losses: Array, left: Array) -> Callable[[float], float]:
    """Of the straight line through the samples."""
    spread = float(np.var(losses))
    slope = float(np.cov(losses, left, ddof=0)[0, 1] / spread) if spread > 0 else 0.0
    return lambda loss: slope
