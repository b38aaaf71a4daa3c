"""How much liquid a point of the metal sees: the nonlocal rate of an interface, without a lattice.

For a point x of the metal, with the liquid everywhere outside its surface,

    Lambda(x) = int_{liquid, r < delta} omega(r/delta) / r^(d+2q) dV,     r = |y - x|,

and a metal point in clean liquid dissolves at lambda = D_int K Lambda (K: closed_constant).
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
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from peri.engine.influence import INFLUENCE_FUNCTIONS
from peri.engine.surface.tree import Array
from peri.engine.surface.triangles import Surface, checked_points

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PIECE = 1.5
"""Longest piece of an edge, in u, for one set of Gauss nodes: 1e-12 of the edge's integral."""
FAR = 2.5
"""From this many of its radii on a triangle is integrated by points instead of exactly."""


_WIDE = 0.15
"""Radius of a group of triangles, in horizons, that counts as one at most."""
_TABLED = 1 / 64
"""From this r^2 on psi is read from a table, to 1e-5."""
_THREE = 0.5
"""Three points this far from the middle to the corners: exact for quadratics."""
_SEVEN = (
    (0.225, 0.0),
    (0.13239415278850619, -0.4104261923153453),
    (0.12593918054482717, 0.6961404780296310),
)
"""Weights and places of the rule of seven points, exact to fifth order (Radon 1948)."""


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
        A triangle whose middle is this many times its radius away is integrated by seven points,
        from twice that on by three, or with its neighbours by four; math.inf: none is.  On the
        reference screw the default errs by 5e-6 of the mean exposure (root of the mean square).

    Returns
    -------
    (n,) array, 1/m^(2q); times D K it is a rate in 1/s.

    Raises
    ------
    ValueError
        For a horizon that is not one positive number, an unknown influence function, q >= 1, or
        points of another dimension.
    """
    points = checked_points(points, surface)
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
    tree = surface.tree.in_units(horizon)
    arguments: tuple[Any, ...] = (
        np.ascontiguousarray(points),
        tree.corners,
        tree.normal,
        tree.area,
        tree.centre,
        tree.radius,
    )
    arguments += (tree.first, tree.last, tree.middle, tree.size, tree.flat, tree.place, tree.weight)
    arguments += (*shape, _table(*shape), _NODES, _WEIGHTS, far)
    return unit * _exposure_3d(*arguments)


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
def _table(p: float, linear: bool) -> Array:
    """psi at even steps of r^2 from 0 to the horizon; the first entries are not used."""
    out = np.zeros(4097)
    for k in range(1, out.size):
        out[k] = _psi(math.sqrt(k / (out.size - 1)), p, linear)
    return out


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
def _exposure_1d(points: Array, ends: Array, p: float, linear: bool) -> Array:
    out = np.zeros(points.size)
    for i in range(points.size):
        for k in range(ends.size):
            xi = ends[k] - points[i]
            if 0.0 < abs(xi) < 1.0:
                outward = 1.0 if k % 2 else -1.0
                out[i] += math.copysign(outward, outward * xi) * _psi(abs(xi), p, linear)
    return out


@njit(cache=True, parallel=True)
def _exposure_2d(
    points: Array, corners: Array, p: float, linear: bool, nodes: Array, weights: Array
) -> Array:
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


@njit(cache=True)
def _edge(
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    nx: float,
    ny: float,
    nz: float,
    h: float,
    p_kernel: float,
    linear: bool,
    nodes: Array,
    weights: Array,
) -> tuple[float, float]:
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
    angle = math.atan2(p * length, p * p + start * end)
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
def _triangle(
    corners: Array,
    t: int,
    x: float,
    y: float,
    z: float,
    normal: Array,
    h: float,
    p: float,
    linear: bool,
    nodes: Array,
    weights: Array,
) -> float:
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


@njit(cache=True, inline="always")
def _point(dx: float, dy: float, dz: float, p: float, linear: bool, table: Array) -> float:
    """psi / r^3 at a distance in horizons, 0 beyond."""
    r2 = dx * dx + dy * dy + dz * dz
    if r2 >= 1.0:
        return 0.0
    r = math.sqrt(r2)
    if r2 < _TABLED:
        return _psi(r, p, linear) / (r2 * r)
    place = r2 * (table.size - 1)
    k = int(place)
    return (table[k] + (place - k) * (table[k + 1] - table[k])) / (r2 * r)


@njit(cache=True, parallel=True)
def _exposure_3d(
    points: Array,
    corners: Array,
    normal: Array,
    area: Array,
    centre: Array,
    radius: Array,
    first: Array,
    last: Array,
    middle: Array,
    size: Array,
    flat: Array,
    place: Array,
    weight: Array,
    p: float,
    linear: bool,
    table: Array,
    nodes: Array,
    weights: Array,
    far: float,
) -> Array:
    out = np.zeros(len(points))
    leaves = first.size // 2
    for i in prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total = 0.0
        waiting = np.empty(64, np.int64)
        waiting[0], count = 1, 1
        while count:
            count -= 1
            k = waiting[count]
            dx, dy, dz = middle[k, 0] - x, middle[k, 1] - y, middle[k, 2] - z
            distance2 = dx * dx + dy * dy + dz * dz
            if distance2 >= (1.0 + size[k]) ** 2:
                continue
            if flat[k] and distance2 > (2.0 * far * size[k]) ** 2 and size[k] < _WIDE:
                for s in range(place.shape[1]):
                    dx, dy, dz = place[k, s, 0] - x, place[k, s, 1] - y, place[k, s, 2] - z
                    across = dx * weight[k, s, 0] + dy * weight[k, s, 1] + dz * weight[k, s, 2]
                    total += across * _point(dx, dy, dz, p, linear, table)
                continue
            if k < leaves:
                waiting[count], waiting[count + 1] = 2 * k, 2 * k + 1
                count += 2
                continue
            for t in range(first[k], last[k]):
                cx, cy, cz = centre[t, 0] - x, centre[t, 1] - y, centre[t, 2] - z
                distance2 = cx * cx + cy * cy + cz * cz
                if distance2 >= (1.0 + radius[t]) ** 2:
                    continue
                h = normal[t, 0] * cx + normal[t, 1] * cy + normal[t, 2] * cz
                if not 1e-14 < abs(h) < 1.0:
                    continue
                if distance2 <= (far * radius[t]) ** 2:
                    total += _triangle(corners, t, x, y, z, normal, h, p, linear, nodes, weights)
                    continue
                value = 0.0
                if distance2 > (2.0 * far * radius[t]) ** 2:
                    for a in range(3):
                        dx = cx + _THREE * (corners[t, a, 0] - centre[t, 0])
                        dy = cy + _THREE * (corners[t, a, 1] - centre[t, 1])
                        dz = cz + _THREE * (corners[t, a, 2] - centre[t, 2])
                        value += _point(dx, dy, dz, p, linear, table) / 3.0
                else:
                    value = _SEVEN[0][0] * _point(cx, cy, cz, p, linear, table)
                    for share, out_by in _SEVEN[1:]:
                        for a in range(3):
                            dx = cx + out_by * (corners[t, a, 0] - centre[t, 0])
                            dy = cy + out_by * (corners[t, a, 1] - centre[t, 1])
                            dz = cz + out_by * (corners[t, a, 2] - centre[t, 2])
                            value += share * _point(dx, dy, dz, p, linear, table)
                total += value * h * area[t]
        out[i] = total
    return out
