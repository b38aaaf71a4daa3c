"""Posteriors against an independent sampler, and against what is known in closed form."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from pipeline.calibration.fit import CalibrationError, Measurements, Parameter, fit
from pipeline.calibration.identifiability import of_fit
from pipeline.calibration.posterior import Posterior, band, posterior
from tests.pipeline.calibration.synthetic import PARAMETERS, measured, model


def linear(count):
    """A model that is linear in the logarithms: its posterior is normal."""
    matrix = np.random.default_rng(5).standard_normal((12, count))

    def predict(times, logs):
        return matrix @ logs, matrix

    times = np.arange(12.0)
    values = matrix @ np.full(count, 0.1) + 0.1 * np.random.default_rng(6).standard_normal(12)
    parameters = tuple(Parameter(f"p{i}", 1.0, 1e-6, 1e6) for i in range(count))
    return predict, parameters, times, values


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_linear_model_has_a_normal_posterior(count):
    predict, parameters, times, values = linear(count)
    found = fit(predict, Measurements(times, values, np.full(12, 0.1)), parameters)
    sampled = posterior(predict, found)
    exact = of_fit(found).deviations
    # grids: 1e-4; 4,000 weighted draws of three parameters: 3 %
    np.testing.assert_allclose(sampled.deviations(), exact, rtol=0.05 if count > 2 else 1e-3)
    np.testing.assert_allclose(sampled.mean(), found.logs, atol=0.05 * exact.max())
    assert sampled.effective > 100


def test_unknown_scatter_widens_the_posterior_to_a_student_t():
    predict, parameters, times, values = linear(1)
    found = fit(predict, Measurements(times, values), parameters)
    sampled = posterior(predict, found)
    low, _, high = band(sampled.logs[:, 0], sampled.weights)
    expected = stats.t.ppf(0.95, 11) * of_fit(found).deviations[0]
    # integrated over the scatter (prior 1/sigma) the logarithm is t-distributed, n - 1 = 11
    assert 0.5 * (high - low) == pytest.approx(expected, rel=0.01)


def test_against_an_independent_sampler():
    emcee = pytest.importorskip("emcee")
    found = fit(model, measured(1), PARAMETERS)
    grid = posterior(model, found)
    lower, upper = (np.log([getattr(p, end) for p in PARAMETERS]) for end in ("lower", "upper"))

    def density(logs):
        if (logs < lower).any() or (logs > upper).any():
            return -np.inf
        left = (found.measurements.values - model(found.measurements.times, logs)[0]) / 0.01
        return -0.5 * np.sum(left**2)

    random = np.random.default_rng(0)
    start = found.logs + 0.1 * random.standard_normal((16, 2))
    np.random.seed(0)
    sampler = emcee.EnsembleSampler(16, 2, density)
    sampler.run_mcmc(start, 400, progress=False)
    chain = sampler.get_chain(discard=100, flat=True)
    # 4,800 steps with a correlation time of about 30 know a quantile to a tenth of a deviation
    bands = band(grid.logs, grid.weights), band(chain)
    assert np.abs((bands[0] - bands[1]) / grid.deviations()).max() < 0.3  # measured 0.1
    assert (grid.deviations() > of_fit(found).deviations).all()  # skewed: wider than normal


def test_draws_have_the_posteriors_moments():
    found = fit(model, measured(1), PARAMETERS)
    sampled = posterior(model, found)
    drawn = sampled.draw(2000)
    np.testing.assert_allclose(drawn.mean(axis=0), sampled.mean(), atol=0.02)
    np.testing.assert_allclose(drawn.std(axis=0), sampled.deviations(), rtol=0.05)
    assert np.array_equal(drawn, sampled.draw(2000))


def test_open_directions_and_few_effective_samples_are_refused(monkeypatch):
    predict, parameters, times, values = linear(3)

    def blind(times, logs):
        predictions, jacobian = predict(times, logs)
        return predictions - jacobian[:, 2] * logs[2], jacobian * [1.0, 1.0, 0.0]

    found = fit(predict, Measurements(times, values, np.full(12, 0.1)), parameters)
    closed = dataclasses.replace(found, jacobian=found.jacobian * [1.0, 1.0, 0.0])
    with pytest.raises(CalibrationError, match="leave a direction"):
        posterior(blind, closed)
    wrong = dataclasses.replace(found, jacobian=1e-3 * found.jacobian)  # a thousand times too wide
    with pytest.raises(CalibrationError, match="effective sample size"):
        posterior(predict, wrong)


def test_bands_are_weighted_quantiles():
    values = np.arange(1000.0)
    np.testing.assert_allclose(band(values), [49.5, 499.5, 949.5], atol=0.6)
    heavy = np.where(values < 500, 3.0, 1.0)
    assert band(values, heavy / heavy.sum())[1] == pytest.approx(333, abs=1)
    assert band(np.stack([values, 2 * values], axis=1)).shape == (3, 2)
    single = Posterior(("a",), np.zeros((1, 1)), np.ones(1))
    assert single.effective == 1.0 and single.draw(3).tolist() == [[0.0]] * 3
