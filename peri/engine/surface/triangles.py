"""Closed surfaces in flat facets: what is refused, which facets are near, how deep a point lies."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[Any]
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
    def pseudo_normals(self) -> NDArray[np.float64]:
        """(m, 7, 3): of each triangle its normal, those of its edges, those of its vertices."""
        facets, corners = self.facets, self.vertices[self.facets]
        normal = frames(corners)[0]
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


# --- facets in reach --------------------------------------------------------------------------


class Finder:
    """Triangles by cells of a grid, so that a group of near points meets only those in reach."""

    def __init__(self, corners: NDArray[np.float64], reach: float) -> None:
        self.lower = corners.min(axis=(0, 1))
        extent = corners.max(axis=(0, 1)) - self.lower
        self.cell = max(reach, float(extent.max()) / 64)
        self.shape = np.floor(extent / self.cell).astype(np.int64) + 1
        self.reach = reach
        first = np.floor((corners.min(axis=1) - self.lower) / self.cell).astype(np.int64)
        last = np.floor((corners.max(axis=1) - self.lower) / self.cell).astype(np.int64)
        self.first = np.clip(first, 0, self.shape - 1)
        last = np.clip(last, 0, self.shape - 1)
        starts, items = _fill_grid(self.first, last, self.shape)
        self.grid: tuple[Any, ...] = (
            starts,
            items,
            self.first,
            self.lower,
            self.cell,
            self.shape,
            reach,
        )

    def group(self, points: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
        """An order of the points in which near ones follow each other, and where groups start."""
        place = np.floor((points - self.lower) / (0.5 * self.reach)).astype(np.int64)
        place -= place.min(axis=0, initial=0)
        span = place.max(axis=0, initial=0) + 1
        key = (place[:, 0] * span[1] + place[:, 1]) * span[2] + place[:, 2]
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        return order, np.append(starts, len(points))


@njit(cache=True)
def _fill_grid(first: Array, last: Array, shape: Array) -> tuple[Array, Array]:
    """Triangle numbers by grid cell, in compressed rows."""
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    items = np.zeros(0, np.int64)
    for sweep in range(2):
        for t in range(len(first)):
            for a in range(first[t, 0], last[t, 0] + 1):
                for b in range(first[t, 1], last[t, 1] + 1):
                    for c in range(first[t, 2], last[t, 2] + 1):
                        k = (a * shape[1] + b) * shape[2] + c
                        if sweep == 0:
                            count[k + 1] += 1
                        else:
                            count[k] -= 1
                            items[count[k]] = t
        if sweep == 0:
            count = np.cumsum(count)
            items = np.empty(count[-1], np.int64)
            count[:-1] = count[1:]
    return count, items


@njit(cache=True)
def in_reach(
    box_low: Array,
    box_high: Array,
    centre: Array,
    radius: Array,
    starts: Array,
    items: Array,
    first: Array,
    lower: Array,
    cell: float,
    shape: Array,
    reach: float,
) -> Array:
    """Triangles whose sphere comes within reach of a box, each once."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(3):
        low[a] = max(0, math.floor((box_low[a] - reach - lower[a]) / cell))
        high[a] = min(shape[a] - 1, math.floor((box_high[a] + reach - lower[a]) / cell))
    found = np.empty(64, np.int64)
    n = 0
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            for k in range(low[2], high[2] + 1):
                row = (i * shape[1] + j) * shape[2] + k
                for s in range(starts[row], starts[row + 1]):
                    t = items[s]
                    # A triangle in several cells counts in the first of those looked at.
                    if (
                        i != max(low[0], first[t, 0])
                        or j != max(low[1], first[t, 1])
                        or k != max(low[2], first[t, 2])
                    ):
                        continue
                    gap = 0.0
                    for a in range(3):
                        off = max(box_low[a] - centre[t, a], centre[t, a] - box_high[a], 0.0)
                        gap += off * off
                    if gap >= (reach + radius[t]) ** 2:
                        continue
                    if n == found.size:
                        grown = np.empty(2 * n, np.int64)
                        grown[:n] = found
                        found = grown
                    found[n] = t
                    n += 1
    return found[:n]


def frames(corners: NDArray[np.float64]) -> tuple[Any, ...]:
    """Outward unit normals, areas, middles and radii of the triangles."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(double, 1e-300)[:, None]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    return normal, 0.5 * double, centre, radius


# --- signed distance --------------------------------------------------------------------------


def signed_distance(
    points: NDArray[np.float64], surface: Surface, reach: float
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
    reach : float
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
    corners = surface.vertices[surface.facets] / reach
    points = points / reach
    finder = Finder(corners, 1.0)
    order, starts = finder.group(points)
    depth, inward = np.empty(len(points)), np.zeros((len(points), 3))
    grouped = (np.ascontiguousarray(points[order]), starts, corners, *frames(corners))
    arguments: tuple[Any, ...] = (*grouped, surface.pseudo_normals, *finder.grid)
    depth[order], inward[order] = _nearest(*arguments)
    return depth * reach, inward


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


@njit(cache=True, parallel=True)
def _nearest(
    points: Array,
    groups: Array,
    corners: Array,
    normal: Array,
    area: Array,
    centre: Array,
    radius: Array,
    pseudo: Array,
    starts: Array,
    items: Array,
    first: Array,
    lower: Array,
    cell: float,
    shape: Array,
    reach: float,
) -> tuple[Array, Array]:
    depth, inward = np.full(len(points), np.nan), np.zeros((len(points), 3))
    for group in prange(len(groups) - 1):
        begin, end = groups[group], groups[group + 1]
        box_low, box_high = points[begin].copy(), points[begin].copy()
        for i in range(begin, end):
            for a in range(3):
                box_low[a] = min(box_low[a], points[i, a])
                box_high[a] = max(box_high[a], points[i, a])
        near = in_reach(
            box_low, box_high, centre, radius, starts, items, first, lower, cell, shape, reach
        )
        last = -1  # the triangle nearest to the point before, which is close by
        for i in range(begin, end):
            x = (points[i, 0], points[i, 1], points[i, 2])
            best, nearest, feature = reach, -1, 0
            y = x
            if last >= 0:
                tried, part = _closest(*_corners(corners, last), x)
                distance = math.sqrt(_dot(_less(tried, x), _less(tried, x)))
                if distance < best:
                    best, nearest, feature, y = distance, last, part, tried
            for t in near:
                gx, gy, gz = centre[t, 0] - x[0], centre[t, 1] - x[1], centre[t, 2] - x[2]
                limit = best + radius[t]
                if t == last or gx * gx + gy * gy + gz * gz > limit * limit:
                    continue
                tried, part = _closest(*_corners(corners, t), x)
                distance = math.sqrt(_dot(_less(tried, x), _less(tried, x)))
                if distance < best:
                    best, nearest, feature, y = distance, t, part, tried
            last = nearest
            if nearest < 0:
                continue
            away = _less(y, x)
            normals = pseudo[nearest, feature]
            inside = _dot(away, (normals[0], normals[1], normals[2])) >= 0.0
            depth[i] = best if inside else -best
            for k in range(3):
                inward[i, k] = -normal[nearest, k]
                if best > 1e-12:
                    inward[i, k] = (-away[k] if inside else away[k]) / best
    return depth, inward
