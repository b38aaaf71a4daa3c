"""How much of each lattice cell a closed triangle surface encloses, exactly.

By the divergence theorem the volume below a surface is the integral of x n_x over it.  Each
triangle is cut at the cells' faces; a piece in a cell adds to that cell the integral of its
distance from the cell's lower x face, and to all cells below that cell, along x, a prism of its
projected area.  No point has to be found inside or outside, so nothing can slip through an edge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

_CORNERS = 12
"""Of a triangle cut by six planes, at most 9."""
_NOTHING = 1e-9
"""A share below is round-off of a face that lies in the cells' own faces."""


def cell_shares(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    origin: Sequence[float],
    spacing: Sequence[float],
    shape: Sequence[int],
) -> NDArray[np.float64]:
    """Share of the cell around every node that lies within the surface, 0..1.

    points: (n, 3), m; triangles: (nt, 3), closed and outward; node (i, j, k) lies at origin +
    spacing * (i, j, k) in the middle of its cell.  The cells' sum is the enclosed volume to
    round-off.  Raises ValueError where the surface does not lie within the lattice's cells.
    """
    step = np.asarray(spacing, float)
    corners = (points[triangles] - np.asarray(origin)) / step + 0.5
    if corners.min() < 0 or (corners.max(axis=(0, 1)) > np.asarray(shape)).any():
        raise ValueError("surface: it must lie within the cells of the lattice")
    own, below = np.zeros(tuple(shape)), np.zeros(tuple(shape))
    _add(corners, own, below)
    # A prism fills every cell from the lowest up to the one below the piece.
    prisms = np.cumsum(below[::-1], axis=0)[::-1] - below
    share = own + prisms
    return np.where(share < _NOTHING, 0.0, np.where(share > 1.0 - _NOTHING, 1.0, share))


@njit(cache=True)
def _cut(polygon: NDArray, count: int, axis: int, at: float, keep: float, out: NDArray) -> int:
    """The part of a polygon where keep * (x_axis - at) >= 0; how many corners it has."""
    found = 0
    for i in range(count):
        j = (i + 1) % count
        a, b = keep * (polygon[i, axis] - at), keep * (polygon[j, axis] - at)
        if a >= 0:
            for k in range(3):
                out[found, k] = polygon[i, k]
            found += 1
        if (a > 0 and b < 0) or (a < 0 and b > 0):
            share = a / (a - b)
            for k in range(3):
                out[found, k] = polygon[i, k] + share * (polygon[j, k] - polygon[i, k])
            out[found, axis] = at
            found += 1
    return found


@njit(cache=True)
def _slab(polygon: NDArray, count: int, axis: int, low: int, spare: NDArray, out: NDArray) -> int:
    """The part of a polygon between two neighbouring faces of the lattice."""
    found = _cut(polygon, count, axis, float(low), 1.0, spare)
    return _cut(spare, found, axis, low + 1.0, -1.0, out) if found > 2 else 0


@njit(cache=True)
def _range(polygon: NDArray, count: int, axis: int, end: int) -> tuple[int, int]:
    """First and last slab that a polygon touches."""
    low, high = polygon[0, axis], polygon[0, axis]
    for i in range(1, count):
        low, high = min(low, polygon[i, axis]), max(high, polygon[i, axis])
    return max(0, min(end - 1, int(np.floor(low)))), max(0, min(end - 1, int(np.floor(high))))


@njit(cache=True)
def _add(corners: NDArray, own: NDArray, below: NDArray) -> None:
    """Add every triangle's pieces; corners in cells from the lattice's lower faces."""
    triangle = np.empty((_CORNERS, 3))
    spare, row, line, piece = (
        np.empty((_CORNERS, 3)), np.empty((_CORNERS, 3)), np.empty((_CORNERS, 3)),
        np.empty((_CORNERS, 3)),
    )  # fmt: skip
    # not as literals, for each of which Numba would compile the functions above anew
    axes = np.arange(3)
    x, y, z = axes[0], axes[1], axes[2]
    for t in range(len(corners)):
        for m in range(3):
            for n in range(3):
                triangle[m, n] = corners[t, m, n]
        first_y, last_y = _range(triangle, 3, y, own.shape[1])
        for j in range(first_y, last_y + 1):
            in_row = _slab(triangle, 3, y, j, spare, row)
            if in_row < 3:
                continue
            first_z, last_z = _range(row, in_row, z, own.shape[2])
            for k in range(first_z, last_z + 1):
                in_line = _slab(row, in_row, z, k, spare, line)
                if in_line < 3:
                    continue
                first_x, last_x = _range(line, in_line, x, own.shape[0])
                for i in range(first_x, last_x + 1):
                    count = _slab(line, in_line, x, i, spare, piece)
                    for m in range(1, count - 1):
                        ay, az = piece[m, 1] - piece[0, 1], piece[m, 2] - piece[0, 2]
                        by, bz = piece[m + 1, 1] - piece[0, 1], piece[m + 1, 2] - piece[0, 2]
                        area = 0.5 * (ay * bz - az * by)
                        height = (piece[0, 0] + piece[m, 0] + piece[m + 1, 0]) / 3.0 - i
                        own[i, j, k] += area * height
                        below[i, j, k] += area
