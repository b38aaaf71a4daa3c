"""One alloy in two media: may they share l, and how do their rates compare over time?

Two fits that share nothing are compared with one that shares l by their likelihoods.  The ratio of
the degradation rates of one solid, (5.34) of Hermann 2024, is that of its volume losses: a curve
over time, never one constant, and not the ratio of the diffusivities.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from pipeline.calibration.calibrate import SAMPLES, Calibrated
from pipeline.calibration.fit import CalibrationError, Fit, Measurements, Model, Parameter, fit
from pipeline.calibration.identifiability import of_fit
from pipeline.calibration.models import ReducedModel
from pipeline.calibration.posterior import LEVELS, Posterior, band, gaussian, posterior
from pipeline.record.run_folder import write_json, write_text

Array = NDArray[np.float64]

SHARED = "volume_loss_scale"
SPEED = "interface_diffusivity"
LEAST_PROBABILITY = 0.05
"""Of data that differ as much if l is shared: below it, l is said to differ."""

RATIO_FILE = "ratio.csv"
JSON_FILE = "media.json"


@dataclass(frozen=True)
class Comparison:
    """Two media, the first over the second.

    names: of the media; excess: how much the loss grows if l is shared (chi-square distributed
    with one degree of freedom if it is), probability: of at least that much; shared: the fit that
    shares l, its posterior of all constants; times (nt,) s; ratio (levels, nt): bands of the ratio
    of the rates; speed (levels,): of the ratio of D_int, None where a medium does not determine it.
    """

    names: tuple[str, str]
    excess: float
    probability: float
    shared: Fit
    times: Array
    ratio: Array
    speed: Array | None

    @property
    def may_share(self) -> bool:
        """Whether the data allow one l for both media."""
        return self.probability >= LEAST_PROBABILITY

    def lines(self) -> list[str]:
        """The comparison for a person."""
        first, second = self.names
        verdict = "may share l" if self.may_share else "do not share l"
        shared = self.shared.values[SHARED]
        lines = [
            f"{first} and {second} {verdict}: with one l (best {shared:.4g}) the loss grows by "
            f"{self.excess:.3g}, as much or more in {100 * self.probability:.2g} % of such data",
            f"rate {first} over {second}, {LEVELS[0]:.0%}, {LEVELS[1]:.0%}, {LEVELS[2]:.0%}:",
        ]
        for time, (low, middle, high) in zip(self.times, self.ratio.T, strict=True):
            days = time / 86400.0
            lines.append(f"  after {days:5.4g} days: {low:.3f} {middle:.3f} {high:.3f}")
        if self.speed is not None:
            low, middle, high = self.speed
            lines.append(f"  beside it D_int over D_int: {low:.3g} {middle:.3g} {high:.3g}")
        return lines


def compare(found: Mapping[str, Calibrated], times: Array) -> Comparison:
    """Compare the fits of two media at times (s, > 0).

    Raises CalibrationError for other than two media, or one that does not determine l.
    """
    if len(found) != 2:
        raise CalibrationError(f"{len(found)} media were given; they must be two")
    for name, one in found.items():
        if SHARED not in one.result.names:
            raise CalibrationError(
                f"{name}: its data do not determine l; both media must, to see whether they share "
                "it"
            )
    joint = _Joint(found)
    separate = sum(one.result.loss for one in found.values())
    shared = joint.fit()
    excess = max(0.0, shared.loss - separate)
    probability = float(chi2.sf(excess, 1))
    draws: list[Array]
    if probability >= LEAST_PROBABILITY:
        of_both = joint.posterior(shared).draw(SAMPLES)
        draws = [of_both[:, places] for places in joint.places]
    else:  # independent: shuffled, since draws are sorted
        random = np.random.default_rng(0)
        draws = [random.permutation(one.posterior.draw(SAMPLES)) for one in found.values()]
    losses = [_losses(one, logs, times) for one, logs in zip(found.values(), draws, strict=True)]
    speeds = [
        logs[:, one.result.names.index(SPEED)]
        for one, logs in zip(found.values(), draws, strict=True)
        if SPEED in one.result.names
    ]
    speed = band(np.exp(speeds[0] - speeds[1])) if len(speeds) == 2 else None
    names = tuple(found)
    return Comparison(
        (names[0], names[1]), excess, probability, shared, times, band(losses[0] / losses[1]), speed
    )


def _losses(one: Calibrated, logs: Array, times: Array) -> Array:
    """V_L (n, nt) of samples: the reduced model's own, or linear about the optimum of marches."""
    if isinstance(one.model, ReducedModel):
        return np.array([one.model(times, row)[0] for row in logs])
    value, jacobian = one.model(times, one.result.logs)
    grown = (logs - one.result.logs) @ (jacobian / value[:, None]).T
    return value * np.exp(grown)


class _Joint:
    """Both media as one model whose last parameter is the shared l."""

    def __init__(self, found: Mapping[str, Calibrated]):
        self.found = list(found.values())
        self.parameters: list[Parameter] = []
        self.places: list[list[int]] = []  # of each medium's constants among those of both
        for name, one in found.items():
            own = [p for p in one.result.parameters if p.name != SHARED]
            start = len(self.parameters)
            rest = iter(range(start, start + len(own)))
            self.places.append([-1 if n == SHARED else next(rest) for n in one.result.names])
            self.parameters += [replace(p, name=f"{p.name} {name}") for p in own]
        scales = [next(p for p in one.result.parameters if p.name == SHARED) for one in self.found]
        middle = float(np.sqrt(scales[0].value * scales[1].value))
        self.parameters.append(replace(scales[0], value=middle))
        results = [one.result for one in self.found]
        self.measurements = Measurements(
            np.concatenate([r.measurements.times for r in results]),
            np.concatenate([r.measurements.values for r in results]),
            np.concatenate([r.deviations for r in results]),
        )

    def model(self) -> Model:
        """Predictions of all measurements; the times are those of the measurements."""

        def predict(times: Array, logs: Array) -> tuple[Array, Array]:
            values, rows = [], []
            for places, one in zip(self.places, self.found, strict=True):
                own = one.result.measurements.times
                value, slopes = one.model(own, logs[places])
                jacobian = np.zeros((len(own), len(logs)))
                jacobian[:, places] = slopes
                values.append(value)
                rows.append(jacobian)
            return np.concatenate(values), np.concatenate(rows)

        return predict

    def fit(self) -> Fit:
        """The best constants with one l; from where the separate fits ended."""
        return fit(self.model(), self.measurements, self.parameters, starts=1)

    def posterior(self, shared: Fit) -> Posterior:
        """That of all constants: importance sampling, or the Gaussian where it takes marches."""
        if all(isinstance(one.model, ReducedModel) for one in self.found):
            return posterior(self.model(), shared)
        return gaussian(shared, of_fit(shared).covariance, 10 * SAMPLES)


def write_comparison(out: Path, found: Comparison) -> tuple[Path, Path]:
    """Write ratio.csv and media.json; returns their paths."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    levels = [f"{100 * level:g}" for level in LEVELS]
    writer.writerow(["immersion_days", *(f"rate_ratio_{level}" for level in levels)])
    for time, values in zip(found.times, found.ratio.T, strict=True):
        writer.writerow([f"{v:.10g}" for v in (time / 86400.0, *values)])
    paths = out / RATIO_FILE, out / JSON_FILE
    write_text(paths[0], buffer.getvalue())
    write_json(
        paths[1],
        {
            "media": list(found.names),
            "loss_growth_if_l_is_shared": found.excess,
            "probability_of_as_much_if_shared": found.probability,
            "may_share_l": found.may_share,
            "shared_fit": found.shared.values,
            "levels": list(LEVELS),
            "times_s": found.times.tolist(),
            "rate_ratio": found.ratio.tolist(),
            "interface_diffusivity_ratio": None if found.speed is None else found.speed.tolist(),
        },
    )
    return paths
