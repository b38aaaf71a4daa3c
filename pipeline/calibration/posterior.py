"""What the measurements leave open, as weighted samples of the parameters.

The prior is flat in the logarithms within the bounds.  One or two parameters: a grid; more:
importance sampling from a Student t about the Gaussian approximation at the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import multivariate_t

from pipeline.calibration.fit import CalibrationError, Fit, Model

Array = NDArray[np.float64]

LEVELS = (0.05, 0.5, 0.95)
"""Of the bands that summaries, reports and plots show."""

LEAST_EFFECTIVE = 100
"""Effective samples below which a posterior is refused: the ends of a band would be chance."""

_GRID = {1: 1001, 2: 60}
"""Grid points per parameter."""

_EDGE = 1e-3
"""Density over its largest value at which the grid may end: what lies beyond is a tail of a few
thousandths, which the bands of 5 to 95 % do not see."""

_COARSE = 13
"""Grid points per parameter of the search for where the density ends."""

_EXTENSIONS = 15  # by a quarter each: from 4 to 114 standard deviations

_DRAWS = 4000
_FREEDOM = 4  # degrees of freedom of the proposal: its tails are heavier than the posterior's


@dataclass(frozen=True)
class Posterior:
    """Weighted samples: logs (n, np) by parameter name, weights (n,) that sum to 1."""

    names: tuple[str, ...]
    logs: Array
    weights: Array

    @property
    def effective(self) -> float:
        """Effective number of samples, 1 / sum w^2."""
        return float(1.0 / np.sum(self.weights**2))

    def mean(self) -> Array:
        """Mean of the logarithms (np,)."""
        return self.weights @ self.logs

    def deviations(self) -> Array:
        """Standard deviations of the logarithms (np,)."""
        return np.sqrt(self.weights @ (self.logs - self.mean()) ** 2)

    def draw(self, count: int, seed: int = 0) -> Array:
        """`count` samples of equal weight (count, np), by systematic resampling."""
        offset = np.random.default_rng(seed).random()
        places = (np.arange(count) + offset) / count
        order = np.lexsort(self.logs.T[::-1])
        chosen = np.searchsorted(np.cumsum(self.weights[order]), places)
        return self.logs[order][np.minimum(chosen, len(order) - 1)]


def posterior(model: Model, result: Fit, *, seed: int = 0) -> Posterior:
    """The posterior of a fit's free parameters, all of which the data must determine.

    Standard deviations that were estimated from the residuals are integrated out (a Student t
    instead of a normal distribution), those that were given are taken as known.

    Raises
    ------
    CalibrationError
        Where the effective number of samples is below `LEAST_EFFECTIVE`.
    """
    density = _Density(model, result)
    fisher = result.fisher()
    values, vectors = np.linalg.eigh(fisher)
    if values.min() <= 1e-14 * values.max():
        raise CalibrationError(
            "the data leave a direction of the parameters open, so there is no posterior; fix "
            "what is not identified first"
        )
    axes = vectors / np.sqrt(values)  # one standard deviation each, in columns
    count = len(result.logs)
    found = _grid(density, axes) if count in _GRID else _importance(density, axes, seed)
    if found.effective < LEAST_EFFECTIVE:
        raise CalibrationError(
            f"the posterior of {', '.join(found.names)} has an effective sample size of "
            f"{found.effective:.0f}; it must be at least {LEAST_EFFECTIVE}"
        )
    return found


class _Density:
    """Logarithm of the posterior density, up to a constant."""

    def __init__(self, model: Model, result: Fit):
        self.model, self.result = model, result
        self.lower = np.log([p.lower for p in result.parameters])
        self.upper = np.log([p.upper for p in result.parameters])
        self.best = self.of(np.clip(result.logs, self.lower, self.upper))

    def of(self, logs: Array) -> float:
        if (logs < self.lower).any() or (logs > self.upper).any():
            return -np.inf
        result = self.result
        predictions, _ = self.model(result.measurements.times, logs)
        squares = float(
            np.sum(((result.measurements.values - predictions) / result.deviations) ** 2)
        )
        if not result.scatter_estimated:
            return -0.5 * squares
        return -0.5 * len(predictions) * np.log(max(squares, 1e-300))


def _grid(density: _Density, axes: Array) -> Posterior:
    """Even points along the principal axes, as far as there is any density."""
    centre, dimension = density.result.logs, len(axes)

    def evaluated(reach: Array, points: int) -> tuple[Array, Array]:
        lines = [np.linspace(-low, high, points) for low, high in reach]
        steps = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
        logs = centre + steps @ axes.T
        values = np.apply_along_axis(density.of, -1, logs)
        return logs, np.exp(values - values.max())

    reach = np.full((dimension, 2), 4.0)
    for _ in range(_EXTENSIONS):
        weights = evaluated(reach, _COARSE)[1]
        ends = np.array([[np.take(weights, n, a).max() for n in (0, -1)] for a in range(dimension)])
        if not (ends > _EDGE).any():
            break
        reach = np.where(ends > _EDGE, 1.25 * reach, reach)
    logs, weights = evaluated(reach, _GRID[dimension])
    kept = weights > 1e-12
    return Posterior(density.result.names, logs[kept], weights[kept] / weights[kept].sum())


def _importance(density: _Density, axes: Array, seed: int) -> Posterior:
    """Draws of a multivariate t, weighted by density over proposal."""
    proposal = multivariate_t(density.result.logs, axes @ axes.T, _FREEDOM, seed=seed)
    logs = np.atleast_2d(proposal.rvs(_DRAWS))
    values = np.array([density.of(point) for point in logs]) - proposal.logpdf(logs)
    weights = np.exp(values - values.max())
    kept = weights > 1e-12
    return Posterior(density.result.names, logs[kept], weights[kept] / weights[kept].sum())


def gaussian(result: Fit, covariance: Array, count: int, seed: int = 0) -> Posterior:
    """`count` draws of the Gaussian approximation less those beyond the bounds of the search."""
    random = np.random.default_rng(seed)
    logs = random.multivariate_normal(result.logs, covariance, count)
    lower = np.log([p.lower for p in result.parameters])
    upper = np.log([p.upper for p in result.parameters])
    kept = logs[((logs >= lower) & (logs <= upper)).all(axis=1)]
    return Posterior(result.names, kept, np.full(len(kept), 1.0 / len(kept)))


def band(values: ArrayLike, weights: Array | None = None, levels=LEVELS) -> Array:
    """Weighted quantiles of samples along the first axis: (n, ...) to (levels, ...)."""
    values = np.asarray(values, float)
    if weights is None:
        weights = np.full(len(values), 1.0 / len(values))
    flat = values.reshape(len(values), -1)
    out = np.empty((len(levels), flat.shape[1]))
    for column in range(flat.shape[1]):
        order = np.argsort(flat[:, column], kind="stable")
        middle = np.cumsum(weights[order]) - 0.5 * weights[order]
        out[:, column] = np.interp(levels, middle, flat[order, column])
    return out.reshape(len(levels), *values.shape[1:])
