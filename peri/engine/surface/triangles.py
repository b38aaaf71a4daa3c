"""Closed surfaces in flat facets: what is refused, which facets are near, how deep a point lies."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from peri.engine.surface.tree import Array, Tree, tree_of

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Surface:
    """The closed, outward oriented surface of a solid.

    Parameters
    ----------
    vertices : (n, d) array
        m; d = 1, 2 or 3.
    facets : (m, d) int array
        Triangles (3D), counter-clockwise seen from outside; segments (2D) with the metal on
        their left; end points (1D), one per facet, in pairs of start and end of an interval.

    Raises
    ------
    ValueError
        For arrays of other shapes, a surface that is open or not consistently oriented, or one
        whose orientation is inward.
    """

    vertices: NDArray[np.float64]
    facets: NDArray[np.int64]

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, float)
        facets = np.ascontiguousarray(self.facets, np.int64)
        if vertices.ndim != 2 or vertices.shape[1] not in (1, 2, 3):
            raise ValueError(f"vertices: shape {vertices.shape}; it must be (n, d), d = 1, 2 or 3")
        if facets.ndim != 2 or facets.shape[1] != vertices.shape[1] or not len(facets):
            raise ValueError(
                f"facets: shape {facets.shape}; it must be (m, {vertices.shape[1]}), m at least 1"
            )
        if not np.isfinite(vertices).all():
            raise ValueError("vertices: some are not finite; all must be")
        if facets.min() < 0 or facets.max() >= len(vertices):
            raise ValueError(f"facets: vertex numbers must lie in 0..{len(vertices) - 1}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "facets", facets)
        if not _is_closed(vertices, facets):
            raise ValueError(
                "facets: the surface is open or not consistently oriented; every edge must be "
                "shared by facets that run along it in opposite directions"
            )
        if not self.volume > 0:
            raise ValueError(
                f"facets: the enclosed volume is {self.volume:.4g}; facets must point outward"
            )

    @property
    def dimension(self) -> int:
        """Number of space dimensions."""
        return self.vertices.shape[1]

    @property
    def volume(self) -> float:
        """Enclosed volume, m^d."""
        corner = self.vertices[self.facets] - self.vertices.mean(axis=0)
        if self.dimension == 1:
            return float((corner[1::2] - corner[::2]).sum())
        return float(np.linalg.det(corner).sum()) / math.factorial(self.dimension)

    @functools.cached_property
    def tree(self) -> Tree:
        """The tree over the triangles (3D), m."""
        return tree_of(self.vertices[self.facets])

    @functools.cached_property
    def pseudo_normals(self) -> NDArray[np.float64]:
        """(m, 7, 3): of each triangle its normal, those of its edges, those of its vertices."""
        facets, corners = self.facets, self.vertices[self.facets]
        normal = np.empty((len(facets), 3))
        normal[self.tree.number] = self.tree.normal
        out = np.empty((len(facets), 7, 3))
        out[:, 0] = normal
        start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
        key = np.minimum(start, end) * len(self.vertices) + np.maximum(start, end)
        _, edge = np.unique(key, return_inverse=True)
        both = np.zeros((edge.max() + 1, 3))
        np.add.at(both, edge, np.repeat(normal, 3, axis=0))
        out[:, 1:4] = both[edge].reshape(-1, 3, 3)
        along = np.roll(corners, -1, axis=1) - corners
        along /= np.maximum(np.linalg.norm(along, axis=2), 1e-300)[..., None]
        cosine = -(along * np.roll(along, 1, axis=1)).sum(axis=2)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        at_vertex = np.zeros((len(self.vertices), 3))
        np.add.at(at_vertex, start, angle.ravel()[:, None] * np.repeat(normal, 3, axis=0))
        out[:, 4:7] = at_vertex[facets]
        return out


def _is_closed(vertices: NDArray[np.float64], facets: NDArray[np.int64]) -> bool:
    d = vertices.shape[1]
    if d == 1:
        return len(facets) % 2 == 0 and bool(np.all(np.diff(vertices[facets[:, 0], 0]) > 0))
    if d == 2:
        return np.array_equal(np.sort(facets[:, 0]), np.sort(facets[:, 1]))
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    n = len(vertices)
    return np.array_equal(np.sort(start * n + end), np.sort(end * n + start))


def checked_points(points: NDArray[np.float64], surface: Surface) -> NDArray[np.float64]:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != surface.dimension:
        raise ValueError(
            f"points: shape {points.shape}; it must be (n, {surface.dimension}) for this surface"
        )
    return points


# --- signed distance --------------------------------------------------------------------------


def signed_distance(
    points: NDArray[np.float64], surface: Surface, reach: float | NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth of each point below the surface (negative in the liquid), and the way to go deeper.

    The sign is that of the pseudo-normal of the nearest facet, edge or vertex (Baerentzen and
    Aanaes 2005), which is right for every closed surface.

    Parameters
    ----------
    points : (n, 3) array
        m.
    surface : Surface
        In 3D.
    reach : float or (n,) array
        m; points that are farther from the surface get NaN.

    Returns
    -------
    depth : (n,), m.  inward : (n, 3), unit vectors along which the depth grows.

    Raises
    ------
    ValueError
        For a surface or points that are not three-dimensional.
    """
    points = checked_points(points, surface)
    if surface.dimension != 3:
        raise ValueError(f"surface: {surface.dimension} dimensions; signed distances need 3")
    tree = surface.tree
    reach = np.ascontiguousarray(np.broadcast_to(np.asarray(reach, float), len(points)))
    return _nearest(
        np.ascontiguousarray(points), reach, tree.corners, tree.normal, tree.number,
        surface.pseudo_normals, tree.first, tree.last, tree.low, tree.high,
    )  # fmt: skip


@njit(cache=True, inline="always")
def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, inline="always")
def _less(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, inline="always")
def _on(a: Triple, s: float, along: Triple) -> Triple:
    return a[0] + s * along[0], a[1] + s * along[1], a[2] + s * along[2]


@njit(cache=True, inline="always")
def _corners(corners: Array, t: int) -> tuple[Triple, Triple, Triple]:
    return (
        (corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]),
        (corners[t, 1, 0], corners[t, 1, 1], corners[t, 1, 2]),
        (corners[t, 2, 0], corners[t, 2, 1], corners[t, 2, 2]),
    )


@njit(cache=True)
def _closest(a: Triple, b: Triple, c: Triple, x: Triple) -> tuple[Triple, int]:
    """Closest point of a triangle and its feature: 0 inside, 1..3 edges, 4..6 vertices."""
    ab, ac, ap = _less(b, a), _less(c, a), _less(x, a)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0 and d2 <= 0:
        return a, 4
    bp = _less(x, b)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0 and d4 <= d3:
        return b, 5
    if d1 * d4 - d3 * d2 <= 0 and d1 >= 0 and d3 <= 0:
        return _on(a, d1 / (d1 - d3), ab), 1
    cp = _less(x, c)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0 and d5 <= d6:
        return c, 6
    if d5 * d2 - d1 * d6 <= 0 and d2 >= 0 and d6 <= 0:
        return _on(a, d2 / (d2 - d6), ac), 3
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        return _on(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), _less(c, b)), 2
    vb, vc = d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    scale = 1.0 / (va + vb + vc)
    return _on(_on(a, vb * scale, ab), vc * scale, ac), 0


@njit(cache=True, inline="always")
def _gap(low: Array, high: Array, k: int, x: Triple) -> float:
    """Squared distance of a point from a node's box."""
    total = 0.0
    for a in range(3):
        off = max(low[k, a] - x[a], x[a] - high[k, a], 0.0)
        total += off * off
    return total


@njit(cache=True, parallel=True)
def _nearest(
    points: Array,
    reach: Array,
    corners: Array,
    normal: Array,
    number: Array,
    pseudo: Array,
    first: Array,
    last: Array,
    low: Array,
    high: Array,
) -> tuple[Array, Array]:
    depth, inward = np.full(len(points), np.nan), np.zeros((len(points), 3))
    leaves = first.size // 2
    for i in prange(len(points)):
        x = (points[i, 0], points[i, 1], points[i, 2])
        least = reach[i] * reach[i]
        nearest, feature, y = -1, 0, x
        waiting, gaps = np.empty(64, np.int64), np.empty(64)
        waiting[0], gaps[0], count = 1, _gap(low, high, 1, x), 1
        while count:
            count -= 1
            k = waiting[count]
            if gaps[count] >= least:
                continue
            if k >= leaves:
                for t in range(first[k], last[k]):
                    tried, part = _closest(*_corners(corners, t), x)
                    away = _less(tried, x)
                    if _dot(away, away) < least:
                        least, nearest, feature, y = _dot(away, away), t, part, tried
                continue
            one, two = _gap(low, high, 2 * k, x), _gap(low, high, 2 * k + 1, x)
            closer = 0 if one < two else 1  # to be looked at first, so put down last
            waiting[count], gaps[count] = 2 * k + 1 - closer, max(one, two)
            waiting[count + 1], gaps[count + 1] = 2 * k + closer, min(one, two)
            count += 2
        if nearest < 0:
            continue
        away, best = _less(y, x), math.sqrt(least)
        normals = pseudo[number[nearest], feature]
        inside = _dot(away, (normals[0], normals[1], normals[2])) >= 0.0
        depth[i] = best if inside else -best
        for a in range(3):
            inward[i, a] = -normal[nearest, a]
            if best > 1e-12 * reach[i]:
                inward[i, a] = (-away[a] if inside else away[a]) / best
    return depth, inward
