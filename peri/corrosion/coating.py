"""A coating that holds the dissolution back for a time, whatever the law of the rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Coating:
    """The interface dissolves at `factor` of its rate until `lifetime`, then at the whole rate.

    Parameters
    ----------
    factor : float
        Share of the rate under the coating, 0..1.
    lifetime : float
        s, > 0.

    Raises
    ------
    ValueError
        For a factor or a lifetime out of range.
    """

    factor: float
    lifetime: float

    def __post_init__(self) -> None:
        if not 0 <= self.factor <= 1:
            raise ValueError(f"factor: {self.factor}; it must be from 0 to 1")
        if not (math.isfinite(self.lifetime) and self.lifetime > 0):
            raise ValueError(f"lifetime: {self.lifetime} s; it must be finite and positive")

    def bare_time(self, times: ArrayLike) -> NDArray[np.float64]:
        """int factor dt up to each time, s: when bare metal in clean liquid would be as far."""
        times = np.asarray(times, float)
        under = np.minimum(times, self.lifetime)
        return self.factor * under + np.maximum(times - self.lifetime, 0.0)
