"""Butler and Volmer's law: both directions of one electrode reaction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from peri.corrosion.polarization.law import PolarizationLaw, exponential, finite, positive
from peri.engine.constants import FARADAY, GAS_CONSTANT


@dataclass(frozen=True)
class ButlerVolmerCurve(PolarizationLaw):
    """i(E) = i_0 (exp(alpha_a z F eta / RT) - exp(-alpha_c z F eta / RT)), eta = E - E_eq.

    Eq. 3.92 of the dissertation, with the signs that slow a cathodic reaction as its overpotential
    rises (Eqs 3.100 and 5.29 print both).

    Parameters
    ----------
    exchange_current_density : float
        i_0, A/m^2, > 0.
    equilibrium_potential : float
        E_eq, V against the reference electrode.
    charge_number, anodic_transfer, cathodic_transfer : float
        z, alpha_a, alpha_c, > 0.
    temperature : float
        K, > 0.

    Raises
    ------
    ValueError
        For values out of range.
    """

    exchange_current_density: float
    equilibrium_potential: float
    charge_number: float = 2.0
    anodic_transfer: float = 0.5
    cathodic_transfer: float = 0.5
    temperature: float = 310.15

    def __post_init__(self) -> None:
        positive("exchange_current_density", self.exchange_current_density, "A/m^2")
        finite("equilibrium_potential", self.equilibrium_potential, "V")
        for name in ("charge_number", "anodic_transfer", "cathodic_transfer", "temperature"):
            positive(name, getattr(self, name), "K" if name == "temperature" else "")

    def _steepness(self) -> tuple[float, float]:
        """alpha z F / RT of both directions, 1/V."""
        scaled = self.charge_number * FARADAY / (GAS_CONSTANT * self.temperature)
        return self.anodic_transfer * scaled, self.cathodic_transfer * scaled

    def _both(self, potential: np.ndarray | float) -> tuple[np.ndarray, ...]:
        above = np.asarray(potential, float) - self.equilibrium_potential
        anodic, cathodic = self._steepness()
        return (*exponential(anodic * above), *exponential(-cathodic * above))

    def current(self, potential: np.ndarray | float) -> np.ndarray:
        """The difference of both directions."""
        forward, _, back, _ = self._both(potential)
        return self.exchange_current_density * (forward - back)

    def slope(self, potential: np.ndarray | float) -> np.ndarray:
        """The sum of both directions' slopes."""
        _, forward, _, back = self._both(potential)
        anodic, cathodic = self._steepness()
        return self.exchange_current_density * (anodic * forward + cathodic * back)
