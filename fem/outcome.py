"""What a tensile test finds: the force-elongation curve and its peak."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fem.loading import Load

_UNEVEN = 3.0  # of increments next to the peak


@dataclass
class TensileResult:
    """Outcome of a test, the same on every rank.

    The curve is motion against reaction: elongation [m] and force [N] of an axial test, angle [rad]
    and torque or moment [N m] otherwise; `history` has both under these names, and the properties
    of that name raise AttributeError for another load. Nominal strain is motion over `extent`.
    status: "past_peak" (the reaction fell by `peak_drop`, perhaps in an increment that found no
    equilibrium and is not on the curve: `Equilibrium.unbalanced`), "completed" (to the full
    strain), "severed", "fully_corroded" (no test was possible: force 0), or "stopped: ..." with the
    reason why the curve ends early. history: one array per quantity, one entry per point of the
    curve.
    """

    motion: np.ndarray  # [m or rad]
    reaction: np.ndarray  # [N or N m]
    load: Load
    length: float  # between the grips [m]
    peak_reaction: float  # [N or N m]
    motion_at_peak: float  # [m or rad]
    status: str
    cells: int = 0
    dead_cells: int = 0  # removed before the test: f at its limit at every point
    loose_cells: int = 0  # removed before the test: not joined to both grips
    loose_pieces: int = 0
    lost_cells: int = 0  # removed during the test
    torn_cells: int = 0  # of these, taken as torn so that the test could go on (`fem.tearing`)
    history: dict[str, np.ndarray] = field(default_factory=dict)
    cost: dict[str, float] = field(default_factory=dict)
    displacement: np.ndarray | None = None  # (n, 3) of the input's vertices at the end [m], rank 0

    @property
    def lag_at_peak(self) -> float:
        """Share of the peak by which it may be off because f lags there; 0 where f is implicit.

        Measured of screws as 0.5 to 2.2 times the difference to ever smaller increments
        (pipeline/MEASURED.md). It knows of the flow of that increment alone: where smaller ones
        would have lost other cells on the way, the peak may be another.
        """
        return float(self.history["lag"][np.argmax(self.reaction)]) if self.history else 0.0

    def __getattr__(self, name: str) -> np.ndarray | float:
        """The curve and its peak by the names that they have for this load."""
        if name.startswith("_") or "load" not in vars(self):
            raise AttributeError(name)
        motion, reaction = self.load.motion, self.load.reaction
        names = {
            motion: self.motion,
            reaction: self.reaction,
            f"{motion}_at_peak": self.motion_at_peak,
            f"peak_{reaction}": self.peak_reaction,
        }
        if name not in names:
            raise AttributeError(f"the result has no {name}; this test has {motion} and {reaction}")
        return names[name]


def peak_of_curve(elongation: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Elongation and force at the peak: the vertex of the parabola through the highest point.

    The highest point itself is returned where it is the last one, or where one of its neighbours is
    more than _UNEVEN times nearer than the other: a curve that breaks off has no parabola.
    """
    k = int(np.argmax(force))
    if k == 0 or k == len(force) - 1:
        return float(elongation[k]), float(force[k])
    x, y = elongation[k - 1 : k + 2], force[k - 1 : k + 2]
    before, after = np.diff(x)  # one of them is zero where the solid parted at its peak
    if not (before > 0 < after and 1 / _UNEVEN <= after / before <= _UNEVEN):
        return float(x[1]), float(y[1])
    rise, fall = np.diff(y) / np.diff(x)
    bend = (fall - rise) / (x[2] - x[0])
    if not bend < 0:
        return float(x[1]), float(y[1])
    top = 0.5 * (x[0] + x[1]) - 0.5 * rise / bend
    if not x[0] <= top <= x[2]:
        return float(x[1]), float(y[1])
    return float(top), float(y[0] + (rise + bend * (top - x[1])) * (top - x[0]))
