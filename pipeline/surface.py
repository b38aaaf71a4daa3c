"""Closed triangle surfaces and the Solid that carries one. NumPy and Numba only, no CAD."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Solid:
    """One closed solid: measures, CAD data for the mesher, and a fine triangulation.

    volume, area: of the CAD model (m^3, m^2). reference_volume, reference_area: computed without
    it - from the parameters for a screw, from ``points`` and ``triangles`` for a file.
    bounding_box: lowest and highest corner (m). smallest_feature: what a lattice has to resolve
    (m). points (n, 3) in m and triangles (nt, 3), outward, closed: the surface for ray casting.
    cad: the model as BREP text in mm, or "" for a solid known by its triangles only (STL).
    """

    name: str
    volume: float
    area: float
    reference_volume: float
    reference_area: float
    bounding_box: tuple[tuple[float, float, float], tuple[float, float, float]]
    smallest_feature: float
    points: np.ndarray
    triangles: np.ndarray
    cad: str = ""


def surface_volume_and_area(points: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
    """Enclosed volume (m^3, positive for outward triangles) and area (m^2) of a surface."""
    corner = points[triangles] - points.mean(axis=0)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = float(np.einsum("ij,ij->", corner[:, 0], normal)) / 6.0
    return volume, float(np.linalg.norm(normal, axis=1).sum()) / 2.0


def bounding_box(points: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lowest and highest corner of points (n, 3)."""
    return tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())
