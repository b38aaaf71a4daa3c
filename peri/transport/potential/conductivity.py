"""Conductivity of a liquid by the ions in it: kappa = F^2 / (R T) sum_k z_k^2 D_k C_k."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.engine.constants import FARADAY, GAS_CONSTANT


@dataclass(frozen=True)
class IonConductivity:
    """kappa of a medium to which a metal's ions come, each with z counter-ions of charge -1.

        kappa(C) = kappa_0 + F^2 / (R T) (z^2 D + z D_c) C

    of independent ions (dilute solution theory); of a crowded liquid it is an upper bound.

    Parameters
    ----------
    medium : kappa_0, S/m, >= 0.
    charge_number : z of the metal's ion, > 0.
    diffusivity, counter_diffusivity : D and D_c, m^2/s, > 0 (of chloride 2.03e-9).
    temperature : K, > 0.

    Raises
    ------
    ValueError
        For values out of range; `of` for concentrations that are negative or not finite.
    """

    medium: float
    charge_number: float
    diffusivity: float
    counter_diffusivity: float = 2.03e-9
    temperature: float = 298.15

    def __post_init__(self) -> None:
        if not (math.isfinite(self.medium) and self.medium >= 0):
            raise ValueError(f"medium: {self.medium} S/m; it must be finite and not negative")
        for name in ("charge_number", "diffusivity", "counter_diffusivity", "temperature"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")

    @property
    def slope(self) -> float:
        """d kappa / dC, S m^2/mol."""
        z = self.charge_number
        mobile = z**2 * self.diffusivity + z * self.counter_diffusivity
        return FARADAY**2 / (GAS_CONSTANT * self.temperature) * mobile

    def of(self, concentration: np.ndarray) -> np.ndarray:
        """kappa, S/m, of concentrations of the metal's ions, mol/m^3."""
        c = np.asarray(concentration, float)
        if not (np.isfinite(c).all() and (c >= 0).all()):
            raise ValueError("concentration: it must be finite and not negative everywhere")
        return self.medium + self.slope * c
