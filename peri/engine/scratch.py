"""Work arrays that a solver needs only while it is at work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


class Scratch:
    """Arrays of one shape, made of zeros when they are first asked for, and droppable in between.

    Their users leave zero what they do not write (margins), so new ones are as good as old ones.
    """

    def __init__(self, shape: Sequence[int], count: int) -> None:
        self._shape, self._count = tuple(shape), count
        self._arrays: list[np.ndarray] = []

    def arrays(self) -> list[np.ndarray]:
        """The arrays."""
        if not self._arrays:
            self._arrays = [np.zeros(self._shape) for _ in range(self._count)]
        return self._arrays

    def drop(self) -> None:
        """Give the memory back."""
        self._arrays = []
