"""Dissolution in the acid that the metal's own ions make: a current by their concentration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics

HIGHEST_FITTED = 5600.0
"""Up to where pH and current were measured, mol/m^3; the double exponential explodes beyond."""


@dataclass(frozen=True)
class AcidityLaw(Kinetics):
    """The current of alloy 625 by the concentration of its ions (Jafarzadeh et al. 2022, 5.1).

        pH = 7.405 exp(-0.08036 C) - 6.498,   log10 i = 1.151 exp(-0.723 pH) - 3.647,

    C in mol/L and i in A/m^2.  Eqs 23 to 25 print log10 i = 1.151 exp(-723 pH) - 7.647, which
    gives no rate at all; as written here i runs from 8.921e-4 (C = 0) to 3.2422 A/m^2 (5.6 mol/L).

    Parameters
    ----------
    saturation_concentration : float
        mol/m^3, > 0 and at most 5600, up to where the law was fitted; it holds from 0 to it.
    reference_current : float
        A/m^2, > 0: the current density that a scene's dissolution flux is stated for.
    factor : float
        Of the current, > 0.

    Raises
    ------
    ValueError
        For values out of range; `rate` for concentrations that are not finite.
    """

    needs = frozenset({"concentration"})

    saturation_concentration: float
    reference_current: float = 1.0
    factor: float = 1.0

    def __post_init__(self) -> None:
        for name in ("saturation_concentration", "reference_current", "factor"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
        if self.saturation_concentration > HIGHEST_FITTED * (1 + 1e-12):
            raise ValueError(
                f"saturation_concentration: {self.saturation_concentration} mol/m^3; the current "
                f"by the acidity is known up to {HIGHEST_FITTED:g} mol/m^3"
            )

    def _steps(self, concentration: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """log10 i and its derivative by C (m^3/mol), C held to the range of the law."""
        held = np.clip(concentration, 0.0, self.saturation_concentration)
        acid = 7.405 * np.exp(-0.08036e-3 * held)
        steep = 1.151 * np.exp(-0.723 * (acid - 6.498))
        return steep - 3.647, steep * 0.723 * 0.08036e-3 * acid

    def current(self, concentration: np.ndarray | float) -> np.ndarray:
        """i(C), A/m^2; beyond the range that at its end."""
        return self.factor * 10.0 ** self._steps(concentration)[0]

    def slope(self, concentration: np.ndarray | float) -> np.ndarray:
        """di/dC, A m/mol, > 0; at and beyond the ends of the range that from within."""
        logarithm, steepness = self._steps(concentration)
        return self.factor * math.log(10.0) * 10.0**logarithm * steepness

    def rate(self, at: Exposed) -> float | np.ndarray:
        """i(C) / i_reference by the concentration of the liquid that a node sees.

        Iterations towards saturation may pass it; the rate is that at C_sat then.
        """
        seen = np.asarray(at.concentration, float)
        if not np.isfinite(seen).all():
            raise ValueError("concentration: it must be finite everywhere")
        return self.current(seen) / self.reference_current
