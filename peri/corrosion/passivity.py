"""Metal that is passive in dilute liquid and dissolves in what a pit makes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.kinetics import Exposed, Kinetics


@dataclass(frozen=True)
class Repassivation(Kinetics):
    """Rate p + (1 - p) ramp((C - C_crit) / w), from p (passive) below C_crit to 1 (active) above.

    A film stands where the liquid holds less of the metal's ions than C_crit and dissolves the
    share p of the active rate through itself; the ramp of width w in the place of a switch makes
    the result one of the concentration and not of the step (the switch of the published procedure
    for lacy covers depends on it).  C is that of the liquid that a node sees, so a pit's mouth
    becomes passive while its bottom goes on, and what is undermined becomes a lacy cover.

    Parameters
    ----------
    critical_concentration : float
        C_crit, mol/m^3, > 0.
    saturation_concentration : float
        C_sat, mol/m^3; a film that stood at C_sat would never let a pit begin, so C_crit + w must
        not exceed it.
    passive_share : float
        p, from 0 to below 1.
    width : float, optional
        w, mol/m^3, > 0; default 2 % of C_sat.

    Raises
    ------
    ValueError
        For values out of range; `rate` for concentrations that are not finite.
    """

    needs = frozenset({"concentration"})

    critical_concentration: float
    saturation_concentration: float
    passive_share: float = 0.0
    width: float | None = None

    def __post_init__(self) -> None:
        for name in ("critical_concentration", "saturation_concentration", "width"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} mol/m^3; it must be finite and positive")
        if self.width is None:
            object.__setattr__(self, "width", 0.02 * self.saturation_concentration)
        most = self.saturation_concentration - self.width
        if not self.critical_concentration <= most * (1 + 1e-12):
            raise ValueError(
                f"critical_concentration: {self.critical_concentration} mol/m^3; it must be at "
                f"most {most:.6g}, the ramp's width below saturation"
            )
        if not 0 <= self.passive_share < 1:
            raise ValueError(
                f"passive_share: {self.passive_share}; it must be at least 0 and below 1"
            )

    def _above(self, at: Exposed) -> np.ndarray:
        seen = np.asarray(at.concentration, float)
        if not np.isfinite(seen).all():
            raise ValueError("concentration: it must be finite everywhere")
        return (seen - self.critical_concentration) / self.width

    def rate(self, at: Exposed) -> float | np.ndarray:
        """From p to 1 by the concentration of the liquid that a node sees."""
        active = np.clip(self._above(at), 0.0, 1.0)
        return self.passive_share + (1.0 - self.passive_share) * active

    def slope(self, at: Exposed) -> np.ndarray:
        """Derivative of the rate by the concentration, m^3/mol; 0 off the ramp."""
        above = self._above(at)
        on_ramp = (above > 0) & (above < 1)
        return np.where(on_ramp, (1.0 - self.passive_share) / self.width, 0.0)


@dataclass(frozen=True)
class Rupture(Repassivation):
    """Repassivation whose film breaks for good where the metal below it is nearly gone.

    A node under a film that stands dissolves from below, by the liquid of the pit that has
    undermined it.  When it has lost the share d_r of its metal, the film breaks and the rate rises
    to 1 whatever the liquid, over a ramp of width w_d: the larger of both ramps counts.  What a
    node has lost only grows, so a broken film stays broken.  A step goes by what was lost at its
    beginning, so a film breaks late by at most a step, and never because a step is long.

    Parameters
    ----------
    rupture : float
        d_r, above 0; d_r + w_d at most 1.
    rupture_width : float
        w_d, > 0.
    """

    needs = frozenset({"concentration", "lost"})

    rupture: float = 0.5
    rupture_width: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("rupture", "rupture_width"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
        if not self.rupture + self.rupture_width <= 1 + 1e-12:
            raise ValueError(
                f"rupture: {self.rupture}; with its width of {self.rupture_width} it must be at "
                "most 1, all of a node's metal"
            )

    def rate(self, at: Exposed) -> float | np.ndarray:
        """From p to 1 by the concentration that a node sees and by what it has lost."""
        broken = np.clip((np.asarray(at.lost) - self.rupture) / self.rupture_width, 0.0, 1.0)
        active = np.maximum(np.clip(self._above(at), 0.0, 1.0), broken)
        return self.passive_share + (1.0 - self.passive_share) * active
