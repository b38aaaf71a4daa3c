"""Tetrahedral elements: quadrature points, weights and shape-function gradients (plain NumPy).

Reference tetrahedron with vertices (0,0,0), (1,0,0), (0,1,0), (0,0,1) and volume 1/6. The ten-node
element is straight-sided; its nodes are the four vertices followed by the midpoints of the edges in
the order of `EDGES`, which is the ordering of basix/dolfinx.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EDGES = np.array([(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)])
FACES = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])
# d(lambda)/dX on the reference tetrahedron, vertex by direction
_BARYCENTRIC_GRADIENT = np.array(
    [(-1.0, -1.0, -1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
)
_A = (5.0 - np.sqrt(5.0)) / 20.0
_FOUR_POINTS = np.full((4, 4), _A) + np.eye(4) * (1.0 - 4.0 * _A)


@dataclass(frozen=True)
class Element:
    """A tetrahedral element: its points in barycentric coordinates and its treatment of volume."""

    name: str
    order: int  # of the shape functions: 1 or 2
    barycentric: np.ndarray  # (nq, 4) quadrature points
    weights: np.ndarray  # (nq,), sum 1/6
    mean_dilatation: bool = False  # F-bar: the volume change is averaged over the cell
    patches: bool = False  # ... or over a patch of cells

    @property
    def nodes(self) -> int:
        """Nodes per cell."""
        return 4 if self.order == 1 else 10

    @property
    def points(self) -> int:
        """Quadrature points per cell."""
        return len(self.weights)

    def reference_gradients(self) -> np.ndarray:
        """Gradients of the shape functions in reference coordinates, (nq, nodes, 3)."""
        if self.order == 1:
            return np.repeat(_BARYCENTRIC_GRADIENT[None], self.points, axis=0)
        gradients = np.empty((self.points, 10, 3))
        for q, bary in enumerate(self.barycentric):
            gradients[q, :4] = (4.0 * bary[:, None] - 1.0) * _BARYCENTRIC_GRADIENT
            for e, (a, b) in enumerate(EDGES):
                gradients[q, 4 + e] = 4.0 * (
                    bary[a] * _BARYCENTRIC_GRADIENT[b] + bary[b] * _BARYCENTRIC_GRADIENT[a]
                )
        return gradients


_ONE_POINT = np.full((1, 4), 0.25)
ELEMENTS: dict[str, Element] = {
    "P1": Element("P1", 1, _ONE_POINT, np.array([1.0 / 6.0])),
    "P1-Fbar": Element("P1-Fbar", 1, _ONE_POINT, np.array([1.0 / 6.0]), True, True),
    "P2": Element("P2", 2, _FOUR_POINTS, np.full(4, 1.0 / 24.0)),
    "P2-Fbar": Element("P2-Fbar", 2, _FOUR_POINTS, np.full(4, 1.0 / 24.0), True),
}


def find_element(name: str) -> Element:
    """Return the element called `name`; ValueError names the known ones."""
    try:
        return ELEMENTS[name]
    except KeyError:
        known = ", ".join(ELEMENTS)
        raise ValueError(f"element is {name!r}; allowed are {known}") from None


def quadrature_points(
    points: np.ndarray, cells: np.ndarray, element: str = "P2"
) -> tuple[np.ndarray, np.ndarray]:
    """Return the quadrature points and their volumes in the original order of the cells.

    Parameters
    ----------
    points: (n, 3) vertices [m].
    cells: (nc, 4) vertex numbers.
    element: "P1", "P1-Fbar" (one point), "P2" or "P2-Fbar" (four points).

    Returns
    -------
    (nc, nq, 3) coordinates [m] and (nc, nq) volumes [m^3]; the volumes of a cell add up to its own.
    """
    kind = find_element(element)
    corners = np.asarray(points, float)[np.asarray(cells)]
    coordinates = np.einsum("qa,cad->cqd", kind.barycentric, corners)
    edges = corners[:, 1:] - corners[:, :1]
    six_volumes = np.abs(np.linalg.det(edges))
    return coordinates, six_volumes[:, None] * kind.weights[None, :]


def sampling_points(
    points: np.ndarray, cells: np.ndarray, halvings: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Points and volumes like those of `quadrature_points`, of cells with edges halved repeatedly.

    For the mean over a cell of a field that varies faster than the mesh: 4 * 8^halvings points per
    cell, (nc, np, 3) [m] and (nc, np) [m^3].
    """
    children = np.eye(4)[None]
    for _ in range(halvings):
        children = np.concatenate([_halves(child) for child in children])
    barycentric = np.concatenate([_FOUR_POINTS @ child for child in children])
    corners = np.asarray(points, float)[np.asarray(cells)]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    share = np.full(len(barycentric), 1.0 / len(barycentric))
    return np.einsum("qa,cad->cqd", barycentric, corners), volumes[:, None] * share


def _halves(corners: np.ndarray) -> np.ndarray:
    """The eight tetrahedra of equal volume (8, 4, 4) between corners and edge midpoints of one."""
    middle = {(a, b): 0.5 * (corners[a] + corners[b]) for a in range(4) for b in range(4)}
    outer = [[middle[a, b] for b in range(4)] for a in range(4)]
    axis = middle[0, 1], middle[2, 3]
    ring = [middle[0, 2], middle[0, 3], middle[1, 3], middle[1, 2]]
    inner = [[*axis, ring[k], ring[(k + 1) % 4]] for k in range(4)]
    return np.array(outer + inner)
