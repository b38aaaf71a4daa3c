"""Pools of liquid: parts between which no bond carries a current.

A metal node that touches two pools has a patch in each: what enters one of them must leave it
again, so the node's current on one side says nothing of that on the other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from peri.engine.operators import NonlocalSum, signed_bonds
from peri.transport.potential.patches import Patches


def label_pools(bond_sum: NonlocalSum, liquid: np.ndarray) -> np.ndarray:
    """Number each pool from 1; int array of the lattice's shape, 0 off the liquid.

    Parts that touch across faces, or that a bond joins across a wall thinner than the horizon, are
    of one pool: its currents balance as a whole.

    Parameters
    ----------
    liquid : bool array of the lattice's shape
    """
    part, count = ndimage.label(liquid)
    if count > 1:
        pairs = _by_bonds(bond_sum, part)
        one, other = np.concatenate([np.zeros((0, 2), int), *pairs]).T
        graph = sparse.coo_matrix((np.ones(one.size), (one, other)), (count + 1, count + 1))
        _, merged = connected_components(graph, directed=False)
        kinds = np.unique(merged[1:])
        part = np.where(part > 0, np.searchsorted(kinds, merged)[part] + 1, 0)
    return part


def by_pool(patches: Patches, pool: np.ndarray) -> tuple[Patches, np.ndarray]:
    """Patches that see one pool each, and (n,) which; one that sees several is shared among these.

    pool : padded, as label_pools gives it.  Areas add up to those before.
    """
    shares = patches.shares.tocsr()
    owner = np.repeat(np.arange(shares.shape[0]), np.diff(shares.indptr))
    seen = np.rint(pool.ravel()[shares.indices]).astype(int)
    first = seen[shares.indptr[:-1]]
    if (seen == first[owner]).all():
        return patches, first
    keys, row = np.unique(owner * (int(seen.max()) + 1) + seen, return_inverse=True)
    of = keys // (int(seen.max()) + 1)
    whole = np.bincount(row, shares.data, len(keys))
    split = sparse.coo_matrix(
        (shares.data / whole[row], (row, shares.indices)), (len(keys), shares.shape[1])
    )
    taken = patches.only(of)
    return (
        replace(taken, area=taken.area * whole, shares=split.tocsr()),
        keys % (int(seen.max()) + 1),
    )


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
