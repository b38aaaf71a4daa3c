"""Polarization laws: the current density of an electrode against its potential.

E = V_metal - phi_liquid at the surface, V; i in A/m^2, positive where metal dissolves.  A law is
called with an array of E and returns i and di/dE >= 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

_LN10 = float(np.log(10.0))
_LARGEST_DECADES = 120.0
"""Decades of a Tafel law at which its exponent is cut, far beyond any current that a liquid
carries: 1e120 A/m^2 keeps products of currents finite."""


class Polarization(Protocol):
    """What the potential problem asks of an electrode."""

    def __call__(self, potential: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Current density, A/m^2, and its derivative, A/(m^2 V), shaped like `potential` (V)."""
        ...


@dataclass(frozen=True)
class LinearPolarization:
    """i = (E - E_0) / R_p.

    rest : E_0, V.  resistance : R_p, ohm m^2, positive.
    """

    rest: float
    resistance: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.resistance) and self.resistance > 0):
            raise ValueError(f"resistance: {self.resistance} ohm m^2; it must be positive")

    def __call__(self, potential: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slope = np.full(np.shape(potential), 1.0 / self.resistance)
        return (potential - self.rest) * slope, slope


@dataclass(frozen=True)
class Tafel:
    """i = i_0 10^((E - E_0) / b), anodic (b > 0), or -i_0 10^((E - E_0) / b), cathodic (b < 0).

    exchange : i_0, A/m^2, positive.  slope : b, V a decade.  rest : E_0, V.
    """

    exchange: float
    slope: float
    rest: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.exchange) and self.exchange > 0):
            raise ValueError(f"exchange: {self.exchange} A/m^2; it must be positive")
        if not np.isfinite(self.slope) or self.slope == 0:
            raise ValueError(f"slope: {self.slope} V a decade; it must be finite and not 0")

    def __call__(self, potential: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decades = np.clip((potential - self.rest) / self.slope, None, _LARGEST_DECADES)
        size = self.exchange * 10.0**decades
        return (size if self.slope > 0 else -size), size * _LN10 / abs(self.slope)


class PiecewiseTafel:
    """Anodic Tafel laws one after the other; each holds below the next one's potential.

    Parameters
    ----------
    pieces : sequence of Tafel
        In the order of their `rest`, which is where a piece begins (the first one reaches down).
    as_published : bool
        Take jumps at the joints as they are; by default they are refused.

    Raises
    ------
    ValueError
        For pieces out of order, cathodic ones, or a current that jumps by more than 1e-3 of
        itself at a joint: a current that falls leaves the solution without a guarantee.
    """

    def __init__(self, pieces: Sequence[Tafel], as_published: bool = False) -> None:
        self.pieces = list(pieces)
        self.joints = np.array([piece.rest for piece in self.pieces[1:]])
        if not self.pieces or any(piece.slope < 0 for piece in self.pieces):
            raise ValueError("pieces: at least one, and anodic ones (slope > 0) only")
        if np.any(np.diff([piece.rest for piece in self.pieces]) <= 0):
            raise ValueError("pieces: their potentials `rest` must rise")
        for before, after in zip(self.pieces, self.pieces[1:], strict=False):
            end = float(before(np.array(after.rest))[0])
            if not as_published and abs(after.exchange / end - 1) > 1e-3:
                slope = (after.rest - before.rest) / np.log10(after.exchange / before.exchange)
                raise ValueError(
                    f"pieces: at {after.rest:g} V the current jumps from {end:.5g} to "
                    f"{after.exchange:.5g} A/m^2; a slope of {slope:.6g} V a decade is continuous"
                )

    def __call__(self, potential: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        potential = np.asarray(potential, float)
        number = np.searchsorted(self.joints, potential, side="right")
        current, slope = np.zeros_like(potential), np.zeros_like(potential)
        for n, piece in enumerate(self.pieces):
            here = number == n
            current[here], slope[here] = piece(potential[here])
        return current, slope


def surface_potential(
    law: Polarization, seen: np.ndarray, resistance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The potential E with E + R i(E) = `seen`: what a patch has behind the liquid it sees.

    Newton's method on a function that rises, kept within a bracket that halves where Newton
    leaves it.

    Parameters
    ----------
    seen : (n,) V
    resistance : (n,) R >= 0, ohm m^2

    Returns
    -------
    E (V), i (A/m^2) and di/d(seen), A/(m^2 V).

    Raises
    ------
    ValueError
        Where the law's slope is negative.
    """
    potential = np.array(seen, float)
    current, slope = law(potential)
    low = np.where(current > 0, -np.inf, potential)
    high = np.where(current > 0, potential, np.inf)
    tolerance = 4e-16 * np.maximum(1.0, np.abs(potential))
    reach = 0.05
    for n in range(200):
        if np.any(slope < 0):
            raise ValueError("law: its current falls where the potential rises")
        excess = potential + resistance * current - seen
        high = np.where(excess > 0, np.minimum(high, potential), high)
        low = np.where(excess < 0, np.maximum(low, potential), low)
        newton = -excess / (1.0 + resistance * slope)
        done = np.abs(newton) <= tolerance
        if done.all():
            break
        trial = potential + newton
        # Newton crawls along an exponential, ln 10 steps a decade: every third step looks further.
        crawls = (np.abs(newton) > 1e-4) & (n % 3 == 2)
        outside = (trial < low) | (trial > high)
        bracketed = np.isfinite(low) & np.isfinite(high)
        half = 0.5 * (np.where(bracketed, low, 0.0) + np.where(bracketed, high, 0.0))
        further = potential + np.where(np.isfinite(low), reach, -reach)
        reach *= 2.0 if n % 3 == 2 else 1.0
        trial = np.where(crawls | outside, np.where(bracketed, half, further), trial)
        potential = np.where(done, potential, trial)
        current, slope = law(potential)
    # The better conditioned of two expressions of the current.
    steep = resistance * slope > 1.0
    series = (seen - potential) / np.where(steep, resistance, 1.0)
    current = np.where(steep, series, current)
    return potential, current, slope / (1.0 + resistance * slope)
