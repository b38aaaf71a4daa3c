"""State at the quadrature points: what the last converged increment left, and what is tried now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem.constitutive.gurson import BULK, LIMIT, SHEAR
from fem.constitutive.laws import Laws
from fem.constitutive.material import identity_plastic, stiffness_left, strength_left


@dataclass
class Fields:
    """Arrays over (cells, points)."""

    plastic: np.ndarray  # (nl, nq, 6) Cp^-1: 00, 11, 22, 01, 02, 12
    strain: np.ndarray  # (nl, nq) accumulated plastic strain
    damage: np.ndarray  # (nl, nq) f
    mises: np.ndarray  # (nl, nq) equivalent Kirchhoff stress [Pa]
    pressure: np.ndarray  # (nl, nq) mean Kirchhoff stress [Pa]
    acted: np.ndarray  # (nl, nq) f that strength and moduli had at the equilibrium
    growth: np.ndarray  # (nl, nq) fall of ln(1 - f) in the last increment

    @classmethod
    def virgin(cls, damage: np.ndarray) -> Fields:
        """Undeformed material with damage variable f (nl, nq)."""
        shape = damage.shape
        return cls(
            identity_plastic(shape),
            np.zeros(shape),
            damage.copy(),
            np.zeros(shape),
            np.zeros(shape),
            damage.copy(),
            np.zeros(shape),
        )

    def copy(self) -> Fields:
        """Deep copy."""
        return Fields(*(getattr(self, name).copy() for name in self.__dataclass_fields__))


def grown_by(damage: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """f after a fall of ln(1 - f) by `growth`; f itself, to the last bit, where that is 0."""
    return damage + (damage - 1.0) * np.expm1(-growth)


class QuadratureState:
    """Old (committed) and new (tried) fields; `commit` accepts the new ones.

    acting (nl, nq): f that strength and moduli have in the increment that is tried: `old.damage`,
    or what is foreseen of its end (`foresee`).
    """

    def __init__(self, damage: np.ndarray) -> None:
        self.old = Fields.virgin(damage)
        self.new = self.old.copy()
        self.acting = damage.copy()

    def foresee(self, share: float, laws: Laws) -> None:
        """Let that f act which the increment ends with if f grows on as in the last one.

        share: size of the increment over that of the last one. At most half of the way to f_max is
        foreseen, and no fall of f: where pores close, f follows within the increment.
        """
        damage = self.old.damage
        foreseen = grown_by(damage, share * np.maximum(self.old.growth, 0.0))
        halfway = 0.5 * (damage + laws.per_cell(LIMIT))
        self.acting = np.maximum(damage, np.minimum(foreseen, halfway))

    def growth(self) -> np.ndarray:
        """Fall of ln(1 - f) from old to new (nl, nq): the plastic volume strain of (5.42)."""
        return np.log((1.0 - self.old.damage) / (1.0 - self.new.damage))

    def average_damage(self, weights: np.ndarray) -> None:
        """Give all points of a cell the mean of their new f; weights: (nq,) of the quadrature."""
        mean = self.new.damage @ (weights / weights.sum())
        self.new.damage[:] = mean[:, None]

    def lagging_work(self, volumes: np.ndarray, laws: Laws) -> float:
        """By how much the plastic work changes if the new f had acted [J]: amounts of all points.

        Strength falls with f by 1 - q1 f; the flow is taken as it was. Where pores close, f fell
        within the increment from the f acting, and that is what acted.
        volumes: (nl, nq) [m^3], zero where a point is another rank's.
        """
        old, new, opened = self.old, self.new, self.growth()
        flowed = np.sqrt(np.maximum((new.strain - old.strain) ** 2 - 2.0 / 9.0 * opened**2, 0.0))
        work = new.mises * flowed + new.pressure * opened
        acted = grown_by(self.acting, np.minimum(opened, 0.0))
        acted = strength_left(acted, laws.parameters, laws.of_cell)
        left = strength_left(new.damage, laws.parameters, laws.of_cell)
        return float(abs(volumes * work * (1.0 - left / acted)).sum())

    def freed_energy(self, volumes: np.ndarray, laws: Laws) -> float:
        """Elastic energy that the loss of stiffness, from the f acting before to now, frees [J].

        volumes: (nl, nq) [m^3], zero where a point is another rank's.
        """
        before = stiffness_left(self.old.acted, laws.parameters, laws.of_cell)
        after = stiffness_left(self.acting, laws.parameters, laws.of_cell)
        stored = self.old.pressure**2 / (2.0 * laws.per_cell(BULK))
        stored += self.old.mises**2 / (6.0 * laws.per_cell(SHEAR))
        return float((volumes * stored / before * (1.0 - after / before)).sum())

    def commit(self) -> None:
        """Accept the tried state; the next assembly overwrites `new` completely."""
        self.new.growth[:] = self.growth()
        self.new.acted[:] = self.acting
        self.old, self.new = self.new, self.old
        self.acting = self.old.damage.copy()
