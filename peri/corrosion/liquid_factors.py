"""What the liquid beside the metal does to the rate: factors, and a local charge balance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics, VolumeLossLaw
from peri.engine.constants import FARADAY, GAS_CONSTANT

BALANCES = ("local",)
"""How anode and cathode share the charge.  Where they stand apart (one corrosion potential for the
whole metal, an applied one), charge flows through the liquid, which a liquid without a net current
does not carry."""

_HALVINGS = 200


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


@dataclass(frozen=True)
class FreeCorrosion(Kinetics):
    """Anode and cathode at one place, at the potential E where their currents are equal.

        i_a = i_0 [exp(alpha_a z F (E - E_0) / RT) - (C_Mg / C_0) exp(-alpha_c z F (E - E_0) / RT)]
        i_c = j_0 10^(-n (pH - pH_0)) exp(-alpha F (E - E_H) / RT)

    the first Butler-Volmer for the metal with its ions in front of the back reaction (finite in
    clean liquid, Nernst's at equilibrium; (3.103) of the dissertation prints a logarithm that is
    minus infinity there), the second hydrogen evolution (5.29 with the sign that slows it as E
    rises).  The rate is i_a over its value in the medium (pH_0, no magnesium).

    Parameters
    ----------
    anodic, cathodic : i_0 and j_0, A/m^2, > 0
    potential, hydrogen_potential : E_0 and E_H, V on one scale
    charge_number : z, > 0;  anodic_transfer, back_transfer, cathodic_transfer : alpha, 0..1
    reference : C_0, mol/m^3, > 0: where E_0 holds
    ph_order, ph_reference : n, >= 0, and pH_0
    temperature : K, > 0
    balance : "local"

    Raises
    ------
    ValueError
        For numbers out of range and another balance.
    """

    needs = frozenset({"ph", "magnesium"})

    anodic: float
    cathodic: float
    potential: float
    hydrogen_potential: float
    reference: float = 1000.0
    charge_number: float = 2.0
    anodic_transfer: float = 0.5
    back_transfer: float = 0.5
    cathodic_transfer: float = 0.5
    ph_order: float = 0.0
    ph_reference: float = 7.0
    temperature: float = 310.15
    balance: str = "local"

    def __post_init__(self) -> None:
        if self.balance not in BALANCES:
            raise ValueError(
                f"balance: '{self.balance}'; it must be local, because a liquid that carries no "
                "net current cannot join an anode to a cathode elsewhere"
            )
        for name in ("anodic", "cathodic", "reference", "charge_number", "temperature"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
        for name in ("anodic_transfer", "back_transfer", "cathodic_transfer"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name}: {getattr(self, name)}; it must be above 0 and at most 1")
        if not (math.isfinite(self.ph_order) and self.ph_order >= 0):
            raise ValueError(f"ph_order: {self.ph_order}; it must be finite and at least 0")

    def currents(
        self, potential: np.ndarray, ph: np.ndarray | float, magnesium: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """i_a and i_c, A/m^2, at potentials (V) and what the liquid beside the metal is like."""
        thermal = GAS_CONSTANT * self.temperature / FARADAY
        z, eta = self.charge_number, (potential - self.potential) / thermal
        forward = np.exp(np.minimum(self.anodic_transfer * z * eta, 700.0))
        back = np.exp(np.minimum(-self.back_transfer * z * eta, 700.0))
        anodic = self.anodic * (forward - magnesium / self.reference * back)
        away = (potential - self.hydrogen_potential) / thermal
        acid = 10.0 ** (-self.ph_order * (np.asarray(ph) - self.ph_reference))
        return anodic, self.cathodic * acid * np.exp(
            np.minimum(-self.cathodic_transfer * away, 700.0)
        )

    def corrosion_potential(
        self, ph: np.ndarray | float, magnesium: np.ndarray | float
    ) -> np.ndarray:
        """E, V, where i_a = i_c: i_a rises and i_c falls with E, so there is exactly one."""
        ph, magnesium = np.broadcast_arrays(np.asarray(ph, float), np.asarray(magnesium, float))
        middle = 0.5 * (self.potential + self.hydrogen_potential)
        low = np.full(ph.shape, middle - 20.0)
        high = np.full(ph.shape, middle + 20.0)
        for _ in range(_HALVINGS):
            half = 0.5 * (low + high)
            anodic, cathodic = self.currents(half, ph, magnesium)
            rises = anodic > cathodic
            low, high = np.where(rises, low, half), np.where(rises, half, high)
            if (high - low <= 1e-15 * np.maximum(np.abs(high), 1.0)).all():
                break
        return 0.5 * (low + high)

    def rate(self, at: Exposed) -> np.ndarray:
        """i_a over that in the medium."""
        free = self.corrosion_potential(at.ph, at.magnesium)
        rest = self.corrosion_potential(self.ph_reference, 0.0)
        # The cathode's current is the anode's, and has no difference of large numbers in it.
        _, current = self.currents(free, at.ph, at.magnesium)
        _, medium = self.currents(rest, self.ph_reference, 0.0)
        return current / medium
