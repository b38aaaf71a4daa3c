"""Least squares in logarithms: from measured volume losses to the constants of a law.

A model is any callable that turns times and the logarithms of its parameters into predictions and
their derivatives; nothing here knows what the parameters mean.  The loss is the plain sum of
squares of (5.15) weighted by the measurements' standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import qmc

Array = NDArray[np.float64]

Model = Callable[[Array, Array], tuple[Array, Array]]
"""Times (nt,) in s and logarithms (np,) to predictions (nt,) and their derivatives (nt, np)."""

STARTS = 12
"""Searches of a fit; 50 of 50 end at one optimum (`perilife bench calibration`)."""

_AT_BOUND = 1e-3
"""Distance in ln at which an optimum counts as lying on its bound."""

_SAME = 1e-6
"""Relative difference of the loss (or absolute, of weighted squares) of two equal optima."""


_FLAT = 1e-2
"""Gradient (in ln) over the best start's loss below which a start lies on a plateau."""


class CalibrationError(ValueError):
    """Data that do not allow what was asked; the message is one sentence."""


@dataclass(frozen=True)
class Parameter:
    """A positive parameter with the bounds of the search, and where the search begins (SI)."""

    name: str
    value: float
    lower: float
    upper: float
    unit: str = "1"

    def __post_init__(self) -> None:
        finite = all(np.isfinite(v) and v > 0 for v in (self.value, self.lower, self.upper))
        if not finite or not self.lower < self.upper:
            raise CalibrationError(
                f"parameter {self.name} is {self.value:g} within {self.lower:g} to "
                f"{self.upper:g}; all three must be positive and finite, the bounds rising"
            )
        if not self.lower <= self.value <= self.upper:
            raise CalibrationError(
                f"parameter {self.name} is {self.value:g}; it must be from {self.lower:g} to "
                f"{self.upper:g}"
            )


@dataclass(frozen=True)
class Measurements:
    """Measured values at times.

    times (n,) in s; values (n,); deviations (n,): their standard deviations, or None.
    """

    times: Array
    values: Array
    deviations: Array | None = None

    def __post_init__(self) -> None:
        if self.deviations is None:
            return
        wrong = np.flatnonzero(~(self.deviations > 0))
        if wrong.size:
            raise CalibrationError(
                f"standard deviation of measurement {int(wrong[0]) + 1} is "
                f"{self.deviations[wrong[0]]:g}; it must be above 0, or be left out for all"
            )


@dataclass(frozen=True)
class Fit:
    """An optimum.

    parameters: the free ones, with `value` at the optimum; logs (np,); predictions, residuals
    (measured less predicted) (n,) and jacobian (n, np) (d prediction/d ln p) there; deviations
    (n,): of the measurements, as given or estimated; loss: sum of squared residuals over
    deviations; at_bound: names of the parameters whose optimum is a bound; evaluations: of the
    model in all; reached, starts: how many searches ended at this optimum, of how many.
    """

    measurements: Measurements
    parameters: tuple[Parameter, ...]
    logs: Array
    predictions: Array
    residuals: Array
    jacobian: Array
    deviations: Array
    scatter_estimated: bool
    loss: float
    at_bound: tuple[str, ...]
    evaluations: int
    reached: int
    starts: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def values(self) -> dict[str, float]:
        """Value of each free parameter at the optimum (SI)."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def fisher(self) -> Array:
        """Fisher information of the logarithms at the optimum, (np, np)."""
        weighted = self.jacobian / self.deviations[:, None]
        return weighted.T @ weighted


def fit(
    model: Model,
    measurements: Measurements,
    parameters: Sequence[Parameter],
    *,
    starts: int = STARTS,
    seed: int = 0,
) -> Fit:
    """The parameters that meet the measurements best, by a trust region from several starts.

    The first start is the parameters' own values, the others are a Latin hypercube in the
    logarithms of the bounds.  Without standard deviations all measurements count alike and the
    scatter is estimated from what the fit leaves, sqrt(RSS/(n - np)).

    Raises
    ------
    CalibrationError
        For no parameter, fewer measurements than parameters, or, without standard deviations,
        fewer than two measurements more than parameters.
    """
    count, free = len(measurements.times), len(parameters)
    if not free:
        raise CalibrationError("no parameter is free; at least one must be")
    if count < free:
        raise CalibrationError(
            f"{count} measurements cannot determine {free} parameters "
            f"({', '.join(p.name for p in parameters)}); they must be as many, or some be fixed"
        )
    if measurements.deviations is None and count < free + 2:
        raise CalibrationError(
            f"the scatter of {count} measurements with {free} free parameters cannot be estimated; "
            f"give standard deviations, or at least {free + 2} measurements"
        )
    lower = np.log([p.lower for p in parameters])
    upper = np.log([p.upper for p in parameters])
    first = np.clip(np.log([p.value for p in parameters]), lower, upper)
    deviations = measurements.deviations
    weights = np.ones(count) if deviations is None else 1.0 / deviations
    search = _Search(model, measurements, weights)
    places = [first]
    if starts > 1:
        cube = qmc.LatinHypercube(free, seed=seed).random(starts - 1)
        places += list(qmc.scale(cube, lower, upper))
        places = search.off_plateaus(places)
    ends = [search.run(place, lower, upper) for place in places]
    best = min(ends, key=lambda end: end.cost)
    reached = sum(end.cost - best.cost <= _SAME * max(best.cost, _SAME) for end in ends)
    predictions, jacobian = search.evaluate(best.x)
    residuals = measurements.values - predictions
    estimated = deviations is None
    if deviations is None:
        scatter = np.sqrt(np.sum(residuals**2) / (count - free))
        deviations = np.full(count, max(scatter, 1e-12))
    near = np.minimum(best.x - lower, upper - best.x) < _AT_BOUND
    return Fit(
        measurements=measurements,
        parameters=tuple(
            replace(p, value=float(np.clip(np.exp(x), p.lower, p.upper)))
            for p, x in zip(parameters, best.x, strict=True)
        ),
        logs=best.x,
        predictions=predictions,
        residuals=residuals,
        jacobian=jacobian,
        deviations=deviations,
        scatter_estimated=estimated,
        loss=float(np.sum((residuals / deviations) ** 2)),
        at_bound=tuple(p.name for p, at in zip(parameters, near, strict=True) if at),
        evaluations=search.evaluations,
        reached=int(reached),
        starts=len(ends),
    )


class _Search:
    """Residuals and their derivatives, the last point remembered."""

    def __init__(self, model: Model, measurements: Measurements, weights: Array):
        self.model, self.measurements, self.weights = model, measurements, weights
        self.evaluations = 0
        self._last: tuple[bytes, tuple[Array, Array]] | None = None

    def evaluate(self, logs: Array) -> tuple[Array, Array]:
        key = logs.tobytes()
        if self._last is None or self._last[0] != key:
            self.evaluations += 1
            self._last = (key, self.model(self.measurements.times, logs))
        return self._last[1]

    def off_plateaus(self, places: list[Array]) -> list[Array]:
        """Starts where some parameter acts: others are moved towards the best start until one does.

        Where all is dissolved, or nothing yet, no parameter changes anything, and a search would
        end where it begins.
        """
        losses = [self._residuals(place) @ self._residuals(place) for place in places]
        best = places[int(np.argmin(losses))]
        moved = []
        for place in places:
            for _ in range(20):
                gradient = self._jacobian(place).T @ self._residuals(place)
                if np.abs(gradient).max() > _FLAT * max(1e-300, np.min(losses)):
                    break
                place = 0.5 * (place + best)
            moved.append(place)
        return moved

    def _residuals(self, logs: Array) -> Array:
        return (self.evaluate(logs)[0] - self.measurements.values) * self.weights

    def _jacobian(self, logs: Array) -> Array:
        return self.evaluate(logs)[1] * self.weights[:, None]

    def run(self, start: Array, lower: Array, upper: Array):
        return least_squares(
            self._residuals,
            start,
            jac=self._jacobian,
            bounds=(lower, upper),
            ftol=1e-14,
            xtol=1e-12,
            gtol=1e-14,
            max_nfev=200,
        )
