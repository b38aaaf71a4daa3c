"""Pools of liquid: parts between which no bond and no patch carries a current."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from peri.engine.operators import NonlocalSum, signed_bonds


def label_pools(
    bond_sum: NonlocalSum, liquid: np.ndarray, shares: sparse.csr_matrix
) -> tuple[np.ndarray, np.ndarray]:
    """Number each pool from 1.

    Parts that touch across faces, that a bond joins across a wall thinner than the horizon, or
    that one patch sees are of one pool: its currents balance as a whole.

    Parameters
    ----------
    liquid : bool array of the lattice's shape
    shares : (patches, padded nodes), as Patches has it

    Returns
    -------
    pool : int array of the lattice's shape, 0 off the liquid.
    of_patch : (patches,) the pool that each patch sees.
    """
    part, count = ndimage.label(liquid)
    if count > 1:
        pairs = [*_by_bonds(bond_sum, part), *_by_patches(bond_sum, part, shares)]
        one, other = np.concatenate([np.zeros((0, 2), int), *pairs]).T
        graph = sparse.coo_matrix((np.ones(one.size), (one, other)), (count + 1, count + 1))
        _, merged = connected_components(graph, directed=False)
        kinds = np.unique(merged[1:])
        part = np.where(part > 0, np.searchsorted(kinds, merged)[part] + 1, 0)
    padded = bond_sum.pad(part).ravel()
    first = shares.indices[shares.indptr[:-1]]
    return part, np.rint(padded[first]).astype(int)


def _by_bonds(bond_sum: NonlocalSum, part: np.ndarray) -> list[np.ndarray]:
    """Pairs of parts that bonds join, one array per offset."""
    offsets, _ = signed_bonds(bond_sum)
    pairs = []
    for offset in offsets[len(offsets) // 2 :, 3 - part.ndim :]:
        here = tuple(
            slice(max(0, -s), max(0, n - max(0, s)))
            for s, n in zip(offset, part.shape, strict=True)
        )
        there = tuple(slice(h.start + s, h.stop + s) for h, s in zip(here, offset, strict=True))
        a, b = part[here], part[there]
        joined = (a > 0) & (b > 0) & (a != b)
        if joined.any():
            pairs.append(np.unique(np.stack([a[joined], b[joined]], axis=1), axis=0))
    return pairs


def _by_patches(
    bond_sum: NonlocalSum, part: np.ndarray, shares: sparse.csr_matrix
) -> list[np.ndarray]:
    """Pairs of parts that one patch sees."""
    seen = np.rint(bond_sum.pad(part).ravel()[shares.indices]).astype(int)
    owner = np.repeat(np.arange(shares.shape[0]), np.diff(shares.indptr))
    first = seen[shares.indptr[:-1]][owner]
    differ = (seen != first) & (seen > 0) & (first > 0)
    return [np.unique(np.stack([first[differ], seen[differ]], axis=1), axis=0)]
