"""Where a test stands between two increments, and how large the next one is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

_UNEVEN = 3.0  # of increments next to the peak
_EASY, _HARD = 5, 8  # Newton iterations below which increments grow, above which they shrink


@dataclass
class March:
    """What goes from increment to increment; with the fields of the cells all that a test needs.

    Strain is nominal: motion of the grip over `Load.extent`. Failures are counted since the last
    accepted increment, so they are none when an observer sees the march.
    """

    displacement: np.ndarray  # (n, 3) of the local nodes at the last equilibrium [m]
    size: float  # strain of the next increment
    strain: float = 0.0
    previous: np.ndarray | None = None  # (n, 3) growth in the last increment [m]: what to predict
    previous_size: float = 0.0  # strain of the last increment
    peak: float = 0.0  # largest reaction so far [N or N m]
    work: float = 0.0  # of the grips [J]
    dissipated: float = 0.0  # [J]
    rows: list[dict[str, float]] = field(default_factory=list)  # see TensileResult.history
    halvings: int = 0  # of the size, since the last accepted increment
    failures: int = 0  # the same, but since cells were last torn
    shrunk: float = 1.0  # share of the size that these failures have left

    def accept(self, displacement: np.ndarray) -> None:
        """Stand at a new equilibrium, one increment further."""
        self.previous, self.previous_size = displacement - self.displacement, self.size
        self.displacement = displacement
        self.strain += self.size

    def choose_size(self, iterations: int, largest: float) -> None:
        """Size of the next increment by the Newton iterations of the last one; forget failures."""
        if iterations <= _EASY and self.halvings == 0:
            self.size = min(1.5 * self.size, largest)
        elif iterations > _HARD:
            self.size *= 0.7
        self.halvings, self.failures, self.shrunk = 0, 0, 1.0

    def halve(self, share: float = 0.5) -> None:
        """Try anew with half or so of the size, from the second time on without `previous`."""
        self.size, self.shrunk = share * self.size, share * self.shrunk
        self.halvings, self.failures = self.halvings + 1, self.failures + 1
        if self.halvings % 2 == 0:
            self.previous = None

    def undo_halvings(self) -> None:
        """Try the size again that failed before cells were torn; the solid is another one now."""
        self.size /= self.shrunk
        self.failures, self.shrunk, self.previous = 0, 1.0, None


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
