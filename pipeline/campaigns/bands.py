"""`perilife run --samples N`: bands of volume loss and strength, and what else makes them unsure.

In clean liquid V_L of each sample is a quadrature, and its strength a point of one curve that a
few tests give.  Where the liquid counts neither holds: surrogates through marches and tests
(`--surrogate`) stand for the samples, or the run is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.calibration.models import Implant, liquid_omission, with_constants
from pipeline.calibration.surrogate import require_kriging
from pipeline.campaigns.banded import Banded, Samples, Strength, sampled_losses, samples_of
from pipeline.campaigns.doubts import CANDIDATES, OtherAssumptions
from pipeline.campaigns.strength import (
    CURVE_FOLDER,
    DEFAULT_TOLERANCE,
    CurveTests,
    clean_at,
    curve_to,
)
from pipeline.campaigns.surrogate_bands import FIRST, MarchedSamples
from pipeline.life_cycle import StagedRun
from pipeline.record.bands import BANDS_FILE, write_bands
from pipeline.record.doubts import DOUBTS_FILE, HoldDoubts, Source, write_doubts
from pipeline.record.progress import Progress
from pipeline.record.run_folder import StageRecord
from pipeline.record.stage_hashes import pull_hash
from pipeline.record.summary import SummaryRow
from pipeline.scene.checks import check
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene, SceneError, content_hash
from pipeline.stages.geometry import read_surface
from pipeline.stages.pulls import Crew

Array = NDArray[np.float64]


REVISION = 5
"""Of what bands.csv and doubts.json hold: raised with every change of them."""

DOUBTS_FOLDER = "other-assumptions"

BEYOND = 0.025
"""Share of the samples that may go beyond the bound of clean liquid: half of a band's tail."""


class BandedRun(StagedRun):
    """A life cycle that adds bands before its report.

    samples: how many per alloy; tolerance: of the strength curve, or of surrogates; surrogate:
    points of those at most, None where the liquid must not count.
    """

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        *,
        samples: int,
        tolerance: float = DEFAULT_TOLERANCE,
        surrogate: int | None = None,
        **more: object,
    ):
        super().__init__(scene, folder, **more)
        self.surrogate = surrogate
        self.tolerance = tolerance
        self.samples = {a.name: samples_of(scene, a.name, samples) for a in scene.alloys}

    def run(self) -> list[SummaryRow]:
        """Every stage; the children that pull are kept to the end."""
        with Crew(self.workers, self.folder.descriptors) as self.crew:
            return super().run()

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
        inputs = content_hash("bands", REVISION, parts, sampled, self.tolerance, self.surrogate)

        def work() -> tuple[list[Path], dict[str, object]]:
            place = self.folder.geometry
            implant = Implant(self.scene, read_surface(place), place)
            rows, doubts, numbers = [], [], {}
            for alloy in self.scene.alloys:
                banded = self._bands_of(alloy.name, implant)
                rows += banded.rows()
                doubts += self._doubts_of(banded)
                tests = {hold: found.tests for hold, found in banded.strengths.items()}
                numbers[alloy.name] = {"tests": tests}
            paths = [self.folder.path / name for name in (BANDS_FILE, DOUBTS_FILE)]
            write_bands(paths[0], rows)
            write_doubts(paths[1], doubts)
            return paths, numbers

        return self._do("bands", "bands", self.folder.path, inputs, work)

    def _bands_of(self, alloy: str, implant: Implant) -> Banded:
        samples, times = self.samples[alloy], self.scene.with_intact()
        shared = self._how()
        try:
            losses, within = self._losses(alloy, implant, samples)
        except SceneError:
            if self.surrogate is None:
                raise
            marched = MarchedSamples(
                self.scene, alloy, samples, self.folder, self.surrogate, self.tolerance, **shared
            )
            return marched.banded(implant.solid)
        folder, geometry = self.folder.path / alloy / CURVE_FOLDER, self.folder.geometry
        peak = f"peak_{LOADS[self.scene.tensile.load].reaction}"
        intact = {h.name: float(self._pulled((alloy, times[0], h))[peak]) for h in self.scene.holds}
        tests = CurveTests(
            self.scene, alloy, implant, folder, geometry=geometry, intact=intact, **shared
        )
        later = [m.seconds > 0 for m in times]
        strengths = {
            hold.name: self._by_curve(tests, hold.name, losses, within, later)
            for hold in self.scene.holds
        }
        weeks = [604800.0 * week for week in CANDIDATES]
        candidates = sampled_losses(self.scene, alloy, implant, samples, weeks)
        return Banded(self.scene, alloy, implant.solid, samples, losses, candidates, strengths)

    def _how(self) -> dict[str, object]:
        """How further tests are done: as those of the run."""
        return {
            "ranks": self.ranks, "workers": self.workers, "progress": self.progress,
            "crew": self.crew,
        }  # fmt: skip

    def _by_curve(
        self, tests: CurveTests, hold: str, losses: Array, within: Array, later: Sequence[bool]
    ) -> Strength:
        """By a curve between the losses of the samples within the bound of clean liquid."""
        known = losses[:, later]
        least, most = float(known[within].min()), float(known[within].max())
        curve = curve_to(tests, hold, most, self.tolerance, self.progress.note, smallest_loss=least)
        left = np.ones_like(losses)
        left[:, later] = curve.left(np.clip(known, least, most))
        error, ends = curve.error(), curve.losses[[0, -1]]

        def slope(loss: float) -> float:
            return float(curve.slope([np.clip(loss, *ends)])[0] / curve.whole)

        words = f"a test left out of {len(curve.losses)} errs by {100 * error:.2g} %-points at most"
        source = Source("strength curve", error / np.sqrt(3.0), None, None, words)
        return Strength(left, error, source, slope, len(curve.losses))

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
            **self._how(),
        ).sources({hold: row.strength_ratio for hold, row in own.items()})
        calibration = perilife_data.load_parameter_set(self.scene.parameter_set).calibrations[alloy]
        return [
            banded.doubts(hold, own[hold], tuple(others[hold]), calibration.scatter)
            for hold in banded.strengths
        ]

    def _losses(self, alloy: str, implant: Implant, samples: Samples) -> tuple[Array, Array]:
        """V_L of every sample at every time (n, nt) as if all liquid were clean, and who may be so.

        Saturation holds back most of the sample that is fastest at the start, and what dissolves
        exposes most of the one that has lost most at the end.  Of either a few may go beyond the
        bound of clean liquid, which the band's ends do not feel (the mask (n,) is False there);
        more, and SceneError is raised.
        """
        seconds = [moment.seconds for moment in self.scene.with_intact()]
        found = sampled_losses(self.scene, alloy, implant, samples, [*seconds, 1.0])
        losses, at_once = found[:, :-1], found[:, -1]
        within, allowed = np.ones(len(losses), bool), int(BEYOND * len(losses))
        bound = 0.0
        for extent in (at_once, losses[:, -1]):
            ascending = np.argsort(extent, kind="stable")
            while True:
                row = int(ascending[within[ascending]][-1])
                scene = with_constants(self.scene, alloy, samples.constants(row))
                omission = liquid_omission(scene, alloy, implant, seconds)
                if omission.applied:
                    break
                beyond = int((~within).sum())
                if beyond >= allowed:
                    clean_at(scene, alloy, implant, seconds)
                more = min(allowed, 2 * beyond + 1) - beyond
                within[ascending[within[ascending]][-more:]] = False
            bound = max(bound, omission.bound)
            self.progress.note(f"{alloy}: liquid is left out of sample {row}: {omission.reason}")
        beyond = int((~within).sum())
        self.progress.note(
            f"{alloy}: clean liquid changes the volume loss of {len(losses) - beyond} of "
            f"{len(losses)} samples by {bound:.1e} of it at most"
            + (f"; up to {beyond} go beyond, and count as if it were clean" if beyond else "")
        )
        return losses, within


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
    march_ranks: int = 1,
    surrogate: int | None = None,
) -> list[SummaryRow]:
    """`run_life_cycle` with bands; SceneError for a set without samples before anything is made.

    surrogate: points of a surrogate at most, where the liquid counts.
    """
    if surrogate is not None:
        check(FIRST <= surrogate <= 400, "--surrogate", surrogate, f"from {FIRST} to 400")
        require_kriging()
    from pipeline.planning.opening import open_run

    for alloy in scene.alloys:
        samples_of(scene, alloy.name, samples)
    if scene.immersion[-1].seconds == 0:
        raise SceneError("--samples is given and no immersion time is above 0; one must be")
    with open_run(scene, out, resume) as (folder, solid):
        cycle = BandedRun(
            scene,
            folder,
            samples=samples,
            tolerance=tolerance,
            ranks=ranks,
            workers=workers,
            progress=progress,
            solid=solid,
            march_ranks=march_ranks,
            surrogate=surrogate,
        )
        return cycle.run()
