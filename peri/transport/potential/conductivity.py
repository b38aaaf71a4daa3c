"""Conductivity of a liquid by the ions in it: kappa = F^2 / (R T) sum_k z_k^2 D_k C_k."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from peri.engine.constants import FARADAY, GAS_CONSTANT


class ConductivityLaw(Protocol):
    """kappa of a liquid by the concentration of a metal's ions."""

    def of(self, concentration: np.ndarray) -> np.ndarray:
        """kappa, S/m, of concentrations, mol/m^3, >= 0."""


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


@dataclass(frozen=True)
class TabulatedConductivity:
    """Measured points of kappa by the ions' concentration, joined by straight lines.

    Parameters
    ----------
    concentrations : tuple of float
        mol/m^3, ascending from 0.
    conductivities : tuple of float
        kappa at each, S/m, > 0.

    Raises
    ------
    ValueError
        For fewer than two points, points that do not ascend from 0, and values out of range; `of`
        for concentrations that are negative, not finite or beyond the last point.
    """

    concentrations: tuple[float, ...]
    conductivities: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("concentrations", "conductivities"):
            object.__setattr__(self, name, tuple(float(v) for v in getattr(self, name)))
        c, kappa = self.concentrations, self.conductivities
        if len(c) < 2 or len(c) != len(kappa):
            raise ValueError(
                f"concentrations: {len(c)} with {len(kappa)} conductivities; there must be two "
                "points or more, and as many of each"
            )
        if c[0] != 0.0 or not (np.isfinite(c).all() and (np.diff(c) > 0).all()):
            raise ValueError(f"concentrations: {list(c)} mol/m^3; they must ascend from 0")
        if not (np.isfinite(kappa).all() and min(kappa) > 0):
            raise ValueError(f"conductivities: {list(kappa)} S/m; each must be finite and positive")

    def of(self, concentration: np.ndarray) -> np.ndarray:
        """kappa, S/m, of concentrations of the metal's ions, mol/m^3."""
        c = np.asarray(concentration, float)
        if not (np.isfinite(c).all() and (c >= 0).all()):
            raise ValueError("concentration: it must be finite and not negative everywhere")
        most = float(c.max(initial=0.0))
        if most > self.concentrations[-1] * (1 + 1e-9):
            raise ValueError(
                f"concentration: {most:g} mol/m^3; the law's points end at "
                f"{self.concentrations[-1]:g} mol/m^3, so it needs more, or a saturation below"
            )
        return np.interp(c, self.concentrations, self.conductivities)
