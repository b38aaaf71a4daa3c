"""Solids and tetrahedral meshes by gmsh and OpenCASCADE: the only file that imports gmsh.

The CAD model is in mm (OpenCASCADE's tolerances suit that); everything handed out is in m.
"""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gmsh
import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from pipeline.mesh import TetrahedralMesh, cell_volumes, mesh_quality, read_mesh, write_mesh
from pipeline.screw import ScrewParameters, reference_volume_and_area
from pipeline.surface import Solid, bounding_box, surface_volume_and_area

__all__ = [
    "ScrewParameters",
    "Solid",
    "TetrahedralMesh",
    "contains",
    "read_mesh",
    "screw_solid",
    "tetrahedral_mesh",
    "write_mesh",
]

logger = logging.getLogger(__name__)

MM = 1e3  # model units per m
_TURN_INTERVALS = 24  # cubic pieces per turn: the helix is off by 1e-5 of its radius at most
_ROOT_INTERVALS = 4  # per half of the root


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


def screw_solid(parameters: ScrewParameters) -> Solid:
    """The solid of a screw, its thread truly modelled.

    The helical thread is built from exact pieces: crest, flanks and root are helical B-spline
    surfaces, knots in mm along profile and helix, one turn long and repeated with the pitch past
    both ends; caps close them to a body, of which the slab 0 <= z <= length is kept and the slot
    is cut. Grooves are the same profile revolved.
    """
    with _gmsh_session():
        occ = gmsh.model.occ
        screw = parameters
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
            wide, width, depth = (
                v * MM for v in (screw.diameter, screw.slot_width, screw.slot_depth)
            )
            floor = screw.length * MM - depth
            slot = (3, occ.addBox(-wide, -width / 2, floor, 2 * wide, width, depth + wide))
            body = _one_volume(occ.cut([body], [slot])[0], "slot")
        name = f"screw M{parameters.diameter * MM:g} x {parameters.length * MM:g} mm"
        reference = reference_volume_and_area(parameters)
        return _finished_solid(name, body, reference, parameters.smallest_feature)


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
    solid: Solid, size: float, size_fine: float | None = None
) -> TetrahedralMesh:
    """Tetrahedra of edge length ``size`` (m) inside and ``size_fine`` along thread and slot.

    ``size_fine`` (default: half of ``size``) holds on the sharp edges of the solid - the helices
    of a thread, the outline of slot and end faces - and grows to ``size`` over 2 ``size``.
    Straight edges, nodes exactly on the end planes. Attempts with other algorithms and slightly
    other sizes follow if gmsh fails. ValueError for sizes out of range or where no attempt works.
    """
    if size_fine is None:
        size_fine = size / 2
    extent = float(np.max(np.subtract(solid.bounding_box[1], solid.bounding_box[0])))
    for name, value in (("mesh size", size), ("fine mesh size", size_fine)):
        if not extent / 1000 <= value <= extent:
            raise ValueError(
                f"{name} is {value * MM:.6g} mm: allowed are {extent / 1000 * MM:.6g} "
                f"to {extent * MM:.6g} mm."
            )
    if size_fine > size:
        raise ValueError(
            f"fine mesh size is {size_fine * MM:.6g} mm: allowed is at most the mesh size, "
            f"{size * MM:.6g} mm."
        )
    reasons = []
    # (2D algorithm, 3D algorithm, factor on both sizes): frontal 6, Delaunay 5; HXT 10, Delaunay 1
    for plane, space, factor in ((6, 10, 1.0), (6, 1, 1.0), (5, 10, 0.95), (6, 10, 0.9), (5, 1, 0.85)):
        try:
            with _gmsh_session():
                _load_cad(solid.cad)
                points, cells = _mesh_model(size * factor * MM, size_fine * factor * MM, plane, space)
        except Exception as error:
            reasons.append(str(error).strip())
            logger.info("mesh attempt failed: %s", reasons[-1])
            continue
        quality = mesh_quality(points, cells, solid.volume)
        if quality["min_cell_volume"] > 0 and abs(quality["volume_error"]) < 0.1:
            quality |= {"size": size, "size_fine": size_fine, "size_factor": factor}
            return TetrahedralMesh(points, cells, quality)
        reasons.append(f"volume off by {quality['volume_error']:.1%}")
    raise ValueError(f"mesh size is {size * MM:.6g} mm: no mesh of {solid.name} ({reasons[-1]}).")


def _mesh_model(
    size: float, size_fine: float, plane: int, space: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mesh the loaded model (sizes in mm); points in m, cells."""
    _size_field(size, size_fine)
    option = gmsh.option.setNumber
    option("Mesh.Algorithm", plane)
    option("Mesh.Algorithm3D", space)
    gmsh.model.mesh.generate(3)
    points, index = _nodes()
    corner = gmsh.model.mesh.getElementsByType(4)[1]
    if not len(corner):
        raise RuntimeError("gmsh made no tetrahedra")
    cells = index[corner.astype(np.int64)].reshape(-1, 4)
    used = np.unique(cells)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    points, cells = points[used], renumber[cells]
    turned = cell_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    return points, cells


def _size_field(size: float, size_fine: float) -> None:
    """Cell size by the distance to the sharp edges of the model (mm)."""
    option = gmsh.option.setNumber
    for name in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        option(f"Mesh.MeshSize{name}", 0)
    if size_fine >= size:
        option("Mesh.MeshSizeMax", size)
        return
    field = gmsh.model.mesh.field
    distance = field.add("Distance")
    edges = [tag for _, tag in gmsh.model.getEntities(1)]
    longest = max(gmsh.model.occ.getMass(1, tag) for tag in edges)
    field.setNumbers(distance, "CurvesList", edges)
    field.setNumber(distance, "Sampling", max(20, min(2000, math.ceil(2 * longest / size_fine))))
    grow = field.add("Threshold")
    field.setNumber(grow, "InField", distance)
    field.setNumber(grow, "SizeMin", size_fine)
    field.setNumber(grow, "SizeMax", size)
    field.setNumber(grow, "DistMin", 0.5 * size_fine)
    field.setNumber(grow, "DistMax", 2 * size)
    field.setAsBackgroundMesh(grow)


def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """All nodes (n, 3) in m, and the row of each gmsh node tag."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    tags = tags.astype(np.int64)
    index = np.full(int(tags.max()) + 1, -1)
    index[tags] = np.arange(len(tags))
    return coordinates.reshape(-1, 3) / MM, index


def _finished_solid(
    name: str, body: tuple[int, int], reference: tuple[float, float] | None, feature: float | None
) -> Solid:
    """Measure, triangulate and store the one solid that the model is to hold."""
    occ = gmsh.model.occ
    occ.synchronize()
    keep = set(gmsh.model.getBoundary([body], oriented=False))
    occ.remove([e for e in occ.getEntities(2) if e not in keep], recursive=True)
    occ.synchronize()
    volume = occ.getMass(*body) / MM**3
    area = sum(occ.getMass(*face) for face in keep) / MM**2
    cad = _save_cad()
    points, triangles = _triangulate(feature, body)
    measured = surface_volume_and_area(points, triangles)
    return Solid(
        name=name,
        volume=volume,
        area=area,
        reference_volume=(reference or measured)[0],
        reference_area=(reference or measured)[1],
        bounding_box=bounding_box(points),
        smallest_feature=feature,
        points=points,
        triangles=triangles,
        cad=cad,
    )


def _triangulate(feature: float, body: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Fine triangulation of the loaded model: points in m, outward triangles."""
    option = gmsh.option.setNumber
    corners = np.array(gmsh.model.getBoundingBox(*body))
    extent = float(np.max(corners[3:] - corners[:3]))
    size = min(feature / 3 * MM, extent / 60)
    option("Mesh.MeshSizeFromCurvature", 18)
    option("Mesh.MeshSizeMax", size)
    option("Mesh.MeshSizeMin", size / 8)
    option("Mesh.Algorithm", 6)
    gmsh.model.mesh.generate(2)
    points, index = _nodes()
    triangles = index[gmsh.model.mesh.getElementsByType(2)[1].astype(np.int64)].reshape(-1, 3)
    used = np.unique(triangles)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    return points[used], renumber[triangles]


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
        shapes = gmsh.model.occ.importShapes(str(path))
    gmsh.model.occ.synchronize()
    return _one_volume(shapes, "model")[1]


def _one_volume(shapes: list[tuple[int, int]], what: str) -> tuple[int, int]:
    volumes = [shape for shape in shapes if shape[0] == 3]
    if len(volumes) != 1:
        raise ValueError(f"{what} leaves {len(volumes)} solids: allowed is exactly 1.")
    return volumes[0]


# --- the bodies of threads, in mm ---------------------------------------------------------------


def _profile(screw: ScrewParameters) -> list[tuple[np.ndarray, int, np.ndarray, np.ndarray]]:
    """Crest, flank, two halves of the root, flank of one pitch from u = -crest/2, as B-splines.

    The root is halved so that meshes have nodes on its bottom; a chord across the whole root
    would add 1 % to the volume. Each piece is (knots in mm of arc length, degree, radii of the poles, axial distances of the poles).
    """
    half, flank, pitch = (
        v * MM for v in (screw.crest_width / 2, screw.flank_width, screw.pitch)
    )
    outer, inner = screw.diameter / 2 * MM, screw.minor_diameter / 2 * MM

    def line(u0: float, u1: float, r0: float, r1: float):
        length = math.hypot(u1 - u0, r1 - r0)
        return np.array([0.0, 0.0, length, length]), 1, np.array([r0, r1]), np.array([u0, u1])

    middle = pitch / 2
    if screw.root_depth == 0.0:
        halves = [
            line(half + flank, middle, inner, inner),
            line(middle, pitch - half - flank, inner, inner),
        ]
    else:
        radius = screw.root_radius * MM
        centre = screw.root_diameter / 2 * MM + radius
        angle = math.asin(screw.root_width * MM / 2 / radius)

        def arc(start: float, end: float):
            sine, cosine = _sine_and_cosine(start, end, _ROOT_INTERVALS)
            knots = (sine.t - start) * radius
            return knots, 3, centre - radius * cosine.c, middle + radius * sine.c

        halves = [arc(-angle, 0.0), arc(0.0, angle)]
    return [
        line(-half, half, outer, outer),
        line(half, half + flank, outer, inner),
        *halves,
        line(pitch - half - flank, pitch - half, inner, outer),
    ]


def _sine_and_cosine(start: float, end: float, intervals: int) -> tuple[BSpline, BSpline]:
    """Cubic splines through sine and cosine, end slopes exact."""
    angle = np.linspace(start, end, intervals + 1)

    def spline(values: np.ndarray, slope_start: float, slope_end: float) -> BSpline:
        ends = ([(1, slope_start)], [(1, slope_end)])
        return make_interp_spline(angle, values, k=3, bc_type=ends)

    sine = spline(np.sin(angle), math.cos(start), math.cos(end))
    cosine = spline(np.cos(angle), -math.sin(start), -math.sin(end))
    return sine, cosine


def _multiplicities(knots: np.ndarray) -> tuple[list[float], list[int]]:
    values, counts = np.unique(np.round(knots, 12), return_counts=True)
    return values.tolist(), counts.tolist()


def _helical_body(screw: ScrewParameters) -> tuple[int, int]:
    """The threaded body from below z = 0 to above z = length, as one volume."""
    occ = gmsh.model.occ
    pitch, length = screw.pitch * MM, screw.length * MM
    crest, outer = screw.crest_width / 2 * MM, screw.diameter / 2 * MM
    seam = _seam_angle(screw)
    sine, cosine = _sine_and_cosine(seam, seam + 2 * math.pi, _TURN_INTERVALS)
    angle_knots = cosine.t - seam
    angles = np.array([angle_knots[k + 1 : k + 4].mean() for k in range(len(cosine.c))])
    rise = pitch / (2 * math.pi)

    def helicoid(knots: np.ndarray, degree: int, radii: np.ndarray, heights: np.ndarray):
        along = angle_knots * math.hypot(float(np.mean(radii)), rise)
        poles = [
            occ.addPoint(radius * c, radius * s, height + rise * angle)
            for c, s, angle in zip(cosine.c, sine.c, angles, strict=True)
            for radius, height in zip(radii, heights, strict=True)
        ]
        knots_u, times_u = _multiplicities(knots)
        knots_v, times_v = _multiplicities(along)
        surface = occ.addBSplineSurface(
            poles, len(radii), degreeU=degree, degreeV=3,
            knotsU=knots_u, multiplicitiesU=times_u, knotsV=knots_v, multiplicitiesV=times_v,
        )  # fmt: skip
        return (2, surface)

    # the crest's middle is at crest_height for angle 0, so at the seam it is higher by its rise
    at_seam = screw.crest_height * MM + rise * seam
    bottom = at_seam - math.ceil((at_seam + 2.2 * pitch) / pitch) * pitch
    turns = math.ceil((length + 1.2 * pitch - bottom) / pitch)
    profile = _profile(screw)
    turn = [
        helicoid(knots, degree, radii, bottom + heights) for knots, degree, radii, heights in profile
    ]
    faces = list(turn)
    for k in range(1, turns):
        copied = occ.copy(turn)
        occ.translate(copied, 0, 0, k * pitch)
        faces += copied
    for level in (bottom, bottom + turns * pitch):
        ends = np.array([0.0, 0.0, outer, outer])
        low = np.full(2, level - crest)
        faces.append(helicoid(ends, 1, np.array([0.0, outer]), low))
        faces.append(_meridian_face(profile, seam, level, crest, pitch, outer))
    loop = occ.addSurfaceLoop([tag for _, tag in faces], sewing=True)
    return (3, occ.addVolume([loop]))


def _meridian_face(
    profile: list, angle: float, level: float, crest: float, pitch: float, outer: float
) -> tuple[int, int]:
    """The plane face between the axis and one pitch of the profile, at an angle."""
    occ = gmsh.model.occ
    c, s = math.cos(angle), math.sin(angle)

    def point(radius: float, height: float) -> int:
        return occ.addPoint(radius * c, radius * s, height)

    curves = []
    for knots, degree, radii, heights in profile:
        poles = [point(r, level + h) for r, h in zip(radii, heights, strict=True)]
        if degree == 1:
            curves.append(occ.addLine(*poles))
        else:
            values, times = _multiplicities(knots)
            curves.append(occ.addBSpline(poles, degree=degree, knots=values, multiplicities=times))
    low, high = level - crest, level - crest + pitch
    axis = point(0.0, low), point(0.0, high)
    rim = point(outer, low), point(outer, high)
    curves = [occ.addLine(axis[0], rim[0]), *curves]
    curves += [occ.addLine(rim[1], axis[1]), occ.addLine(axis[1], axis[0])]
    return (2, occ.addPlaneSurface([occ.addWire(curves)]))


def _seam_angle(screw: ScrewParameters) -> float:
    """The angle where turns meet, as far as can be from the corners that the ends cut.

    Where seam, end plane and an edge of the profile nearly meet, gmsh would find a tiny edge.
    """
    candidates = (np.arange(360) + 0.5) * 2 * math.pi / 360
    clearance = np.full(candidates.shape, np.inf)
    for height in (0.0, screw.length, screw.length - screw.slot_depth):
        axial = height - screw.crest_height - screw.pitch * candidates / (2 * math.pi)
        clearance = np.minimum(clearance, screw.edge_distance(axial))
    # and away from the walls of the slot
    radius = screw.root_diameter / 2
    wall = np.abs(np.abs(np.sin(candidates)) * radius - screw.slot_width / 2)
    clearance[wall < screw.slot_width / 4] = 0.0
    return float(candidates[int(np.argmax(clearance))])


def _grooved_body(screw: ScrewParameters) -> tuple[int, int]:
    """The profile revolved, from below z = 0 to above z = length, as one volume."""
    occ = gmsh.model.occ
    pitch, length = screw.pitch * MM, screw.length * MM
    crest, outer = screw.crest_width / 2 * MM, screw.diameter / 2 * MM
    bottom = screw.crest_height * MM
    bottom -= math.ceil((bottom + 0.2 * pitch) / pitch) * pitch
    count = math.ceil((length + 0.2 * pitch - bottom) / pitch)
    first = last = occ.addPoint(outer, 0, bottom - crest)
    curves = []
    for k in range(count):
        for knots, degree, radii, heights in _profile(screw):
            poles = [last]
            poles += [
                occ.addPoint(r, 0, bottom + k * pitch + h)
                for r, h in zip(radii[1:], heights[1:], strict=True)
            ]
            if degree == 1:
                curves.append(occ.addLine(*poles))
            else:
                values, times = _multiplicities(knots)
                curves.append(
                    occ.addBSpline(poles, degree=degree, knots=values, multiplicities=times)
                )
            last = poles[-1]
    axis = [occ.addPoint(0, 0, z) for z in (bottom - crest, bottom - crest + count * pitch)]
    curves += [occ.addLine(last, axis[1]), occ.addLine(axis[1], axis[0])]
    curves.append(occ.addLine(axis[0], first))
    face = occ.addPlaneSurface([occ.addWire(curves)])
    made = occ.revolve([(2, face)], 0, 0, 0, 0, 0, 1, 2 * math.pi)
    return _one_volume(made, "grooves")
