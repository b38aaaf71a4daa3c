"""Small surfaces and files for the tests of geometry and voxels."""

import functools

import numpy as np

_CUBE_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def box(low=(0.0, 0.0, 0.0), high=(1e-3, 1e-3, 1e-3)) -> tuple[np.ndarray, np.ndarray]:
    """Points (8, 3) in m and outward triangles (12, 3) of a box."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    bits = np.array([(k & 1, k >> 1 & 1, k >> 2 & 1) for k in range(8)])
    triangles = [t for a, b, c, d in _CUBE_FACES for t in ((a, b, c), (a, c, d))]
    return low + bits * (high - low), np.array(triangles)


def joined(*surfaces) -> tuple[np.ndarray, np.ndarray]:
    """Several surfaces as one, vertices kept apart."""
    points, triangles, first = [], [], 0
    for p, t in surfaces:
        points.append(p)
        triangles.append(t + first)
        first += len(p)
    return np.concatenate(points), np.concatenate(triangles)


def icosphere(radius: float, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """A ball's surface from an octahedron halved `rounds` times."""
    points = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
    triangles = np.array(
        [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    )
    for _ in range(rounds):
        ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, inverse = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (inverse.reshape(-1, 3) + len(points)).T
        a, b, c = triangles.T
        points = np.concatenate([points, points[edges].sum(axis=1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(q, axis=1) for q in quarters])
    return points * radius, triangles


def write_stl(path, points: np.ndarray, triangles: np.ndarray, unit: float = 1e-3) -> None:
    """Write a binary STL in the given unit (m)."""
    record = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
    rows = np.zeros(len(triangles), record)
    rows["corner"] = points[triangles] / unit
    path.write_bytes(b"\0" * 80 + len(rows).to_bytes(4, "little") + rows.tobytes())


def write_ascii_stl(path, points: np.ndarray, triangles: np.ndarray, unit: float = 1e-3) -> None:
    """Write an ASCII STL in the given unit (m)."""
    lines = ["solid test"]
    for triangle in points[triangles] / unit:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid test", ""]))


@functools.cache
def reference_screw():
    """The solid of the reference screw, built once for all tests."""
    from pipeline.geometry.solids import screw_solid
    from pipeline.scene.screw import ScrewParameters

    return screw_solid(ScrewParameters())


@functools.cache
def coarse_mesh():
    """A coarse mesh of the reference screw."""
    from pipeline.geometry.solids import tetrahedral_mesh

    return tetrahedral_mesh(reference_screw(), 0.3e-3, 0.2e-3)


@functools.cache
def fine_mesh():
    """A fine mesh of the reference screw."""
    from pipeline.geometry.solids import tetrahedral_mesh

    return tetrahedral_mesh(reference_screw(), 0.12e-3, 0.07e-3)


@functools.cache
def body(name: str):
    """A ball, a torus, or a plate with a slot and a hole, from a BREP file (mm)."""
    import tempfile
    from pathlib import Path

    from pipeline.geometry import solids

    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / f"{name}.brep"
        with solids._gmsh_session():
            _draw(solids.occ, name)
            solids.occ.synchronize()
            solids.gmsh.write(str(path))
        return solids.solid_from_file(path)


def _draw(occ, name: str) -> None:
    if name == "ball":
        occ.addSphere(0, 0, 0, 0.6)
    elif name == "torus":
        occ.addTorus(0, 0, 0, 0.7, 0.3)
    else:
        plate = occ.addBox(-0.7, -0.3, 0, 1.4, 0.6, 2.0)
        hole = occ.addCylinder(0, -1, 0.8, 0, 2, 0, 0.3)
        slot = occ.addBox(-0.25, -1, 1.6, 0.5, 2, 1)
        occ.cut([(3, plate)], [(3, hole), (3, slot)])


BODIES = ("ball", "torus", "plate")
