"""The surface of electrodes on a lattice, patch by patch (equations: potential.electrostatics).

A patch is a metal node beside liquid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum, signed_bonds


@dataclass(frozen=True)
class Patches:
    """The surface of the electrodes, patch by patch.

    electrode (n,): which one.  node (n, d): index of the metal node.  normal (n, d): from metal to
    liquid.  area (n,): m^2 (m in 2D, 1 in 1D).  distance (n,): z of the head of this file, m.
    shares (n, padded nodes): a, rows sum to 1.  drawn (n, nodes of the lattice): where behind the
    patch its current comes from, rows sum to 1; a node stands behind one patch, the nearest, or
    behind all that a metal node between pools of liquid has (potential.pools).
    """

    electrode: np.ndarray
    node: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    distance: np.ndarray
    shares: sparse.csr_matrix
    drawn: sparse.csr_matrix

    def only(self, kept: np.ndarray) -> Patches:
        """Some of the patches; kept: bool, or their numbers."""
        if kept.dtype == bool and kept.all():
            return self
        values = {f.name: getattr(self, f.name)[kept] for f in fields(self)}
        return Patches(**values)


def surface_patches(
    bond_sum: NonlocalSum, liquid: np.ndarray, electrodes: Sequence[np.ndarray]
) -> Patches:
    """The patches of metal nodes (bool arrays of the lattice's shape) against liquid nodes.

    Raises ValueError if a node belongs to two of liquid and electrodes, or no metal touches liquid.
    """
    taken = np.asarray(liquid, bool).astype(int)
    for metal in electrodes:
        taken += np.asarray(metal, bool)
    if (taken > 1).any():
        raise ValueError(f"electrodes: {int((taken > 1).sum())} nodes are named twice")
    d = len(bond_sum.lattice_shape)
    spacing = np.array(bond_sum.spacing[3 - d :])
    volume = float(np.prod(spacing))
    offsets, weights = signed_bonds(bond_sum)
    bonds = offsets[:, 3 - d :] * spacing
    wet = bond_sum.pad(liquid).ravel()
    _, rows, columns = bond_sum.padded_shape
    shifts = offsets @ np.array([rows * columns, columns, 1])
    all_metal = taken.astype(bool) & ~np.asarray(liquid, bool)
    exposed_faces, raw_area, normals = _surface(bond_sum, np.asarray(liquid, bool), all_metal)
    sees = bond_sum.crop(bond_sum(bond_sum.pad(liquid))) > 0
    parts = []
    for number, metal in enumerate(electrodes):
        exposed = np.argwhere(np.asarray(metal, bool) & (exposed_faces > 0))
        if not len(exposed):
            continue
        behind = np.argwhere(np.asarray(metal, bool) & sees)
        nearest = cKDTree(exposed * spacing).query(behind * spacing)[1]
        flat = _padded_index(bond_sum, behind)
        on = wet[flat[:, None] + shifts] > 0
        node, bond = np.nonzero(on)
        normal = normals[tuple(exposed.T)]
        along = (bonds[bond] * normal[nearest[node]]).sum(axis=1)
        along = np.where(
            normal.any(axis=1)[nearest[node]],
            np.maximum(along, 0.0),
            np.linalg.norm(bonds, axis=1)[bond],
        )
        carried = volume * weights[bond] * along
        carrying = np.bincount(nearest[node], carried, len(exposed))
        reach = np.bincount(nearest[node], carried * along, len(exposed))
        entries = sparse.coo_matrix(
            (carried, (nearest[node], flat[node] + shifts[bond])), (len(exposed), wet.size)
        ).tocsr()
        keep = carrying > 0
        scale = sparse.diags(1.0 / carrying[keep])
        # Faradaic bonds carry their current in proportion to 1/|xi| (Zhao et al. 2021, Eq. 16).
        here = weights[bond] * np.linalg.norm(bonds, axis=1)[bond] * (along > 0)
        place = np.ravel_multi_index(tuple(behind.T), liquid.shape)
        drawn = sparse.coo_matrix(
            (np.bincount(node, here, len(behind)), (nearest, place)), (len(exposed), liquid.size)
        ).tocsr()[keep]
        drawn.eliminate_zeros()
        whole = np.asarray(drawn.sum(axis=1)).ravel()
        # Area of a plane of that normal per exposed face: 1 / sum_a |n_a| / (area of a face).
        facing = (np.abs(normal) * spacing / volume).sum(axis=1)
        raw = raw_area[tuple(exposed.T)]
        count = exposed_faces[tuple(exposed.T)]
        area = np.where(facing > 0, count / np.where(facing > 0, facing, 1.0), raw)
        parts.append(
            (
                np.full(int(keep.sum()), number),
                exposed[keep],
                normal[keep],
                area[keep],
                0.5 * reach[keep] / carrying[keep],
                scale @ entries[keep],
                sparse.diags(1.0 / whole) @ drawn,
            )
        )
    if not parts:
        raise ValueError("electrodes: none of them touches the liquid")
    electrode, node_of, directions, areas, distances, shares, behind_it = zip(*parts, strict=True)
    return Patches(
        np.concatenate(electrode),
        np.concatenate(node_of),
        np.concatenate(directions),
        np.concatenate(areas),
        np.concatenate(distances),
        sparse.csr_matrix(sparse.vstack(shares)),
        sparse.csr_matrix(sparse.vstack(behind_it)),
    )


def _surface(
    bond_sum: NonlocalSum, liquid: np.ndarray, metal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces to liquid of each metal node: their number, their raw area, and the smoothed normal.

    The normal is the mean direction of the faces of all metal nodes within the horizon, without
    those that look away from a node's own: a plane has them in proportion to its normal.  It is
    zero for nodes that look to both sides of all axes.
    """
    d, stencil = metal.ndim, bond_sum.stencil
    volume = float(np.prod(stencil.spacing))
    ball = np.where(stencil.octant > 0, 1.0, 0.0)
    ball.flat[0] = 1.0
    near = NonlocalSum(Stencil(ball, stencil.spacing), metal.shape)
    count, raw = np.zeros(metal.shape, int), np.zeros(metal.shape)
    normals = np.zeros((*metal.shape, d))
    for a in range(d):
        low = (slice(None),) * a + (slice(0, -1),)
        high = (slice(None),) * a + (slice(1, None),)
        ahead, back = np.zeros(metal.shape, bool), np.zeros(metal.shape, bool)
        ahead[low] = metal[low] & liquid[high]
        back[high] = metal[high] & liquid[low]
        count += ahead.astype(int) + back
        raw += (ahead.astype(int) + back) * volume / stencil.spacing[a]
        up, down = (np.rint(near.crop(near(near.pad(side)))) for side in (ahead, back))
        normals[..., a] = np.where(ahead & ~back, up, np.where(back & ~ahead, -down, up - down))
    # The faces of an axis lie closer where the others' spacing is short: per area, not per face.
    normals /= np.array(stencil.spacing)
    normals[(count == 0)] = 0.0
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return count, raw, normals / np.where(length > 0, length, 1.0)


def _padded_index(bond_sum: NonlocalSum, nodes: np.ndarray) -> np.ndarray:
    """Flat indices in a padded array of nodes (n, d)."""
    d = nodes.shape[1]
    place = np.zeros((len(nodes), 3), np.int64)
    place[:, 3 - d :] = nodes
    return np.ravel_multi_index(tuple((place + np.array(bond_sum.reach)).T), bond_sum.padded_shape)
