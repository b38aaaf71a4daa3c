"""Triangle against triangle and ray against triangles, in Numba: no CAD, no state."""

from __future__ import annotations

import numba
import numpy as np


def first_intersection(
    points: np.ndarray, triangles: np.ndarray, tolerance: float
) -> tuple[int, int] | None:
    """Two triangles of a surface that cross, fold onto each other or overlap; None if none do.

    points (n, 3), triangles (nt, 3), tolerance a length in the unit of the points: penetrations
    below it are touch, not crossing. Candidates come from a sweep along the longest axis;
    triangles that share vertices are tested beyond what they share.
    """
    corner = points[triangles]
    low, high = corner.min(axis=1), corner.max(axis=1)
    axis = int(np.argmax(high.max(axis=0) - low.min(axis=0)))
    order = np.argsort(low[:, axis], kind="stable")
    others = [(axis + 1) % 3, (axis + 2) % 3]
    columns = [axis, *others]
    found = _sweep(
        points.astype(np.float64),
        triangles[order].astype(np.int64),
        np.ascontiguousarray(low[order][:, columns]),
        np.ascontiguousarray(high[order][:, columns]),
        tolerance,
    )
    hits = np.flatnonzero(found >= 0)
    if not len(hits):
        return None
    return int(order[hits[0]]), int(order[found[hits[0]]])


def ray_distances(
    points: np.ndarray, triangles: np.ndarray, start: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance (nr,) from each start (nr, 3) along its unit direction to the first facing wall.

    A wall faces a ray when its plane stands at more than 25 degrees to it, so that the sides of
    the corner a ray starts in do not count. inf where there is none. The second array is the
    cosine between the ray and the normal of that wall, 1 where it is square on, 0 for none.
    """
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    centre = corner.mean(axis=1)
    radius = np.sqrt(((corner - centre[:, None]) ** 2).sum(axis=2).max(axis=1))
    near = 1e-6 * float(np.max(points.max(axis=0) - points.min(axis=0)))
    return _cast(corner.reshape(-1, 9), normal, centre, radius, start, direction, near)


@numba.njit(inline="always")
def _minus(p, q):
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@numba.njit(inline="always")
def _dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@numba.njit(inline="always")
def _product(p, q):
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@numba.njit(cache=True)
def _inside(hit, a, b, c, normal, margin):
    """Whether a point of a triangle's plane lies inside it, clear of each edge by the margin."""
    for p, q in ((a, b), (b, c), (c, a)):
        edge = _minus(q, p)
        if _dot(_product(normal, edge), _minus(hit, p)) < margin * np.sqrt(_dot(edge, edge)):
            return False
    return True


@numba.njit(cache=True, parallel=True)
def _cast(corner, normal, centre, radius, start, direction, near):
    distances = np.full(start.shape[0], np.inf)
    cosines = np.zeros(start.shape[0])
    for r in numba.prange(start.shape[0]):
        best, cosine = np.inf, 0.0
        p = (start[r, 0], start[r, 1], start[r, 2])
        d = (direction[r, 0], direction[r, 1], direction[r, 2])
        for t in range(corner.shape[0]):
            to = (centre[t, 0] - p[0], centre[t, 1] - p[1], centre[t, 2] - p[2])
            along = _dot(to, d)
            if along < -radius[t] or along - radius[t] > best:
                continue
            if _dot(to, to) - along * along > radius[t] * radius[t]:
                continue
            n = (normal[t, 0], normal[t, 1], normal[t, 2])
            facing = _dot(n, d)
            if abs(facing) < 0.42:
                continue
            a = (corner[t, 0], corner[t, 1], corner[t, 2])
            distance = _dot(n, _minus(a, p)) / facing
            if distance <= near or distance >= best:
                continue
            b = (corner[t, 3], corner[t, 4], corner[t, 5])
            c = (corner[t, 6], corner[t, 7], corner[t, 8])
            hit = (p[0] + distance * d[0], p[1] + distance * d[1], p[2] + distance * d[2])
            if _inside(hit, a, b, c, n, -1e-12 * radius[t]):
                best, cosine = distance, abs(facing)
        distances[r], cosines[r] = best, cosine
    return distances, cosines


@numba.njit(cache=True, parallel=True)
def _sweep(points, triangles, low, high, tolerance):
    """For every triangle, sorted by low[:, 0], one that it crosses, or -1."""
    count = triangles.shape[0]
    found = np.full(count, -1)
    for m in numba.prange(count):
        for n in range(m + 1, count):
            if low[n, 0] > high[m, 0]:
                break
            if low[n, 1] > high[m, 1] or low[m, 1] > high[n, 1]:
                continue
            if low[n, 2] > high[m, 2] or low[m, 2] > high[n, 2]:
                continue
            if _cross(points, triangles, m, n, tolerance):
                found[m] = n
                break
    return found


@numba.njit(cache=True)
def _cross(points, triangles, m, n, tolerance):
    """Whether two triangles cross, fold or overlap beyond the vertices that they share."""
    shared = 0
    for i in range(3):
        for j in range(3):
            if triangles[m, i] == triangles[n, j]:
                shared += 1
    a0, a1, a2 = _corners(points, triangles, m)
    b0, b1, b2 = _corners(points, triangles, n)
    na, nb = _unit_normal(a0, a1, a2), _unit_normal(b0, b1, b2)
    if _dot(na, na) == 0.0 or _dot(nb, nb) == 0.0:
        return False
    if shared >= 2:
        return _dot(na, nb) < -1.0 + 1e-12
    h0, h1, h2 = _dot(nb, _minus(a0, b0)), _dot(nb, _minus(a1, b0)), _dot(nb, _minus(a2, b0))
    lowest, highest = min(h0, min(h1, h2)), max(h0, max(h1, h2))
    if lowest > tolerance or highest < -tolerance:
        return False
    if lowest >= -tolerance and highest <= tolerance:
        return _overlap(a0, a1, a2, na, b0, b1, b2, tolerance) and _overlap(
            b0, b1, b2, nb, a0, a1, a2, tolerance
        )
    for p, q in ((a0, a1), (a1, a2), (a2, a0)):
        if _pierces(p, q, b0, b1, b2, nb, tolerance):
            return True
    for p, q in ((b0, b1), (b1, b2), (b2, b0)):
        if _pierces(p, q, a0, a1, a2, na, tolerance):
            return True
    return False


@numba.njit(cache=True)
def _corners(points, triangles, t):
    i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    return (
        (points[i, 0], points[i, 1], points[i, 2]),
        (points[j, 0], points[j, 1], points[j, 2]),
        (points[k, 0], points[k, 1], points[k, 2]),
    )


@numba.njit(cache=True)
def _unit_normal(a, b, c):
    """Unit normal of a triangle; zero for one without area."""
    n = _product(_minus(b, a), _minus(c, a))
    length = np.sqrt(_dot(n, n))
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return n[0] / length, n[1] / length, n[2] / length


@numba.njit(cache=True)
def _pierces(p, q, a, b, c, normal, tolerance):
    """Whether the segment p-q, its ends clear of the plane, meets a triangle or its edges."""
    hp, hq = _dot(normal, _minus(p, a)), _dot(normal, _minus(q, a))
    if not ((hp > tolerance and hq < -tolerance) or (hp < -tolerance and hq > tolerance)):
        return False
    share = hp / (hp - hq)
    along = _minus(q, p)
    hit = (p[0] + share * along[0], p[1] + share * along[1], p[2] + share * along[2])
    return _inside(hit, a, b, c, normal, -tolerance)


@numba.njit(cache=True)
def _overlap(a, b, c, normal, p, q, r, tolerance):
    """Whether no edge of the triangle a, b, c separates p, q, r of its plane from it."""
    for start, end in ((a, b), (b, c), (c, a)):
        edge = _minus(end, start)
        inward = _product(normal, edge)
        deepest = _dot(inward, _minus(p, start))
        deepest = max(deepest, _dot(inward, _minus(q, start)))
        deepest = max(deepest, _dot(inward, _minus(r, start)))
        if deepest <= tolerance * np.sqrt(_dot(edge, edge)):
            return False
    return True
