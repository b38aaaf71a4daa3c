"""Cutting a closed surface of triangles into patches that can be laid flat, for gmsh to mesh.

The sharp edges of the surface are cut first, and what they leave until every patch is a disc.
gmsh's own way cuts by sharp edges too, but what these leave by METIS, which ends the process on
some surfaces ("Failed during initial partitioning": 98,000 triangles of a threaded pin).
"""

from __future__ import annotations

import gmsh
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

SMOOTH_PATCHES = 16
"""That a shell without sharp edges begins with: more make more seams that the cells have to follow,
fewer are bent more."""
MOST_PATCHES = 400
LONGEST = 10.0
"""Longest way from a patch's seed over the root of the patch's area, about 0.6 for a round one: a
longer strip is laid flat unevenly.  On a screw of 71,504 triangles, whose crest and flanks are one
strip, 10 gives cells of a mean shape of 0.71, 4 and 3, with two and four times the patches and
their ragged seams, 0.66 and 0.60."""


def load_patches(points: np.ndarray, triangles: np.ndarray, sharp: float = np.pi) -> list[int]:
    """Make the surface a part of gmsh's model, as patches; points in the model's unit.

    sharp: angle (rad) between the normals of two triangles from which on their edge is one of the
    solid's.  Returns the model's curves along such edges.
    """
    mesh = gmsh.model.mesh
    patch = surface_patches(points, triangles, sharp)
    tags = [gmsh.model.addDiscreteEntity(2) for _ in range(int(patch.max()) + 1)]
    mesh.addNodes(2, tags[0], np.arange(1, len(points) + 1), points.ravel())
    for number, tag in enumerate(tags):
        mesh.addElementsByType(tag, 2, [], (triangles[patch == number] + 1).ravel())
    mesh.reclassifyNodes()
    mesh.createTopology()
    mesh.createGeometry()
    ends, one, other = _shared_edges(triangles)
    creased = ends[_turn(points, triangles, one, other) >= sharp]
    keys = creased[:, 0] * len(points) + creased[:, 1]
    return [tag for _, tag in gmsh.model.getEntities(1) if _follows(tag, keys, len(points))]


def surface_patches(points: np.ndarray, triangles: np.ndarray, sharp: float = np.pi) -> np.ndarray:
    """Number of the patch of each triangle (nt,), from 0 on; each patch is a disc.

    The triangles nearest to a seed, along the surface and not across edges of at least the angle
    `sharp` (rad), make a patch; the seeds are farthest from one another.  Patches with a hole or
    handle, and long strips, get seeds more until none is left.  ValueError for a surface of too
    intricate a shape.
    """
    graph = _neighbours(points, triangles, sharp)
    component = connected_components(graph, directed=False)[1]
    _, first = np.unique(component, return_index=True)
    seeds = list(first)  # each part between sharp edges, and each shell, needs its own
    distance = dijkstra(graph, directed=False, indices=seeds, min_only=True)
    for smooth in np.flatnonzero(_rim_lengths(triangles, component) == 0):
        part = component == smooth
        for _ in range(SMOOTH_PATCHES - 1):
            seeds.append(int(np.where(part, distance, -1.0).argmax()))
            distance = np.minimum(distance, dijkstra(graph, directed=False, indices=seeds[-1]))
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    while True:
        distance, _, source = dijkstra(
            graph, directed=False, indices=seeds, min_only=True, return_predecessors=True
        )
        _, patch = np.unique(source, return_inverse=True)
        farthest = np.zeros(int(patch.max()) + 1)
        np.maximum.at(farthest, patch, distance)
        bad = _euler_numbers(triangles, patch) != 1
        bad |= farthest > LONGEST * np.sqrt(np.bincount(patch, area))
        if not bad.any():
            return patch
        if len(seeds) + np.count_nonzero(bad) > MOST_PATCHES + len(first):
            raise ValueError(
                f"the surface has {np.count_nonzero(bad)} places of too intricate a shape to mesh"
            )
        for number in np.flatnonzero(bad):
            inside = np.flatnonzero(patch == number)
            seeds.append(int(inside[distance[inside].argmax()]))


def _shared_edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (ne, 2), vertices sorted, and the two triangles of each; the surface is closed."""
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    one, other = (order // 3).reshape(-1, 2).T
    return ends[order[::2]], one, other


def _turn(
    points: np.ndarray, triangles: np.ndarray, one: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Angle (rad) between the normals of pairs of triangles; 0 where one has no area."""
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    a, b = normal[one], normal[other]
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.arctan2(sine, np.einsum("ij,ij->i", a, b))


def _follows(tag: int, keys: np.ndarray, size: int) -> bool:
    """Whether most of a curve's mesh edges are among those with the keys a * size + b, a < b."""
    _, _, nodes = gmsh.model.mesh.getElements(1, tag)
    ends = np.sort(np.concatenate(nodes).astype(np.int64).reshape(-1, 2) - 1, axis=1)
    return bool(np.isin(ends[:, 0] * size + ends[:, 1], keys).mean() > 0.5)


def _neighbours(points: np.ndarray, triangles: np.ndarray, sharp: float) -> csr_array:
    """Distances between the middles of triangles that share an edge that is not sharp, (nt, nt)."""
    _, one, other = _shared_edges(triangles)
    smooth = _turn(points, triangles, one, other) < sharp
    one, other = one[smooth], other[smooth]
    middle = points[triangles].mean(axis=1)
    length = np.linalg.norm(middle[one] - middle[other], axis=1)
    return csr_array((length, (one, other)), shape=(len(triangles),) * 2)


def _rim_lengths(triangles: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Number of the edges between each part and others."""
    _, one, other = _shared_edges(triangles)
    rim = part[one] != part[other]
    count = int(part.max()) + 1
    return np.bincount(part[one][rim], minlength=count) + np.bincount(
        part[other][rim], minlength=count
    )


def _euler_numbers(triangles: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Vertices less edges plus triangles of each patch; 1 for a disc."""
    size, count = int(triangles.max()) + 1, int(patch.max()) + 1
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique((np.repeat(patch, 3) * size + ends[:, 0]) * size + ends[:, 1]) // size**2
    vertices = np.unique(np.repeat(patch, 3) * size + triangles.ravel()) // size
    return (
        np.bincount(vertices, minlength=count)
        - np.bincount(edges, minlength=count)
        + np.bincount(patch, minlength=count)
    )
