"""The ohmic film of salt at the bottom of a pit, from the current that diffusion lets through.

At a held potential a metal without a film offers i_0, and diffusion from C_sat carries i < i_0.
What is offered beyond that precipitates, and the film grows until its resistance has taken so much
of the potential that the metal offers what is carried: by a Tafel law of the slope b

    i = i_0 10^(-i s / (k b))    so that    i s / k = b log10(i_0 / i)

with s the film's thickness and k its conductivity.  It follows the current within

    t = s z F / (V i),

the time in which the current i precipitates it (V the salt's molar volume).  Complementarity gives
i without any film; where t is short beside the time that has passed, the film of that i is this one
(late by the share (1 + 1 / ln(i_0 / i)) of t over that time) and holds little metal itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from peri.engine.constants import FARADAY


@dataclass(frozen=True)
class SaltFilm:
    """A salt film over metal with a Tafel law.

    Parameters
    ----------
    conductivity : k, S/m, > 0.
    tafel_slope : b of the metal, V per decade, > 0.
    charge_number : z of the metal's ion, > 0.
    molar_volume : V of the salt per mol of metal, m^3/mol, > 0.

    Raises
    ------
    ValueError
        For numbers out of range; the methods for currents that are not between 0 and i_0.
    """

    conductivity: float
    tafel_slope: float
    charge_number: float
    molar_volume: float

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{f.name}: {value}; it must be finite and positive")

    def drop(self, current: np.ndarray, bare: float) -> np.ndarray:
        """What the film takes of the potential, V; current and bare current i_0, A/m^2."""
        i = np.asarray(current, float)
        if not ((i > 0) & (i <= bare * (1 + 1e-9))).all():
            raise ValueError(f"current: it must be above 0 and at most the bare one, {bare} A/m^2")
        return self.tafel_slope * np.log10(bare / np.minimum(i, bare))

    def thickness(self, current: np.ndarray, bare: float) -> np.ndarray:
        """s, m."""
        return self.conductivity * self.drop(current, bare) / np.asarray(current, float)

    def settling(self, current: np.ndarray, bare: float) -> np.ndarray:
        """t, s: how far behind the current the film may be."""
        charge = self.charge_number * FARADAY
        amount = self.thickness(current, bare) / self.molar_volume
        return amount * charge / np.asarray(current, float)
