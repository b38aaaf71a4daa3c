"""The solids that a metal is made of: phases of an alloy, grain boundaries, two metals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from peri.corrosion.kinetics import Kinetics


@dataclass(frozen=True)
class Solid:
    """One row of a scene's table of solids; `scene.phase` says which node is which (from 1).

    concentration : C_solid, mol/m^3.  rate : flux of its fresh surface into clean liquid over
    that of the scene, >= 0.  kinetics : its own law (default: the scene's).
    """

    concentration: float
    rate: float = 1.0
    kinetics: Kinetics | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.concentration) and self.concentration > 0):
            raise ValueError(
                f"solids: concentration {self.concentration} mol/m3; it must be finite and positive"
            )
        if not (math.isfinite(self.rate) and self.rate >= 0):
            raise ValueError(f"solids: rate {self.rate}; it must be finite and not negative")
