"""Solids and tetrahedral meshes by gmsh and OpenCASCADE (mesh_sizes: how large the cells are).

The CAD model is in mm (OpenCASCADE's tolerances suit that); everything handed out is in m.
"""

from __future__ import annotations

import logging
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gmsh
import numpy as np

from pipeline.geometry.mesh import TetrahedralMesh, cell_volumes, mesh_quality
from pipeline.geometry.mesh_sizes import set_sizes
from pipeline.geometry.patches import load_patches
from pipeline.geometry.surface import (
    Solid,
    bounding_box,
    check_surface,
    read_stl,
    smallest_feature,
    solid_of_surface,
    surface_volume_and_area,
)
from pipeline.geometry.thread import (
    MM,
    HelixTurn,
    ProfilePiece,
    helix_turn,
    line_piece,
    multiplicities,
    profile_pieces,
    seam_angle,
)
from pipeline.geometry.true_volume import with_true_volume
from pipeline.scene.screw import ScrewParameters, reference_volume_and_area
from pipeline.scene.units import metres

__all__ = [
    "ScrewParameters",
    "Solid",
    "TetrahedralMesh",
    "contains",
    "screw_solid",
    "solid_from_file",
    "tetrahedral_mesh",
    "write_cad",
]

logger = logging.getLogger(__name__)
occ = gmsh.model.occ

STEP, BREP, STL = (".step", ".stp"), (".brep", ".brp"), (".stl",)
STL_EDGE_ANGLE = math.radians(25.0)  # between triangles, from where on an edge of an STL is sharp

# (2D algorithm, 3D algorithm, factor on both sizes): frontal 6, Delaunay 5; HXT 10, Delaunay 1
MESH_ATTEMPTS = ((6, 10, 1.0), (6, 1, 1.0), (5, 10, 0.95), (6, 10, 0.9), (5, 1, 0.85))


@contextmanager
def _gmsh_session() -> Iterator[None]:
    """A gmsh of our own: quiet, one thread (so that a mesh is the same every time), then closed."""
    if gmsh.isInitialized():
        raise RuntimeError("gmsh is already in use in this process; finish that work first.")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        yield
    finally:
        gmsh.finalize()


@contextmanager
def _silent_stdout() -> Iterator[None]:
    """OpenCASCADE's readers and writers print past every option; send that nowhere."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def screw_solid(screw: ScrewParameters) -> Solid:
    """The solid of a screw, its thread truly modelled.

    The helical thread is built from exact pieces: crest, flanks and root are helical B-spline
    surfaces, knots in mm along profile and helix, one turn long and repeated with the pitch past
    both ends; caps close them to a body, of which the slab 0 <= z <= length is kept and the slot
    is cut. Grooves are the same profile revolved.
    """
    with _gmsh_session():
        if screw.thread == "none":
            radius = screw.pin_diameter / 2 * MM
            body = (3, occ.addCylinder(0, 0, 0, 0, 0, screw.length * MM, radius))
        else:
            build = _helical_body if screw.thread == "helical" else _grooved_body
            body = build(screw)
            wide = screw.diameter * MM
            slab = (3, occ.addBox(-wide, -wide, 0, 2 * wide, 2 * wide, screw.length * MM))
            body = _one_volume(occ.intersect([body], [slab])[0], "thread")
        if screw.has_slot:
            wide, width, depth = screw.diameter * MM, screw.slot_width * MM, screw.slot_depth * MM
            floor = screw.length * MM - depth
            slot = (3, occ.addBox(-wide, -width / 2, floor, 2 * wide, width, depth + wide))
            body = _one_volume(occ.cut([body], [slot])[0], "slot")
        name = f"screw M{screw.diameter * MM:g} x {screw.length * MM:g} mm"
        return _finished_solid(name, body, reference_volume_and_area(screw), screw.smallest_feature)


def solid_from_file(path: str | Path, unit: str = "mm") -> Solid:
    """The one closed solid of a STEP, BREP or STL file.

    unit: of the numbers in a BREP or STL file (m, cm, mm, um, nm, inch). A STEP file carries its
    own unit and is converted; any other ``unit`` than mm is refused for it. Raises
    FileNotFoundError, or ValueError for another suffix, an unknown unit, a file that cannot be
    read, and surfaces that are empty, open, not manifold, inverted, of several bodies, or that
    cross themselves.
    """
    path = Path(path)
    scale = metres(1.0, unit, "solid")
    kind = path.suffix.lower()
    if kind not in (*STEP, *BREP, *STL):
        allowed = ", ".join((*STEP, *BREP, *STL))
        raise ValueError(f"solid is {path.name!r}: allowed are files that end in {allowed}.")
    if not path.is_file():
        raise FileNotFoundError(
            f"solid {path} does not exist: allowed is a STEP, BREP or STL file."
        )
    if kind in STEP and unit != "mm":
        raise ValueError(f"unit is {unit!r}: a STEP file carries its own unit, allowed is mm.")
    if kind in STL:
        points, triangles = read_stl(path, scale)
        check_surface(points, triangles, path.name)
        return solid_of_surface(path.name, points, triangles)
    with _gmsh_session():
        gmsh.option.setNumber("Geometry.OCCScaling", scale * MM)
        try:
            with _silent_stdout():
                shapes = occ.importShapes(str(path))
        except Exception as error:
            raise ValueError(
                f"{path.name} cannot be read as {kind[1:].upper()}: {error}"
            ) from error
        finally:
            gmsh.option.setNumber("Geometry.OCCScaling", 1.0)
        volumes = [shape for shape in shapes if shape[0] == 3]
        if len(volumes) != 1:
            why = "it cannot be read or its surface is open" if not volumes else "allowed is 1"
            raise ValueError(f"{path.name} holds {len(volumes)} solids: {why}.")
        occ.synchronize()
        if occ.getMass(*volumes[0]) <= 0:
            raise ValueError(f"{path.name} is inverted: the volume of its solid is not positive.")
        solid = _finished_solid(path.name, volumes[0])
    check_surface(solid.points, solid.triangles, solid.name)
    return solid


def write_cad(solid: Solid, path: str | Path) -> None:
    """Write a solid's CAD model as STEP or BREP (mm), by the suffix of the path.

    Raises ValueError for a solid without CAD model (STL) or another suffix.
    """
    path = Path(path)
    if not solid.cad:
        raise ValueError(f"{solid.name} has no CAD model: allowed are screws, STEP and BREP.")
    if path.suffix.lower() not in (*STEP, *BREP):
        allowed = ", ".join((*STEP, *BREP))
        raise ValueError(f"path is {path.name!r}: allowed are files that end in {allowed}.")
    with _gmsh_session(), tempfile.TemporaryDirectory(dir=path.parent) as folder:
        _load_cad(solid.cad)
        with _silent_stdout():
            gmsh.write(str(Path(folder) / path.name))
        os.replace(Path(folder) / path.name, path)


def contains(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Which of the points (n, 3) in m lie inside, by OpenCASCADE's classifier (slow; for checks).

    Raises ValueError for a solid without CAD model (STL).
    """
    if not solid.cad:
        raise ValueError(f"{solid.name} has no CAD model: allowed are screws, STEP and BREP.")
    with _gmsh_session():
        volume = _load_cad(solid.cad)
        inside = np.empty(len(points), dtype=bool)
        for k, point in enumerate(np.asarray(points, dtype=float) * MM):
            inside[k] = gmsh.model.isInside(3, volume, point.tolist()) > 0
        return inside


def tetrahedral_mesh(
    solid: Solid,
    size: float,
    size_fine: float | None = None,
    size_ends: tuple[float | None, float | None] = (None, None),
) -> TetrahedralMesh:
    """Tetrahedra of edge length ``size`` (m) inside and ``size_fine`` along thread and slot.

    ``size_fine`` (default: half of ``size``) holds on the sharp edges of the solid - the helices
    of a thread, the outline of slot and end faces - and grows to ``size`` over 2 ``size``; on a
    solid without sharp edges, as one from an image, it holds on the whole surface;
    ``size_ends`` likewise within two of these lengths of the lowest and of the highest z (None:
    nothing is refined there). Straight edges, nodes exactly on the end planes. Attempts with other
    algorithms and slightly other sizes follow if gmsh fails. ValueError for sizes out of range or
    where no attempt works.
    """
    if size_fine is None:
        size_fine = size / 2
    extent = float(np.max(np.subtract(solid.bounding_box[1], solid.bounding_box[0])))
    levels = [corner[2] for corner in solid.bounding_box]
    smaller = zip(("fine", "bottom", "top"), (size_fine, *size_ends), strict=True)
    smaller = {f"{name} mesh size": value for name, value in smaller if value is not None}
    for name, value in {"mesh size": size, **smaller}.items():
        if not extent / 1000 <= value <= extent:
            raise ValueError(
                f"{name} is {value * MM:.6g} mm: allowed are {extent / 1000 * MM:.6g} "
                f"to {extent * MM:.6g} mm."
            )
        if value > size:
            raise ValueError(
                f"{name} is {value * MM:.6g} mm: allowed is at most the mesh size, "
                f"{size * MM:.6g} mm."
            )
    reasons = []
    for plane, space, factor in MESH_ATTEMPTS:
        try:
            with _gmsh_session():
                edges = _load_solid(solid)
                scale = factor * MM
                set_sizes(
                    size * scale,
                    size_fine * scale,
                    [
                        (z * MM, end * scale)
                        for z, end in zip(levels, size_ends, strict=True)
                        if end
                    ],
                    edges,
                )
                points, cells = _mesh_model(plane, space)
        except (MemoryError, RuntimeError):
            raise
        except Exception as error:  # gmsh raises nothing more specific
            reasons.append(str(error).strip().split("\n")[0])
            logger.info("mesh attempt failed: %s", reasons[-1])
            continue
        points = with_true_volume(points, cells, solid.points, solid.triangles)
        quality = mesh_quality(points, cells, solid.volume)
        if quality["min_cell_volume"] > 0 and abs(quality["volume_error"]) < 0.1:
            quality |= {"size": size, "size_fine": size_fine, "size_factor": factor}
            quality["size_ends"] = list(size_ends)
            return TetrahedralMesh(points, cells, quality)
        reasons.append(f"volume off by {quality['volume_error']:.1%}")
    raise ValueError(f"mesh size is {size * MM:.6g} mm: no mesh of {solid.name} ({reasons[-1]}).")


def _mesh_model(plane: int, space: int) -> tuple[np.ndarray, np.ndarray]:
    """Mesh the loaded model with the sizes that were set; points in m, cells."""
    option = gmsh.option.setNumber
    option("Mesh.Algorithm", plane)
    option("Mesh.Algorithm3D", space)
    gmsh.model.mesh.generate(3)
    points, index = _nodes()
    corner = gmsh.model.mesh.getElementsByType(4)[1]
    if not len(corner):
        raise ValueError("gmsh made no tetrahedra")
    cells = index[corner.astype(np.int64)].reshape(-1, 4)
    points, cells = _used_only(points, cells)
    for level in (points[:, 2].min(), points[:, 2].max()):
        near = np.abs(points[:, 2] - level) < 1e-8 * np.ptp(points[:, 2])
        points[near, 2] = round(level, 12)  # the ends are planes to the last digit
    turned = cell_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    return points, cells


def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """All nodes (n, 3) in m, and the row of each gmsh node tag."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    tags = tags.astype(np.int64)
    index = np.full(int(tags.max()) + 1, -1)
    index[tags] = np.arange(len(tags))
    return coordinates.reshape(-1, 3) / MM, index


def _finished_solid(
    name: str,
    body: tuple[int, int],
    reference: tuple[float, float] | None = None,
    feature: float | None = None,
) -> Solid:
    """Measure, triangulate and store the one solid that the model is to hold."""
    occ.synchronize()
    keep = set(gmsh.model.getBoundary([body], oriented=False))
    occ.remove([e for e in occ.getEntities(2) if e not in keep], recursive=True)
    occ.synchronize()
    volume = occ.getMass(*body) / MM**3
    area = sum(occ.getMass(*face) for face in keep) / MM**2
    cad = _save_cad()
    points, triangles = _triangulate(body, feature)
    measured = surface_volume_and_area(points, triangles)
    return Solid(
        name=name,
        volume=volume,
        area=area,
        reference_volume=(reference or measured)[0],
        reference_area=(reference or measured)[1],
        bounding_box=bounding_box(points),
        smallest_feature=feature or smallest_feature(points, triangles),
        points=points,
        triangles=triangles,
        cad=cad,
    )


def _triangulate(body: tuple[int, int], feature: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Fine triangulation of the loaded model: points in m, outward triangles."""
    option = gmsh.option.setNumber
    corners = np.array(gmsh.model.getBoundingBox(*body))
    extent = float(np.max(corners[3:] - corners[:3]))
    size = extent / 60 if feature is None else min(feature / 3 * MM, extent / 60)
    option("Mesh.MeshSizeFromCurvature", 14)
    option("Mesh.MeshSizeMax", size)
    option("Mesh.MeshSizeMin", size / 8)
    option("Mesh.Algorithm", 5)
    option("Mesh.Smoothing", 0)  # the shape of these triangles does not matter
    gmsh.model.mesh.generate(2)
    points, index = _nodes()
    triangles = index[gmsh.model.mesh.getElementsByType(2)[1].astype(np.int64)].reshape(-1, 3)
    return _used_only(points, triangles)


def _used_only(points: np.ndarray, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, elements = np.unique(elements, return_inverse=True), elements.shape
    return points[used[0]], used[1].reshape(elements)


def _save_cad() -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "solid.brep"
        gmsh.write(str(path))
        return path.read_text()


def _load_cad(cad: str) -> int:
    """Load BREP text (mm) as the model; the tag of its volume."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "solid.brep"
        path.write_text(cad)
        shapes = occ.importShapes(str(path))
    occ.synchronize()
    return _one_volume(shapes, "model")[1]


def _load_solid(solid: Solid) -> list[int]:
    """Load a solid's CAD model, or make a model of the patches of its triangles.

    Returns the model's curves along sharp edges; of a solid from an image, none.
    """
    if solid.cad:
        _load_cad(solid.cad)
        return [tag for _, tag in gmsh.model.getEntities(1)]
    sharp = math.pi if solid.voxels is not None else STL_EDGE_ANGLE
    edges = load_patches(solid.points * MM, solid.triangles, sharp)
    loop = gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])
    gmsh.model.geo.addVolume([loop])
    gmsh.model.geo.synchronize()
    return edges


def _one_volume(shapes: list[tuple[int, int]], what: str) -> tuple[int, int]:
    volumes = [shape for shape in shapes if shape[0] == 3]
    if len(volumes) != 1:
        raise ValueError(f"{what} leaves {len(volumes)} solids: allowed is exactly 1.")
    return volumes[0]


# --- the bodies of threads, in mm ---------------------------------------------------------------


def _helical_body(screw: ScrewParameters) -> tuple[int, int]:
    """The threaded body from below z = 0 to above z = length, as one volume."""
    pitch, length = screw.pitch * MM, screw.length * MM
    crest, outer = screw.crest_width / 2 * MM, screw.diameter / 2 * MM
    seam = seam_angle(screw)
    rise = pitch / (2 * math.pi)
    turn = helix_turn(seam)
    # the crest's middle is at crest_height for angle 0, so at the seam it is higher by its rise
    at_seam = screw.crest_height * MM + rise * seam
    bottom = at_seam - math.ceil((at_seam + 2.2 * pitch) / pitch) * pitch
    turns = math.ceil((length + 1.2 * pitch - bottom) / pitch)
    pieces = profile_pieces(screw)
    first = [_helicoid(turn, piece, bottom, rise) for piece in pieces]
    faces = list(first)
    for k in range(1, turns):
        copied = occ.copy(first)
        occ.translate(copied, 0, 0, k * pitch)
        faces += copied
    radial = line_piece(0.0, 0.0, 0.0, outer)
    for level in (bottom, bottom + turns * pitch):
        faces.append(_helicoid(turn, radial, level - crest, rise))
        faces.append(_meridian_face(pieces, seam, level, crest, pitch, outer))
    loop = occ.addSurfaceLoop([tag for _, tag in faces], sewing=True)
    return (3, occ.addVolume([loop]))


def _helicoid(turn: HelixTurn, piece: ProfilePiece, height: float, rise: float) -> tuple[int, int]:
    """The B-spline surface that a piece of the profile sweeps in one turn."""
    poles = [
        occ.addPoint(r * c, r * s, height + h + rise * angle)
        for c, s, angle in zip(turn.cosine, turn.sine, turn.angles, strict=True)
        for r, h in zip(piece.radii, piece.heights, strict=True)
    ]
    across, times_across = multiplicities(piece.knots)
    along, times_along = multiplicities(turn.knots * math.hypot(float(piece.radii.mean()), rise))
    surface = occ.addBSplineSurface(
        poles,
        len(piece.radii),
        degreeU=piece.degree,
        degreeV=3,
        knotsU=across,
        multiplicitiesU=times_across,
        knotsV=along,
        multiplicitiesV=times_along,
    )
    return (2, surface)


def _meridian_face(
    pieces: list[ProfilePiece], angle: float, level: float, crest: float, pitch: float, outer: float
) -> tuple[int, int]:
    """The plane face between the axis and one pitch of the profile, at an angle."""
    c, s = math.cos(angle), math.sin(angle)

    def point(radius: float, height: float) -> int:
        return occ.addPoint(radius * c, radius * s, height)

    curves = []
    for piece in pieces:
        poles = [point(r, level + h) for r, h in zip(piece.radii, piece.heights, strict=True)]
        curves.append(_profile_curve(piece, poles))
    low, high = level - crest, level - crest + pitch
    axis = point(0.0, low), point(0.0, high)
    rim = point(outer, low), point(outer, high)
    curves = [occ.addLine(axis[0], rim[0]), *curves]
    curves += [occ.addLine(rim[1], axis[1]), occ.addLine(axis[1], axis[0])]
    return (2, occ.addPlaneSurface([occ.addWire(curves)]))


def _profile_curve(piece: ProfilePiece, poles: list[int]) -> int:
    if piece.degree == 1:
        return occ.addLine(*poles)
    knots, times = multiplicities(piece.knots)
    return occ.addBSpline(poles, degree=piece.degree, knots=knots, multiplicities=times)


def _grooved_body(screw: ScrewParameters) -> tuple[int, int]:
    """The profile revolved, from below z = 0 to above z = length, as one volume."""
    pitch, length = screw.pitch * MM, screw.length * MM
    crest, outer = screw.crest_width / 2 * MM, screw.diameter / 2 * MM
    bottom = screw.crest_height * MM
    bottom -= math.ceil((bottom + 0.2 * pitch) / pitch) * pitch
    count = math.ceil((length + 0.2 * pitch - bottom) / pitch)
    first = last = occ.addPoint(outer, 0, bottom - crest)
    curves = []
    for k in range(count):
        for piece in profile_pieces(screw):
            rest = zip(piece.radii[1:], piece.heights[1:], strict=True)
            poles = [last, *(occ.addPoint(r, 0, bottom + k * pitch + h) for r, h in rest)]
            curves.append(_profile_curve(piece, poles))
            last = poles[-1]
    axis = [occ.addPoint(0, 0, z) for z in (bottom - crest, bottom - crest + count * pitch)]
    curves += [occ.addLine(last, axis[1]), occ.addLine(axis[1], axis[0])]
    curves.append(occ.addLine(axis[0], first))
    face = occ.addPlaneSurface([occ.addWire(curves)])
    made = occ.revolve([(2, face)], 0, 0, 0, 0, 0, 1, 2 * math.pi)
    return _one_volume(made, "grooves")
