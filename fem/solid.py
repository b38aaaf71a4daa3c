"""Which cells still carry load, which pieces join both grips, and who owns which cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fem.patches import face_pairs


@dataclass(frozen=True)
class Grips:
    """Where the solid is held. The axis is z; both ends of the input mesh count, corroded or not.

    bottom_length, top_length [m]: every node within this distance of the end is held; 0 holds the
    end faces only, as published. lateral: "free" leaves lateral motion free but for rigid motions
    (as published), "clamped" holds it as well.
    """

    bottom_length: float = 0.0
    top_length: float = 0.0
    lateral: str = "free"

    def __post_init__(self) -> None:
        for name in ("bottom_length", "top_length"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(
                    f"grip {name} is {value}; it must be zero or a positive length in m"
                )
        if self.lateral not in ("free", "clamped"):
            raise ValueError(f"grip lateral is {self.lateral!r}; allowed are 'free' and 'clamped'")


@dataclass(frozen=True)
class Held:
    """Held nodes of a set of coordinates, from the ends of the whole solid."""

    bottom: float  # highest z held at the bottom [m]
    top: float  # lowest z held at the top [m]
    length: float  # between the grips [m]

    @classmethod
    def of(cls, points: np.ndarray, grips: Grips) -> Held:
        """Ends of the solid with vertices `points` (n, 3); ValueError if the grips meet."""
        low, high = float(points[:, 2].min()), float(points[:, 2].max())
        length = high - low
        if not length > 0:
            raise ValueError(f"the mesh has length {length} m along z; it must be positive")
        slack = 1e-6 * length
        held = cls(
            low + grips.bottom_length + slack,
            high - grips.top_length - slack,
            length - grips.bottom_length - grips.top_length,
        )
        if held.bottom >= held.top:
            raise ValueError(
                f"grip lengths are {grips.bottom_length} m and {grips.top_length} m; "
                f"together they must be shorter than the solid, {length} m"
            )
        return held

    def at_bottom(self, coordinates: np.ndarray) -> np.ndarray:
        """Which of (n, 3) nodes the bottom grip holds."""
        return coordinates[:, 2] <= self.bottom

    def at_top(self, coordinates: np.ndarray) -> np.ndarray:
        """Which of (n, 3) nodes the top grip holds."""
        return coordinates[:, 2] >= self.top


@dataclass(frozen=True)
class Remains:
    """What is left of the solid."""

    kept: np.ndarray  # (nc,) bool: alive and joined to both grips
    pieces: np.ndarray  # (nc,) piece number of the kept cells, -1 elsewhere
    dead: int  # cells without strength
    loose_cells: int  # cells alive in pieces that do not join both grips
    loose_pieces: int

    @property
    def severed(self) -> bool:
        """No piece joins both grips."""
        return not bool(self.kept.any())


def remains(cells: np.ndarray, alive: np.ndarray, bottom: np.ndarray, top: np.ndarray) -> Remains:
    """Keep the pieces that join both grips.

    Cells (nc, 4) are joined through common faces only: a piece that hangs on an edge or a vertex
    is a hinge and carries nothing that a stiffness matrix could be factorised with. A piece counts
    as held where it has a whole face (three vertices of one cell) in the grip. bottom, top: (n,)
    bool per vertex; alive: (nc,) bool.
    """
    numbers = np.flatnonzero(alive)
    living = cells[numbers]
    pieces = np.full(len(cells), -1)
    if not len(living):
        return Remains(np.zeros(len(cells), bool), pieces, int((~alive).sum()), 0, 0)
    first, second = (side // 4 for side in face_pairs(living, len(bottom)))
    graph = coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(len(living),) * 2)
    total, label = connected_components(graph, directed=False)
    held_bottom, held_top = np.zeros(total, bool), np.zeros(total, bool)
    held_bottom[label[bottom[living].sum(axis=1) >= 3]] = True
    held_top[label[top[living].sum(axis=1) >= 3]] = True
    good = held_bottom & held_top
    kept = np.zeros(len(cells), bool)
    kept[numbers] = good[label]
    pieces[numbers] = np.where(good[label], (np.cumsum(good) - 1)[label], -1)
    return Remains(
        kept,
        pieces,
        int((~alive).sum()),
        int((~good[label]).sum()),
        int((~good).sum()),
    )


def guide_vertices(
    points: np.ndarray, cells: np.ndarray, pieces: np.ndarray, bottom: np.ndarray
) -> list[tuple[int, int]]:
    """Vertices and directions (0 = x, 1 = y) whose guidance removes each piece's rigid motions.

    Three conditions per piece, at two vertices of its bottom grip: they are statically determinate,
    so they carry no force where none is applied laterally.
    """
    guides: list[tuple[int, int]] = []
    for piece in range(int(pieces.max()) + 1):
        vertices = np.unique(cells[pieces == piece])
        vertices = vertices[bottom[vertices]]
        plane = points[vertices, :2]
        first = int(np.argmin(((plane - plane.mean(axis=0)) ** 2).sum(axis=1)))
        offsets = plane - plane[first]
        second = int(np.argmax((offsets**2).sum(axis=1)))
        across = 1 if abs(offsets[second, 0]) >= abs(offsets[second, 1]) else 0
        guides += [(int(vertices[first]), 0), (int(vertices[first]), 1)]
        guides.append((int(vertices[second]), across))
    return guides


def destinations(
    points: np.ndarray, cells: np.ndarray, groups: np.ndarray, ranks: int
) -> tuple[np.ndarray, np.ndarray]:
    """Slabs along z with equal numbers of groups; ghosts are the groups that share a vertex.

    groups: (nc,) number of the patch of each cell (or of the cell itself), which is never split.
    Returns the adjacency list (ranks, offsets): for each cell its owner, then the ghosting ranks.
    """
    total = int(groups.max()) + 1
    height = np.bincount(groups, points[cells, 2].mean(axis=1)) / np.bincount(groups)
    group_owner = np.empty(total, np.int32)
    for rank, part in enumerate(np.array_split(np.argsort(height, kind="stable"), ranks)):
        group_owner[part] = rank
    owner = group_owner[groups]
    touched = np.zeros((len(points), ranks), bool)
    for corner in range(4):
        touched[cells[:, corner], owner] = True
    group_needed = np.zeros((total, ranks), bool)
    cell, rank = np.nonzero(touched[cells].any(axis=1))
    group_needed[groups[cell], rank] = True
    needed = group_needed[groups]
    needed[np.arange(len(cells)), owner] = False
    lists = np.concatenate([owner[:, None], np.where(needed, np.arange(ranks)[None], -1)], axis=1)
    keep = lists >= 0
    offsets = np.concatenate([[0], np.cumsum(keep.sum(axis=1))])
    return lists[keep].astype(np.int32), offsets.astype(np.int32)
