"""Corrosion kinetics: how fast an interface dissolves, by what the metal and its liquid are like.

A law gives a rate >= 0 that multiplies the interface diffusivity (or dissolution flux) stated at
zero volume loss: one number for the whole metal, or one per metal node.  A new law is one class
with `needs` and `rate`, and a row in rate_laws.KINETICS; `derivatives` (of the rate, by the name of
the law's parameter, and by "volume_loss") lets a fit follow it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from peri.engine.constants import FARADAY, GAS_CONSTANT

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Exposed:
    """What a law may look at: one number for the whole metal, or arrays over its nodes.

    volume_loss : V_L of the whole metal.  phase : which of the scene's solids a node is (from 1).
    concentration : of the liquid that a node sees, mol/m^3
    (the mean over its bonds to liquid).  potential : metal minus liquid, V.  age : s since the
    node was exposed.  ph, chloride, magnesium and inhibitor (totals, mol/m^3) : of the liquid that
    a node sees where its ions are followed.  layer : thickness of the minerals on a node, m.  What
    a law does not need may be missing.  lost : share of a node's own metal that is gone, 0..1.
    """

    volume_loss: float | np.ndarray = 0.0
    phase: np.ndarray | None = None
    concentration: np.ndarray | None = None
    potential: np.ndarray | float | None = None
    age: np.ndarray | None = None
    ph: np.ndarray | float | None = None
    chloride: np.ndarray | float | None = None
    magnesium: np.ndarray | float | None = None
    inhibitor: np.ndarray | float | None = None
    layer: np.ndarray | float | None = None
    lost: np.ndarray | None = None


QUANTITIES = tuple(f.name for f in fields(Exposed))
"""What a law may need."""

_GLOBAL = frozenset({"volume_loss"})


class Kinetics(ABC):
    """A law of the rate.

    needs : names of the quantities of `Exposed` that the rate depends on.  With nothing but the
    volume loss the rate is one number, and clean liquid reduces to one equation (peri.omissions).
    slows : whether the rate never rises with the volume loss, other things equal; bounds of what
    a march may leave out rest on it.  on_classes : whether it may be asked for the rate classes of
    cells, several of them in one place, as for nodes.
    """

    needs: ClassVar[frozenset[str]] = _GLOBAL
    slows: ClassVar[bool] = False
    on_classes: ClassVar[bool] = True

    @abstractmethod
    def rate(self, at: Exposed) -> float | np.ndarray:
        """The rate over that at zero volume loss, >= 0; of the shape of what the law needs."""

    def key(self) -> dict[str, object]:
        """What determines the law, for the mark of a checkpoint."""
        return {"law": type(self).__qualname__, **vars(self)}

    @property
    def is_global(self) -> bool:
        """Whether the rate is one number for the whole metal, given by its volume loss."""
        return self.needs <= _GLOBAL

    @property
    def never_speeds_up(self) -> bool:
        """Whether rate(zero volume loss) bounds the rate of a march from above."""
        return self.is_global and (self.slows or not self.needs)


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name}: {value}; it must be finite and positive")


@dataclass(frozen=True)
class ConstantRate(Kinetics):
    """Rate 1: the interface diffusivity does not change."""

    needs = frozenset()

    def rate(self, at: Exposed) -> float | np.ndarray:
        """1 for every volume loss."""
        return 1.0

    def derivatives(self, at: Exposed) -> dict[str, float | np.ndarray]:
        """No parameters, no slope."""
        return {"volume_loss": 0.0}


@dataclass(frozen=True)
class VolumeLossLaw(Kinetics):
    """Rate 10^(-V_L / l) of Eq. 5.13 of the dissertation.

    The law V_L = l log10(1 + t/tau) of a uniformly corroding body (Eq. 5.9 with log read as
    log10) makes the rate fall by a factor ten per l of volume loss.

    Parameters
    ----------
    length : float
        l, dimensionless like V_L (the tables print m^3), > 0.
    """

    slows = True

    length: float

    def __post_init__(self) -> None:
        _positive("length", self.length)

    def rate(self, at: Exposed) -> float | np.ndarray:
        """10^(-V_L / l)."""
        return 10.0 ** (-at.volume_loss / self.length)

    def derivatives(self, at: Exposed) -> dict[str, float | np.ndarray]:
        """By l (per unit of l) and by V_L."""
        steepness = math.log(10) / self.length * self.rate(at)
        return {"length": steepness * at.volume_loss / self.length, "volume_loss": -steepness}


@dataclass(frozen=True)
class Tafel(Kinetics):
    """Rate 10^(eta / beta_a) of Eq. 2.47.

    Parameters
    ----------
    overpotential : float
        eta, V.
    slope : float
        Anodic Tafel slope beta_a, V per decade, > 0.
    """

    needs = frozenset()

    overpotential: float
    slope: float

    def __post_init__(self) -> None:
        _positive("slope", self.slope)
        _rate_in_range("overpotential", self.overpotential, self.overpotential / self.slope)

    def rate(self, at: Exposed) -> float | np.ndarray:
        """10^(eta / beta_a), whatever the volume loss."""
        return 10.0 ** (self.overpotential / self.slope)

    def derivatives(self, at: Exposed) -> dict[str, float | np.ndarray]:
        """By eta (1/V) and by beta_a (1/V)."""
        steepness = math.log(10) / self.slope * self.rate(at)
        return {
            "overpotential": steepness,
            "slope": -steepness * self.overpotential / self.slope,
            "volume_loss": 0.0,
        }


@dataclass(frozen=True)
class ButlerVolmer(Kinetics):
    """Rate exp(alpha_a z F eta / RT) - exp(-alpha_c z F eta / RT) of Eq. 3.92.

    Parameters
    ----------
    overpotential : float
        eta >= 0, V (below zero the metal would plate out, which the model does not cover).
    charge_number : float
        z of the dissolving ion, > 0.
    anodic_transfer, cathodic_transfer : float
        alpha_a, alpha_c, > 0.
    temperature : float
        K, > 0.
    """

    needs = frozenset()

    overpotential: float
    charge_number: float = 2.0
    anodic_transfer: float = 0.5
    cathodic_transfer: float = 0.5
    temperature: float = 310.15

    def __post_init__(self) -> None:
        for name in ("charge_number", "anodic_transfer", "cathodic_transfer", "temperature"):
            _positive(name, getattr(self, name))
        if not self.overpotential >= 0:
            raise ValueError(f"overpotential: {self.overpotential} V; it must be at least 0")
        _rate_in_range("overpotential", self.overpotential, self._exponent() / math.log(10))

    def _exponent(self) -> float:
        scaled = self.charge_number * FARADAY / (GAS_CONSTANT * self.temperature)
        return self.anodic_transfer * scaled * self.overpotential

    def rate(self, at: Exposed) -> float | np.ndarray:
        """The bracket of Eq. 3.92, whatever the volume loss."""
        anodic = self._exponent()
        return math.exp(anodic) - math.exp(-anodic * self.cathodic_transfer / self.anodic_transfer)

    def derivatives(self, at: Exposed) -> dict[str, float | np.ndarray]:
        """By every parameter, per unit of it."""
        anodic = self._exponent()
        cathodic = anodic * self.cathodic_transfer / self.anodic_transfer
        forward, back = anodic * math.exp(anodic), cathodic * math.exp(-cathodic)
        both = forward + back
        scaled = self.charge_number * FARADAY / (GAS_CONSTANT * self.temperature)
        per_volt = self.anodic_transfer * math.exp(anodic)
        per_volt += self.cathodic_transfer * math.exp(-cathodic)
        return {
            "overpotential": scaled * per_volt,
            "charge_number": both / self.charge_number,
            "anodic_transfer": forward / self.anodic_transfer,
            "cathodic_transfer": back / self.cathodic_transfer,
            "temperature": -both / self.temperature,
            "volume_loss": 0.0,
        }


def _rate_in_range(name: str, value: float, decades: float) -> None:
    if not abs(decades) <= 100:
        raise ValueError(f"{name}: {value}; it changes the rate by more than 100 decades")
