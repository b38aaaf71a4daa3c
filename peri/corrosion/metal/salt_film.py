"""The ohmic film of salt between saturated liquid and its metal, from the current through it.

At a held potential E a metal without a film offers i_0, and diffusion from C_sat carries i < i_0.
What is offered beyond that precipitates, and the film grows until its resistance has taken so much
of the potential that the metal offers what is carried: by a Tafel law of the slope b

    i = i_0 10^(-i s / (k b))    so that    i s / k = b log10(i_0 / i)

with s the film's thickness and k its conductivity.  It follows the current within

    t = s z F / (V i),

the time in which the current i precipitates it (V the salt's molar volume).  The saturation factors
theta of complementarity are that film's: bonds carry theta of what bare metal offers, theta =
10^(-drop / b), so the film needs no state of its own.  A film whose growth is integrated in time is
late by the share (1 + 1 / ln(i_0 / i)) of t over the time that has passed, and holds little metal.

The current does not depend on E while there is a film, whose drop is E - E_T: at the transition
potential E_T = E - drop bare metal offers just what is carried, and below it there is no film.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from peri.engine.constants import FARADAY
from peri.engine.influence import Stencil


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


def carried_share(theta: np.ndarray, metal: np.ndarray, stencil: Stencil) -> np.ndarray:
    """Share of the bare current that the surface near each liquid node carries, 1 without a film.

    Mean of theta over the bonds of all liquid nodes within the horizon of one that see metal.  All
    layers of liquid that see a flat front are within it, so that this is the current of the front
    over the bare one; theta of a node alone is not, because liquid a little away from the surface
    is below C_sat and takes what its bonds offer.

    theta, metal : on the lattice, theta 0 where there is none.
    """
    from scipy.ndimage import convolve

    signed = [np.abs(np.arange(1 - n, n)) for n in stencil.octant.shape]
    weights = stencil.octant[np.ix_(*signed)]
    within = (weights > 0).astype(float)
    within[tuple(n - 1 for n in stencil.octant.shape)] = 1.0
    bonds = convolve(metal.astype(float), weights, mode="constant") * (theta > 0)
    offered = convolve(bonds, within, mode="constant")
    carried = convolve(bonds * theta, within, mode="constant")
    sees = (bonds > 1e-9 * weights.sum()) & (carried < offered * (1 - 1e-9))
    return np.divide(carried, offered, out=np.ones_like(theta), where=sees)
