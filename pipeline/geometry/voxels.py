"""Which lattice nodes are metal and how much of each cell: ray casting through a closed surface.

No CAD here: the surface is a triangulation, for instance of ``pipeline.geometry.surface.Solid``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from pipeline.geometry.surface import Solid
from pipeline.geometry.voxel_mask import voxel_fraction, voxel_inside

CELLS_PER_FEATURE = 1.9


def check_resolution(solid: Solid, spacing: float | Sequence[float]) -> None:
    """Refuse a lattice too coarse for the solid: about two cells across its smallest feature.

    With two cells a ridge or a gap holds at least one whole cell however the lattice falls, so
    it can neither vanish nor close. The limit is 1.9 because a feature size measured on a file is
    uncertain by a few per cent. For the reference screw (ridge of the thread P/2 = 200 um) that
    allows 100 um and no more than 105 um. ValueError names the spacing and the largest allowed.
    """
    coarsest = float(np.max(spacing))
    allowed = solid.smallest_feature / CELLS_PER_FEATURE
    if not coarsest <= allowed * (1 + 1e-6):
        raise ValueError(
            f"lattice spacing is {coarsest * 1e6:.6g} um: too coarse for the smallest feature of "
            f"{solid.name}, {solid.smallest_feature * 1e6:.4g} um; allowed is at most "
            f"{allowed * 1e6:.4g} um."
        )


def metal_fraction(
    surface: Solid | tuple[np.ndarray, np.ndarray],
    origin: Sequence[float],
    spacing: float | Sequence[float],
    shape: Sequence[int],
    samples: int = 4,
) -> tuple[np.ndarray, np.ndarray]:
    """Node inside test and volume fraction of the cell around every node of a lattice.

    surface: a Solid, or (points (n, 3) in m, triangles (nt, 3)) of a closed surface. Node
    (i, j, k) is at origin + spacing * (i, j, k) (m); its cell reaches half a spacing to each
    side. Returns inside, bool, and fraction in [0, 1], float64, both of the given shape (nx, ny,
    nz); ``inside`` is True where the node itself is in the solid.

    Of a solid from an image both come straight from its voxels. Of another one, rays run along x.
    A cell is crossed by samples x samples of them, each with the exact length
    it has inside the triangulated solid. Whether a ray passes left or right of a projected edge
    is decided by the sign of one determinant per edge, the same for both triangles at the edge,
    with ties broken as if the ray were moved by (eps, eps^2): no ray slips through an edge or
    counts it twice. Nodes are tested 1e-6 spacings off their place, so that all nodes of a plane
    face that coincides with lattice nodes get the same answer.

    Raises ValueError for shapes, spacings or samples out of range, and where a ray enters the
    solid more often than it leaves (an open surface).
    """
    origin = np.asarray(origin, dtype=float)
    step = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    counts = np.asarray(shape)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise ValueError(f"origin is {origin}: allowed are three finite coordinates in m.")
    if not (np.isfinite(step).all() and (step > 0).all()):
        raise ValueError(f"spacing is {spacing}: allowed are positive lengths in m.")
    if counts.shape != (3,) or not (counts >= 1).all():
        raise ValueError(f"shape is {shape}: allowed are three counts of at least 1.")
    if not 1 <= samples <= 64:
        raise ValueError(f"samples is {samples}: allowed are 1 to 64.")
    nx, ny, nz = (int(c) for c in counts)
    if isinstance(surface, Solid) and surface.voxels is not None:
        return (
            voxel_inside(surface.voxels, origin, step, (nx, ny, nz)),
            voxel_fraction(surface.voxels, origin, step, (nx, ny, nz)),
        )

    points, triangles = _arrays(surface)
    offset = 1e-6 * step * np.array([1.0, 0.7548776662, 0.5698402910])
    nodes = _crossings(points, triangles, origin[1:] + offset[1:], step[1:], ny, nz)
    inside = np.zeros((nx, ny, nz), dtype=np.bool_)
    _mark_nodes(*nodes, origin[0] + offset[0], step[0], inside)

    fine = step[1:] / samples
    corner = origin[1:] - step[1:] / 2 + fine / 2
    rays = _crossings(points, triangles, corner, fine, ny * samples, nz * samples)
    fraction = np.zeros((nx, ny, nz))
    _fill_cells(*rays, origin[0] - step[0] / 2, step[0], samples, fraction)
    return inside, np.minimum(fraction, 1.0, out=fraction)


def _arrays(surface: Solid | tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    points, triangles = (
        (surface.points, surface.triangles) if isinstance(surface, Solid) else surface
    )
    points = np.ascontiguousarray(points, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise ValueError(f"surface has triangles of shape {triangles.shape}: allowed is (nt, 3).")
    return points, triangles


def _crossings(
    points: np.ndarray,
    triangles: np.ndarray,
    start: np.ndarray,
    step: np.ndarray,
    rays_y: int,
    rays_z: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays along x at start + step * (j, k) meet the surface: row starts, sorted x."""
    counts = np.zeros(rays_y * rays_z + 1, dtype=np.int64)
    empty = np.zeros(0)
    _trace(points, triangles, start, step, rays_y, rays_z, counts, empty)
    if (counts % 2).any():
        raise ValueError("the surface is open or not manifold: a ray enters it without leaving.")
    starts = np.zeros_like(counts)
    np.cumsum(counts[:-1], out=starts[1:])
    values = np.empty(int(starts[-1]))
    cursor = starts.copy()
    _trace(points, triangles, start, step, rays_y, rays_z, cursor, values)
    _sort_rows(starts, values)
    return starts, values


@numba.njit(cache=True)
def _side(ay, az, a, by, bz, b, py, pz):
    """Sign of the point p against the directed edge a -> b; never 0 for an edge of length."""
    flip = 1
    if a > b:
        ay, by = by, ay
        az, bz = bz, az
        flip = -1
    value = (by - ay) * (pz - az) - (bz - az) * (py - ay)
    if value == 0.0:
        value = az - bz
        if value == 0.0:
            value = by - ay
    if value > 0.0:
        return flip
    if value < 0.0:
        return -flip
    return 0


@numba.njit(cache=True)
def _trace(points, triangles, start, step, rays_y, rays_z, cursor, values):
    """Count the crossings of every ray (values empty) or store their x at the cursor."""
    store = values.size > 0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
        bx, by, bz = points[b, 0], points[b, 1], points[b, 2]
        cx, cy, cz = points[c, 0], points[c, 1], points[c, 2]
        double_area = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        j0 = max(0, math.ceil((min(ay, by, cy) - start[0]) / step[0] - 1e-9))
        j1 = min(rays_y - 1, math.floor((max(ay, by, cy) - start[0]) / step[0] + 1e-9))
        k0 = max(0, math.ceil((min(az, bz, cz) - start[1]) / step[1] - 1e-9))
        k1 = min(rays_z - 1, math.floor((max(az, bz, cz) - start[1]) / step[1] + 1e-9))
        lowest, highest = min(ax, bx, cx), max(ax, bx, cx)
        for j in range(j0, j1 + 1):
            py = start[0] + step[0] * j
            for k in range(k0, k1 + 1):
                pz = start[1] + step[1] * k
                side = _side(ay, az, a, by, bz, b, py, pz)
                if side == 0 or side != _side(by, bz, b, cy, cz, c, py, pz):
                    continue
                if side != _side(cy, cz, c, ay, az, a, py, pz):
                    continue
                ray = j * rays_z + k
                if store:
                    # plane through a: exact at a, and kept within the triangle when steep
                    u = (py - ay) * (cz - az) - (pz - az) * (cy - ay)
                    v = (by - ay) * (pz - az) - (bz - az) * (py - ay)
                    x = lowest
                    if double_area != 0.0:
                        x = ax + (u * (bx - ax) + v * (cx - ax)) / double_area
                    values[cursor[ray]] = min(max(x, lowest), highest)
                cursor[ray] += 1


@numba.njit(cache=True, parallel=True)
def _sort_rows(starts, values):
    for ray in numba.prange(starts.size - 1):
        for m in range(starts[ray] + 1, starts[ray + 1]):
            value = values[m]
            n = m - 1
            while n >= starts[ray] and values[n] > value:
                values[n + 1] = values[n]
                n -= 1
            values[n + 1] = value


@numba.njit(cache=True, parallel=True)
def _mark_nodes(starts, values, first, step, inside):
    nx, ny, nz = inside.shape
    for j in numba.prange(ny):
        for k in range(nz):
            ray = j * nz + k
            for m in range(starts[ray], starts[ray + 1], 2):
                low = max(0, math.ceil((values[m] - first) / step))
                high = min(nx, math.ceil((values[m + 1] - first) / step))
                for i in range(low, high):
                    inside[i, j, k] = True


@numba.njit(cache=True, parallel=True)
def _fill_cells(starts, values, first, step, samples, fraction):
    nx, ny, nz = fraction.shape
    share = 1.0 / (samples * samples)
    for j in numba.prange(ny):
        for fine_j in range(j * samples, (j + 1) * samples):
            for fine_k in range(nz * samples):
                ray = fine_j * (nz * samples) + fine_k
                k = fine_k // samples
                for m in range(starts[ray], starts[ray + 1], 2):
                    enter = max((values[m] - first) / step, 0.0)
                    leave = min((values[m + 1] - first) / step, float(nx))
                    for i in range(int(enter), min(nx, math.ceil(leave))):
                        length = min(leave, i + 1.0) - max(enter, float(i))
                        if length > 0.0:
                            fraction[i, j, k] += share * length
