"""`perilife run --until-left 0.8` or `--until-force 300N`: when does the part become too weak?

The tests of the run enclose the time; strength over volume loss, which bends less than strength
over time, is interpolated through them, and a full run at the time found (march, map and test)
checks it and is one more point.  Nothing here asks whether the liquid is clean, and every second
step halves what encloses the time, so that a solid that falls apart at once is found, too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from pipeline.campaigns.strength import take_over
from pipeline.life_cycle import StagedRun
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder, StageRecord
from pipeline.record.run_results import column, read_run
from pipeline.record.stage_hashes import pull_hash
from pipeline.record.summary import SummaryRow
from pipeline.record.until import ALWAYS, FOUND, NEVER, UNTIL_FILE, UntilRow, write_until
from pipeline.scene.errors import corrosion_error, strength_error
from pipeline.scene.loads import LOADS, read_reaction
from pipeline.scene.scene import HoldScene, Scene, SceneError, content_hash
from pipeline.scene.units import ImmersionTime

Array = NDArray[np.float64]

REVISION = 1
"""Of what until.csv holds: raised with every change of the search."""

UNTIL_FOLDER = "until"

CLOSE = 0.003
"""Of the intact strength: a test so near to what is wanted ends the search."""

NARROW = 0.01
"""Of the time: enclosed as narrowly, a strength that jumps ends the search."""

_SLOPE_STEP = 0.02
"""Of the time, either side, for the slope of the strength."""


@dataclass(frozen=True)
class Wanted:
    """The strength below which a part is too weak: of the intact one, or in N or N m."""

    share: float | None = None
    peak: float | None = None

    def of(self, intact: float) -> float:
        """In N or N m."""
        return self.peak if self.share is None else self.share * intact


@dataclass(frozen=True)
class Point:
    """One test of the course: time (s), peak (N or N m) and volume loss."""

    seconds: float
    peak: float
    volume_loss: float = math.nan


def wanted_of(options: argparse.Namespace, scene: Scene) -> Wanted | None:
    """What the options ask for, None where they do not; ValueError with one sentence."""
    share, force = options.until_left, options.until_force
    if share is None and force is None:
        return None
    name = "--until-left" if force is None else "--until-force"
    if share is not None and force is not None:
        raise ValueError("give either --until-left or --until-force, not both")
    if options.samples is not None:
        raise ValueError(
            f"{name} does not go with --samples; `perilife design --probability` asks for a "
            "strength that most samples keep"
        )
    if scene.immersion[-1].seconds == 0:
        raise SceneError(f"{name} is given and no immersion time is above 0; one must be")
    if share is not None and not 0 < share < 1:
        raise ValueError(f"--until-left is {share:g}; it must be above 0 and below 1")
    return Wanted(share, None if force is None else read_reaction(force, scene.tensile.load, name))


def enclosed(points: Sequence[Point], wanted: float) -> tuple[Point, Point] | None:
    """The first two neighbours in time between which the peak falls below what is wanted."""
    for before, after in zip(points, points[1:], strict=False):
        if before.peak >= wanted > after.peak:
            return before, after
    return None


def search(
    points: Sequence[Point],
    wanted: float,
    loss_at: Callable[[Array], Array],
    test: Callable[[float], Point],
) -> tuple[Point, float, int]:
    """When the peak falls below `wanted`: that test, the error of its time (s), and tests taken.

    points: tests that enclose it, rising in time, the intact solid first; loss_at: volume loss by
    time (s), by which the peaks are interpolated; test: a full run at a time (s).
    The test found is the last one where its peak is within CLOSE; else the first below `wanted`.
    """
    points, intact, taken = list(points), points[0].peak, 0
    while True:
        before, after = enclosed(points, wanted)
        width = after.seconds - before.seconds
        if width <= NARROW * after.seconds:
            return after, width, taken
        middle = 0.5 * (before.seconds + after.seconds)
        time = middle if taken % 2 else _interpolated(points, before, after, wanted, loss_at)
        found = test(_round(time, before.seconds, after.seconds))
        taken += 1
        points = sorted([*points, found], key=lambda p: p.seconds)
        if abs(found.peak - wanted) <= CLOSE * intact:
            slope = abs(_slope(points, found.seconds, loss_at))
            off = abs(found.peak - wanted) / slope if slope > 0 else width
            return found, min(off, width), taken


def _curve(points: Sequence[Point], loss_at: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Peak by time: interpolated over the volume loss, or over time where that stands still."""
    times = np.array([p.seconds for p in points])
    peaks, losses = np.array([p.peak for p in points]), loss_at(times)
    if (np.diff(losses) > 0).all():
        over_loss = PchipInterpolator(losses, peaks)
        return lambda t: over_loss(loss_at(t))
    return PchipInterpolator(times, peaks)


def _interpolated(
    points: Sequence[Point],
    before: Point,
    after: Point,
    wanted: float,
    loss_at: Callable[[Array], Array],
) -> float:
    curve = _curve(points, loss_at)

    def excess(time: float) -> float:
        return float(curve(np.array([time]))[0]) - wanted

    return float(brentq(excess, before.seconds, after.seconds, xtol=1.0))


def _slope(points: Sequence[Point], at: float, loss_at: Callable[[Array], Array]) -> float:
    """d peak / d time of the interpolated peaks, N/s or N m/s."""
    step = _SLOPE_STEP * at
    ends = np.array([at - step, min(at + step, points[-1].seconds)])
    return float(np.diff(_curve(points, loss_at)(ends))[0] / np.diff(ends)[0])


def _round(seconds: float, low: float, high: float) -> float:
    """To a whole hour where that stays well within what encloses it, else to a second."""
    edge = 0.02 * (high - low)
    seconds = min(max(seconds, low + edge), high - edge)
    hours = 3600.0 * round(seconds / 3600.0)
    return hours if low + edge <= hours <= high - edge else float(round(seconds))


class UntilRun(StagedRun):
    """A life cycle that finds, before its report, when each alloy becomes too weak."""

    def __init__(self, scene: Scene, folder: RunFolder, *, wanted: Wanted, **more: object):
        super().__init__(scene, folder, **more)
        self.wanted = wanted

    def report(self, again: bool = False) -> StageRecord:
        """The times first, then the report that shows them."""
        self.until()
        return super().report(again)

    def until(self) -> StageRecord:
        """until.csv: each alloy in each way of holding."""
        parts = [
            pull_hash(self.scene, alloy.name, moment, hold)
            for alloy in self.scene.alloys
            for hold in self.scene.holds
            for moment in self.scene.with_intact()
        ]
        wanted = [self.wanted.share, self.wanted.peak]
        inputs = content_hash("until", REVISION, parts, wanted)
        path = self.folder.path / UNTIL_FILE

        def work() -> tuple[list[Path], dict[str, object]]:
            rows = [
                self._row(alloy.name, hold)
                for alloy in self.scene.alloys
                for hold in self.scene.holds
            ]
            write_until(path, rows)
            return [path], {}

        return self._do("until", "until", self.folder.path, inputs, work)

    def _row(self, alloy: str, hold: HoldScene) -> UntilRow:
        peak = f"peak_{LOADS[hold.tensile.load].reaction}"
        losses = self.folder.read_record(self.folder.corrosion(alloy), "corrode").numbers
        points = [
            Point(moment.seconds, float(self._pulled((alloy, moment, hold))[peak]), float(loss))
            for moment, loss in zip(
                self.scene.with_intact(), losses["volume_loss"], strict=True
            )
        ]  # fmt: skip
        intact = points[0].peak
        wanted = self.wanted.of(intact)
        shared = {
            "alloy": alloy,
            "hold": hold.name,
            "load": hold.tensile.load,
            "wanted_ratio": wanted / intact,
            "wanted_peak": wanted,
        }

        def row(outcome: str, at: Point, **more: object) -> UntilRow:
            return UntilRow(
                **shared, outcome=outcome, days=at.seconds / 86400.0, volume_loss=at.volume_loss,
                strength_ratio=at.peak / intact, peak_reaction=at.peak, **more,
            )  # fmt: skip

        if intact < wanted:
            return row(ALWAYS, points[0])
        if enclosed(points, wanted) is None:
            return row(NEVER, points[-1])
        loss_at = self._course(alloy)
        place: dict[float, Path] = {}

        def test(seconds: float) -> Point:
            found, place[seconds] = self._full_run(alloy, hold, seconds)
            self.progress.note(
                f"{alloy}, {hold.name}: {100 * found.peak / intact:.1f} % left after "
                f"{seconds / 604800:.2f} weeks"
            )
            return found

        found, error, taken = search(points, wanted, loss_at, test)
        known = sorted([*points, found], key=lambda p: p.seconds)
        slope = abs(_slope(known, found.seconds, loss_at))
        where = place.get(found.seconds)
        return row(
            FOUND,
            found,
            search_error_days=error / 86400.0,
            settings_error_days=self._settings_error(alloy, hold, found, slope, loss_at),
            tests=taken,
            run="" if where is None else str(where.relative_to(self.folder.path)),
        )

    def _course(self, alloy: str) -> Callable[[Array], Array]:
        """Volume loss by time (s), through the steps of the run's own march."""
        run = read_run(self.folder.path, fields=False)
        history = next(a.history for a in run.alloys if a.name == alloy)
        times, first = np.unique(column(history, "time"), return_index=True)
        course = PchipInterpolator(times, column(history, "volume_loss")[first])
        return lambda t: course(np.clip(t, times[0], times[-1]))

    def _full_run(self, alloy: str, hold: HoldScene, seconds: float) -> tuple[Point, Path]:
        """March, map and test to one time, in a run folder of its own, done once."""
        moment = ImmersionTime(f"{seconds / 3600:.6g}h", seconds)
        # what the ions do is left out: they do not act on the metal
        scene = replace(self.scene.at(moment), alloys=(self.scene.alloy(alloy),), ions=None)
        folder = RunFolder(self.folder.path / alloy / UNTIL_FOLDER / moment.label)
        if not folder.geometry.exists():
            take_over(self.folder.geometry, folder.geometry)
        cycle = StagedRun(
            scene, folder, ranks=self.ranks, workers=self.workers, progress=self.progress,
            march_ranks=self.march_ranks,
        )  # fmt: skip
        cycle.geometry()
        loss = cycle.corrode(alloy).numbers["volume_loss"][-1]
        cycle.map(alloy, moment, hold)
        (record,) = cycle.pull([(alloy, moment, hold)])
        peak = float(record.numbers[f"peak_{LOADS[hold.tensile.load].reaction}"])
        return Point(seconds, peak, float(loss)), folder.path

    def _settings_error(
        self,
        alloy: str,
        hold: HoldScene,
        found: Point,
        slope: float,
        loss_at: Callable[[Array], Array],
    ) -> float | None:
        """What the measured errors of strength and volume loss make of the time, days."""
        mesh, lattice = strength_error(self.scene, hold), corrosion_error(self.scene)
        step = _SLOPE_STEP * found.seconds
        ends = loss_at(np.array([found.seconds - step, found.seconds]))
        rate = float(np.diff(ends)[0]) / step
        if mesh is None or lattice is None or slope == 0 or rate == 0:
            return None
        seconds = mesh * found.peak / slope + lattice.of(alloy) * found.volume_loss / rate
        return seconds / 86400.0


def run_until(
    scene: Scene,
    out: Path | str,
    wanted: Wanted,
    *,
    resume: bool = False,
    ranks: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
    march_ranks: int = 1,
    solid: object = None,
) -> list[SummaryRow]:
    """`run_life_cycle` with until.csv."""
    from pipeline.planning.opening import open_run

    stages = ("geometry", "corrode", "map", "pull")
    with open_run(scene, out, resume, solid=solid, stages=stages, ranks=ranks, workers=workers) as (
        folder,
        solid,
    ):
        return UntilRun(
            scene, folder, wanted=wanted, ranks=ranks, workers=workers, progress=progress,
            solid=solid, march_ranks=march_ranks,
        ).run()  # fmt: skip
