"""Strength over volume loss from few tests, on the curve measured for Mg-5Gd's screw."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pipeline.calibration.strength_curve import StrengthCurve, strength_curve

# nine pulls of the quick screw, Mg-5Gd: volume loss and strength left
LOSSES = np.array([0.0, 4.67, 7.55, 11.22, 13.65, 15.46, 18.07, 20.72, 22.61]) / 100
STRENGTHS = np.array([100.0, 94.5, 91.6, 88.0, 85.6, 83.8, 81.0, 78.3, 76.3]) / 100
screw = CubicSpline(LOSSES, STRENGTHS)


def pull(losses):
    return [float(screw(v)) for v in losses]


def test_a_point_left_out_is_met_within_the_stated_error():
    curve = StrengthCurve(LOSSES, STRENGTHS)
    assert curve.error() < 0.002  # measured 0.16 %-points, the strengths being rounded to 0.1
    assert 0.185 < curve.loss_at(0.8) < 0.195
    assert np.all(curve.slope(np.linspace(0.01, 0.22, 20)) < 0)


@pytest.mark.parametrize("tolerance", [0.01, 0.001])
def test_tests_are_added_until_the_tolerance_holds(tolerance):
    curve = strength_curve(pull, 0.226, tolerance)
    fine = np.linspace(0, 0.226, 200)
    assert curve.error() <= tolerance
    # between tests the error may be larger than at those left out: measured 1.24 times
    assert np.abs(curve(fine) - screw(fine)).max() <= 1.5 * tolerance
    assert len(curve.losses) <= (5 if tolerance == 0.01 else 12)


def test_tests_are_added_where_the_curve_bends():
    curve = strength_curve(lambda v: list(np.exp(-np.array(v) / 0.05)), 0.4, 0.02)
    spread = np.diff(curve.losses)
    assert spread[0] == spread.min() < 0.2 * spread[-1]


def test_a_curve_that_begins_later_spends_no_tests_on_the_first_damage():
    """A drop of 6 % at once, as of a bar pulled by its end faces."""
    asked = []

    def bar(losses):
        asked.append(list(losses))
        return [500.0 * (1 - 0.06 * min(1.0, (v / 0.01) ** 0.5) - 2.5 * v) for v in losses]

    with pytest.raises(ValueError, match="12 tests leave an error"):
        strength_curve(bar, 0.3, 0.002)
    asked.clear()
    curve = strength_curve(bar, 0.3, 0.002, smallest_loss=0.1)
    assert asked == [[0.0, *np.linspace(0.1, 0.3, 4)]] and curve.whole == 500.0
    assert curve.left([0.2]) == pytest.approx([1 - 0.06 - 0.5])
    with pytest.raises(ValueError, match="range of the strength curve"):
        curve(0.05)
    # all at one loss: a curve still has an extent
    assert strength_curve(bar, 0.3, 0.01, smallest_loss=0.3).losses[0] == pytest.approx(0.24)
    with pytest.raises(ValueError, match="does not begin at no loss"):
        StrengthCurve(np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.8, 0.7]))


def test_what_no_curve_answers_is_refused():
    curve = StrengthCurve(LOSSES, STRENGTHS)
    with pytest.raises(ValueError, match="range of the strength curve"):
        curve(0.3)
    assert np.isnan(curve.loss_at(0.5)) and curve.loss_at(1.0) == 0.0
    with pytest.raises(ValueError, match="must be above 0"):
        strength_curve(pull, 0.0)
    random = np.random.default_rng(0)
    with pytest.raises(ValueError, match="tests leave an error"):
        strength_curve(lambda v: list(1 - 0.3 * random.random(len(v))), 0.2, 1e-4)
    with pytest.raises(ValueError, match="three volume losses"):
        StrengthCurve(np.array([0.0, 0.1]), np.array([1.0, 0.9]))
