"""Solids and meshes: volumes and areas against the parameters, files, what is refused."""

import dataclasses
import math

import numpy as np
import pytest

from pipeline.geometry.mesh import (
    boundary_triangles,
    cell_volumes,
    dihedral_angles,
    mesh_quality,
    read_mesh,
    scaled_shape,
    write_mesh,
)
from pipeline.geometry.solids import (
    ScrewParameters,
    screw_solid,
    solid_from_file,
    tetrahedral_mesh,
    write_cad,
)
from pipeline.geometry.surface import check_surface, smallest_feature, surface_volume_and_area
from pipeline.scene.screw import reference_volume_and_area
from tests.pipeline.geometry.solids import (
    box,
    coarse_mesh,
    fine_mesh,
    icosphere,
    joined,
    reference_screw,
    write_ascii_stl,
    write_stl,
)

MM = 1e-3


# --- the parameters ------------------------------------------------------------------------------


def test_iso_profile_of_the_reference_screw():
    screw = ScrewParameters()
    assert screw.minor_diameter == pytest.approx(1.567e-3, abs=1e-12)
    assert screw.root_diameter == pytest.approx(1.509e-3, abs=1e-12)
    # d1 and d3 are rounded to 1 um: P/4 holds to 0.01 %, H/6 to 0.22 %
    assert screw.root_width == pytest.approx(screw.pitch / 4, rel=2e-4)
    assert screw.root_radius == pytest.approx(screw.pitch * math.sqrt(3) / 12, rel=3e-3)
    u = np.array([0.0, screw.pitch / 16, screw.pitch * 3 / 8, screw.pitch / 2, screw.pitch])
    expected = np.array([2.0, 2.0, 1.567, 1.509, 2.0]) / 2 * MM
    # at 3/8 P the flank has 60 degrees, so 1 um of rounding is 0.03 um of radius
    assert np.abs(screw.radius(u) - expected).max() < 1e-7


def test_thread_is_right_handed():
    screw = ScrewParameters()
    quarter = screw.pitch / 4
    start = screw.crest_height
    assert screw.surface_radius(math.pi / 2, start + quarter) == pytest.approx(1e-3)
    assert screw.surface_radius(math.pi / 2, start - quarter) < 0.8e-3


def test_plain_pin_matches_closed_form():
    screw = ScrewParameters(thread="none")
    r, h = screw.pin_diameter / 2, screw.slot_width / 2
    chord = math.sqrt(r * r - h * h)
    strip = 2 * (h * chord + r * r * math.asin(h / r))
    volume = math.pi * r * r * screw.length - strip * screw.slot_depth
    arc = 2 * math.pi * r - 4 * r * math.asin(h / r)
    area = 2 * math.pi * r * r + 2 * math.pi * r * (screw.length - screw.slot_depth)
    area += (arc + 4 * chord) * screw.slot_depth
    found = reference_volume_and_area(screw)
    assert found[0] == pytest.approx(volume, rel=1e-6)  # measured 1.3e-7
    assert found[1] == pytest.approx(area, rel=5e-4)  # measured 2.6e-4 (singular at the wall)


def test_plain_pin_has_the_metal_of_the_thread():
    pin = reference_volume_and_area(ScrewParameters(thread="none"))
    threaded = reference_volume_and_area(ScrewParameters())
    # sections are equal; measured 2.8e-4, from the slot, whose chord differs
    assert pin[0] == pytest.approx(threaded[0], rel=1e-3)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("diameter", -1e-3, "diameter is -1 mm: allowed are 0.1 to 100 mm"),
        ("diameter", math.nan, "diameter is nan: allowed is a finite number"),
        ("diameter", "2mm", "diameter is '2mm': allowed is a finite number"),
        ("length", 0.0, "length is 0 mm"),
        ("pitch", 1.2e-3, "pitch is 1.2 mm: allowed are 0.1 to 1 mm"),
        ("thread", "trapezoidal", "allowed are 'helical', 'grooves', 'none'"),
        ("thread_angle", 60.0, "allowed are 20 to 120 degrees"),
        ("minor_diameter", 1.0e-3, "the flanks meet above it"),
        ("root_diameter", 1.0e-3, "root_diameter is 1 mm: allowed are 1.46699 to 1.567 mm"),
        ("slot_width", 1.9e-3, "0 to 1.2072 mm (diameter 2 mm, length 4 mm, pitch 0.4 mm)"),
        ("slot_depth", 3.5e-3, "slot_depth is 3.5 mm: allowed are 0 to 3.2 mm"),
        ("slot_depth", 0.0, "both positive, or both 0"),
    ],
)
def test_parameters_out_of_range(field, value, says):
    with pytest.raises(ValueError, match=field) as caught:
        ScrewParameters(**{field: value})
    assert says in str(caught.value)
    assert str(caught.value).count("\n") == 0


# --- the solids ----------------------------------------------------------------------------------


def test_reference_screw_volume_and_area():
    solid = reference_screw()
    assert solid.reference_volume == pytest.approx(9.2457e-9, rel=1e-4)
    assert solid.reference_area == pytest.approx(42.683e-6, rel=1e-4)
    # asked for is 1 %; measured -1.2e-5 and -1.6e-5, the splines of helix and root
    assert solid.volume == pytest.approx(solid.reference_volume, rel=5e-5)
    assert solid.area == pytest.approx(solid.reference_area, rel=1e-4)
    low, high = solid.bounding_box
    assert (low[2], high[2]) == (pytest.approx(0.0, abs=1e-12), pytest.approx(4e-3, abs=1e-12))
    # no node need lie on the axes: measured 2e-8
    assert np.allclose([low[:2], high[:2]], [[-1e-3] * 2, [1e-3] * 2], atol=2e-7)
    assert solid.smallest_feature == pytest.approx(0.2e-3)


def test_reference_screw_surface_is_closed_and_close():
    solid = reference_screw()
    check_surface(solid.points, solid.triangles, solid.name)
    volume, area = surface_volume_and_area(solid.points, solid.triangles)
    assert volume == pytest.approx(solid.volume, rel=3e-4)  # measured 1.4e-4: chords of arcs
    assert area == pytest.approx(solid.area, rel=3e-3)  # measured -1.6e-3
    # the same feature measured with rays: 0.2001 mm
    assert smallest_feature(solid.points, solid.triangles) == pytest.approx(0.2e-3, rel=0.03)


@pytest.mark.parametrize(
    "screw",
    [
        ScrewParameters(thread="grooves", length=2.2e-3),
        ScrewParameters(thread="none"),
        ScrewParameters(length=1.4e-3, slot_width=0.0, slot_depth=0.0, root_diameter=1.567e-3),
        ScrewParameters(
            diameter=3e-3,
            length=1.9e-3,
            pitch=0.5e-3,
            slot_width=0.8e-3,
            slot_depth=1.1e-3,
        ),
        pytest.param(
            ScrewParameters(length=1.3e-3, pitch=0.25e-3, thread_angle=math.radians(55)),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["grooves", "pin", "no slot, flat root", "M3", "fine pitch"],
)
def test_other_screws(screw):
    solid = screw_solid(screw)
    assert solid.volume == pytest.approx(solid.reference_volume, rel=1e-4)  # measured <= 2e-5
    assert solid.area == pytest.approx(solid.reference_area, rel=1e-3)  # measured <= 3e-4
    check_surface(solid.points, solid.triangles, solid.name)
    mesh = tetrahedral_mesh(solid, screw.pitch * 0.8, screw.pitch * 0.5)
    # the mesh cuts arcs by chords; measured up to 1.2 % (pin, whose cells are coarse)
    assert abs(mesh.quality["volume_error"]) < 0.02
    assert mesh.quality["min_shape"] > 0.05


# --- meshes --------------------------------------------------------------------------------------


def _assert_sound(mesh, solid, area_error):
    assert cell_volumes(mesh.points, mesh.cells).min() > 0
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.points)))
    skin = boundary_triangles(mesh.cells)
    check_surface(mesh.points, skin, "skin of the mesh")
    volume, _ = surface_volume_and_area(mesh.points, skin)
    assert volume == pytest.approx(mesh.quality["volume"], rel=1e-12)
    # both ends are flat and exact
    z = mesh.points[:, 2]
    assert (z.min(), z.max()) == (0.0, 4e-3)
    screw = ScrewParameters()
    section = math.pi * screw.pin_diameter**2 / 4
    assert mesh.quality["bottom_area"] == pytest.approx(section, rel=area_error)
    assert 0.60 * section < mesh.quality["top_area"] < 0.66 * section


def test_quick_mesh():
    mesh = coarse_mesh()
    assert 5_000 <= mesh.quality["cells"] <= 10_000  # measured 7,320
    assert abs(mesh.quality["volume_error"]) < 0.01  # measured -0.45 %
    # the smallest angles belong to the 3.6 degree corners where the crest runs out at the ends
    assert mesh.quality["min_shape"] > 0.1  # measured 0.134
    assert mesh.quality["mean_shape"] > 0.6  # measured 0.652
    _assert_sound(mesh, reference_screw(), 0.015)  # measured -0.7 %


@pytest.mark.slow
def test_standard_mesh():
    mesh = fine_mesh()
    assert 40_000 <= mesh.quality["cells"] <= 80_000  # measured 57,850
    assert abs(mesh.quality["volume_error"]) < 0.004  # measured 0.17 %
    assert mesh.quality["min_shape"] > 0.1  # measured 0.219
    assert mesh.quality["mean_shape"] > 0.7  # measured 0.756
    _assert_sound(mesh, reference_screw(), 0.003)  # measured -0.1 %


@pytest.mark.slow
def test_mesh_is_finer_at_the_thread():
    mesh = fine_mesh()
    centre = mesh.points[mesh.cells].mean(axis=1)
    size = np.cbrt(cell_volumes(mesh.points, mesh.cells))
    radius = np.hypot(centre[:, 0], centre[:, 1])
    core = size[(radius < 0.4e-3) & (centre[:, 2] > 0.5e-3) & (centre[:, 2] < 3e-3)].mean()
    assert core / size[radius > 0.75e-3].mean() > 1.3  # measured 1.5


def test_mesh_is_reproducible():
    again = tetrahedral_mesh(reference_screw(), 0.3e-3, 0.2e-3)
    assert np.array_equal(again.points, coarse_mesh().points)
    assert np.array_equal(again.cells, coarse_mesh().cells)


def test_quality_of_a_regular_and_a_flat_tetrahedron():
    regular = np.array([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)], float)
    cells = np.array([[0, 1, 2, 3]])
    assert cell_volumes(regular, cells)[0] == pytest.approx(8 / 3)
    assert scaled_shape(regular, cells)[0] == pytest.approx(1.0)
    assert np.degrees(dihedral_angles(regular, cells)) == pytest.approx(70.528779, abs=1e-5)
    flat = regular.copy()
    flat[0] = flat[1:].mean(axis=0) + 1e-3 * (flat[0] - flat[1:].mean(axis=0))
    assert scaled_shape(flat, cells)[0] < 0.02
    assert mesh_quality(regular, cells, 2.0)["volume_error"] == pytest.approx(1 / 3)


def test_mesh_files(tmp_path):
    mesh = coarse_mesh()
    write_mesh(mesh, tmp_path)
    again = read_mesh(tmp_path)
    assert np.array_equal(again.points, mesh.points)
    assert np.array_equal(again.cells, mesh.cells)
    assert again.quality == mesh.quality
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mesh.h5", "mesh.vtu"]
    with pytest.raises(FileNotFoundError, match="run the geometry stage first"):
        read_mesh(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("size", "fine", "says"),
    [
        (0.0, None, "mesh size is 0 mm: allowed are 0.004 to 4 mm"),
        (1.0, None, "mesh size is 1000 mm"),
        (0.3e-3, 0.4e-3, "fine mesh size is 0.4 mm: allowed is at most the mesh size, 0.3 mm"),
        (0.3e-3, math.nan, "fine mesh size is nan mm"),
    ],
)
def test_mesh_size_out_of_range(size, fine, says):
    with pytest.raises(ValueError) as caught:
        tetrahedral_mesh(reference_screw(), size, fine)
    assert says in str(caught.value)


# --- solids from files ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pin():
    return screw_solid(ScrewParameters(thread="none", length=2e-3))


@pytest.mark.parametrize("suffix", [".step", ".brep"])
def test_cad_file_round_trip(tmp_path, pin, suffix):
    write_cad(pin, tmp_path / f"pin{suffix}")
    solid = solid_from_file(tmp_path / f"pin{suffix}")
    assert solid.name == f"pin{suffix}"
    assert solid.volume == pytest.approx(pin.volume, rel=1e-9)
    assert solid.area == pytest.approx(pin.area, rel=1e-9)
    # reference: the triangulation, measured -5e-4
    assert solid.reference_volume == pytest.approx(solid.volume, rel=2e-3)
    # the slot's width, depth and prongs are 0.5, 0.5 and 0.63 mm; measured 0.5 mm
    assert solid.smallest_feature == pytest.approx(0.5e-3, rel=0.05)
    mesh = tetrahedral_mesh(solid, 0.3e-3)
    assert abs(mesh.quality["volume_error"]) < 0.02  # measured -1.1 %


def test_unit_of_a_brep_scales(tmp_path, pin):
    write_cad(pin, tmp_path / "pin.brep")
    solid = solid_from_file(tmp_path / "pin.brep", "cm")
    assert solid.volume == pytest.approx(1e3 * pin.volume, rel=1e-9)
    write_cad(pin, tmp_path / "pin.step")
    with pytest.raises(ValueError, match="unit is 'cm': a STEP file carries its own unit"):
        solid_from_file(tmp_path / "pin.step", "cm")


@pytest.mark.parametrize("write", [write_stl, write_ascii_stl])
def test_stl_box(tmp_path, write):
    points, triangles = box((1e-3, 0, 0), (3e-3, 1e-3, 4e-3))
    write(tmp_path / "box.stl", points, triangles, 1e-6)
    solid = solid_from_file(tmp_path / "box.stl", "um")
    assert solid.volume == pytest.approx(8e-9, rel=1e-6)  # float32 in the file
    assert solid.area == pytest.approx(28e-6, rel=1e-6)
    assert solid.smallest_feature == pytest.approx(1e-3, rel=1e-6)
    mesh = tetrahedral_mesh(solid, 0.4e-3, 0.4e-3)
    assert mesh.quality["volume_error"] == pytest.approx(0.0, abs=1e-6)
    assert mesh.quality["top_area"] == pytest.approx(2e-6, rel=1e-6)
    assert mesh.quality["cells"] > 500


def test_stl_with_a_cavity(tmp_path):
    points, inner = icosphere(0.3e-3, 2)
    surface = joined(box(), (points + 0.5e-3, inner[:, ::-1]))
    write_stl(tmp_path / "hollow.stl", *surface)
    solid = solid_from_file(tmp_path / "hollow.stl")
    ball = surface_volume_and_area(points, inner)[0]
    assert ball > 0.1e-9
    assert solid.volume == pytest.approx(1e-9 - ball, rel=1e-5)


def test_nearly_equal_corners_are_joined(tmp_path):
    points, triangles = box()
    loose = points[triangles].reshape(-1, 3).copy()
    loose += 1e-7 * 1e-3 * np.random.default_rng(3).uniform(-1, 1, loose.shape)
    write_stl(tmp_path / "loose.stl", loose, np.arange(36).reshape(-1, 3))
    assert solid_from_file(tmp_path / "loose.stl").volume == pytest.approx(1e-9, rel=1e-5)


def _open():
    points, triangles = box()
    return points, triangles[:-1]


def _inverted():
    points, triangles = box()
    return points, triangles[:, ::-1]


def _one_triangle_turned():
    points, triangles = box()
    triangles = triangles.copy()
    triangles[4] = triangles[4, ::-1]
    return points, triangles


def _two_boxes_on_an_edge():
    return joined(box(), box((1e-3, 1e-3, 0), (2e-3, 2e-3, 1e-3)))


def _two_boxes_on_a_corner():
    return joined(box(), box((1e-3, 1e-3, 1e-3), (2e-3, 2e-3, 2e-3)))


def _two_bodies():
    return joined(box(), box((2e-3, 0, 0), (3e-3, 1e-3, 1e-3)))


def _pushed_through():
    """One body whose top is pulled down through its bottom, volume still positive."""
    points, triangles = icosphere(1e-3, 3)
    points = points.copy()
    cap = points[:, 2] > 0.9e-3
    points[cap, 2] -= 2.2e-3
    return points, triangles


def _empty():
    return np.zeros((0, 3)), np.zeros((0, 3), int)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (_open, "is open: 3 edges belong to one triangle only"),
        (_inverted, "is inverted"),
        (_one_triangle_turned, "is inconsistently oriented"),
        (_two_boxes_on_an_edge, "is not manifold: 1 edges belong to more than two triangles"),
        (_two_boxes_on_a_corner, "is not manifold: at 1 vertices separate sheets touch"),
        (_two_bodies, "has 2 bodies: allowed is exactly 1"),
        (_pushed_through, "crosses itself near"),
        (_empty, "is empty"),
    ],
)
def test_surfaces_that_bound_no_solid(tmp_path, make, says):
    write_stl(tmp_path / "bad.stl", *make())
    with pytest.raises(ValueError) as caught:
        solid_from_file(tmp_path / "bad.stl")
    assert str(caught.value).startswith("bad.stl ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_overlapping_and_folded_triangles_are_found():
    # the overlap of coplanar faces, and two triangles folded onto each other at their edge
    points = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0.5, 0.5, 0), (2, 1, 0), (0.5, 2, 0)])
    with_overlap = np.array([(0, 1, 2), (3, 4, 5)])
    from pipeline.geometry.intersections import first_intersection

    assert first_intersection(points, with_overlap, 1e-9) is not None
    folded = np.array([(0, 1, 2), (1, 0, 4)])
    assert first_intersection(points, folded, 1e-9) is not None
    apart = points + np.array([0, 0, 1]) * (np.arange(6) > 2)[:, None] * 1e-3
    assert first_intersection(apart, with_overlap, 1e-9) is None


@pytest.mark.parametrize(
    ("name", "content", "unit", "error", "says"),
    [
        ("a.stl", None, "mm", FileNotFoundError, "a.stl does not exist"),
        ("a.obj", "", "mm", ValueError, "allowed are files that end in .step"),
        ("a.stl", "", "parsec", ValueError, "unit 'parsec'"),
        ("a.stl", "nonsense", "mm", ValueError, "a.stl is no STL file"),
        ("a.stl", "solid\nvertex 1 2 x\n", "mm", ValueError, "not three numbers"),
        ("a.stl", "solid\nendsolid\n", "mm", ValueError, "is empty"),
        ("a.step", "nonsense", "mm", ValueError, "a.step cannot be read as STEP"),
        ("a.brep", "nonsense", "mm", ValueError, "a.brep holds 0 solids: it cannot be read"),
    ],
)
def test_files_that_are_refused(tmp_path, name, content, unit, error, says):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(error) as caught:
        solid_from_file(tmp_path / name, unit)
    assert says in str(caught.value)


def test_solid_without_cad_is_refused_by_write_cad(tmp_path):
    write_stl(tmp_path / "box.stl", *box())
    with pytest.raises(ValueError, match=r"box\.stl has no CAD model"):
        write_cad(solid_from_file(tmp_path / "box.stl"), tmp_path / "box.step")


def test_solid_can_be_replaced_but_not_changed():
    solid = reference_screw()
    with pytest.raises(dataclasses.FrozenInstanceError):
        solid.volume = 0.0
