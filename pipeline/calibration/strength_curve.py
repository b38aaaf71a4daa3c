"""The strength left as a function of the volume loss alone, from a few mechanical tests.

In clean liquid the damage is a one-parameter family, C = C_solid exp(-mu z): whatever the rate and
the time, equal volume loss means equal damage and equal strength.  A few tests at chosen volume
losses and a monotone interpolation then give the strength of every sample of the parameters.  Where
the liquid slows the rate this does not hold, and the caller must not use it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]

FIRST = 4
"""Tests that a curve begins with; three leave one error only to judge by."""

MOST = 12

_NARROWEST = 0.8
"""Of the largest loss, at which a curve begins at the latest."""


@dataclass(frozen=True)
class StrengthCurve:
    """Strength at volume losses (both (n,), the losses rising), interpolated in between.

    intact: strength of the intact solid, by default that at the first loss, which then must be 0.
    """

    losses: Array
    strengths: Array
    intact: float | None = None

    def __post_init__(self) -> None:
        if len(self.losses) < 3 or not (np.diff(self.losses) > 0).all():
            raise ValueError("losses: a curve needs three volume losses at least, rising")
        if self.intact is None and self.losses[0] != 0:
            raise ValueError("intact: it must be given for a curve that does not begin at no loss")

    @property
    def whole(self) -> float:
        """Strength of the intact solid."""
        return float(self.strengths[0]) if self.intact is None else self.intact

    def left(self, losses: ArrayLike) -> Array:
        """Strength at volume losses over that of the intact solid."""
        return self(losses) / self.whole

    def __call__(self, losses: ArrayLike) -> Array:
        """Strength at volume losses within the curve's range; ValueError outside."""
        losses = np.asarray(losses, float)
        low, high = self.losses[[0, -1]]
        if losses.size and not (losses.min() >= low - 1e-9 and losses.max() <= high + 1e-9):
            raise ValueError(
                f"volume loss {100 * losses.min():.3g} to {100 * losses.max():.3g} % leaves the "
                f"range of the strength curve, {100 * low:.3g} to {100 * high:.3g} %"
            )
        return self._interpolant()(np.clip(losses, low, high))

    def slope(self, losses: ArrayLike) -> Array:
        """d strength / d volume loss."""
        return self._interpolant().derivative()(np.asarray(losses, float))

    def leave_one_out(self) -> Array:
        """Error at each inner point of the curve through all others (n - 2,)."""
        inner = range(1, len(self.losses) - 1)
        return np.array([self._without(i)(self.losses[i]) - self.strengths[i] for i in inner])

    def error(self) -> float:
        """Largest leave-one-out error relative to the intact strength.

        It is that of a curve with one test fewer, so the curve itself is better.
        """
        return float(np.abs(self.leave_one_out()).max() / self.whole)

    def loss_at(self, strength: float) -> float:
        """The volume loss at which the strength has fallen to `strength`; NaN where it has not."""
        fine = np.linspace(*self.losses[[0, -1]], 4001)
        below = np.flatnonzero(self(fine) <= strength)
        if not below.size:
            return float("nan")
        n = below[0]
        if n == 0:
            return float(fine[0])
        ends = self(fine[n - 1 : n + 1])
        return float(np.interp(-strength, -ends, fine[n - 1 : n + 1]))

    def _interpolant(self) -> PchipInterpolator:
        return PchipInterpolator(self.losses, self.strengths)

    def _without(self, index: int) -> PchipInterpolator:
        return PchipInterpolator(np.delete(self.losses, index), np.delete(self.strengths, index))


def strength_curve(
    test: Callable[[list[float]], list[float]],
    largest_loss: float,
    tolerance: float = 0.01,
    most: int = MOST,
    smallest_loss: float = 0.0,
) -> StrengthCurve:
    """Test until the leave-one-out error is within the tolerance.

    test: volume losses to strengths (several at once, to run side by side); largest_loss: where
    the curve ends; tolerance: relative to the intact strength; smallest_loss: where the curve
    begins.  Above 0 the intact solid is tested beside the curve, which then spends no tests on
    what the first damage does: the neck of a bar pulled by its ends moves there at once.

    Raises
    ------
    ValueError
        For a largest loss that is not above 0, or where `most` tests do not reach the tolerance.
    """
    if not 0 < largest_loss <= 1:
        raise ValueError(f"largest volume loss is {largest_loss:g}; it must be above 0, at most 1")
    smallest_loss = min(smallest_loss, _NARROWEST * largest_loss)
    losses = list(np.linspace(smallest_loss, largest_loss, FIRST))
    intact = [] if smallest_loss == 0 else [0.0]
    strengths = list(test([*intact, *losses]))
    whole = float(strengths[0])
    strengths = strengths[len(intact) :]
    while True:
        curve = StrengthCurve(np.array(losses), np.array(strengths), whole)
        if curve.error() <= tolerance:
            return curve
        if len(losses) >= most:
            raise ValueError(
                f"strength curve: {most} tests leave an error of {100 * curve.error():.2g} %; "
                f"it must be at most {100 * tolerance:.2g} %"
            )
        worst = 1 + int(np.argmax(np.abs(curve.leave_one_out())))
        before, after = np.diff(losses[worst - 1 : worst + 2])
        wider = worst if after > before else worst - 1
        losses.insert(wider + 1, 0.5 * (losses[wider] + losses[wider + 1]))
        strengths.insert(wider + 1, test([losses[wider + 1]])[0])
