"""How much liquid a point of the metal sees: the nonlocal rate of an interface, without a lattice.

For a point x of the metal, with the liquid everywhere outside its surface,

    Lambda(x) = int_{liquid, r < delta} omega(r/delta) / r^(d+2q) dV,     r = |y - x|,

and a metal point in clean liquid dissolves at lambda = D_int K Lambda (K: influence.closed_constant).
With psi(r) = int_r^delta omega(s/delta) / s^(1+2q) ds the divergence of -psi(r) xi / r^d is the
integrand, and psi vanishes at r = delta, so that the volume integral is one over the surface
within reach,

    Lambda(x) = int_{surface, r < delta} psi(r) dOmega,     dOmega = xi . n / r^d dA,  n outward,

for any solid, cavities included; psi = ln(delta/r) for q = 0, omega = 1.  From a point of the
liquid the same integral with the opposite sign is the metal seen.  A flat triangle is integrated
in polar coordinates about the foot of x in its plane (distance |h|): with B' = psi/r^2,
B(delta) = 0,

    int psi dOmega = sgn(h) sum_edges int |h| (B(min(r(phi), delta)) - B(|h|)) dphi,

each edge by Gauss quadrature in u, r^2 = h^2 + p^2 cosh^2 u, p the edge's distance from the foot.
Neighbours integrate their common edge alike, so the quadrature's error cancels on flat parts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from peri.engine.influence import INFLUENCE_FUNCTIONS

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PIECE = 1.5
"""Longest piece of an edge, in u, for one set of Gauss nodes: 1e-12 of the edge's integral."""
FAR = 4.0
"""From this many of its radii on a triangle is integrated by three points instead of exactly."""


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


def _is_closed(vertices: NDArray[np.float64], facets: NDArray[np.int64]) -> bool:
    d = vertices.shape[1]
    if d == 1:
        return len(facets) % 2 == 0 and bool(np.all(np.diff(vertices[facets[:, 0], 0]) > 0))
    if d == 2:
        return np.array_equal(np.sort(facets[:, 0]), np.sort(facets[:, 1]))
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    n = len(vertices)
    return np.array_equal(np.sort(start * n + end), np.sort(end * n + start))


def exposure(
    points: NDArray[np.float64],
    surface: Surface,
    horizon: float,
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    far: float = FAR,
) -> NDArray[np.float64]:
    """Lambda at each point: the liquid seen from the metal, minus the metal seen from the liquid.

    Exact for the facets given, but for the quadrature over edges (1e-12 beside a flat face) and
    the far triangles.  Zero beyond the horizon's reach.

    Parameters
    ----------
    points : (n, d) array
        m, none on the surface.
    surface : Surface
    horizon : float
        delta, m; a ball (ellipsoids have no such integral).
    kernel_exponent : float
        q < 1.
    influence : {"constant", "linear"}
    far : float
        A triangle whose middle is this many times its radius away is integrated by three points;
        math.inf: none is.  On a ball of 3 horizons in triangles of 0.06 horizons the default is
        9 times faster than none, at errors of at most 1e-4 of the mean exposure.

    Returns
    -------
    (n,) array, 1/m^(2q); times D K it is a rate in 1/s.

    Raises
    ------
    ValueError
        For a horizon that is not one positive number, an unknown influence function, q >= 1, or
        points of another dimension.
    """
    points = _checked_points(points, surface)
    if np.ndim(horizon) != 0 or not (np.isfinite(horizon) and horizon > 0):
        raise ValueError(f"horizon: {horizon} m; exposures need one finite positive number")
    if influence not in INFLUENCE_FUNCTIONS:
        raise ValueError(f"influence: {influence!r}; allowed: {', '.join(INFLUENCE_FUNCTIONS)}")
    if not (np.isfinite(kernel_exponent) and kernel_exponent < 1):
        raise ValueError(f"kernel_exponent: {kernel_exponent}; allowed: finite and below 1")
    shape = (-2.0 * kernel_exponent, influence == "linear")
    unit = float(horizon) ** (-2.0 * kernel_exponent)
    corners = surface.vertices[surface.facets] / horizon
    points = points / horizon
    if surface.dimension == 1:
        return unit * _exposure_1d(points[:, 0], corners[:, 0, 0], *shape)
    if surface.dimension == 2:
        return unit * _exposure_2d(points, corners, *shape, _NODES, _WEIGHTS)
    finder = _Finder(corners, 1.0)
    order, starts = finder.group(points)
    out = np.zeros(len(points))
    out[order] = _exposure_3d(
        np.ascontiguousarray(points[order]), starts, corners, *_frames(corners),
        *finder.grid, *shape, _NODES, _WEIGHTS, far,
    )  # fmt: skip
    return unit * out


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
    points = _checked_points(points, surface)
    if surface.dimension != 3:
        raise ValueError(f"surface: {surface.dimension} dimensions; signed distances need 3")
    corners = surface.vertices[surface.facets] / reach
    points = points / reach
    finder = _Finder(corners, 1.0)
    order, starts = finder.group(points)
    depth, inward = np.empty(len(points)), np.zeros((len(points), 3))
    depth[order], inward[order] = _nearest(
        np.ascontiguousarray(points[order]), starts, corners, *_frames(corners),
        _pseudo_normals(surface, corners), *finder.grid,
    )  # fmt: skip
    return depth * reach, inward


def _checked_points(points: NDArray[np.float64], surface: Surface) -> NDArray[np.float64]:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != surface.dimension:
        raise ValueError(
            f"points: shape {points.shape}; it must be (n, {surface.dimension}) for this surface"
        )
    return points


# --- one and two dimensions -------------------------------------------------------------------


@njit(cache=True)
def _power_mean(p: float, x: float) -> float:
    """int_x^1 s^(p-1) ds."""
    if abs(p) < 1e-13:
        return -math.log(x)
    return -math.expm1(p * math.log(x)) / p


@njit(cache=True)
def _psi(x: float, p: float, linear: bool) -> float:
    """int_x^1 omega(s) s^(p-1) ds, in units of the horizon; p = -2 q."""
    if p == 0.0 and not linear:
        return -math.log(x)
    value = _power_mean(p, x)
    return value - _power_mean(p + 1.0, x) if linear else value


@njit(cache=True)
def _inner(x: float, p: float, linear: bool) -> float:
    """B(x) = -int_x^1 psi(s) / s^2 ds."""
    if p == 0.0 and not linear:
        return (1.0 + math.log(x)) / x - 1.0
    value = _power_mean(p - 1.0, x)
    if linear:
        value -= _power_mean(p, x)
    return value - _psi(x, p, linear) / x


@njit(cache=True)
def _exposure_1d(points, ends, p, linear):
    out = np.zeros(points.size)
    for i in range(points.size):
        for k in range(ends.size):
            xi = ends[k] - points[i]
            if 0.0 < abs(xi) < 1.0:
                outward = 1.0 if k % 2 else -1.0
                out[i] += math.copysign(outward, outward * xi) * _psi(abs(xi), p, linear)
    return out


@njit(cache=True, parallel=True)
def _exposure_2d(points, corners, p, linear, nodes, weights):
    """Each segment in the angle about the point, r = h cosh u."""
    out = np.zeros(len(points))
    for i in prange(len(points)):
        total = 0.0
        for k in range(len(corners)):
            ax, ay = corners[k, 0, 0] - points[i, 0], corners[k, 0, 1] - points[i, 1]
            bx, by = corners[k, 1, 0] - points[i, 0], corners[k, 1, 1] - points[i, 1]
            length = math.hypot(bx - ax, by - ay)
            ex, ey = (bx - ax) / length, (by - ay) / length
            h = ax * ey - ay * ex
            if not 1e-14 < abs(h) < 1.0:
                continue
            reach = math.sqrt(1.0 - h * h)
            along = ax * ex + ay * ey
            low, high = max(along, -reach), min(along + length, reach)
            if low >= high:
                continue
            u, end = math.asinh(low / abs(h)), math.asinh(high / abs(h))
            pieces = max(1, math.ceil((end - u) / _PIECE))
            half = 0.5 * (end - u) / pieces
            value = 0.0
            for m in range(pieces):
                for g in range(nodes.size):
                    c = math.cosh(u + half * (2 * m + 1 + nodes[g]))
                    value += weights[g] * half / c * _psi(abs(h) * c, p, linear)
            total += math.copysign(value, h)
        out[i] = total
    return out


# --- three dimensions -------------------------------------------------------------------------


class _Finder:
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
        self.grid = (starts, items, self.first, self.lower, self.cell, self.shape, reach)

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
def _fill_grid(first, last, shape):
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
def _in_reach(box_low, box_high, centre, radius, starts, items, first, lower, cell, shape, reach):
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


def _frames(corners: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Outward unit normals, areas, middles and radii of the triangles."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(double, 1e-300)[:, None]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    return normal, 0.5 * double, centre, radius


@njit(cache=True)
def _edge(ax, ay, az, bx, by, bz, nx, ny, nz, h, p_kernel, linear, nodes, weights):
    """int |h| B(min(r, 1)) dphi over an edge's angle about the foot, and that angle."""
    ax, ay, az = ax - h * nx, ay - h * ny, az - h * nz
    bx, by, bz = bx - h * nx, by - h * ny, bz - h * nz
    ex, ey, ez = bx - ax, by - ay, bz - az
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex / length, ey / length, ez / length
    start = ax * ex + ay * ey + az * ez
    end = start + length
    side = nx * (ay * ez - az * ey) + ny * (az * ex - ax * ez) + nz * (ax * ey - ay * ex)
    p = abs(side)
    if p < 1e-14 * length:
        return 0.0, 0.0
    angle = math.atan2(end, p) - math.atan2(start, p)
    value = 0.0
    squared = 1.0 - h * h - p * p
    if squared > 0.0:
        reach = math.sqrt(squared)
        low, high = max(start, -reach), min(end, reach)
        if low < high:
            u, last = math.asinh(low / p), math.asinh(high / p)
            pieces = max(1, math.ceil((last - u) / _PIECE))
            half = 0.5 * (last - u) / pieces
            for m in range(pieces):
                for g in range(nodes.size):
                    e = math.exp(u + half * (2 * m + 1 + nodes[g]))
                    c = 0.5 * (e + 1.0 / e)
                    r = math.sqrt(h * h + p * p * c * c)
                    value += weights[g] * half / c * _inner(r, p_kernel, linear)
            value *= abs(h)
    sign = math.copysign(1.0, side)
    return sign * value, sign * angle


@njit(cache=True)
def _triangle(corners, t, x, y, z, normal, h, p, linear, nodes, weights):
    """int psi dOmega over one triangle in units of the horizon, |h| < 1."""
    value, angle = 0.0, 0.0
    for a in range(3):
        b = (a + 1) % 3
        v, g = _edge(
            corners[t, a, 0] - x, corners[t, a, 1] - y, corners[t, a, 2] - z,
            corners[t, b, 0] - x, corners[t, b, 1] - y, corners[t, b, 2] - z,
            normal[t, 0], normal[t, 1], normal[t, 2], h, p, linear, nodes, weights,
        )  # fmt: skip
        value += v
        angle += g
    value -= abs(h) * _inner(abs(h), p, linear) * angle
    return math.copysign(1.0, h) * value


@njit(cache=True, parallel=True)
def _exposure_3d(
    points, groups, corners, normal, area, centre, radius,
    starts, items, first, lower, cell, shape, reach, p, linear, nodes, weights, far,
):  # fmt: skip
    out = np.zeros(len(points))
    for group in prange(len(groups) - 1):
        begin, end = groups[group], groups[group + 1]
        box_low, box_high = points[begin].copy(), points[begin].copy()
        for i in range(begin, end):
            for a in range(3):
                box_low[a] = min(box_low[a], points[i, a])
                box_high[a] = max(box_high[a], points[i, a])
        near = _in_reach(
            box_low, box_high, centre, radius, starts, items, first, lower, cell, shape, reach
        )
        for i in range(begin, end):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            total = 0.0
            for t in near:
                cx, cy, cz = centre[t, 0] - x, centre[t, 1] - y, centre[t, 2] - z
                distance2 = cx * cx + cy * cy + cz * cz
                if distance2 >= (1.0 + radius[t]) ** 2:
                    continue
                h = normal[t, 0] * cx + normal[t, 1] * cy + normal[t, 2] * cz
                if not 1e-14 < abs(h) < 1.0:
                    continue
                if distance2 > (far * radius[t]) ** 2:
                    # Three points a sixth in from the edges: exact for quadratics.
                    value = 0.0
                    for a in range(3):
                        dx = cx + 0.5 * (corners[t, a, 0] - centre[t, 0])
                        dy = cy + 0.5 * (corners[t, a, 1] - centre[t, 1])
                        dz = cz + 0.5 * (corners[t, a, 2] - centre[t, 2])
                        r = math.sqrt(dx * dx + dy * dy + dz * dz)
                        if r < 1.0:
                            value += _psi(r, p, linear) / (r * r * r)
                    total += value * h * area[t] / 3.0
                else:
                    total += _triangle(
                        corners, t, x, y, z, normal, h, p, linear, nodes, weights
                    )
            out[i] = total
    return out


# --- signed distance --------------------------------------------------------------------------


def _pseudo_normals(surface: Surface, corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 7, 3): of each triangle its normal, those of its edges and those of its vertices."""
    facets, normal = surface.facets, _frames(corners)[0]
    out = np.empty((len(facets), 7, 3))
    out[:, 0] = normal
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    key = np.minimum(start, end) * len(surface.vertices) + np.maximum(start, end)
    _, edge = np.unique(key, return_inverse=True)
    both = np.zeros((edge.max() + 1, 3))
    np.add.at(both, edge, np.repeat(normal, 3, axis=0))
    out[:, 1:4] = both[edge].reshape(-1, 3, 3)
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.maximum(np.linalg.norm(along, axis=2), 1e-300)[..., None]
    cosine = -(along * np.roll(along, 1, axis=1)).sum(axis=2)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    at_vertex = np.zeros((len(surface.vertices), 3))
    np.add.at(at_vertex, start, angle.ravel()[:, None] * np.repeat(normal, 3, axis=0))
    out[:, 4:7] = at_vertex[facets]
    return out


@njit(cache=True)
def _closest(a, b, c, x):
    """Closest point of a triangle and its feature: 0 inside, 1..3 edges, 4..6 vertices."""
    ab, ac, ap = b - a, c - a, x - a
    d1, d2 = ab.dot(ap), ac.dot(ap)
    if d1 <= 0 and d2 <= 0:
        return a, 4
    bp = x - b
    d3, d4 = ab.dot(bp), ac.dot(bp)
    if d3 >= 0 and d4 <= d3:
        return b, 5
    if d1 * d4 - d3 * d2 <= 0 and d1 >= 0 and d3 <= 0:
        return a + d1 / (d1 - d3) * ab, 1
    cp = x - c
    d5, d6 = ab.dot(cp), ac.dot(cp)
    if d6 >= 0 and d5 <= d6:
        return c, 6
    if d5 * d2 - d1 * d6 <= 0 and d2 >= 0 and d6 <= 0:
        return a + d2 / (d2 - d6) * ac, 3
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b), 2
    vb, vc = d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    scale = 1.0 / (va + vb + vc)
    return a + vb * scale * ab + vc * scale * ac, 0


@njit(cache=True, parallel=True)
def _nearest(
    points, groups, corners, normal, area, centre, radius, pseudo,
    starts, items, first, lower, cell, shape, reach,
):  # fmt: skip
    depth, inward = np.full(len(points), np.nan), np.zeros((len(points), 3))
    for group in prange(len(groups) - 1):
        begin, end = groups[group], groups[group + 1]
        box_low, box_high = points[begin].copy(), points[begin].copy()
        for i in range(begin, end):
            for a in range(3):
                box_low[a] = min(box_low[a], points[i, a])
                box_high[a] = max(box_high[a], points[i, a])
        near = _in_reach(
            box_low, box_high, centre, radius, starts, items, first, lower, cell, shape, reach
        )
        for i in range(begin, end):
            x = points[i]
            best = reach
            bound = reach
            for t in near:
                gx, gy, gz = centre[t, 0] - x[0], centre[t, 1] - x[1], centre[t, 2] - x[2]
                bound = min(bound, math.sqrt(gx * gx + gy * gy + gz * gz) + radius[t])
            for t in near:
                gx, gy, gz = centre[t, 0] - x[0], centre[t, 1] - x[1], centre[t, 2] - x[2]
                limit = min(best, bound) + radius[t]
                if gx * gx + gy * gy + gz * gz > limit * limit * (1.0 + 1e-12):
                    continue
                y, feature = _closest(corners[t, 0], corners[t, 1], corners[t, 2], x)
                away = y - x
                distance = math.sqrt(away.dot(away))
                if distance < best or (distance == best and not depth[i] == depth[i]):
                    best = distance
                    inside = away.dot(pseudo[t, feature]) >= 0.0
                    depth[i] = distance if inside else -distance
                    for a in range(3):
                        inward[i, a] = -normal[t, a]
                        if distance > 1e-12:
                            inward[i, a] = (-away[a] if inside else away[a]) / distance
    return depth, inward
