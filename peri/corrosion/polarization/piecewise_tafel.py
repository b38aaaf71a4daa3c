"""Tafel's law in pieces: semi-logarithmic lines between given potentials."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from peri.corrosion.polarization.law import PolarizationLaw
from peri.corrosion.polarization.tafel import TafelCurve

_ROUNDING = 1e-9


@dataclass(frozen=True)
class PiecewiseTafelCurve(PolarizationLaw):
    """A Tafel law on each interval of the potential.

    A curve as published may jump at a joint.  Where it falls, a potential problem may have several
    solutions, so a fall is refused unless it is asked for.  AE44 of Zhao et al. 2021, Table 3,
    falls at -1.48 V from 30.16 to 21.145 A/m^2 and jumps at -1.41 V from 55.83 to 58.107: the
    printed slopes 0.021 and 0.166 V are 0.022019 and 0.159446 V on a continuous curve.

    Parameters
    ----------
    pieces : tuple of TafelCurve
        In order of the potential, all anodic or all cathodic.
    joints : tuple of float
        V, ascending, where one piece ends and the next begins; one fewer than the pieces.
    as_published : bool
        Accept a curve that falls at a joint.

    Raises
    ------
    ValueError
        For joints that do not ascend or do not fit, pieces of both signs, or a fall; the text
        names the two currents and the slope of a continuous curve.
    """

    pieces: tuple[TafelCurve, ...]
    joints: tuple[float, ...]
    as_published: bool = False

    def __post_init__(self) -> None:
        if len(self.pieces) != len(self.joints) + 1:
            raise ValueError(
                f"joints: {len(self.joints)} for {len(self.pieces)} pieces; one fewer is needed"
            )
        ascending = all(a < b for a, b in itertools.pairwise(self.joints))
        if not (ascending and all(math.isfinite(v) for v in self.joints)):
            raise ValueError(f"joints: {list(self.joints)} V; they must be finite and ascend")
        if len({p.tafel_slope > 0 for p in self.pieces}) > 1:
            raise ValueError(
                "pieces: anodic and cathodic ones; all must have one sign of the slope"
            )
        if not self.as_published:
            for joint, (before, after) in zip(
                self.joints, itertools.pairwise(self.pieces), strict=True
            ):
                self._check_joint(joint, before, after)

    @staticmethod
    def _check_joint(joint: float, before: TafelCurve, after: TafelCurve) -> None:
        low, high = float(before.current(joint)), float(after.current(joint))
        if high >= low - _ROUNDING * abs(low):
            return
        offered = ""
        if low * high > 0 and joint != before.standard_potential:
            slope = _joining_slope(before, joint, high)
            offered = f", or give the piece below a slope of {slope:.6g} V, which joins them"
        raise ValueError(
            f"joints: at {joint} V the current falls from {low:.5g} to {high:.5g} A/m^2; it must "
            f"not fall with the potential unless as_published{offered}"
        )

    def continuous(self) -> PiecewiseTafelCurve:
        """The curve whose slopes make it continuous: each but the last piece meets the next.

        Raises ValueError where a piece starts at the joint it would have to turn about.
        """
        pieces = list(self.pieces)
        for n in reversed(range(len(self.joints))):
            joint = self.joints[n]
            if joint == pieces[n].standard_potential:
                raise ValueError(f"joints: the piece below {joint} V is stated at its own end")
            slope = _joining_slope(pieces[n], joint, float(pieces[n + 1].current(joint)))
            pieces[n] = replace(pieces[n], tafel_slope=slope)
        return replace(self, pieces=tuple(pieces), as_published=False)

    def _by_piece(self, potential: np.ndarray | float, what: str) -> np.ndarray:
        place = np.asarray(potential, float)
        number = np.searchsorted(self.joints, place, side="right")
        values = [getattr(piece, what)(place) for piece in self.pieces]
        return np.choose(number, values) if place.ndim else values[int(number)]

    def current(self, potential: np.ndarray | float) -> np.ndarray:
        """That of the piece; at a joint that of the piece above."""
        return self._by_piece(potential, "current")

    def slope(self, potential: np.ndarray | float) -> np.ndarray:
        """That of the piece; at a joint that of the piece above."""
        return self._by_piece(potential, "slope")


def _joining_slope(piece: TafelCurve, joint: float, current: float) -> float:
    """The slope with which a piece has a current (A/m^2) at a joint (V)."""
    return (joint - piece.standard_potential) / math.log10(abs(current) / piece.current_density)
