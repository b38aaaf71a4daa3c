"""Faster fixed points: Anderson's mixing of the last rounds."""

from __future__ import annotations

import numpy as np

from peri.engine.processes import ONE_PROCESS, OneProcess

_MEMORY = 8
"""Rounds that the mixing looks back on; more no longer help, fewer take more rounds."""


class Mixing:
    """The last rounds of a fixed point x = f(x), mixed so that the residual is least.

    Walker and Ni (2011), SIAM J. Numer. Anal. 49, 1715.  Scale x so that its parts count alike.

    processes : among which x is shared out; by default each has the whole of it.
    """

    def __init__(self, processes: OneProcess = ONE_PROCESS) -> None:
        self._processes = processes
        self._x: list[np.ndarray] = []
        self._f: list[np.ndarray] = []

    def next(self, x: np.ndarray, found: np.ndarray) -> np.ndarray:
        """The next x, from this one and f(x)."""
        self._x.append(x)
        self._f.append(found - x)
        del self._x[: -_MEMORY - 1], self._f[: -_MEMORY - 1]
        if len(self._x) == 1:
            return found
        dx = np.diff(np.array(self._x), axis=0)
        df = np.diff(np.array(self._f), axis=0)
        weight = self._processes.least_squares(df.T, self._f[-1])
        return found - weight @ (dx + df)
