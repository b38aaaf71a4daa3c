"""Patches of tetrahedra over which the F-bar element with four nodes averages the volume change."""

from __future__ import annotations

import numpy as np
from numba import njit

from fem.quadrature import FACES

PATCH_SIZE = 6  # about three unknowns per volume constraint, the ratio of the continuum


def make_patches(cells: np.ndarray, count: int, size: int = PATCH_SIZE) -> np.ndarray:
    """Patch number of every cell: compact groups of about `size` cells joined through faces.

    A patch grows by the neighbour that shares most vertices with it, which closes rings around
    edges; a remainder of less than half the size joins the neighbouring patch that shares most of
    its faces. cells: (nc, 4); count: number of vertices. The result depends on the mesh only.
    """
    neighbours = face_neighbours(cells, count)
    patch = _grow(np.ascontiguousarray(cells), neighbours, size)
    _, patch = np.unique(patch, return_inverse=True)
    return patch.reshape(-1).astype(np.int64)


def sound_patches(
    cells: np.ndarray, count: int, sound: np.ndarray, material: np.ndarray
) -> np.ndarray:
    """Patch numbers where only the cells with `sound` (nc,) True are joined; others stay alone.

    Porous cells can dilate plastically, so they do not lock; in one patch with sound ones they
    would force their dilation on them. No patch mixes materials (nc,), whose pressures differ.
    """
    groups, first = len(cells) + np.arange(len(cells)), 0
    for row in np.unique(material[sound]):
        numbers = np.flatnonzero(sound & (material == row))
        groups[numbers] = first + make_patches(cells[numbers], count)
        first += len(numbers)
    return np.unique(groups, return_inverse=True)[1]


def face_pairs(cells: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Entries 4 c + face of the two sides of every inner face of (nc, 4) cells."""
    faces = np.sort(cells[:, FACES].reshape(-1, 3), axis=1).astype(np.int64)
    if count < 2_000_000:  # one integer per face sorts faster than three
        keys = (faces[:, 0] * count + faces[:, 1]) * count + faces[:, 2]
        order = np.argsort(keys, kind="stable")
        same = keys[order][1:] == keys[order][:-1]
    else:
        order = np.lexsort(faces.T[::-1])
        same = (faces[order][1:] == faces[order][:-1]).all(axis=1)
    return order[:-1][same], order[1:][same]


def face_neighbours(cells: np.ndarray, count: int) -> np.ndarray:
    """Cell behind each face (nc, 4), -1 at the surface."""
    first, second = face_pairs(cells, count)
    neighbours = np.full(4 * len(cells), -1, np.int64)
    neighbours[first], neighbours[second] = second // 4, first // 4
    return neighbours.reshape(-1, 4)


@njit(cache=True)
def _shared(cells, cell, members, amount):
    """How many vertices of a cell occur in the patch."""
    shared = 0
    for a in range(4):
        found = False
        for m in range(amount):
            for b in range(4):
                if cells[members[m], b] == cells[cell, a]:
                    found = True
        if found:
            shared += 1
    return shared


@njit(cache=True)
def _grow(cells, neighbours, size):
    patch = np.full(cells.shape[0], -1, np.int64)
    members = np.empty(size, np.int64)
    for seed in range(cells.shape[0]):
        if patch[seed] >= 0:
            continue
        members[0], amount = seed, 1
        patch[seed] = seed
        while amount < size:
            best, best_score = -1, -1
            for m in range(amount):
                for face in range(4):
                    cell = neighbours[members[m], face]
                    if cell < 0 or patch[cell] >= 0:
                        continue
                    free = 0  # prefer cells that would otherwise be left alone
                    for other in neighbours[cell]:
                        if other >= 0 and patch[other] < 0:
                            free += 1
                    score = 8 * _shared(cells, cell, members, amount) + 4 - free
                    if score > best_score:
                        best, best_score = cell, score
            if best < 0:
                break
            patch[best] = seed
            members[amount] = best
            amount += 1
        if amount < (size + 1) // 2:
            votes, target = 0, -1
            for m in range(amount):
                for cell in neighbours[members[m]]:
                    if cell < 0 or patch[cell] < 0 or patch[cell] == seed:
                        continue
                    same = 0
                    for n in range(amount):
                        for other in neighbours[members[n]]:
                            if other >= 0 and patch[other] == patch[cell]:
                                same += 1
                    if same > votes:
                        votes, target = same, patch[cell]
            if target >= 0:
                for m in range(amount):
                    patch[members[m]] = target
    return patch
