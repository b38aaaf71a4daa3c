"""Samples of the constants of an alloy, and what a run makes of them: bands and doubts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.calibration.models import Implant, ReducedModel
from pipeline.calibration.posterior import band
from pipeline.campaigns.doubts import next_measurements, shares_of_constants
from pipeline.geometry.surface import Solid
from pipeline.record.bands import BandRow
from pipeline.record.doubts import HoldDoubts, Source
from pipeline.record.summary import SummaryRow
from pipeline.scene.resolve import NO_PARAMETERS, OWN_PARAMETERS
from pipeline.scene.scene import Scene, SceneError
from pipeline.stages.corrosion import degradation_rate

Array = NDArray[np.float64]


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
    if scene.parameter_set in (OWN_PARAMETERS, NO_PARAMETERS):
        raise SceneError(
            "--samples is given without --parameters; it must go with a set that `perilife "
            "calibrate` wrote, as --parameters fits/mine/parameters.toml"
        )
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
class Strength:
    """Strength left of the samples held in one way.

    left (n, nt): at the scene's times, 1 before immersion; error: of the way by which it was
    found, source: the same among the doubts; slope: d strength left / d volume loss at a loss
    and the last time; tests: how many mechanical tests it took.
    """

    left: Array
    error: float
    source: Source
    slope: Callable[[float], float]
    tests: int


@dataclass(frozen=True)
class Banded:
    """One alloy with its samples.

    losses (n, nt): V_L at the scene's times, time zero included; candidates (n, nw): at the weeks
    at which one more measurement is considered; strengths: by way of holding.
    """

    scene: Scene
    alloy: str
    solid: Solid
    samples: Samples
    losses: Array
    candidates: Array
    strengths: dict[str, Strength]

    def rows(self) -> list[BandRow]:
        """Bands in each way of holding at the scene's times after zero."""
        times, rows = self.scene.with_intact(), []
        rates = degradation_rate(self.losses, [m.seconds for m in times], self.solid)
        for hold, strength in self.strengths.items():
            bands = [band(values).T for values in (self.losses, rates, strength.left)]
            rows += [
                BandRow(
                    self.alloy,
                    hold,
                    moment.days,
                    *(tuple(map(float, values)) for values in found),
                    len(self.losses),
                    strength.error,
                )
                for moment, *found in zip(times, *bands, strict=True)
                if moment in self.scene.immersion and moment.seconds > 0
            ]
        return rows

    def doubts(
        self, hold: str, own: SummaryRow, others: tuple[Source, ...], scatter: float
    ) -> HoldDoubts:
        """What the samples say of the last time, beside other sources."""
        strength = self.strengths[hold]
        left = strength.left[:, -1]
        low, _, high = map(float, band(left))
        count = len(self.losses)
        measured = Source(
            "measurement and constants", float(left.std()), low, high, f"{count} samples"
        )
        shares = shares_of_constants(np.log(self.samples.values), left)
        now, after = next_measurements(self.candidates, self.losses[:, -1], left, scatter)
        return HoldDoubts(
            alloy=self.alloy,
            hold=hold,
            immersion_days=own.immersion_days,
            volume_loss=own.volume_loss,
            strength_left=own.strength_ratio,
            slope=strength.slope(own.volume_loss),
            sources=(measured, strength.source, *others),
            constants=dict(zip(self.samples.names, map(float, shares), strict=True)),
            now=now,
            after=after,
            scatter=scatter,
        )
