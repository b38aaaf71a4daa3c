"""What the liquid beside the metal does to the rate of a law: factors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics, VolumeLossLaw


@dataclass(frozen=True)
class LiquidFactors(Kinetics):
    """The rate of another law times what pH, chloride and a layer of minerals do to it.

        g (pH) = 10^(-n (pH - pH_0)) (C_Cl / C_0)^m / (1 + h / h_0)

    Parameters
    ----------
    base : Kinetics
        Of the volume loss alone.
    ph_order, ph_reference : n, >= 0, and pH_0, where the base law holds; n = 0 leaves pH out.
    chloride_order, chloride_reference : m, >= 0, and C_0, mol/m^3, > 0; m = 0 leaves it out.
    layer_thickness : h_0, m, > 0: where the layer halves the rate; infinite leaves it out.
    layer_twice : bool
        Whether a layer may slow a law of the volume loss, which has been fitted to metal under its
        layer and contains it.

    Raises
    ------
    ValueError
        For numbers out of range, a base law that looks at more than the volume loss, and a layer
        with the volume-loss law unless `layer_twice`.
    """

    base: Kinetics
    ph_order: float = 0.0
    ph_reference: float = 7.0
    chloride_order: float = 0.0
    chloride_reference: float = 1.0
    layer_thickness: float = math.inf
    layer_twice: bool = False

    def __post_init__(self) -> None:
        for name in ("ph_order", "chloride_order"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: {value}; it must be finite and at least 0")
        if not (math.isfinite(self.ph_reference)):
            raise ValueError(f"ph_reference: {self.ph_reference}; it must be finite")
        if not (math.isfinite(self.chloride_reference) and self.chloride_reference > 0):
            raise ValueError(
                f"chloride_reference: {self.chloride_reference} mol/m^3; it must be above 0"
            )
        if not self.layer_thickness > 0:
            raise ValueError(f"layer_thickness: {self.layer_thickness} m; it must be above 0")
        if not self.base.is_global:
            raise ValueError(
                f"base: {type(self.base).__name__} looks at more than the volume loss, which a "
                "factor cannot multiply"
            )
        layered = math.isfinite(self.layer_thickness)
        if layered and isinstance(self.base, VolumeLossLaw) and not self.layer_twice:
            raise ValueError(
                "layer_thickness: the law of the volume loss already contains the layer, which "
                "would count twice; layer_twice=True asks for it"
            )

    @property
    def needs(self) -> frozenset[str]:  # type: ignore[override]
        """The base law's, and what the factors that are not 1 look at."""
        own = {"ph"} if self.ph_order else set()
        own |= {"chloride"} if self.chloride_order else set()
        own |= {"layer"} if math.isfinite(self.layer_thickness) else set()
        return self.base.needs | own

    def rate(self, at: Exposed) -> float | np.ndarray:
        """The base law's rate times the factors."""
        factor: float | np.ndarray = self.base.rate(at)
        if self.ph_order:
            factor = factor * 10.0 ** (-self.ph_order * (at.ph - self.ph_reference))
        if self.chloride_order:
            factor = factor * (at.chloride / self.chloride_reference) ** self.chloride_order
        if math.isfinite(self.layer_thickness):
            factor = factor / (1.0 + at.layer / self.layer_thickness)
        return factor
