"""What the measurements determine: Fisher information, unseen directions, what to measure next.

Everything is in natural logarithms of the parameters, so a standard deviation of 0.1 is ten per
cent.  A direction whose standard deviation exceeds `UNSEEN` is not determined by the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.fit import Fit, Measurements, Model, Parameter, fit

Array = NDArray[np.float64]

UNSEEN = 1.0
"""Standard deviation in ln (a factor e either way) beyond which a direction is not determined."""

_PART = 0.1
"""Share of a unit direction below which a parameter is not named as part of it."""


@dataclass(frozen=True)
class Direction:
    """A unit direction in the logarithms and its standard deviation (infinite without effect)."""

    names: tuple[str, ...]
    components: Array
    deviation: float

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parameters that take part, the largest component first."""
        order = np.argsort(-np.abs(self.components), kind="stable")
        return tuple(self.names[i] for i in order if abs(self.components[i]) >= _PART)

    def in_words(self, symbols: Mapping[str, str] | None = None) -> str:
        """One sentence on what the data do not see."""
        symbols = symbols or {}
        parts = [name for name in self.names if name in self.parts]
        called = [symbols.get(name, name) for name in parts]
        if len(parts) == 1:
            return f"{called[0]} is not determined"
        share = dict(zip(self.names, self.components, strict=True))
        if len(parts) == 2:
            power = -share[parts[0]] / share[parts[1]]
            seen = _product(called, power)
            return f"only {seen} is determined, not {called[0]} and {called[1]}"
        moves = ", ".join(f"ln {c} by {share[p]:+.2f}" for c, p in zip(called, parts, strict=True))
        return f"the data do not see {moves} together"


def _product(names: Sequence[str], power: float) -> str:
    """`a b`, `a / b` or `a b^0.30`, whichever the power of the second is."""
    if abs(power - 1.0) < 0.05:
        return f"{names[0]} {names[1]}"
    if abs(power + 1.0) < 0.05:
        return f"{names[0]} / {names[1]}"
    return f"{names[0]} {names[1]}^{power:.2f}"


def directions(names: Sequence[str], fisher: Array) -> list[Direction]:
    """Principal directions of the information, the least determined first."""
    values, vectors = np.linalg.eigh(fisher)
    floor = 1e-14 * max(float(np.abs(values).max(initial=0.0)), 1e-300)
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        deviation = np.inf if value <= floor else 1.0 / np.sqrt(value)
        largest = vector[np.argmax(np.abs(vector))]
        found.append(Direction(tuple(names), vector * np.sign(largest), float(deviation)))
    return found


@dataclass(frozen=True)
class Identifiability:
    """Which parameters the data determine.

    determined: names; fixed: those that are not, each with the direction that says why.
    covariance (nd, nd): of the logarithms of the determined ones, the fixed ones held.
    """

    determined: tuple[str, ...]
    fixed: dict[str, Direction]
    covariance: Array

    @property
    def deviations(self) -> Array:
        """Standard deviations of the logarithms of the determined parameters (nd,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlations(self) -> Array:
        """Correlations of the logarithms (nd, nd)."""
        d = self.deviations
        return self.covariance / np.outer(d, d)


def identify(names: Sequence[str], fisher: Array) -> Identifiability:
    """Sort parameters into determined ones and those that have to be fixed.

    While a direction is undetermined, the parameter with the largest part in it is fixed (of two
    equal ones the later); the other parameters of that direction then carry the combination.
    """
    names, fixed = list(names), {}
    information = np.asarray(fisher, float)
    while names:
        worst = directions(names, information)[0]
        if worst.deviation <= UNSEEN:
            break
        parts = np.abs(worst.components)
        chosen = int(np.flatnonzero(parts >= parts.max() * (1 - 0.02))[-1])
        fixed[names.pop(chosen)] = worst
        keep = [i for i in range(len(information)) if i != chosen]
        information = information[np.ix_(keep, keep)]
    covariance = np.linalg.inv(information) if names else np.zeros((0, 0))
    return Identifiability(tuple(names), fixed, covariance)


def predicted_deviation(covariance: Array, gradient: Array) -> Array:
    """Standard deviation of predictions with these gradients (..., np) in the logarithms."""
    return np.sqrt(np.einsum("...i,ij,...j", gradient, covariance, gradient))


@dataclass(frozen=True)
class NextMeasurement:
    """What one more measurement at `time` (s) would leave: sd of a value at the wanted time."""

    time: float
    deviation: float


def what_to_measure_next(
    model: Model,
    logs: Array,
    fisher: Array,
    candidates: Sequence[float],
    wanted: float,
    deviation: float,
) -> tuple[float, list[NextMeasurement]]:
    """Standard deviation at the wanted time now, and after one more measurement at each candidate.

    candidates, wanted: s; deviation: of the measurement to come.  Linear in the logarithms.
    """
    _, gradient = model(np.array([wanted, *candidates], float), logs)
    target, rows = gradient[0], gradient[1:] / deviation
    now = float(predicted_deviation(np.linalg.inv(fisher), target))
    after = [
        NextMeasurement(
            float(time),
            float(predicted_deviation(np.linalg.inv(fisher + np.outer(row, row)), target)),
        )
        for time, row in zip(candidates, rows, strict=True)
    ]
    return now, after


def profile(
    model: Model,
    measurements: Measurements,
    parameters: Sequence[Parameter],
    name: str,
    values: Sequence[float],
) -> Array:
    """Loss of the best fit with one parameter held at each value: the profile likelihood.

    A loss less its least is chi-square distributed with one degree of freedom: values with less
    than 2.71 (3.84) lie in the 90 (95) % interval.  parameters: at the optimum.
    """
    index = [p.name for p in parameters].index(name)
    others = [p for p in parameters if p.name != name]

    def held(value: float) -> Model:
        def restricted(times: Array, logs: Array) -> tuple[Array, Array]:
            predictions, jacobian = model(times, np.insert(logs, index, np.log(value)))
            return predictions, np.delete(jacobian, index, axis=1)

        return restricted

    if measurements.deviations is None:
        raise ValueError("deviations: None; a profile needs those of the measurements or estimated")
    losses = []
    for value in values:
        if others:
            losses.append(fit(held(value), measurements, others, starts=1).loss)
            continue
        predictions, _ = model(measurements.times, np.log([value]))
        residuals = (measurements.values - predictions) / measurements.deviations
        losses.append(float(np.sum(residuals**2)))
    return np.array(losses)


def of_fit(result: Fit) -> Identifiability:
    """`identify` at an optimum."""
    return identify(result.names, result.fisher())
