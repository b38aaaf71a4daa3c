"""Anode and cathode of a corroding metal: Butler-Volmer, hydrogen evolution, and their balance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics
from peri.engine.constants import FARADAY, GAS_CONSTANT
from peri.engine.march.problem import BoundsError

BALANCES = ("local", "mixed", "applied")
"""How anode and cathode share the charge: at one place; all over the metal, which has one potential
of its own (mixed), or one that is held, or that carries a held current (applied)."""

_HALVINGS = 200


class PlatingError(BoundsError, ValueError):
    """The metal's ions would plate out on it; in the rounds of a stage it may pass."""


@dataclass(frozen=True)
class ElectrodeKinetics(Kinetics):
    """A metal that dissolves as its anode lets it, hydrogen evolving at its cathode.

        i_a = i_0 [exp(alpha_a z F (E - E_0) / RT) - (C_Mg / C_0) exp(-alpha_c z F (E - E_0) / RT)]
        i_c = j_0 10^(-n (pH - pH_0)) exp(-alpha F (E - E_H) / RT)

    the first Butler-Volmer for the metal with its ions in front of the back reaction (finite in
    clean liquid, Nernst's at equilibrium; (3.103) of the dissertation prints a logarithm that is
    minus infinity there), the second hydrogen evolution (5.29 with the sign that slows it as E
    rises).  E is metal minus liquid.  The rate is i_a over its value where i_a = i_c in the medium
    (pH_0, no magnesium), which the scene's dissolution flux is stated for.

    Parameters
    ----------
    anodic, cathodic : i_0 and j_0, A/m^2, > 0
    potential, hydrogen_potential : E_0 and E_H, V on one scale
    charge_number : z, > 0;  anodic_transfer, back_transfer, cathodic_transfer : alpha, 0..1
    reference : C_0, mol/m^3, > 0: where E_0 holds
    ph_order, ph_reference : n, >= 0, and pH_0
    temperature : K, > 0
    balance : of BALANCES.  `local`: E is where i_a = i_c at every node.  Else the metal has one
        potential and the node's E is `Exposed.potential` (peri.coupled.charge_balance).
    applied_potential : of the metal against the refreshed liquid, V, with `applied`
    applied_current : from the metal through the liquid to the refreshed layer, A (A/m in 2D,
        A/m^2 in 1D), anodic > 0, with `applied` in the place of the potential

    Raises
    ------
    ValueError
        For numbers out of range and another balance.
    """

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
    applied_potential: float | None = None
    applied_current: float | None = None

    def __post_init__(self) -> None:
        if self.balance not in BALANCES:
            raise ValueError(f"balance: '{self.balance}'; it must be one of {', '.join(BALANCES)}")
        for name in ("anodic", "cathodic", "reference", "charge_number", "temperature"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
        for name in ("anodic_transfer", "back_transfer", "cathodic_transfer"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name}: {getattr(self, name)}; it must be above 0 and at most 1")
        if not (math.isfinite(self.ph_order) and self.ph_order >= 0):
            raise ValueError(f"ph_order: {self.ph_order}; it must be finite and at least 0")
        given = [v for v in (self.applied_potential, self.applied_current) if v is not None]
        if len(given) != (self.balance == "applied"):
            raise ValueError(
                f"balance: '{self.balance}' with {len(given)} of applied_potential and "
                "applied_current; 'applied' takes one of them, the others none"
            )
        if not all(math.isfinite(v) for v in given):
            raise ValueError(f"applied: {given[0]}; it must be finite")

    @property
    def needs(self) -> frozenset[str]:  # type: ignore[override]
        """pH and magnesium and, unless anode and cathode are at one place, the potential."""
        beside = {"ph", "magnesium"}
        return frozenset(beside if self.balance == "local" else beside | {"potential"})

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

    @property
    def free_current(self) -> float:
        """i_a = i_c in the medium, A/m^2: the current that rate 1 stands for."""
        rest = self.corrosion_potential(self.ph_reference, 0.0)
        return float(self.currents(rest, self.ph_reference, 0.0)[1])

    def rates(
        self, potential: np.ndarray, ph: np.ndarray | float, magnesium: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """i_a and i_c over `free_current`."""
        anodic, cathodic = self.currents(potential, ph, magnesium)
        return anodic / self.free_current, cathodic / self.free_current

    def rate(self, at: Exposed) -> np.ndarray:
        """i_a over that in the medium.

        Raises PlatingError where the metal's ions would plate out on it.
        """
        if self.balance == "local":
            free = self.corrosion_potential(at.ph, at.magnesium)
            # The cathode's current is the anode's, and has no difference of large numbers in it.
            return self.rates(free, at.ph, at.magnesium)[1]
        anodic, _ = self.rates(np.asarray(at.potential), at.ph, at.magnesium)
        if (anodic < 0).any():
            lowest = float(np.asarray(at.potential)[anodic < 0].min())
            raise PlatingError(
                f"potential: at {lowest:.4g} V the metal's ions would plate out on it, which is "
                "not computed; hold it higher"
            )
        return anodic
