"""An inhibitor in the liquid: it covers the metal by Langmuir's isotherm and slows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics


@dataclass(frozen=True)
class Inhibited(Kinetics):
    """The rate of another law times 1 - eta K C / (1 + K C).

    K C / (1 + K C) is the share of the surface that the inhibitor covers where the liquid beside it
    holds C of it (all its forms), eta what a covered surface loses of its rate.  What sticks to the
    metal is not taken from the liquid.

    Parameters
    ----------
    base : Kinetics
        Any law but one of a metal whose anodes and cathodes lie apart (it needs a potential).
    inhibitor : str
        A component of the liquid's chemistry.
    constant : float
        K, m^3/mol, > 0.
    efficiency : float
        eta, above 0 and at most 1.

    Raises
    ------
    ValueError
        For numbers out of range and a base that needs a potential.
    """

    base: Kinetics
    inhibitor: str
    constant: float
    efficiency: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.constant) and self.constant > 0):
            raise ValueError(f"constant: {self.constant} m^3/mol; it must be finite and positive")
        if not 0 < self.efficiency <= 1:
            raise ValueError(f"efficiency: {self.efficiency}; it must be above 0 and at most 1")
        if "potential" in self.base.needs:
            raise ValueError(
                "base: its anodes and cathodes lie apart, which an inhibitor of the rate alone "
                "does not know; use balance 'local'"
            )

    @property
    def needs(self) -> frozenset[str]:  # type: ignore[override]
        """The base law's, and the inhibitor."""
        return self.base.needs | {"inhibitor"}

    def rate(self, at: Exposed) -> float | np.ndarray:
        """The base law's rate times what the free and the covered surface leave of it."""
        bound = self.constant * np.asarray(at.inhibitor)
        return self.base.rate(at) * (1.0 - self.efficiency * bound / (1.0 + bound))
