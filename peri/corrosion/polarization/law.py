"""What a polarization law is, and how one makes a rate of dissolution."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics

_LARGEST_EXPONENT = 69.0
"""30 decades: beyond them an exponential goes on along its tangent, so that no current overflows
and a Newton iteration that strays there still comes back."""


class PolarizationLaw(ABC):
    """A law of the current density by the potential; one file each, one row in POLARIZATION."""

    @abstractmethod
    def current(self, potential: np.ndarray | float) -> np.ndarray:
        """i(E), A/m^2, anodic > 0, cathodic < 0."""

    @abstractmethod
    def slope(self, potential: np.ndarray | float) -> np.ndarray:
        """di/dE >= 0, A/(m^2 V)."""

    def check_range(self, potential: np.ndarray | float) -> None:
        """Refuse potentials that the law is not known for (none by default): ValueError."""
        return None


@dataclass(frozen=True)
class PolarizedRate(Kinetics):
    """Rate of dissolution by the potential of each metal node: max(0, i(E)) / i_reference.

    Parameters
    ----------
    law : PolarizationLaw
    reference_current : float
        A/m^2, > 0: the current density that the scene's dissolution flux or interface
        diffusivity is stated for, z F times that flux.
    """

    needs = frozenset({"potential"})

    law: PolarizationLaw
    reference_current: float

    def __post_init__(self) -> None:
        positive("reference_current", self.reference_current, "A/m^2")

    def rate(self, at: Exposed) -> float | np.ndarray:
        """max(0, i(E)) / i_reference; ValueError outside the law's range."""
        assert at.potential is not None
        self.law.check_range(at.potential)
        return np.maximum(self.law.current(at.potential), 0.0) / self.reference_current

    def slope(self, at: Exposed) -> np.ndarray:
        """Derivative of the rate by the potential, 1/V."""
        assert at.potential is not None
        dissolves = self.law.current(at.potential) > 0
        return np.where(dissolves, self.law.slope(at.potential), 0.0) / self.reference_current


def exponential(exponent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """exp and its derivative; above 30 decades the tangent, once differentiable and rising."""
    capped = np.exp(np.minimum(exponent, _LARGEST_EXPONENT))
    beyond = np.maximum(exponent - _LARGEST_EXPONENT, 0.0)
    return capped * (1.0 + beyond), capped


def positive(name: str, value: float, unit: str = "") -> None:
    """Refuse what is not finite and positive: ValueError."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name}: {value}{' ' * bool(unit)}{unit}; it must be finite and positive")


def finite(name: str, value: float, unit: str = "") -> None:
    """Refuse what is not finite: ValueError."""
    if not math.isfinite(value):
        raise ValueError(f"{name}: {value}{' ' * bool(unit)}{unit}; it must be finite")
