"""Kriging: its errors are what it says they are, and it does not leave its box."""

import numpy as np
import pytest

pytest.importorskip("sklearn")

from pipeline.calibration.fit import CalibrationError
from pipeline.calibration.surrogate import Box, Surrogate, design
from tests.pipeline.calibration.synthetic import WEEK, model

BOX = Box(("D", "l"), (1e-17, 0.05), (1e-12, 1.0))


def losses(points):
    """V_L after eight weeks."""
    return np.array([model(np.array([8 * WEEK]), np.log(p))[0][0] for p in np.atleast_2d(points)])


@pytest.fixture(scope="module")
def checks():
    points = BOX.values(np.random.default_rng(7).random((200, 2)))
    return points, losses(points)


def test_errors_are_near_those_of_leaving_one_out(checks):
    points = design(BOX, 30)
    surrogate = Surrogate(BOX, points, losses(points))
    found = surrogate.leave_one_out()
    worst = np.abs(surrogate(checks[0])[0] - checks[1]).max()
    assert np.ptp(checks[1]) > 0.25
    assert found.mean < 2e-3 and found.worst < 0.03
    assert worst < 3 * found.worst
    np.testing.assert_allclose(surrogate(points)[0], losses(points), atol=1e-4)


def test_leaving_one_out_in_closed_form_is_a_fit_without_the_point():
    points = design(BOX, 12)
    values = losses(points)
    surrogate = Surrogate(BOX, points, values)
    closed = surrogate.leave_one_out().errors
    kernel = surrogate._process.kernel_
    for n in range(3):
        rest = np.delete(np.arange(12), n)
        inputs = BOX.scaled(points)
        matrix = kernel(inputs[rest]) + 1e-10 * np.eye(11)
        scaled = (values - values.mean()) / values.std()
        predicted = kernel(inputs[[n]], inputs[rest]) @ np.linalg.solve(matrix, scaled[rest])
        assert closed[n] == pytest.approx(values.std() * (scaled[n] - predicted[0]), rel=1e-3)


def test_ranges_as_printed_hide_a_worst_case(checks):
    """Scaled linearly, thirty points lie at large D only, and small D is anyone's guess."""
    random = np.random.default_rng(0)
    points = random.uniform(BOX.lower, BOX.upper, (30, 2))
    surrogate = Surrogate(BOX, points, losses(points), logarithms=False)
    worst = np.abs(surrogate(checks[0])[0] - checks[1]).max()
    assert worst > 0.15


def test_a_cheap_model_leaves_less_to_learn(checks):
    points = design(BOX, 15)
    plain = Surrogate(BOX, points, losses(points))
    helped = Surrogate(BOX, points, losses(points), cheap=lambda p: 0.95 * losses(p))
    errors = [np.abs(s(checks[0])[0] - checks[1]).max() for s in (plain, helped)]
    assert errors[1] < 0.3 * errors[0]


def test_a_surrogate_does_not_leave_its_box():
    points = design(BOX, 10)
    surrogate = Surrogate(BOX, points, losses(points))
    with pytest.raises(CalibrationError, match="D is 1e-11; the surrogate holds from 1e-17"):
        surrogate([1e-11, 0.1])
    with pytest.raises(CalibrationError, match="range of D"):
        Box(("D",), (1.0,), (0.5,))


def test_designs_fill_the_box_evenly_in_the_logarithms():
    scaled = np.sort(BOX.scaled(design(BOX, 20)), axis=0)
    # one point in each twentieth of each range
    assert np.array_equal(np.floor(20 * scaled).astype(int), np.stack([np.arange(20)] * 2, axis=1))
