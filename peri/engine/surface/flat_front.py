"""A flat front of metal in clean liquid: what lies how deep, and the profile that travels with it.

Depths x are in horizons.  p(x) is the rate of the metal at depth x over its mean from 0 to 1;
F(x) = int_0^x p the share of the front's flux that comes from above x.  A front that travels
steadily has used up the share 1 - F(x) of what lies at depth x: `left` of it is F(x).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from peri.engine.surface.sampling import flat_profile

_POINTS = 1200
_GRADE = 4.0

Array = NDArray[np.float64]


class FlatFront:
    """Tables of a kernel's flat front.

    Parameters
    ----------
    horizon : float
        m.
    kernel_exponent : float
        q < 1/2.
    influence : {"constant", "linear"}
    """

    def __init__(self, horizon: float, kernel_exponent: float, influence: str) -> None:
        self.horizon = float(horizon)
        self.kernel_exponent, self.influence = kernel_exponent, influence
        self._x = (np.arange(_POINTS + 1) / _POINTS) ** _GRADE
        carried = self._integral(self._raw)
        self._scale = carried[-1]
        self._carried = carried / carried[-1]
        life = self._integral(self.carried)
        self._life = life

    def _raw(self, x: Array) -> Array:
        kernel = (self.horizon, self.kernel_exponent, self.influence)
        return flat_profile(x * self.horizon, *kernel)

    def _integral(self, function: Callable[[Array], Array]) -> Array:
        """int_0^x of a function at the table's points."""
        t, w = np.polynomial.legendre.leggauss(4)
        u = (np.arange(_POINTS)[:, None] + (t + 1) / 2) / _POINTS
        values = function(u**_GRADE) * _GRADE * u ** (_GRADE - 1) * w / (2 * _POINTS)
        return np.append(0.0, np.cumsum(values.sum(axis=1)))

    def profile(self, x: Array) -> Array:
        """p(x), 0 from x = 1 on."""
        return np.maximum(self._raw(x), 0.0) / self._scale

    def at_reach(self, width: float) -> float:
        """Mean of p at one horizon from the front, spread over two boxes `width` horizons wide."""
        t, w = np.polynomial.legendre.leggauss(32)
        u = 0.5 * (t + 1.0)
        return float(0.5 * (w * (1.0 - u) * self.profile(1.0 - width * u)).sum())

    def carried(self, x: Array) -> Array:
        """F(x), 1 from x = 1 on."""
        return np.interp(x, self._x, self._carried)

    def life(self, thickness: Array) -> Array:
        """int_0^thickness F: what a travelling front has left in a slab that begins at it."""
        return np.interp(thickness, self._x, self._life) + np.maximum(thickness - 1.0, 0.0)

    def slab(self, life: Array) -> Array:
        """The inverse of `life`."""
        return np.interp(life, self._life, self._x) + np.maximum(life - self._life[-1], 0.0)

    def top(self, share: Array, thickness: Array) -> Array:
        """How deep a slab begins that carries `share` of the front's flux; 0 where it has more."""
        low, high = np.zeros(share.shape), np.ones(share.shape)
        for _ in range(30):
            middle = 0.5 * (low + high)
            much = self.carried(middle + thickness) - self.carried(middle) > share
            low, high = np.where(much, middle, low), np.where(much, high, middle)
        return np.where(self.carried(thickness) > share, high, 0.0)

    def layers(self, spacing: float, count: int) -> tuple[Array, float]:
        """What carries the flux below a layer that a front along an axis cuts, and what it draws.

        Returns T (count + 1,) and c: with a share f of the layer left, the flux from what lies
        n layers or more below its bottom is f T_(n+1) + (1 - f) T_n, T_0 = 1, and the cut layer has
        c f (1 - f) of that of the next, so that on the average over f each layer has its own.

        Parameters
        ----------
        spacing : of the layers, m.
        count : of layers in reach of the first.
        """
        places = (np.arange(400) + 0.5) / 400
        depth = (places + np.arange(count)[:, None]) * spacing / self.horizon
        below = 1.0 - self.carried(depth).mean(axis=1)
        tails = np.zeros(count + 1)
        for n in range(count - 1, 0, -1):
            tails[n] = 2.0 * below[n] - tails[n + 1]
        tails[0] = 1.0
        return tails, float(3.0 * (1.0 + tails[1]) - 6.0 * below[0])

    def mean_depth(self, spacing: float) -> float:
        """Mean depth of the flux (m) if layers of cells of this size spread theirs evenly.

        The mean over all places of the layers; delta/6 at spacing 0 for q = 0, omega = 1.
        """
        h = spacing / self.horizon
        places = (np.arange(200) + 0.5) / 200 * h
        edges = places[:, None] + h * np.arange(int(np.ceil(1 / h)) + 1)
        edges = np.hstack([np.zeros((200, 1)), edges])
        share = np.diff(self.carried(edges), axis=1)
        middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
        return float((share * middle).sum(axis=1).mean()) * self.horizon
