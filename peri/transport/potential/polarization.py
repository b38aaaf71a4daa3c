"""What the potential problem asks of an electrode's law, and the potential behind a patch.

E = V_metal - phi_liquid at the surface, V; i in A/m^2, positive where metal dissolves.  The laws
of corroding metals are in corrosion.polarization; a linear one is here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Polarization(Protocol):
    """Current density by potential; it never falls as the potential rises."""

    def current(self, potential: np.ndarray) -> np.ndarray:
        """i, A/m^2, shaped like `potential` (V)."""
        ...

    def slope(self, potential: np.ndarray) -> np.ndarray:
        """di/dE, A/(m^2 V), not negative."""
        ...


@dataclass(frozen=True)
class LinearPolarization:
    """i = (E - E_0) / R_p.

    rest : E_0, V.  resistance : R_p, ohm m^2, positive.
    """

    rest: float
    resistance: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.resistance) and self.resistance > 0):
            raise ValueError(f"resistance: {self.resistance} ohm m^2; it must be positive")

    def current(self, potential: np.ndarray) -> np.ndarray:
        """(E - E_0) / R_p."""
        return (np.asarray(potential, float) - self.rest) / self.resistance

    def slope(self, potential: np.ndarray) -> np.ndarray:
        """1 / R_p."""
        return np.full(np.shape(potential), 1.0 / self.resistance)


@dataclass(frozen=True)
class Insulated:
    """No current at any potential."""

    def current(self, potential: np.ndarray) -> np.ndarray:
        """0."""
        return np.zeros(np.shape(potential))

    def slope(self, potential: np.ndarray) -> np.ndarray:
        """0."""
        return np.zeros(np.shape(potential))


def surface_potential(
    law: Polarization, seen: np.ndarray, resistance: np.ndarray, guess: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The potential E with E + R i(E) = `seen`: what a patch has behind the liquid it sees.

    Newton's method on a function that rises, kept within a bracket that halves where Newton
    leaves it.

    Parameters
    ----------
    seen : (n,) V
    resistance : (n,) R >= 0, ohm m^2
    guess : (n,) V to start from, such as E of currents nearby; `seen` where it is not finite.

    Returns
    -------
    E (V), i (A/m^2) and di/d(seen), A/(m^2 V).

    Raises
    ------
    ValueError
        Where the law's slope is negative.
    """
    potential = np.array(seen, float)
    if guess is not None:
        potential = np.where(np.isfinite(guess), guess, potential)
    current, slope = law.current(potential), law.slope(potential)
    low, high = np.full((2, *potential.shape), [[-np.inf], [np.inf]])
    tolerance = 4e-16 * np.maximum(1.0, np.abs(seen))
    reach = 0.05
    for n in range(200):
        if np.any(slope < 0):
            raise ValueError("law: its current falls where the potential rises")
        excess = potential + resistance * current - seen
        high = np.where(excess > 0, np.minimum(high, potential), high)
        low = np.where(excess < 0, np.maximum(low, potential), low)
        newton = -excess / (1.0 + resistance * slope)
        done = np.abs(newton) <= tolerance
        if done.all():
            break
        trial = potential + newton
        # Newton crawls along an exponential, ln 10 steps a decade: every third step looks further.
        crawls = (np.abs(newton) > 1e-4) & (n % 3 == 2)
        outside = (trial < low) | (trial > high)
        bracketed = np.isfinite(low) & np.isfinite(high)
        half = 0.5 * (np.where(bracketed, low, 0.0) + np.where(bracketed, high, 0.0))
        further = potential + np.where(np.isfinite(low), reach, -reach)
        reach *= 2.0 if n % 3 == 2 else 1.0
        trial = np.where(crawls | outside, np.where(bracketed, half, further), trial)
        potential = np.where(done, potential, trial)
        current, slope = law.current(potential), law.slope(potential)
    # The better conditioned of two expressions of the current.
    steep = resistance * slope > 1.0
    series = (seen - potential) / np.where(steep, resistance, 1.0)
    current = np.where(steep, series, current)
    return potential, current, slope / (1.0 + resistance * slope)
