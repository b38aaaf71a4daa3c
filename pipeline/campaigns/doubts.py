"""What makes the strength left unsure beside the measurements: tests with other assumptions.

Samples of the constants give the doubt of the measurements, and which constant carries how much of
it.  Other hardening records and other horizons are tests of their own, at the last immersion time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

import perilife_data
from pipeline.campaigns.strength import take_over
from pipeline.life_cycle import StagedRun
from pipeline.record.doubts import Next, Source
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder, RunFolderError
from pipeline.scene.laws.hardening import with_hardening
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene
from pipeline.scene.units import format_length
from pipeline.stages.pulls import Crew

Array = NDArray[np.float64]

HORIZONS = (0.5, 1.5)
"""Other horizons that are tried, over that of the scene: 100 and 300 um beside 200 um."""

CANDIDATES = (1, 2, 4, 8, 12, 16, 24)
"""Weeks at which one more measurement is considered."""

_DEGREE = 3
"""Of the polynomial in the logarithm of a constant that explains a value."""


def half_range(values: Sequence[float]) -> float:
    """Standard deviation of what may be anywhere between the ends of a range, evenly."""
    return float((max(values) - min(values)) / np.sqrt(12.0))


def shares_of_constants(logs: ArrayLike, values: ArrayLike) -> Array:
    """Share of the variance of values (n,) that knowing each column of logs (n, np) would remove.

    The first-order index of Sobol from the samples at hand, by a cubic in each logarithm.
    Correlated constants share what they explain, so that the shares need not add up to one.
    """
    logs, values = np.asarray(logs, float), np.asarray(values, float)
    spread = float(np.var(values))
    shares = []
    for column in logs.T:
        width = float(np.std(column))
        if spread <= 0 or width <= 0:
            shares.append(0.0)
            continue
        basis = np.vander((column - column.mean()) / width, _DEGREE + 1)
        left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
        shares.append(1.0 - float(np.var(left)) / spread)
    return np.array(shares)


def after_one_more(measured: ArrayLike, wanted: ArrayLike, scatter: float) -> Array:
    """Standard deviation of wanted (n,) after one measurement of each column of measured (n, m).

    var(W) - cov(W, M)^2 / (var(M) + scatter^2), linear in the samples.
    """
    measured, wanted = np.asarray(measured, float), np.asarray(wanted, float)
    away = measured - measured.mean(axis=0)
    covariance = away.T @ (wanted - wanted.mean()) / len(wanted)
    gain = covariance**2 / (np.var(measured, axis=0) + scatter**2)
    return np.sqrt(np.maximum(np.var(wanted) - gain, 0.0))


def next_measurements(
    losses: Array, loss: Array, strength: Array, scatter: float
) -> tuple[Next, tuple[Next, ...]]:
    """Deviations of volume loss and strength at the last time, now and after one more measurement.

    losses (n, candidates): of the samples at `CANDIDATES`; loss, strength (n,): at the last time.
    """
    now = Next(0.0, float(np.std(loss)), float(np.std(strength)))
    left = zip(
        CANDIDATES,
        after_one_more(losses, loss, scatter),
        after_one_more(losses, strength, scatter),
        strict=True,
    )
    return now, tuple(Next(7.0 * week, float(v), float(s)) for week, v, s in left)


class OtherAssumptions:
    """Tests of one alloy at the last time of a scene, with another hardening or horizon.

    run: the finished folder of the scene; folder: of the tests; crew: children for them.
    """

    def __init__(
        self,
        scene: Scene,
        alloy: str,
        run: RunFolder,
        folder: Path,
        ranks: int = 1,
        workers: int = 1,
        progress: Progress | None = None,
        crew: Crew | None = None,
    ):
        self.last = scene.with_intact()[-1]
        self.scene = replace(scene, alloys=(scene.alloy(alloy),), immersion=(self.last,), ions=None)
        self.alloy, self.run, self.folder = alloy, run, folder
        self.how = {"ranks": ranks, "workers": workers, "progress": progress, "crew": crew}

    def left(self, scene: Scene, name: str) -> dict[str, float]:
        """Strength left by way of holding in a changed scene; the folder's name is `name`.

        The intact solid is tested again only where its material is another.
        """
        folder = RunFolder(self.folder / name)
        if not folder.geometry.exists():
            take_over(self.run.geometry, folder.geometry)
        cycle = StagedRun(scene, folder, **self.how)
        cycle.geometry()
        cycle.corrode(self.alloy)
        first, *_, last = scene.with_intact()
        again = scene.alloys[0].material != self.scene.alloys[0].material
        moments = (first, last) if again else (last,)
        tests = [(self.alloy, m, h) for h in scene.holds for m in moments]
        for test in tests:
            cycle.map(*test)
        cycle.pull(tests)
        found = {}
        for hold in scene.holds:
            whole = self._peak(folder if again else self.run, first.label, hold.name)
            peak = self._peak(folder, last.label, hold.name)
            found[hold.name] = peak / whole if whole > 0 else 0.0
        return found

    def _peak(self, folder: RunFolder, label: str, hold: str) -> float:
        record = folder.read_record(folder.test(self.alloy, label, hold), "pull")
        if record is None:
            raise RunFolderError(f"the test of {self.alloy} at {label} held by {hold} is not there")
        return float(record.numbers[f"peak_{LOADS[self.scene.tensile.load].reaction}"])

    def _hardenings(self) -> dict[str, Callable[[], Scene]]:
        own = self.scene.alloys[0].hardening
        names = [n for n in perilife_data.list_hardening(self.alloy) if n != own]
        return {name: partial(with_hardening, self.scene, [name]) for name in names}

    def _horizons(self) -> dict[str, Callable[[], Scene]]:
        lattice = self.scene.lattice
        found = {}
        for factor in HORIZONS:
            horizon = factor * lattice.horizon
            spacing = min(lattice.spacing, lattice.spacing * factor)
            changed = replace(lattice, spacing=spacing, horizon=horizon)
            name = f"horizon {format_length(horizon)}"
            found[name] = partial(replace, self.scene, lattice=changed)
        return found

    def sources(self, own: dict[str, float]) -> dict[str, list[Source]]:
        """Sources by way of holding; own: the strength left that the run itself found."""
        found = [
            self._source("hardening data", self._hardenings(), own),
            self._source("horizon", self._horizons(), own),
        ]
        return {hold: [source[hold] for source in found] for hold in own}

    def _source(
        self, name: str, scenes: dict[str, Callable[[], Scene]], own: dict[str, float]
    ) -> dict[str, Source]:
        """The range of the strength left over the scenes and the run itself."""
        if not scenes:
            reason = f"no other record of {self.alloy} is known"
            return {hold: Source(name, None, None, None, reason) for hold in own}
        found: dict[str, dict[str, float]] = {}
        failed: dict[str, str] = {}
        for label, changed in scenes.items():
            try:
                found[label] = self.left(changed(), label.replace(" ", "-"))
            except (ValueError, OSError, RuntimeError) as error:
                failed[label] = " ".join(str(error).split())
        sources = {}
        for hold, value in own.items():
            values = [value, *(kept[hold] for kept in found.values())]
            words = [f"{label} {100 * kept[hold]:.1f} %" for label, kept in found.items()]
            words += [f"{label} not computed ({reason})" for label, reason in failed.items()]
            deviation = half_range(values) if found else None
            ends = (min(values), max(values)) if found else (None, None)
            sources[hold] = Source(name, deviation, *ends, ", ".join(words))
        return sources
