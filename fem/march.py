"""Where a test stands between two increments, and how large the next one is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

_EASY, _HARD = 5, 8  # Newton iterations up to which increments grow, above which they shrink
_GROWTH, _RETURN = 1.5, 3.0  # of increments at most; back to a size that failed
_SHORTEST = 0.25  # of its size: what an increment is shortened to at once
_TIMES = 3  # in a row that an increment is shortened


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
    failed_size: float = 0.0  # before it was cut to settle a jump, until it is reached again
    shortened: int = 0  # times that the increment was, since the last accepted one

    def accept(self, displacement: np.ndarray) -> None:
        """Stand at a new equilibrium, one increment further."""
        self.previous, self.previous_size = displacement - self.displacement, self.size
        self.displacement = displacement
        self.strain += self.size

    def choose_size(self, iterations: int, excess: float, smallest: float, largest: float) -> None:
        """Size of the next increment by the last one's Newton iterations and lag; forget failures.

        excess: the lag over the one wanted. It makes no increment smaller than `smallest`.
        """
        factor = 1.0
        if iterations <= _EASY and self.halvings == 0:
            back = 2.0 * self.size < self.failed_size
            factor = _RETURN if back else _GROWTH
        elif iterations > _HARD:
            factor = 0.7
        if self.size >= self.failed_size:
            self.failed_size = 0.0
        self.size = min(self.size * factor, max(self.size * _by_lag(excess), smallest), largest)
        self.halvings, self.failures, self.shrunk, self.shortened = 0, 0, 1.0, 0

    def shorten(self, excess: float, smallest: float) -> bool:
        """Take the increment anew, shorter, by its lag over the one wanted.

        False, and nothing changed, where that was done _TIMES or it is not larger than `smallest`.
        """
        if self.shortened == _TIMES or self.size <= smallest:
            return False
        self.size, self.shortened = max(self.size * _by_lag(excess), smallest), self.shortened + 1
        return True

    def halve(self, share: float = 0.5) -> None:
        """Try anew with half or so of the size, from the second time on without `previous`."""
        if share < 0.5:
            self.failed_size = self.size
        self.size, self.shrunk = share * self.size, share * self.shrunk
        self.halvings, self.failures = self.halvings + 1, self.failures + 1
        if self.halvings % 2 == 0:
            self.previous = None

    def undo_halvings(self) -> None:
        """Try the size again that failed before cells were torn; the solid is another one now."""
        self.size /= self.shrunk
        self.failures, self.shrunk, self.previous = 0, 1.0, None


def _by_lag(excess: float) -> float:
    """Factor of the size that makes the lag, of second order in it, the one wanted."""
    return max(_SHORTEST, excess**-0.5) if excess > 0.0 else np.inf
