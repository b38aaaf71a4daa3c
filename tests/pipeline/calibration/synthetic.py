"""A synthetic implant whose volume loss is known for any constants; nothing here was measured."""

import math

import numpy as np

from peri.omissions.reduced import RateFactor, ReducedCorrosion
from pipeline.calibration.fit import Measurements, Parameter

WEEK = 7 * 86400.0
WEEKS = np.array([1.0, 2.0, 3.0, 4.0, 8.0]) * WEEK
"""When the published experiments measured (Hermann 2024, 5.1)."""

TRUTH = {"D": 1.5e-14, "l": 0.25}
SCATTER = 0.01  # one %-point of the volume
PARAMETERS = (Parameter("D", 1e-14, 2.2e-16, 4.2e-8), Parameter("l", 0.1, 0.01, 10.0))


def implant() -> ReducedCorrosion:
    """Metal of which three quarters are within reach of the liquid, over three decades of rates."""
    random = np.random.default_rng(3)
    sums = np.concatenate([10.0 ** random.uniform(5.0, 8.0, 300), np.zeros(100)])
    return ReducedCorrosion(sums, np.ones(400))


_IMPLANT = implant()


def model(times, logs):
    """V_L and its derivatives for ln D and ln l."""
    diffusivity, length = np.exp(logs)

    def factor(loss):
        value = 10.0 ** (-loss / length)
        return RateFactor(value, {"length": value * math.log(10) * loss / length**2})

    found = _IMPLANT.volume_loss(times, diffusivity, factor)
    slopes = found.slopes
    jacobian = np.stack([slopes["diffusivity"] * diffusivity, slopes["length"] * length], axis=1)
    return found.value, jacobian


def truth() -> np.ndarray:
    """Logarithms of the constants behind the synthetic data."""
    return np.log(list(TRUTH.values()))


def measured(seed=None, scatter=SCATTER, known=True, times=WEEKS) -> Measurements:
    """Volume losses with normal scatter (none where seed is None)."""
    values = model(times, truth())[0]
    if seed is not None:
        values = values + scatter * np.random.default_rng(seed).standard_normal(len(times))
    return Measurements(times, values, np.full(len(times), scatter) if known else None)
