"""Points spread evenly over the triangles of a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def parts(count: int) -> Array:
    """Centres (count^2, 3) of the equal parts of a triangle, barycentric."""
    found = []
    for i in range(count):
        for j in range(count - i):
            found.append((i + 1 / 3, j + 1 / 3))
            if i + j < count - 1:
                found.append((i + 2 / 3, j + 2 / 3))
    first, second = np.array(found).T / count
    return np.stack([first, second, 1.0 - first - second], axis=1)


def spread_points(points: Array, triangles: NDArray, step: float) -> tuple[Array, NDArray, Array]:
    """Points no farther apart than `step` (m) on triangles, whose they are, and all normals."""
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    counts = np.maximum(1, np.ceil(longest / step).astype(int))
    at, own = [], []
    for count in np.unique(counts):
        which = np.flatnonzero(counts == count)
        weights = parts(count)
        at.append(np.einsum("qa,tad->tqd", weights, corner[which]).reshape(-1, 3))
        own.append(np.repeat(which, len(weights)))
    return np.concatenate(at), np.concatenate(own), normal
