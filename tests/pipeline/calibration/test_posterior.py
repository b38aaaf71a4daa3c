"""Posteriors against an independent sampler, and against what is known in closed form."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from pipeline.calibration.fit import CalibrationError, Measurements, Parameter, fit
from pipeline.calibration.identifiability import of_fit
from pipeline.calibration.posterior import Posterior, band, posterior
from tests.pipeline.calibration.synthetic import PARAMETERS, SCATTER, measured, model


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


@pytest.fixture(scope="module")
def fitted():
    return fit(model, measured(1), PARAMETERS)


@pytest.fixture(scope="module")
def sampled(fitted):
    return posterior(model, fitted)


def log_density(fitted):
    """Of the posterior, up to a constant, from the definition."""
    lower, upper = (np.log([getattr(p, end) for p in PARAMETERS]) for end in ("lower", "upper"))

    def density(logs):
        if (logs < lower).any() or (logs > upper).any():
            return -np.inf
        left = fitted.measurements.values - model(fitted.measurements.times, logs)[0]
        return -0.5 * np.sum((left / SCATTER) ** 2)

    return density


@pytest.mark.slow
def test_bands_are_those_of_a_plain_grid(fitted, sampled):
    density = log_density(fitted)
    lines = (np.log(np.geomspace(6e-15, 1e-13, 40)), np.log(np.geomspace(0.02, 10.0, 40)))
    logs = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.exp([density(point) + 0.5 * fitted.loss for point in logs])
    plain = band(logs, weights / weights.sum())
    difference = (band(sampled.logs, sampled.weights) - plain) / sampled.deviations()
    # of a standard deviation; measured 0.15, of which half is the plain grid of 40 points
    assert np.abs(difference).max() < 0.25
    assert (sampled.deviations() > of_fit(fitted).deviations).all()  # skewed: wider than normal


@pytest.mark.slow
def test_against_an_independent_sampler(fitted, sampled):
    emcee = pytest.importorskip("emcee")
    start = fitted.logs + 0.1 * np.random.default_rng(0).standard_normal((16, 2))
    sampler = emcee.EnsembleSampler(16, 2, log_density(fitted))
    sampler.run_mcmc(start, 2000, progress=False)
    chain = sampler.get_chain(discard=200, flat=True)
    difference = (band(sampled.logs, sampled.weights) - band(chain)) / sampled.deviations()
    assert np.abs(difference).max() < 0.3  # about 600 independent samples


def test_draws_have_the_posteriors_moments(sampled):
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
