"""Fits to synthetic data, whose constants are known."""

import numpy as np
import pytest

from pipeline.calibration.fit import CalibrationError, Measurements, Parameter, fit
from tests.pipeline.calibration.synthetic import (
    PARAMETERS,
    SCATTER,
    TRUTH,
    WEEK,
    WEEKS,
    measured,
    model,
    truth,
)


def test_noiseless_data_give_the_constants_back():
    found = fit(model, measured(), PARAMETERS, starts=50)
    assert found.values == pytest.approx(TRUTH, rel=1e-6)
    # every start of the published ranges ends at the one optimum
    assert found.reached == found.starts == 50
    assert found.loss < 1e-12 and found.at_bound == ()


def test_scattered_data_give_one_optimum_from_every_start():
    found = fit(model, measured(seed=1), PARAMETERS, starts=50)
    assert found.reached == 50
    assert 0.1 < found.loss < 20  # chi-square of three degrees of freedom
    assert found.names == ("D", "l") and found.evaluations < 2000
    step = 1e-3
    for axis in np.eye(2):
        for sign in (-1, 1):
            other = model(WEEKS, found.logs + sign * step * axis)[0]
            assert np.sum(((found.measurements.values - other) / SCATTER) ** 2) > found.loss


def test_unknown_scatter_is_estimated():
    known, unknown = (fit(model, measured(2, known=k), PARAMETERS) for k in (True, False))
    assert unknown.scatter_estimated and not known.scatter_estimated
    np.testing.assert_allclose(unknown.logs, known.logs, atol=1e-5)
    expected = np.sqrt(np.sum(known.residuals**2) / 3)
    np.testing.assert_allclose(unknown.deviations, expected, rtol=1e-4)


def test_measurements_count_by_their_deviations():
    values = measured(3).values.copy()
    values[-1] += 0.05
    careful = Measurements(WEEKS, values, np.array([0.001, 0.001, 0.001, 0.001, 0.1]))
    careless = Measurements(WEEKS, values, np.array([0.1, 0.1, 0.1, 0.1, 0.001]))
    assert abs(fit(model, careful, PARAMETERS).residuals[-1]) > 0.03
    assert abs(fit(model, careless, PARAMETERS).residuals[-1]) < 0.003


def test_an_optimum_on_a_bound_is_said():
    """As q = 0 of the source: the search ends where it may not go on."""
    narrow = (Parameter("D", 1e-15, 2.2e-16, 1e-15), PARAMETERS[1])
    assert fit(model, measured(), narrow).at_bound[0] == "D"


@pytest.mark.parametrize("value", [0.0, 0.02, 1.0])
def test_equal_measurements(value):
    """All measurements equal, nothing lost, all lost: a fit without an error or a NaN."""
    same = Measurements(WEEKS, np.full(5, value), np.full(5, 0.01))
    found = fit(model, same, PARAMETERS)
    assert np.isfinite(found.logs).all() and np.isfinite(found.predictions).all()
    if value == 0.0:
        assert found.predictions.max() < 0.01 and "D" in found.at_bound


@pytest.mark.parametrize("unit", [1e-6, 1e3])
def test_times_of_seconds_and_of_years(unit):
    times = WEEKS * unit
    values = model(WEEKS, truth())[0]
    wide = (Parameter("D", 1e-14, 1e-20, 1e-5), PARAMETERS[1])
    found = fit(model, Measurements(times, values, np.full(5, 0.01)), wide)
    assert found.values["D"] == pytest.approx(TRUTH["D"] / unit, rel=1e-6)


def test_tiny_deviations():
    exact = Measurements(WEEKS, measured().values, np.full(5, 1e-12))
    assert fit(model, exact, PARAMETERS).values == pytest.approx(TRUTH, rel=1e-6)


def test_one_measurement_determines_one_constant():
    one = measured(times=np.array([4 * WEEK]))
    only = (Parameter("D", 1e-14, 2.2e-16, 4.2e-8),)

    def held(times, logs):
        values, jacobian = model(times, np.append(logs, np.log(TRUTH["l"])))
        return values, jacobian[:, :1]

    assert fit(held, one, only).values["D"] == pytest.approx(TRUTH["D"], rel=1e-6)


@pytest.mark.parametrize(
    ("data", "free", "words"),
    [
        (measured(times=WEEKS[:1]), PARAMETERS, "1 measurements cannot determine 2"),
        (measured(known=False, times=WEEKS[:3]), PARAMETERS, "cannot be estimated"),
        (measured(), (), "no parameter is free"),
    ],
)
def test_too_little_is_refused(data, free, words):
    with pytest.raises(CalibrationError, match=words):
        fit(model, data, free)


def test_wrong_parameters_and_deviations_are_refused():
    with pytest.raises(CalibrationError, match="bounds rising"):
        Parameter("D", 1.0, 2.0, 1.0)
    with pytest.raises(CalibrationError, match="must be from"):
        Parameter("D", 3.0, 1.0, 2.0)
    with pytest.raises(CalibrationError, match="measurement 2 is 0"):
        Measurements(WEEKS[:2], np.array([0.1, 0.2]), np.array([0.01, 0.0]))
