"""Closed triangle surfaces: the Solid that carries one, reading STL, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pipeline.geometry.intersections import first_intersection, ray_distances
from pipeline.geometry.voxel_mask import VoxelMask

FEATURE_RAYS = 1000
WALL_SHARE, RIDGE_SHARE = 0.02, 0.25  # of the surface, for smallest_feature


@dataclass(frozen=True)
class Solid:
    """One closed solid: measures, CAD data for the mesher, and a fine triangulation.

    volume, area: of the CAD model (m^3, m^2). reference_volume, reference_area: computed without
    it - from the parameters for a screw, from ``points`` and ``triangles`` for a file, the volume
    of an image's solid from its voxels.
    bounding_box: lowest and highest corner (m). smallest_feature: what a lattice has to resolve
    (m). points (n, 3) in m and triangles (nt, 3), outward, closed: the surface for ray casting.
    cad: the model as BREP text in mm, or "" for a solid known by its triangles only (STL, image).
    voxels, image: of a solid from an image its voxels, and how it was found in the image
    (pipeline.geometry.scans).
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
    voxels: VoxelMask | None = None
    image: dict | None = None


def surface_volume_and_area(points: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
    """Enclosed volume (m^3, positive for outward triangles) and area (m^2) of a surface."""
    corner = points[triangles] - points.mean(axis=0)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = float(np.einsum("ij,ij->", corner[:, 0], normal)) / 6.0
    return volume, float(np.linalg.norm(normal, axis=1).sum()) / 2.0


def bounding_box(points: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lowest and highest corner of points (n, 3)."""
    return tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())


def smallest_feature(points: np.ndarray, triangles: np.ndarray) -> float:
    """Width (m) of the thinnest walls, gaps, ridges and grooves, by rays along the normals.

    From 1000 places spread evenly over the area one ray goes inward and one outward, to the first
    wall that faces it. Where that wall is nearly parallel (within 25 degrees) the way is the width
    of a wall or gap, and the width that 2 % of the surface fall below counts. Otherwise it is a
    ridge or groove, which has every width down to that of its crest, and the width that a quarter
    of the surface falls below counts: 0.199 mm for the reference screw read from a file (P/2
    is 0.200). Smaller details do not count.
    """
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    double_area = np.linalg.norm(normal, axis=1)
    cumulated = np.cumsum(double_area)
    places = (np.arange(FEATURE_RAYS) + 0.5) / FEATURE_RAYS * cumulated[-1]
    chosen = np.searchsorted(cumulated, places)
    # a low-discrepancy place in the triangle, so that few large triangles are sampled all over
    u = np.mod(0.5 + np.arange(FEATURE_RAYS) * 0.7548776662466927, 1.0)
    v = np.mod(0.5 + np.arange(FEATURE_RAYS) * 0.5698402909980532, 1.0)
    outside = u + v > 1.0
    u[outside], v[outside] = 1.0 - u[outside], 1.0 - v[outside]
    p = corner[chosen]
    start = p[:, 0] + u[:, None] * (p[:, 1] - p[:, 0]) + v[:, None] * (p[:, 2] - p[:, 0])
    direction = normal[chosen] / double_area[chosen, None]
    walls = np.full(FEATURE_RAYS, np.inf)
    ridges = np.full(FEATURE_RAYS, np.inf)
    for way in (direction, -direction):
        distance, cosine = ray_distances(points, triangles, start, way)
        parallel = cosine > np.cos(np.radians(25.0))
        walls = np.minimum(walls, np.where(parallel, distance, np.inf))
        ridges = np.minimum(ridges, np.where(parallel, np.inf, distance))
    size = min(_quantile(walls, WALL_SHARE), _quantile(ridges, RIDGE_SHARE))
    extent = points.max(axis=0) - points.min(axis=0)
    return min(size, float(extent.min()))


def _quantile(values: np.ndarray, share: float) -> float:
    return float(np.sort(values)[int(share * len(values))])


def solid_of_surface(name: str, points: np.ndarray, triangles: np.ndarray) -> Solid:
    """The solid inside a checked surface; volume and area are those of the triangles."""
    volume, area = surface_volume_and_area(points, triangles)
    return Solid(
        name=name,
        volume=volume,
        area=area,
        reference_volume=volume,
        reference_area=area,
        bounding_box=bounding_box(points),
        smallest_feature=smallest_feature(points, triangles),
        points=points,
        triangles=triangles,
    )


def check_surface(points: np.ndarray, triangles: np.ndarray, name: str) -> None:
    """Refuse a surface that does not bound one solid; ValueError says in one sentence why.

    Refused are surfaces that are empty, not finite, open, not manifold (an edge of more than two
    triangles, a vertex where two sheets touch), of several bodies, inconsistently oriented,
    inverted, or that cross themselves. Cavities, inner shells that point inward, are allowed.
    """
    if not len(triangles):
        raise ValueError(f"{name} is empty: allowed is one closed surface.")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} has coordinates that are not finite numbers.")
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ends = np.sort(directed, axis=1)
    keys, inverse, counts = np.unique(
        ends[:, 0] * len(points) + ends[:, 1], return_inverse=True, return_counts=True
    )
    edges = np.stack(np.divmod(keys, len(points)), axis=1)
    if (counts > 2).any():
        raise ValueError(
            f"{name} is not manifold: {int((counts > 2).sum())} edges belong to more than two "
            f"triangles, the first near {_place(points, edges[np.argmax(counts > 2)])}."
        )
    if (counts < 2).any():
        raise ValueError(
            f"{name} is open: {int((counts < 2).sum())} edges belong to one triangle only, the "
            f"first near {_place(points, edges[np.argmax(counts < 2)])}."
        )
    forward = np.bincount(inverse.ravel(), weights=directed[:, 0] < directed[:, 1])
    if (forward != 1).any():
        raise ValueError(
            f"{name} is inconsistently oriented: at {int((forward != 1).sum())} edges the two "
            "triangles point to different sides."
        )
    shells = _shells(triangles, inverse.reshape(-1, 3))
    _check_vertices(points, triangles, inverse.reshape(-1, 3), name)
    volumes = _shell_volumes(points, triangles, shells)
    if volumes.sum() <= 0:
        raise ValueError(
            f"{name} is inverted: its triangles point inward (volume {volumes.sum() * 1e9:.4g} "
            "mm^3); allowed is a surface that points outward."
        )
    if (volumes > 0).sum() != 1:
        raise ValueError(f"{name} has {int((volumes > 0).sum())} bodies: allowed is exactly 1.")
    extent = float(np.max(points.max(axis=0) - points.min(axis=0)))
    crossing = first_intersection(points, triangles, 1e-9 * extent)
    if crossing is not None:
        raise ValueError(
            f"{name} crosses itself near {_place(points, triangles[crossing[0]])}: allowed is a "
            "surface whose triangles meet only at shared edges and vertices."
        )


def read_stl(path: Path, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in m and triangles (nt, 3) of an ASCII or binary STL file.

    scale: metres per unit of the file. Equal corners become one point; corners closer than 1e-6
    of the extent too, if the surface is open otherwise. Triangles without area that this leaves
    are dropped. ValueError for a file that is no STL, is cut short, or has other facets than
    triangles. Read here because meshio 5.3 takes a binary file that was cut short for an empty
    surface, cuts the corners of quadrilaterals into wrong triangles, ends the process on a file of
    another format, and refuses keywords in capitals (tests/pipeline/geometry/test_stl_files.py).
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        record = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
        corner = np.frombuffer(data, record, count, 84)["corner"].astype(float)
    else:
        corner = _ascii_corners(data, path)
    corner = corner.reshape(-1, 3) * scale
    if not np.isfinite(corner).all():
        raise ValueError(f"{path.name} has coordinates that are not finite numbers.")
    if not len(corner):
        return corner, np.zeros((0, 3), dtype=np.int64)
    points, index = np.unique(corner, axis=0, return_inverse=True)
    triangles = _without_degenerate(index.reshape(-1, 3))
    if _open_edges(triangles):
        extent = float(np.max(points.max(axis=0) - points.min(axis=0)))
        pairs = cKDTree(points).query_pairs(1e-6 * extent, output_type="ndarray")
        ones = np.ones(len(pairs))
        joined = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        _, label = connected_components(joined, directed=False)
        first = np.unique(label, return_index=True)[1]
        points, triangles = points[first], _without_degenerate(label[triangles])
    return points, triangles


def _ascii_corners(data: bytes, path: Path) -> np.ndarray:
    lines = data.decode("ascii", errors="replace").split("\n")
    if not lines[0].strip().lower().startswith("solid"):
        raise ValueError(f"{path.name} is no STL file: neither binary of the right size nor ASCII.")
    words = [line.split() for line in lines]
    try:
        corner = np.array([w[1:4] for w in words if w and w[0].lower() == "vertex"], dtype=float)
    except ValueError as error:
        raise ValueError(f"{path.name} has a vertex that is not three numbers.") from error
    facets = sum(1 for w in words if w and w[0].lower() == "endfacet")
    if corner.size != 9 * facets:
        raise ValueError(
            f"{path.name} has {corner.size // 3} vertices in {facets} facets: allowed are three in "
            "each, so it is cut short or has facets that are not triangles."
        )
    return corner


def _without_degenerate(triangles: np.ndarray) -> np.ndarray:
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _open_edges(triangles: np.ndarray) -> bool:
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(ends.max()) + 1) + ends[:, 1]
    return bool((np.unique(keys, return_counts=True)[1] < 2).any())


def _shells(triangles: np.ndarray, edge_of: np.ndarray) -> np.ndarray:
    """Number of the connected shell of each triangle; edge_of (nt, 3) are edge numbers."""
    order = np.argsort(edge_of.ravel(), kind="stable")
    pairs = (order // 3).reshape(-1, 2)
    size = len(triangles)
    joined = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return connected_components(joined, directed=False)[1]


def _shell_volumes(points: np.ndarray, triangles: np.ndarray, shells: np.ndarray) -> np.ndarray:
    corner = points[triangles] - points.mean(axis=0)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.bincount(shells, weights=np.einsum("ij,ij->i", corner[:, 0], normal)) / 6.0


def _check_vertices(
    points: np.ndarray, triangles: np.ndarray, edge_of: np.ndarray, name: str
) -> None:
    """Refuse vertices at which more than one fan of triangles meets."""
    corners = triangles.ravel()
    # corner 3 t + a lies on the edges a (a, a + 1) and a - 1 of its triangle
    ends = np.stack(
        [3 * np.arange(len(triangles))[:, None] + a for a in ((0, 1), (1, 2), (2, 0))], 1
    )
    order = np.argsort(edge_of.ravel(), kind="stable").reshape(-1, 2)
    first, second = ends.reshape(-1, 2)[order[:, 0]], ends.reshape(-1, 2)[order[:, 1]][:, ::-1]
    rows, columns = first.ravel(), second.ravel()  # opposite directions, so ends correspond
    size = len(corners)
    joined = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    fans = connected_components(joined, directed=False)[1]
    owner = np.full(fans.max() + 1, -1)
    owner[fans] = corners
    counts = np.bincount(owner, minlength=len(points))
    if (counts > 1).any():
        where = _place(points, np.array([int(np.argmax(counts > 1))]))
        raise ValueError(
            f"{name} is not manifold: at {int((counts > 1).sum())} vertices separate sheets "
            f"touch, the first near {where}."
        )


def _place(points: np.ndarray, indices: np.ndarray) -> str:
    x, y, z = points[indices].mean(axis=0) * 1e3
    return f"({x:.4g}, {y:.4g}, {z:.4g}) mm"
