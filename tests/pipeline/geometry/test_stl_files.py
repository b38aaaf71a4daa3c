"""STL files that are read and refused; where meshio's reader would not have done (see read_stl)."""

import meshio
import numpy as np
import pytest

from pipeline.geometry.mesh import boundary_triangles
from pipeline.geometry.patches import surface_patches
from pipeline.geometry.solids import solid_from_file, tetrahedral_mesh
from pipeline.geometry.surface import read_stl
from tests.pipeline.geometry.solids import box, icosphere, joined, write_ascii_stl, write_stl


@pytest.fixture
def files(tmp_path) -> tuple[str, bytes]:
    """A box as ASCII and as binary file."""
    write_ascii_stl(tmp_path / "a.stl", *box())
    write_stl(tmp_path / "b.stl", *box())
    return (tmp_path / "a.stl").read_text(), (tmp_path / "b.stl").read_bytes()


REFUSED = {
    "nothing": (lambda a, b: b"", "is no STL file"),
    "cut short": (lambda a, b: b[:-30], "is no STL file"),
    "a byte too many": (lambda a, b: b + b"x", "is no STL file"),
    "text cut short": (lambda a, b: a[: a.rindex("vertex")].encode(), "cut short"),
    "quadrilaterals": (
        lambda a, b: a.replace("endloop", "vertex 0 0 0\nendloop").encode(),
        "48 vertices in 12 facets",
    ),
    "two numbers": (lambda a, b: a.replace("vertex 0 0 0", "vertex 0 0", 1).encode(), "not three"),
    "nan": (lambda a, b: a.replace("vertex 0 0 0", "vertex 0 0 nan", 1).encode(), "not finite"),
    "another format": (lambda a, b: b"v 0 0 0\nv 1 0 0\nf 1 2 3\n" * 8, "is no STL file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_surface_of_triangles_is_refused(tmp_path, files, name):
    make, words = REFUSED[name]
    (tmp_path / "bad.stl").write_bytes(make(*files))
    with pytest.raises(ValueError, match=words) as caught:
        read_stl(tmp_path / "bad.stl", 1e-3)
    assert str(caught.value).startswith("bad.stl ")


@pytest.mark.parametrize(
    "make",
    [
        lambda a, b: a.encode(),
        lambda a, b: a.upper().encode(),
        lambda a, b: a.replace("\n", "\r\n").encode(),
        lambda a, b: b,
        lambda a, b: b"solid" + b[5:],
    ],
    ids=["ascii", "capitals", "crlf", "binary", "binary that begins with solid"],
)
def test_what_is_one_is_read(tmp_path, files, make):
    (tmp_path / "good.stl").write_bytes(make(*files))
    points, triangles = read_stl(tmp_path / "good.stl", 1e-3)
    wanted, _ = box()
    assert len(points) == 8 and len(triangles) == 12
    assert np.allclose(np.sort(points, axis=0), np.sort(wanted, axis=0), rtol=0, atol=1e-10)


def test_meshio_takes_a_file_cut_short_for_an_empty_surface(tmp_path, files):
    """Why the reader is our own; where this fails, a newer meshio may do."""
    (tmp_path / "short.stl").write_bytes(files[1][:-30])
    assert sum(len(block.data) for block in meshio.read(tmp_path / "short.stl").cells) == 0


def test_sharp_edges_are_kept_and_smooth_shells_cut_into_discs(tmp_path):
    """A box with a round cavity: six faces, twelve edges, and a shell that has none."""
    ball, inner = icosphere(0.3e-3, 3)
    points, triangles = joined(box((-5e-4,) * 3, (5e-4,) * 3), (ball, inner[:, ::-1]))
    patch = surface_patches(points, triangles, np.radians(25.0))
    faces, shell = np.unique(patch[:12]), np.unique(patch[12:])
    assert len(faces) == 6 and len(shell) == 16 and not np.isin(faces, shell).any()
    assert (patch[:12:2] == patch[1:12:2]).all()  # the two triangles of a face
    write_stl(tmp_path / "hollow.stl", points, triangles)
    solid = solid_from_file(tmp_path / "hollow.stl")
    mesh = tetrahedral_mesh(solid, 0.2e-3, 0.1e-3)
    assert abs(mesh.quality["volume_error"]) < 0.01  # 0.3 % measured: chords of the cavity
    assert mesh.quality["top_area"] == pytest.approx(1e-6, rel=1e-6)
    assert mesh.quality["min_shape"] > 0.05  # 0.11 measured


def test_a_solid_without_sharp_edges_is_fine_on_its_whole_surface(tmp_path):
    write_stl(tmp_path / "ball.stl", *icosphere(1e-3, 4))
    mesh = tetrahedral_mesh(solid_from_file(tmp_path / "ball.stl"), 0.5e-3, 0.25e-3)
    assert abs(mesh.quality["volume_error"]) < 0.03
    corners = mesh.points[boundary_triangles(mesh.cells)]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert 0.15e-3 < np.median(edges) < 0.3e-3  # 0.18 mm measured: seams of patches are ragged
