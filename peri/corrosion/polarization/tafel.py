"""Tafel's law: one exponential, anodic or cathodic."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.polarization.law import PolarizationLaw, exponential, finite, positive


@dataclass(frozen=True)
class TafelCurve(PolarizationLaw):
    """i(E) = s i_0 10^((E - E_0) / beta), s the sign of beta (Zhao et al. 2021, Eq. 13).

    A positive beta is an anodic branch (i > 0), a negative one a cathodic branch (i < 0); the
    slope ln 10 i / beta is positive for both.

    Parameters
    ----------
    current_density : float
        i_0 at the potential E_0, A/m^2, > 0.
    tafel_slope : float
        beta, V per decade, not 0.
    standard_potential : float
        E_0, V against the reference electrode.

    Raises
    ------
    ValueError
        For values out of range.
    """

    current_density: float
    tafel_slope: float
    standard_potential: float

    def __post_init__(self) -> None:
        positive("current_density", self.current_density, "A/m^2")
        finite("standard_potential", self.standard_potential, "V")
        if not (math.isfinite(self.tafel_slope) and self.tafel_slope != 0):
            raise ValueError(
                f"tafel_slope: {self.tafel_slope} V; it must be finite and not 0, positive for "
                "an anodic and negative for a cathodic branch"
            )

    def _exponent(self, potential: np.ndarray | float) -> np.ndarray:
        above = np.asarray(potential, float) - self.standard_potential
        return math.log(10.0) * above / self.tafel_slope

    def current(self, potential: np.ndarray | float) -> np.ndarray:
        """s i_0 10^((E - E_0) / beta)."""
        value, _ = exponential(self._exponent(potential))
        return math.copysign(self.current_density, self.tafel_slope) * value

    def slope(self, potential: np.ndarray | float) -> np.ndarray:
        """ln 10 |i / beta|."""
        _, value = exponential(self._exponent(potential))
        return self.current_density * math.log(10.0) / abs(self.tafel_slope) * value
