"""Where a test stands between two increments, and how large the next one is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

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
