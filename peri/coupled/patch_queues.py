"""What a patch's current takes from the metal nodes behind it, to the last mole."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree


def drain(
    content: np.ndarray, drawn: sparse.csr_matrix, demand: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Take an amount from the nodes behind each patch, in proportion to their shares.

    A node that is empty passes its share on to the others behind its patch at that moment, so the
    result does not depend on how a demand is split into steps.

    Parameters
    ----------
    content : (nodes,) array
        Of every node of the lattice, >= 0.
    drawn : (n, nodes)
        Shares, rows sum to 1; each node has an entry in one row at most.
    demand : (n,) array
        >= 0, in the unit of content.

    Returns
    -------
    content, unmet : what is left, and (n,) what a patch found nothing for.  Content before equals
    content after and demand - unmet, in sum, to round-off.
    """
    node = drawn.indices
    owner = np.repeat(np.arange(drawn.shape[0]), np.diff(drawn.indptr))
    left, want = content[node].astype(float), np.array(demand, float)
    while True:
        share = np.where(left > 0, drawn.data, 0.0)
        whole = np.bincount(owner, share, len(want))
        want_now = np.where(whole > 0, want, 0.0)
        if not want_now.any():
            break
        # The demand of a patch at which each of its nodes is empty, and the first of these.
        empties = np.full(len(node), np.inf)
        there = share > 0
        empties[there] = left[there] / share[there] * whole[owner[there]]
        first = np.full(len(want), np.inf)
        np.minimum.at(first, owner, empties)
        take = np.minimum(want_now, first)
        gone = there & (empties <= take[owner])
        taken = np.where(there, take[owner] * share / np.where(there, whole[owner], 1.0), 0.0)
        left = np.where(gone, 0.0, np.maximum(left - taken, 0.0))
        want = want - take
    out = content.astype(float).copy()
    out[node] = left
    return out, want


def spill(
    content: np.ndarray, place: np.ndarray, origin: np.ndarray, unmet: np.ndarray, nodes: np.ndarray
) -> np.ndarray:
    """Take what patches found nothing for from the nearest metal that is left, in place.

    content : (nodes of the lattice,).  place : (nodes of the lattice, d), m.  origin : (n, d), m,
    where the patches are.  unmet : (n,).  nodes : indices that may give, of the patches' metal.

    Returns what could not be taken at all, (n,).
    """
    unmet = unmet.copy()
    for patch in np.flatnonzero(unmet > 0):
        there = nodes[content[nodes] > 0]
        if not there.size:
            break
        order = cKDTree(place[there]).query(origin[patch], k=min(64, there.size))[1]
        for node in there[np.atleast_1d(order)]:
            taken = min(unmet[patch], content[node])
            content[node] -= taken
            unmet[patch] -= taken
            if unmet[patch] <= 0:
                break
    return unmet
