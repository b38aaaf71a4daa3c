"""`perilife run --samples N`: bands of volume loss and strength, and what else makes them unsure.

In clean liquid V_L of each sample is a quadrature, and its strength a point of one curve that a
few tests give; where the liquid counts neither holds and the run is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.calibration.models import Implant, ReducedModel, liquid_omission, with_constants
from pipeline.calibration.posterior import band
from pipeline.calibration.strength_curve import StrengthCurve
from pipeline.campaigns.doubts import (
    CANDIDATES,
    OtherAssumptions,
    next_measurements,
    shares_of_constants,
)
from pipeline.campaigns.strength import (
    CURVE_FOLDER,
    DEFAULT_TOLERANCE,
    CurveTests,
    clean_until,
    curve_to,
)
from pipeline.life_cycle import LifeCycle
from pipeline.record.bands import BANDS_FILE, BandRow, write_bands
from pipeline.record.doubts import DOUBTS_FILE, HoldDoubts, Source, write_doubts
from pipeline.record.progress import Progress
from pipeline.record.run_folder import StageRecord
from pipeline.record.stage_hashes import pull_hash
from pipeline.record.summary import SummaryRow
from pipeline.scene.scene import Scene, SceneError, content_hash
from pipeline.stages.corrosion import degradation_rate
from pipeline.stages.geometry import read_surface

Array = NDArray[np.float64]


REVISION = 4
"""Of what bands.csv and doubts.json hold: raised with every change of them."""

DOUBTS_FOLDER = "other-assumptions"

BEYOND = 0.025
"""Share of the samples that may go beyond the bound of clean liquid: half of a band's tail."""


class Samples:
    """Samples of the constants of one alloy: names, values (n, np) in SI."""

    def __init__(self, names: tuple[str, ...], values: Array):
        self.names, self.values = names, values

    def constants(self, row: int) -> dict[str, float]:
        """Those of one sample, by name."""
        return dict(zip(self.names, map(float, self.values[row]), strict=True))


def samples_of(scene: Scene, alloy: str, count: int) -> Samples:
    """`count` samples that the scene's parameter set carries for an alloy.

    Raises SceneError for a set without samples, or with fewer.
    """
    calibrations = perilife_data.load_parameter_set(scene.parameter_set).calibrations
    if alloy not in calibrations:
        raise SceneError(
            f"parameter set '{scene.parameter_set}' has no posterior of {alloy}; --samples must "
            "go with a set that `perilife calibrate` wrote"
        )
    rows = np.array(calibrations[alloy].samples)
    if not 2 <= count <= len(rows):
        raise SceneError(f"--samples is {count}; it must be 2 to {len(rows)}, those of the set")
    # Draws are sorted; every nth of them keeps their spread.
    chosen = np.round(np.linspace(0, len(rows) - 1, count)).astype(int)
    return Samples(calibrations[alloy].parameters, rows[chosen])


def sampled_losses(
    scene: Scene, alloy: str, implant: Implant, samples: Samples, seconds: Sequence[float]
) -> Array:
    """V_L in clean liquid of every sample at every time (n, nt)."""
    model = ReducedModel(scene, alloy, implant, samples.names)
    return np.array([model(np.array(seconds), np.log(row))[0] for row in samples.values])


@dataclass(frozen=True)
class Banded:
    """One alloy with its samples: V_L (n, nt) at the scene's times, a strength curve per hold."""

    scene: Scene
    alloy: str
    implant: Implant
    samples: Samples
    losses: Array
    curves: dict[str, StrengthCurve]

    def left(self, hold: str) -> Array:
        """Strength left of every sample at every time (n, nt), 1 before immersion."""
        curve, out = self.curves[hold], np.ones_like(self.losses)
        later = [moment.seconds > 0 for moment in self.scene.with_intact()]
        out[:, later] = curve.left(self.losses[:, later])
        return out

    def rows(self) -> list[BandRow]:
        """Bands in each way of holding at the scene's times after zero."""
        times, rows = self.scene.with_intact(), []
        rates = degradation_rate(self.losses, [m.seconds for m in times], self.implant.solid)
        for hold, curve in self.curves.items():
            bands = [band(values).T for values in (self.losses, rates, self.left(hold))]
            rows += [
                BandRow(
                    self.alloy,
                    hold,
                    moment.days,
                    *(tuple(map(float, values)) for values in found),
                    len(self.losses),
                    curve.error(),
                )
                for moment, *found in zip(times, *bands, strict=True)
                if moment in self.scene.immersion and moment.seconds > 0
            ]
        return rows

    def doubts(
        self, hold: str, own: SummaryRow, others: tuple[Source, ...], scatter: float
    ) -> HoldDoubts:
        """What the samples say of the last time, beside other sources."""
        curve, left = self.curves[hold], self.left(hold)[:, -1]
        low, _, high = map(float, band(left))
        count = len(self.losses)
        measured = Source(
            "measurement and constants", float(left.std()), low, high, f"{count} samples"
        )
        error = curve.error()
        between = Source(
            "strength curve", error / np.sqrt(3.0), None, None,
            f"a test left out of {len(curve.losses)} errs by {100 * error:.2g} %-points at most",
        )  # fmt: skip
        names = self.samples.names
        shares = shares_of_constants(np.log(self.samples.values), left)
        weeks = [604800.0 * week for week in CANDIDATES]
        candidates = sampled_losses(self.scene, self.alloy, self.implant, self.samples, weeks)
        now, after = next_measurements(candidates, self.losses[:, -1], left, scatter)
        inside = float(np.clip(own.volume_loss, *curve.losses[[0, -1]]))
        return HoldDoubts(
            alloy=self.alloy,
            hold=hold,
            immersion_days=own.immersion_days,
            volume_loss=own.volume_loss,
            strength_left=own.strength_ratio,
            slope=float(curve.slope([inside])[0] / curve.whole),
            sources=(measured, between, *others),
            constants=dict(zip(names, map(float, shares), strict=True)),
            now=now,
            after=after,
            scatter=scatter,
        )


class BandedLifeCycle(LifeCycle):
    """A life cycle that adds bands before its report.

    samples: how many per alloy; tolerance: of the strength curve.
    """

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        *,
        samples: int,
        tolerance: float = DEFAULT_TOLERANCE,
        **more: object,
    ):
        super().__init__(scene, folder, **more)
        self.tolerance = tolerance
        self.samples = {a.name: samples_of(scene, a.name, samples) for a in scene.alloys}

    def report(self, again: bool = False) -> StageRecord:
        """Bands first, then the report that shows them."""
        self.bands()
        return super().report(again)

    def bands(self) -> StageRecord:
        """bands.csv and doubts.json of all alloys."""
        last = self.scene.with_intact()[-1]
        parts = [
            [pull_hash(self.scene, a.name, last, hold) for hold in self.scene.holds]
            for a in self.scene.alloys
        ]
        sampled = [[s.names, s.values.tolist()] for s in self.samples.values()]
        inputs = content_hash("bands", REVISION, parts, sampled, self.tolerance)

        def work() -> tuple[list[Path], dict[str, object]]:
            place = self.folder.geometry
            implant = Implant(self.scene, read_surface(place), place)
            rows, doubts, numbers = [], [], {}
            for alloy in self.scene.alloys:
                banded = self._bands_of(alloy.name, implant)
                rows += banded.rows()
                doubts += self._doubts_of(banded)
                tests = {hold: len(curve.losses) for hold, curve in banded.curves.items()}
                numbers[alloy.name] = {"tests": tests}
            paths = [self.folder.path / name for name in (BANDS_FILE, DOUBTS_FILE)]
            write_bands(paths[0], rows)
            write_doubts(paths[1], doubts)
            return paths, numbers

        return self._do("bands", "bands", self.folder.path, inputs, work)

    def _bands_of(self, alloy: str, implant: Implant) -> Banded:
        samples = self.samples[alloy]
        end = max(moment.seconds for moment in self.scene.with_intact())
        losses = self._losses(alloy, implant, samples, end)
        tests = CurveTests(
            self.scene,
            alloy,
            implant,
            self.folder.path / alloy / CURVE_FOLDER,
            geometry=self.folder.geometry,
            ranks=self.ranks,
            workers=self.workers,
            progress=self.progress,
        )
        later = losses[:, [m.seconds > 0 for m in self.scene.with_intact()]]
        curves = {
            hold.name: curve_to(
                tests, hold.name, float(later.max()), self.tolerance, self.progress.note,
                smallest_loss=float(later.min()),
            )
            for hold in self.scene.holds
        }  # fmt: skip
        return Banded(self.scene, alloy, implant, samples, losses, curves)

    def _doubts_of(self, banded: Banded) -> list[HoldDoubts]:
        """The doubts at the last time in each way of holding, other assumptions tested."""
        alloy, last = banded.alloy, self.scene.with_intact()[-1]
        if last.seconds == 0:
            return []
        own = {
            row.hold: row
            for row in self.summarise()
            if row.alloy == alloy and row.immersion_days == last.days
        }
        others = OtherAssumptions(
            self.scene,
            alloy,
            self.folder,
            self.folder.path / alloy / DOUBTS_FOLDER,
            ranks=self.ranks,
            workers=self.workers,
            progress=self.progress,
        ).sources({hold: row.strength_ratio for hold, row in own.items()})
        calibration = perilife_data.load_parameter_set(self.scene.parameter_set).calibrations[alloy]
        return [
            banded.doubts(hold, own[hold], tuple(others[hold]), calibration.scatter)
            for hold in banded.curves
        ]

    def _losses(self, alloy: str, implant: Implant, samples: Samples, end: float) -> Array:
        """V_L of every sample at every time (n, nt), as if all liquid were clean.

        The bound of that grows with the rate at the start: of the fastest samples a few may go
        beyond it, which the band's ends do not feel; more, and SceneError is raised.
        """
        model = ReducedModel(self.scene, alloy, implant, samples.names)
        seconds = [moment.seconds for moment in self.scene.with_intact()]
        losses = sampled_losses(self.scene, alloy, implant, samples, seconds)
        at_once = [float(model(np.array([1.0]), np.log(row))[0][0]) for row in samples.values]
        slowest_first = np.argsort(at_once, kind="stable")

        def scene(row: int) -> Scene:
            return with_constants(self.scene, alloy, samples.constants(row))

        beyond, allowed = 0, int(BEYOND * len(slowest_first))
        while not liquid_omission(scene(slowest_first[-1 - beyond]), alloy, implant, end).applied:
            if beyond >= allowed:
                clean_until(scene(slowest_first[-1 - beyond]), alloy, implant, end)
            beyond = min(allowed, 2 * beyond + 1)
        if beyond:
            self.progress.note(
                f"{alloy}: up to {beyond} of {len(slowest_first)} samples, the fastest, go beyond "
                "the bound of clean liquid; they count as if it were clean"
            )
        return losses


def run_with_bands(
    scene: Scene,
    out: Path | str,
    samples: int,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    resume: bool = False,
    ranks: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[SummaryRow]:
    """`run_life_cycle` with bands; SceneError for a set without samples before anything is made."""
    from pipeline.stages.opening import open_run

    for alloy in scene.alloys:
        samples_of(scene, alloy.name, samples)
    if scene.immersion[-1].seconds == 0:
        raise SceneError("--samples is given and no immersion time is above 0; one must be")
    with open_run(scene, out, resume) as (folder, solid):
        cycle = BandedLifeCycle(
            scene,
            folder,
            samples=samples,
            tolerance=tolerance,
            ranks=ranks,
            workers=workers,
            progress=progress,
            solid=solid,
        )
        return cycle.run()
