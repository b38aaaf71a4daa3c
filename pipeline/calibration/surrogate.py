"""Kriging for scenes where every evaluation is a march: Gaussian processes in the logarithms.

A surrogate states its box and refuses to leave it.  Matern 5/2 with a length per parameter; where a
cheap model exists (the reduced one), the surrogate learns the difference from it.  Its error is
that of leaving one point out, in closed form, e_i = [K^-1 y]_i / [K^-1]_ii (Dubrule 1983), and both
the mean and the worst are reported: the mean, (5.36) of the source, hides a worst case twenty times
as large.

Needs scikit-learn (the extra `surrogate`).
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.stats import qmc

from pipeline.calibration.fit import CalibrationError

Array = NDArray[np.float64]

WORST_ALLOWED = 0.03
"""Worst leave-one-out error of V_L or of the strength left above which a surrogate is refused."""

_DESIGNS = 200
"""Latin hypercubes of which the one with the largest least distance is taken."""

_NUGGET = 1e-10


@dataclass(frozen=True)
class Box:
    """Ranges of positive parameters, by name: lower < upper, SI."""

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        for name, low, high in zip(self.names, self.lower, self.upper, strict=True):
            if not 0 < low < high < np.inf:
                raise CalibrationError(
                    f"range of {name} is {low:g} to {high:g}; it must rise from above 0"
                )

    def scaled(self, values: ArrayLike) -> Array:
        """Logarithms scaled to [0, 1] (n, np); CalibrationError outside the box."""
        values = np.atleast_2d(np.asarray(values, float))
        low, high = np.log(self.lower), np.log(self.upper)
        inside = (np.log(values) - low) / (high - low)
        outside = np.argwhere((inside < -1e-9) | (inside > 1 + 1e-9))
        if outside.size:
            row, column = outside[0]
            raise CalibrationError(
                f"{self.names[column]} is {values[row, column]:g}; the surrogate holds from "
                f"{self.lower[column]:g} to {self.upper[column]:g} only"
            )
        return np.clip(inside, 0.0, 1.0)

    def values(self, scaled: ArrayLike) -> Array:
        """Parameters (n, np) of scaled logarithms."""
        low, high = np.log(self.lower), np.log(self.upper)
        return np.exp(low + np.asarray(scaled, float) * (high - low))


def design(box: Box, count: int, seed: int = 0) -> Array:
    """Parameters (count, np) that fill the box evenly in the logarithms: a maximin hypercube."""
    random = np.random.default_rng(seed)
    dimension = len(box.names)
    cubes = [qmc.LatinHypercube(dimension, seed=random).random(count) for _ in range(_DESIGNS)]
    return box.values(max(cubes, key=lambda cube: pdist(cube).min() if count > 1 else 0.0))


@dataclass(frozen=True)
class LeaveOneOut:
    """Errors of a surrogate at each of its points, the point left out (n,), in its own unit.

    mean: sum of squares over that of the spread about the mean, (5.36); worst: largest.
    """

    errors: Array
    mean: float

    @property
    def worst(self) -> float:
        """Largest error."""
        return float(np.abs(self.errors).max())


def require_kriging() -> None:
    """Refuse to go on without scikit-learn; CalibrationError says what to install."""
    if importlib.util.find_spec("sklearn") is None:
        raise CalibrationError(
            "a surrogate needs scikit-learn, which is not installed; install perilife[surrogate]"
        )


class Surrogate:
    """One quantity as a function of the parameters of a box, and of nothing outside it.

    box: ranges; points (n, np), values (n,): evaluations; cheap: a model whose difference is
    learned, parameters (n, np) to values (n,); logarithms: False scales the parameters themselves,
    as the source seems to (for the comparison of `study calibration`).
    """

    def __init__(
        self,
        box: Box,
        points: ArrayLike,
        values: ArrayLike,
        cheap: Callable[[Array], Array] | None = None,
        logarithms: bool = True,
        seed: int = 0,
    ):
        require_kriging()
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern

        self.box, self.cheap, self.logarithms = box, cheap, logarithms
        self.points = np.atleast_2d(np.asarray(points, float))
        self.values = np.asarray(values, float)
        learned = self.values - (cheap(self.points) if cheap else 0.0)
        self._offset = float(learned.mean())
        self._scale = float(learned.std()) or 1.0
        dimension = len(box.names)
        kernel = ConstantKernel(1.0, (1e-3, 1e4)) * Matern(
            np.full(dimension, 0.5), [(1e-2, 1e2)] * dimension, nu=2.5
        )
        self._process = GaussianProcessRegressor(
            kernel, alpha=_NUGGET, n_restarts_optimizer=2, random_state=seed
        )
        with warnings.catch_warnings():
            # a search for the lengths that ends early is judged by what leaving one out gives
            warnings.simplefilter("ignore", ConvergenceWarning)
            self._process.fit(self._inputs(self.points), (learned - self._offset) / self._scale)

    def _inputs(self, points: ArrayLike) -> Array:
        scaled = self.box.scaled(points)
        if self.logarithms:
            return scaled
        low, high = np.asarray(self.box.lower), np.asarray(self.box.upper)
        return (np.atleast_2d(points) - low) / (high - low)

    def __call__(self, points: ArrayLike) -> tuple[Array, Array]:
        """Value and its predicted standard deviation at points (n, np) of the box."""
        points = np.atleast_2d(np.asarray(points, float))
        mean, deviation = self._process.predict(self._inputs(points), return_std=True)
        mean = self._offset + self._scale * mean
        return mean + (self.cheap(points) if self.cheap else 0.0), self._scale * deviation

    def leave_one_out(self) -> LeaveOneOut:
        """Errors in closed form, the kernel's lengths kept."""
        inverse = np.linalg.inv(self._process.L_ @ self._process.L_.T)
        errors = self._scale * (inverse @ self._process.y_train_) / np.diag(inverse)
        spread = float(np.sum((self.values - self.values.mean()) ** 2)) or 1.0
        return LeaveOneOut(errors, float(np.sum(errors**2) / spread))
