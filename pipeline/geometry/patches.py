"""Cutting a closed surface of triangles without sharp edges into patches that can be laid flat.

gmsh cuts surfaces by their sharp edges, and where these leave none by METIS, which ends the process
on some surfaces of scans ("Failed during initial partitioning": 98,000 triangles of a threaded
pin).
"""

from __future__ import annotations

import gmsh
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

FIRST_PATCHES = 16  # more make more edges that the cells have to follow, fewer are bent more
MOST_PATCHES = 400


def load_patches(points: np.ndarray, triangles: np.ndarray) -> None:
    """Make the surface a part of gmsh's model, as patches; points in the model's unit."""
    mesh = gmsh.model.mesh
    patch = surface_patches(points, triangles)
    tags = [gmsh.model.addDiscreteEntity(2) for _ in range(int(patch.max()) + 1)]
    mesh.addNodes(2, tags[0], np.arange(1, len(points) + 1), points.ravel())
    for number, tag in enumerate(tags):
        mesh.addElementsByType(tag, 2, [], (triangles[patch == number] + 1).ravel())
    mesh.reclassifyNodes()
    mesh.createTopology()
    mesh.createGeometry()


def surface_patches(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Number of the patch of each triangle (nt,), from 0 on; each patch is a disc.

    The triangles nearest to a seed, along the surface, make a patch; the seeds are farthest from
    one another.  Patches with a hole or handle get seeds more until none is left.  ValueError for
    a surface of too intricate a shape.
    """
    graph = _neighbours(points, triangles)
    _, first = np.unique(connected_components(graph, directed=False)[1], return_index=True)
    seeds = list(first)  # each shell needs its own
    distance = dijkstra(graph, directed=False, indices=seeds, min_only=True)
    while len(seeds) < FIRST_PATCHES + len(first) - 1:
        seeds.append(int(distance.argmax()))
        distance = np.minimum(distance, dijkstra(graph, directed=False, indices=seeds[-1]))
    while True:
        distance, _, source = dijkstra(
            graph, directed=False, indices=seeds, min_only=True, return_predecessors=True
        )
        _, patch = np.unique(source, return_inverse=True)
        bad = np.flatnonzero(_euler_numbers(triangles, patch) != 1)
        if not len(bad):
            return patch
        if len(seeds) + len(bad) > MOST_PATCHES:
            raise ValueError(f"the surface has {len(bad)} places of too intricate a shape to mesh")
        for number in bad:
            inside = np.flatnonzero(patch == number)
            seeds.append(int(inside[distance[inside].argmax()]))


def _neighbours(points: np.ndarray, triangles: np.ndarray) -> csr_array:
    """Distances between the middles of triangles that share an edge, (nt, nt)."""
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    one, other = (order // 3).reshape(-1, 2).T  # a closed surface has two triangles an edge
    middle = points[triangles].mean(axis=1)
    length = np.linalg.norm(middle[one] - middle[other], axis=1)
    return csr_array((length, (one, other)), shape=(len(triangles),) * 2)


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
