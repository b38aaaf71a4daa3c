"""`perilife run --samples N`: bands of volume loss and strength from samples of the constants.

In clean liquid V_L of each sample is a quadrature, and its strength a point of one curve that a
few tests give; where the liquid counts neither holds and the run is refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.calibration.models import Implant, ReducedModel, liquid_omission, with_constants
from pipeline.calibration.posterior import band
from pipeline.campaigns.strength import (
    CURVE_FOLDER,
    DEFAULT_TOLERANCE,
    CurveTests,
    clean_until,
    curve_to,
)
from pipeline.life_cycle import LifeCycle
from pipeline.record.bands import BANDS_FILE, BandRow, write_bands
from pipeline.record.progress import Progress
from pipeline.record.run_folder import StageRecord
from pipeline.record.stage_hashes import pull_hash
from pipeline.record.summary import SummaryRow
from pipeline.scene.scene import Scene, SceneError, content_hash
from pipeline.stages.corrosion import degradation_rate
from pipeline.stages.geometry import read_surface

Array = NDArray[np.float64]


REVISION = 2
"""Of what bands.csv holds: raised with every change of it."""

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
        """bands.csv of all alloys."""
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
            rows, numbers = [], {}
            for alloy in self.scene.alloys:
                found, tests = self._bands_of(alloy.name, implant)
                rows += found
                numbers[alloy.name] = {"tests": tests}
            path = self.folder.path / BANDS_FILE
            write_bands(path, rows)
            return [path], numbers

        return self._do("bands", "bands", self.folder.path, inputs, work)

    def _bands_of(self, alloy: str, implant: Implant) -> tuple[list[BandRow], dict[str, int]]:
        """Rows of one alloy, and how many tests each way of holding took."""
        samples, times = self.samples[alloy], self.scene.with_intact()
        losses = self._losses(alloy, implant, samples, max(m.seconds for m in times))
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
        rates = degradation_rate(losses, [m.seconds for m in times], implant.solid)
        rows, counts = [], {}
        for hold in self.scene.holds:
            most = float(losses.max())
            curve = curve_to(tests, hold.name, most, self.tolerance, self.progress.note)
            counts[hold.name] = len(curve.losses)
            ratios = curve(losses) / curve.strengths[0]
            bands = zip(times, *(band(v).T for v in (losses, rates, ratios)), strict=True)
            rows += [
                BandRow(
                    alloy,
                    hold.name,
                    moment.days,
                    *(tuple(map(float, values)) for values in found),
                    len(samples.values),
                    curve.error(),
                )
                for moment, *found in bands
                if moment in self.scene.immersion and moment.seconds > 0
            ]
        return rows, counts

    def _losses(self, alloy: str, implant: Implant, samples: Samples, end: float) -> Array:
        """V_L of every sample at every time (n, nt), as if all liquid were clean.

        The bound of that grows with the rate at the start: of the fastest samples a few may go
        beyond it, which the band's ends do not feel; more, and SceneError is raised.
        """
        model = ReducedModel(self.scene, alloy, implant, samples.names)
        seconds = np.array([moment.seconds for moment in self.scene.with_intact()])
        losses = np.array([model(seconds, np.log(row))[0] for row in samples.values])
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
