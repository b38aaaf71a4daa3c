"""Metal known by voxels: its share of the cells of a lattice, straight from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

PLANES = 32  # of voxels turned into numbers at a time; more takes memory and no less time


@dataclass(frozen=True)
class VoxelMask:
    """Which voxels of a box are metal.

    metal: (nx, ny, nz), bool; nothing outside the box is metal.  corner: lowest corner of the box
    (m); size: edge lengths of a voxel (m).
    """

    metal: np.ndarray
    corner: tuple[float, float, float]
    size: tuple[float, float, float]

    @property
    def volume(self) -> float:
        """Volume of the metal, m^3."""
        return float(np.count_nonzero(self.metal)) * float(np.prod(self.size))


def voxel_fraction(
    mask: VoxelMask,
    origin: Sequence[float],
    spacing: float | Sequence[float],
    shape: Sequence[int],
    width: float | Sequence[float] | None = None,
) -> np.ndarray:
    """Share of metal in the box about every node of a lattice, float64 of the given shape.

    Node (i, j, k) is at origin + spacing * (i, j, k), m; its box is `width` wide (default: one
    spacing, the node's cell).  The share is exact, the volume that box and metal voxels have in
    common over that of the box, so that the shares of all cells add up to the metal's volume where
    the lattice covers it: three products, one an axis, with the matrix of how much of each
    voxel lies in each box.
    """
    step = np.broadcast_to(np.asarray(spacing, float), (3,))
    wide = step if width is None else np.broadcast_to(np.asarray(width, float), (3,))
    along_x, along_y, along_z = (
        _overlap(mask.metal.shape[a], mask.corner[a], mask.size[a], origin[a], step[a], shape[a],
                 wide[a])
        for a in range(3)
    )  # fmt: skip
    planes = mask.metal.transpose(2, 1, 0)
    by_z = np.zeros((shape[2], planes[0].size), np.float32)
    for begin in range(0, len(planes), PLANES):
        block = planes[begin : begin + PLANES]
        by_z += along_z[:, begin : begin + PLANES] @ block.reshape(len(block), -1).astype("f4")
    share = np.empty(tuple(shape))
    for k in range(shape[2]):
        rows = along_y @ by_z[k].reshape(planes.shape[1:])
        share[:, :, k] = along_x @ rows.T
    return np.minimum(share, 1.0, out=share)


def voxel_inside(
    mask: VoxelMask, origin: Sequence[float], spacing: float | Sequence[float], shape: Sequence[int]
) -> np.ndarray:
    """Whether each node of a lattice lies in a metal voxel, bool of the given shape.

    A node on the face between two voxels is in the one with the higher coordinate.
    """
    step = np.broadcast_to(np.asarray(spacing, float), (3,))
    found = np.zeros(tuple(shape), bool)
    nodes, voxels = [], []
    for a in range(3):
        place = (origin[a] + step[a] * np.arange(shape[a]) - mask.corner[a]) / mask.size[a]
        voxel = np.floor(place + 1e-6).astype(int)
        there = (voxel >= 0) & (voxel < mask.metal.shape[a])
        nodes.append(np.flatnonzero(there))
        voxels.append(voxel[there])
    found[np.ix_(*nodes)] = mask.metal[np.ix_(*voxels)]
    return found


def _overlap(
    voxels: int, corner: float, size: float, origin: float, step: float, nodes: int, width: float
) -> sparse.csr_array:
    """Share of each box (row) that each voxel (column) takes up, along one axis."""
    edges = corner + size * np.arange(voxels + 1)
    low = (origin + step * np.arange(nodes) - width / 2)[:, None]
    common = np.minimum(edges[1:], low + width) - np.maximum(edges[:-1], low)
    return sparse.csr_array((np.maximum(common, 0.0) / width).astype(np.float32))
