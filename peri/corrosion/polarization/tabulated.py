"""A measured polarization curve: points of potential and current density."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from peri.corrosion.polarization.law import PolarizationLaw


@dataclass(frozen=True)
class TabulatedCurve(PolarizationLaw):
    """i(E) through given points, once differentiable and monotone between them.

    Piecewise cubic Hermite interpolation with the slopes of Fritsch and Butland (1984): rising
    data give a rising curve, so that the potential problem keeps one solution.  Beyond the points
    the curve goes on along its end tangents, for iterations that stray there; a solution that
    ends there is refused by `check_range`.

    Parameters
    ----------
    potentials : tuple of float
        V, ascending, two at least.
    currents : tuple of float
        A/m^2, as many; they must not fall.

    Raises
    ------
    ValueError
        For points that are not finite, do not ascend or fall; the text names the two points.
    """

    potentials: tuple[float, ...]
    currents: tuple[float, ...]

    def __post_init__(self) -> None:
        e, i = np.asarray(self.potentials, float), np.asarray(self.currents, float)
        if e.ndim != 1 or e.shape != i.shape or e.size < 2:
            raise ValueError(f"currents: {i.size} for {e.size} potentials; two points at least")
        if not (np.isfinite(e).all() and np.isfinite(i).all()):
            raise ValueError("potentials: every point of the curve must be finite")
        for k in np.flatnonzero(np.diff(e) <= 0)[:1]:
            raise ValueError(f"potentials: {e[k]} V is followed by {e[k + 1]} V; they must ascend")
        for k in np.flatnonzero(np.diff(i) < 0)[:1]:
            raise ValueError(
                f"currents: {i[k]} A/m^2 at {e[k]} V is followed by {i[k + 1]} A/m^2 at "
                f"{e[k + 1]} V; the current must not fall with the potential"
            )

    @cached_property
    def _curve(self) -> tuple[PchipInterpolator, PchipInterpolator]:
        curve = PchipInterpolator(np.asarray(self.potentials), np.asarray(self.currents))
        return curve, curve.derivative()

    def _inside(self, potential: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The nearest potential of the range, and how far the given one is beyond it, V."""
        place = np.asarray(potential, float)
        within = np.clip(place, self.potentials[0], self.potentials[-1])
        return within, place - within

    def current(self, potential: np.ndarray | float) -> np.ndarray:
        """Through the points; beyond them along the end tangents."""
        curve, slope = self._curve
        within, beyond = self._inside(potential)
        return curve(within) + beyond * slope(within)

    def slope(self, potential: np.ndarray | float) -> np.ndarray:
        """Of the interpolation; constant beyond the points."""
        return np.maximum(self._curve[1](self._inside(potential)[0]), 0.0)

    def check_range(self, potential: np.ndarray | float) -> None:
        """Refuse potentials beyond the points."""
        beyond = np.atleast_1d(self._inside(potential)[1])
        if np.any(beyond != 0):
            worst = float(np.atleast_1d(potential).ravel()[np.abs(beyond).argmax()])
            raise ValueError(
                f"potential: {worst:.4g} V lies outside the polarization curve, which is known "
                f"from {self.potentials[0]} to {self.potentials[-1]} V"
            )
