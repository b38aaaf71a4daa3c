"""Isotropic hardening: yield stress of the undamaged metal against accumulated plastic strain.

A law is a small frozen dataclass for the reader and a (kind, parameters) pair for the kernels.
Where a newcomer adds one: a dataclass with `parameters()`, a branch in `flow_stress`, a row in the
catalogue of tests/fem/test_hardening.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fem.constitutive.compiled import kernel

VOCE, SWIFT, TABLE = 0, 1, 2


class Hardening(Protocol):
    """What the kernels need of a hardening law."""

    kind: int

    def parameters(self) -> np.ndarray:
        """Numbers that `flow_stress` reads, in its order."""


def _require(condition: bool, field: str, value: object, allowed: str) -> None:
    if not condition:
        raise ValueError(f"hardening {field} is {value}; it must be {allowed}")


@dataclass(frozen=True)
class VoceHardening:
    """s = s0 + linear e + Q (1 - exp(-b e)), in Pa; `linear` = 0 is Voce's own law.

    Q = 0 and linear = 0 is perfect plasticity.
    """

    s0: float
    Q: float = 0.0
    b: float = 1.0
    linear: float = 0.0
    kind: int = VOCE

    def __post_init__(self) -> None:
        _require(np.isfinite(self.s0) and self.s0 > 0, "s0", self.s0, "a positive stress in Pa")
        _require(
            np.isfinite(self.Q) and self.Q >= 0, "Q", self.Q, "zero or a positive stress in Pa"
        )
        _require(np.isfinite(self.b) and self.b > 0, "b", self.b, "a positive number")
        _require(
            np.isfinite(self.linear) and self.linear >= 0,
            "linear",
            self.linear,
            "zero or positive, in Pa",
        )

    def parameters(self) -> np.ndarray:
        """s0, Q, b, linear."""
        return np.array([self.s0, self.Q, self.b, self.linear])


@dataclass(frozen=True)
class SwiftHardening:
    """s = s0 (1 + e / e0)^n, in Pa."""

    s0: float
    e0: float
    n: float
    kind: int = SWIFT

    def __post_init__(self) -> None:
        _require(np.isfinite(self.s0) and self.s0 > 0, "s0", self.s0, "a positive stress in Pa")
        _require(np.isfinite(self.e0) and self.e0 > 0, "e0", self.e0, "a positive strain")
        _require(0 <= self.n < 1, "n", self.n, "in [0, 1)")

    def parameters(self) -> np.ndarray:
        """s0, e0, n."""
        return np.array([self.s0, self.e0, self.n])


@dataclass(frozen=True)
class TabulatedHardening:
    """Piecewise linear through (plastic strain, stress in Pa); constant beyond the last point."""

    strains: tuple[float, ...]
    stresses: tuple[float, ...]
    kind: int = TABLE

    def __post_init__(self) -> None:
        strain, stress = np.asarray(self.strains, float), np.asarray(self.stresses, float)
        _require(
            strain.ndim == 1 and len(strain) == len(stress) >= 1, "table", len(strain), "pairs"
        )
        _require(strain[0] == 0, "first strain", strain[0], "0")
        _require(bool(np.all(np.diff(strain) > 0)), "strains", self.strains, "increasing")
        _require(
            bool(stress[0] > 0 and np.all(np.diff(stress) >= 0)),
            "stresses",
            self.stresses,
            "positive and not falling",
        )

    def parameters(self) -> np.ndarray:
        """Strains, then stresses."""
        return np.concatenate([np.asarray(self.strains, float), np.asarray(self.stresses, float)])


@kernel
def flow_stress(kind: int, parameters: np.ndarray, strain: float) -> tuple[float, float]:
    """Return yield stress [Pa] and its slope [Pa] at an accumulated plastic strain."""
    if kind == VOCE:
        decay = parameters[1] * np.exp(-parameters[2] * strain)
        stress = parameters[0] + parameters[3] * strain + parameters[1] - decay
        return stress, parameters[3] + parameters[2] * decay
    if kind == SWIFT:
        base = 1.0 + strain / parameters[1]
        stress = parameters[0] * base ** parameters[2]
        return stress, stress * parameters[2] / (base * parameters[1])
    size = parameters.size // 2
    if strain >= parameters[size - 1]:
        return parameters[2 * size - 1], 0.0
    low, high = 0, size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if parameters[middle] <= strain:
            low = middle
        else:
            high = middle
    slope = (parameters[size + high] - parameters[size + low]) / (
        parameters[high] - parameters[low]
    )
    return parameters[size + low] + slope * (strain - parameters[low]), slope


def fit_voce(yield_stress: float, ultimate_stress: float, uniform_strain: float) -> VoceHardening:
    """Fit Voce's law through yield, Considere's condition and the ultimate strength.

    With e = ln(1 + uniform_strain) and true stress s = ultimate_stress (1 + uniform_strain), the
    law must give s(e) = s and ds/de(e) = s. With s0 = yield_stress this leaves one equation
    for x = b e: x / (exp(x) - 1) = s e / (s - s0), which has one positive root when s e < s - s0.

    Stresses in Pa (engineering), strain engineering. Raises ValueError where no such law exists.
    """
    if not 0 < yield_stress < ultimate_stress:
        raise ValueError(
            f"yield stress is {yield_stress} Pa and ultimate stress {ultimate_stress} Pa; "
            "0 < yield < ultimate is needed"
        )
    if not 0 < uniform_strain < 1:
        raise ValueError(
            f"uniform strain is {uniform_strain}; it must be in (0, 1), as engineering strain"
        )
    strain = np.log1p(uniform_strain)
    stress = ultimate_stress * (1.0 + uniform_strain)
    ratio = stress * strain / (stress - yield_stress)
    if ratio >= 1.0:
        raise ValueError(
            f"uniform strain is {uniform_strain}; with yield {yield_stress} Pa and ultimate "
            f"{ultimate_stress} Pa a Voce curve exists only below the strain where "
            "ultimate (1 + strain) ln(1 + strain) = ultimate (1 + strain) - yield"
        )
    low, high = 1e-12, 700.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle / np.expm1(middle) > ratio:
            low = middle
        else:
            high = middle
    exponent = 0.5 * (low + high)
    saturation = (stress - yield_stress) / -np.expm1(-exponent)
    return VoceHardening(yield_stress, saturation, exponent / strain)
