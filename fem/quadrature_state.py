"""State at the quadrature points: what the last converged increment left, and what is tried now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem.constitutive.gurson import BULK, SHEAR
from fem.constitutive.laws import Laws
from fem.constitutive.material import identity_plastic, stiffness_left


@dataclass
class Fields:
    """Arrays over (cells, points)."""

    plastic: np.ndarray  # (nl, nq, 6) Cp^-1: 00, 11, 22, 01, 02, 12
    strain: np.ndarray  # (nl, nq) accumulated plastic strain
    damage: np.ndarray  # (nl, nq) f
    mises: np.ndarray  # (nl, nq) equivalent Kirchhoff stress [Pa]
    pressure: np.ndarray  # (nl, nq) mean Kirchhoff stress [Pa]

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
        )

    def copy(self) -> Fields:
        """Deep copy."""
        return Fields(*(getattr(self, name).copy() for name in self.__dataclass_fields__))


class QuadratureState:
    """Old (committed) and new (tried) fields; `commit` accepts the new ones."""

    def __init__(self, damage: np.ndarray) -> None:
        self.old = Fields.virgin(damage)
        self.new = self.old.copy()

    def average_damage(self, weights: np.ndarray) -> None:
        """Give all points of a cell the mean of their new f; weights: (nq,) of the quadrature."""
        mean = self.new.damage @ (weights / weights.sum())
        self.new.damage[:] = mean[:, None]

    def freed_energy(self, volumes: np.ndarray, laws: Laws) -> float:
        """Elastic energy that the loss of stiffness from old to new f sets free [J].

        volumes: (nl, nq) [m^3], zero where a point is another rank's.
        """
        before = stiffness_left(self.old.damage, laws.parameters, laws.of_cell)
        after = stiffness_left(self.new.damage, laws.parameters, laws.of_cell)
        stored = self.new.pressure**2 / (2.0 * laws.per_cell(BULK))
        stored += self.new.mises**2 / (6.0 * laws.per_cell(SHEAR))
        return float((volumes * stored / before * (1.0 - after / before)).sum())

    def commit(self) -> None:
        """Accept the tried state; the next assembly overwrites `new` completely."""
        self.old, self.new = self.new, self.old
