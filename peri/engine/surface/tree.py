"""A tree over the triangles of a surface: which of them are near, and what far ones amount to.

Each node halves its triangles along the longest side of their middles' box, so that triangles of a
node are near each other; node k has the children 2 k and 2 k + 1, the root is node 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

LEAF = 8
"""Triangles of a leaf at most."""
_FLAT = 0.97
"""A node is flat if its vector area is this much of its area."""
SOURCES = 4
"""Points that stand for a node's triangles."""


class Tree(NamedTuple):
    """Triangles (nt) in the order of the leaves, and nodes (2^k, the first unused).

    corners : (nt, 3, 3).  normal, centre : (nt, 3), outward unit normals and middles.
    area, radius : (nt,), radius about the middle.  number : (nt,) of each in the surface's facets.
    first, last : (n,) range of a node's triangles.  low, high : (n, 3) its box.
    middle, size : (n, 3), (n,) ball about its triangles.
    flat : (n,) whether its triangles face nearly the same way.
    place, weight : (n, 4, 3) points and vector areas that stand for it: of int n dA the sum, both
    first moments along the node's surface, and the difference of the second ones are its own.
    """

    corners: Array
    normal: Array
    area: Array
    centre: Array
    radius: Array
    number: Array
    first: Array
    last: Array
    low: Array
    high: Array
    middle: Array
    size: Array
    flat: Array
    place: Array
    weight: Array

    def in_units(self, unit: float) -> Tree:
        """All lengths over `unit` (m)."""
        lengths = ("corners", "centre", "radius", "low", "high", "middle", "size", "place")
        scaled = {name: getattr(self, name) / unit for name in lengths}
        return self._replace(area=self.area / unit**2, weight=self.weight / unit**2, **scaled)


def tree_of(corners: NDArray[np.float64]) -> Tree:
    """The tree over triangles (nt, 3, 3)."""
    count = len(corners)
    levels = max(0, int(np.ceil(np.log2(count / LEAF))))
    order = _order(corners.mean(axis=1), levels)
    corners = np.ascontiguousarray(corners[order])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(double, 1e-300)[:, None]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    level = np.concatenate([np.full(1 << k, k) for k in range(levels + 1)])
    place = np.concatenate([np.arange(1 << k) for k in range(levels + 1)])
    first, last = (np.append(0, (count * (place + end)) >> level) for end in (0, 1))
    nodes = _nodes(corners, normal, 0.5 * double, first, last)
    return Tree(corners, normal, 0.5 * double, centre, radius, order, first, last, *nodes)


@njit(cache=True)
def _order(centre: Array, levels: int) -> Array:
    """Numbers of the triangles in the order of the leaves."""
    n = len(centre)
    order = np.arange(n)
    for level in range(levels):
        for j in range(1 << level):
            a, b = (n * j) >> level, (n * (j + 1)) >> level
            if b - a < 2:
                continue
            axis, longest = 0, -1.0
            for k in range(3):
                values = centre[order[a:b], k]
                if values.max() - values.min() > longest:
                    axis, longest = k, values.max() - values.min()
            part = order[a:b].copy()
            order[a:b] = part[np.argsort(centre[part, axis])]
    return order


@njit(cache=True)
def _nodes(
    corners: Array, normal: Array, area: Array, first: Array, last: Array
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    n = first.size
    low, high, middle = np.full((n, 3), np.inf), np.full((n, 3), -np.inf), np.zeros((n, 3))
    size, flat = np.zeros(n), np.zeros(n, np.bool_)
    place, weight = np.zeros((n, SOURCES, 3)), np.zeros((n, SOURCES, 3))
    for k in range(1, n):
        whole, spread, off = 1e-300, np.zeros((3, 3)), np.zeros(3)
        for t in range(first[k], last[k]):
            whole += area[t]
            for c in range(3):
                for a in range(3):
                    low[k, a] = min(low[k, a], corners[t, c, a])
                    high[k, a] = max(high[k, a], corners[t, c, a])
                    middle[k, a] += area[t] * corners[t, c, a] / 3.0
        middle[k] /= whole
        # A triangle's second moments are those of three points a sixth in from its edges.
        for t in range(first[k], last[k]):
            for c in range(3):
                far = 0.0
                for a in range(3):
                    inner = (corners[t, 0, a] + corners[t, 1, a] + corners[t, 2, a]) / 6.0
                    off[a] = inner + 0.5 * corners[t, c, a] - middle[k, a]
                    far += (corners[t, c, a] - middle[k, a]) ** 2
                size[k] = max(size[k], far)
                for a in range(3):
                    for b in range(3):
                        spread[a, b] += off[a] * off[b] * area[t] / 3.0
        size[k] = np.sqrt(size[k])
        variance, axes = np.linalg.eigh(spread / whole)
        sums = np.zeros((SOURCES, 3))  # of n, n x, n y, n (x^2 / var x - y^2 / var y)
        one = np.sqrt(max(variance[2], 1e-300))
        two = np.sqrt(max(variance[1], 1e-12 * one * one))
        for t in range(first[k], last[k]):
            for c in range(3):
                x, y = 0.0, 0.0
                for a in range(3):
                    inner = (corners[t, 0, a] + corners[t, 1, a] + corners[t, 2, a]) / 6.0
                    away = inner + 0.5 * corners[t, c, a] - middle[k, a]
                    x += away * axes[a, 2] / one
                    y += away * axes[a, 1] / two
                for a in range(3):
                    part = normal[t, a] * area[t] / 3.0
                    sums[0, a] += part
                    sums[1, a] += part * x
                    sums[2, a] += part * y
                    sums[3, a] += part * (x * x - y * y)
        flat[k] = np.linalg.norm(sums[0]) > _FLAT * whole
        root = np.sqrt(2.0)
        for side in range(2):
            sign = 1.0 - 2.0 * side
            place[k, side] = middle[k] + sign * root * one * axes[:, 2]
            place[k, 2 + side] = middle[k] + sign * root * two * axes[:, 1]
            weight[k, side] = 0.25 * (sums[0] + 0.5 * sums[3] + sign * root * sums[1])
            weight[k, 2 + side] = 0.25 * (sums[0] - 0.5 * sums[3] + sign * root * sums[2])
    return low, high, middle, size, flat, place, weight
