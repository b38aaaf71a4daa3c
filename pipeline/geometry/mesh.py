"""Tetrahedral meshes: arrays, quality, files. No CAD here; ``solids`` makes them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

SCHEMA_VERSION = 1
_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


@dataclass(frozen=True)
class TetrahedralMesh:
    """Four-node tetrahedra: points (n, 3) float64 in m, cells (nc, 4) int64, positively oriented.

    ``quality`` holds what ``mesh_quality`` measures, and what the mesher adds to it.
    """

    points: np.ndarray
    cells: np.ndarray
    quality: dict = field(default_factory=dict)


def cell_volumes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Signed volumes (nc,) in m^3 of tetrahedra; positive when node 3 sees 0, 1, 2 turn left."""
    corner = points[cells]
    a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
    return np.einsum("ij,ij->i", np.cross(a, b), c) / 6.0


def boundary_triangles(cells: np.ndarray) -> np.ndarray:
    """Outward triangles (nf, 3) that belong to one cell only."""
    faces = cells[:, _FACES][surface_faces(cells)]
    return faces[np.lexsort(np.sort(faces, axis=1).T[::-1])]


def surface_faces(cells: np.ndarray) -> np.ndarray:
    """Which faces of each cell (nc, 4) belong to it only; the face k lies opposite its node k."""
    a, b, c = np.sort(cells[:, _FACES].reshape(-1, 3).astype(np.int64), axis=1).T
    n = int(cells.max()) + 1
    _, place, count = np.unique((a * n + b) * n + c, return_inverse=True, return_counts=True)
    return (count[place] == 1).reshape(-1, 4)


def refine_tetrahedra(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split every tetrahedron into eight at the middles of its edges.

    points (n, 3) and cells (nc, 4) become (n + number of edges, 3) and (8 nc, 4), the parts of a
    cell one after another; neighbours keep sharing their points and the volume stays the same.
    """
    ends = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
    edges = np.sort(cells[:, ends].reshape(-1, 2), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    middle = len(points) + number.reshape(len(cells), 6)
    corners = np.concatenate([cells, middle], axis=1)  # 4 corners, then middles in order of `ends`
    parts = np.array(
        [
            (0, 4, 5, 6),
            (4, 1, 7, 8),
            (5, 7, 2, 9),
            (6, 8, 9, 3),
            (4, 5, 6, 8),
            (4, 7, 5, 8),
            (9, 5, 7, 8),
            (9, 6, 5, 8),
        ]
    )
    finer = np.concatenate([points, points[unique].mean(axis=1)])
    return finer, corners[:, parts].reshape(-1, 4)


def scaled_shape(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Mean-ratio shape 12 (3 V)^(2/3) / sum of squared edge lengths (nc,): 1 regular, 0 flat."""
    edges = points[cells[:, _EDGES[:, 0]]] - points[cells[:, _EDGES[:, 1]]]
    squares = np.einsum("ijk,ijk->i", edges, edges)
    volumes = np.maximum(cell_volumes(points, cells), 0.0)
    return 12.0 * (3.0 * volumes) ** (2.0 / 3.0) / squares


def dihedral_angles(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """The six dihedral angles of every cell (nc, 6) in rad."""
    corner = points[cells]
    normals = []
    for a, b, c in _FACES:
        normal = np.cross(corner[:, b] - corner[:, a], corner[:, c] - corner[:, a])
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    cosines = [-np.einsum("ij,ij->i", normals[a], normals[b]) for a, b in _EDGES]
    return np.arccos(np.clip(np.stack(cosines, axis=1), -1.0, 1.0))


def mesh_quality(points: np.ndarray, cells: np.ndarray, volume: float | None = None) -> dict:
    """Counts, shape, angles (degrees), sizes (m) and the area of the flat ends of a mesh.

    ``volume`` (m^3) is the volume of the solid, for ``volume_error`` (relative, signed).
    """
    volumes = cell_volumes(points, cells)
    shape = scaled_shape(points, cells)
    angles = np.degrees(dihedral_angles(points, cells))
    edges = points[cells[:, _EDGES[:, 0]]] - points[cells[:, _EDGES[:, 1]]]
    lengths = np.linalg.norm(edges, axis=2)
    total = float(volumes.sum())
    quality = {
        "points": int(points.shape[0]),
        "cells": int(cells.shape[0]),
        "volume": total,
        "min_cell_volume": float(volumes.min()),
        "min_shape": float(shape.min()),
        "mean_shape": float(shape.mean()),
        "shape_below_0.1": int((shape < 0.1).sum()),
        "min_dihedral_angle": float(angles.min()),
        "max_dihedral_angle": float(angles.max()),
        "dihedral_angle_below_5": int((angles.min(axis=1) < 5.0).sum()),
        "min_edge": float(lengths.min()),
        "mean_edge": float(lengths.mean()),
        "max_edge": float(lengths.max()),
    }
    if volume is not None:
        quality["volume_error"] = total / volume - 1.0
    quality["bottom_area"], quality["top_area"] = flat_end_areas(points, cells)
    return quality


def flat_end_areas(points: np.ndarray, cells: np.ndarray) -> tuple[float, float]:
    """Areas (m^2) of the boundary that lie in the planes of the lowest and of the highest z."""
    corner = points[boundary_triangles(cells)]
    areas = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    areas = 0.5 * np.linalg.norm(areas, axis=1)
    low, high = points[:, 2].min(), points[:, 2].max()
    near = 1e-6 * (high - low)
    ends = []
    for level in (low, high):
        ends.append(float(areas[(np.abs(corner[:, :, 2] - level) < near).all(axis=1)].sum()))
    return ends[0], ends[1]


def write_mesh(mesh: TetrahedralMesh, folder: str | Path) -> None:
    """Write ``mesh.h5`` and ``mesh.vtu`` (cell data: scaled shape; m) into an existing folder."""
    import meshio

    folder = Path(folder)
    partial = folder / "mesh.h5.part"
    with h5py.File(partial, "w") as store:
        store.attrs["schema_version"] = SCHEMA_VERSION
        store.attrs["quality"] = json.dumps(mesh.quality)
        points = store.create_dataset("points", data=mesh.points)
        points.attrs["unit"] = "m"
        store.create_dataset("cells", data=mesh.cells)
    os.replace(partial, folder / "mesh.h5")
    partial = folder / "mesh.part.vtu"
    meshio.Mesh(
        mesh.points,
        [("tetra", mesh.cells)],
        cell_data={"scaled_shape": [scaled_shape(mesh.points, mesh.cells)]},
    ).write(partial)
    os.replace(partial, folder / "mesh.vtu")


def read_mesh(folder: str | Path) -> TetrahedralMesh:
    """The mesh that ``write_mesh`` left in a folder."""
    path = Path(folder) / "mesh.h5"
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist: run the geometry stage first.")
    with h5py.File(path, "r") as store:
        version = int(store.attrs.get("schema_version", -1))
        if version != SCHEMA_VERSION:
            raise ValueError(f"schema_version of {path} is {version}: allowed is {SCHEMA_VERSION}.")
        return TetrahedralMesh(
            store["points"][:], store["cells"][:], json.loads(store.attrs["quality"])
        )
