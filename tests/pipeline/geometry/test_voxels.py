"""Lattice classification: against closed forms, against OpenCASCADE, against brute force."""

import time

import numpy as np
import pytest

from pipeline.geometry.solids import contains
from pipeline.geometry.voxels import check_resolution, metal_fraction
from tests.pipeline.geometry.solids import box, icosphere, joined, reference_screw


def _lattice(solid, spacing, margin=2.0, shift=(0.0, 0.0, 0.0)):
    low, high = (np.array(corner) for corner in solid.bounding_box)
    origin = low - (margin + np.array(shift)) * spacing
    shape = np.ceil((high - origin) / spacing + margin).astype(int) + 1
    return origin, spacing, tuple(shape)


def test_box_off_the_lattice_is_exact():
    # faces fall at 0.3 and 0.8 of a cell; per axis the cells have 0.8, 1, 1, ..., 0.2 of it ...
    low, high = np.array([0.3, 0.3, 0.3]) * 1e-3, np.array([4.8, 3.8, 2.8]) * 1e-3
    inside, fraction = metal_fraction(box(low, high), (0, 0, 0), 1e-3, (7, 6, 5), samples=10)

    def shares(a, b, count):
        edges = np.arange(count + 1) - 0.5
        return np.clip(np.minimum(b, edges[1:]) - np.maximum(a, edges[:-1]), 0, None)

    # along x the length is exact, along y and z ten rays count tenths of a cell
    x, y, z = (shares(low[a] * 1e3, high[a] * 1e3, n) for a, n in enumerate((7, 6, 5)))
    assert fraction == pytest.approx(np.einsum("i,j,k->ijk", x, y, z), abs=1e-9)
    nodes = np.stack(np.meshgrid(*(np.arange(n) for n in (7, 6, 5)), indexing="ij"), -1) * 1e-3
    assert np.array_equal(inside, ((nodes > low) & (nodes < high)).all(axis=-1))
    assert inside.sum() == 4 * 3 * 2


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_faces_edges_and_diagonals_on_the_rays(samples):
    """Every face, edge, vertex and face diagonal of this box meets rays and nodes exactly."""
    surface = box((1e-3, 1e-3, 1e-3), (5e-3, 5e-3, 5e-3))
    inside, fraction = metal_fraction(surface, (0, 0, 0), 1e-3, (7, 7, 7), samples)
    # one of two opposite faces counts: 4^3 nodes, and the same 64 cells' worth of volume
    assert inside.sum() == 64
    if samples % 2:  # with an even number no ray lies in a face
        assert fraction.sum() == pytest.approx(64.0, rel=1e-12)
    else:
        assert fraction.sum() == pytest.approx(64.0, rel=1e-12)
        assert fraction[1, 3, 3] == pytest.approx(0.5, abs=1e-12)


def test_ball_converges():
    radius = 1e-3
    points, triangles = icosphere(radius, 5)
    centre = np.array([0.13, -0.21, 0.07]) * 1e-3
    surface = points + centre, triangles
    corner = points[triangles]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    errors = []
    for count in (10, 20, 40):
        spacing = 2.4e-3 / count
        inside, fraction = metal_fraction(
            surface, (-1.2e-3,) * 3, spacing, (count + 1,) * 3, samples=4
        )
        errors.append(abs(fraction.sum() * spacing**3 / volume - 1))
        grid = -1.2e-3 + spacing * np.stack(np.indices(inside.shape), -1) - centre
        r = np.linalg.norm(grid, axis=-1)
        # the triangulated ball lies between the sphere and 0.07 % below it
        assert not inside[r > radius].any()
        assert inside[r < radius * (1 - 1e-3)].all()
        assert ((fraction > 0) & (fraction < 1)).any()
        assert fraction.max() <= 1.0
    assert errors[0] < 3e-3  # measured 1.9e-4
    assert errors[2] < 1e-4  # measured 1.6e-5


def test_fraction_equals_dense_sampling():
    surface = icosphere(1e-3, 2)
    spacing, shape = 0.4e-3, (7, 7, 7)
    origin = np.array([-1.25, -1.15, -1.2]) * 1e-3
    fraction = metal_fraction(surface, origin, spacing, shape, samples=8)[1]
    corner = surface[0][surface[1]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    rng = np.random.default_rng(7)
    for i, j, k in [(1, 1, 2), (3, 0, 3), (3, 3, 3), (5, 2, 3), (2, 5, 4), (0, 0, 0)]:
        cell = origin + spacing * np.array([i, j, k])
        samples = cell + spacing * (rng.random((4000, 3)) - 0.5)
        # a convex body: inside all planes
        sides = np.einsum("ta,sa->st", normal, samples) - (normal * corner[:, 0]).sum(axis=1)
        # 4000 samples: standard deviation at most 0.008
        assert fraction[i, j, k] == pytest.approx((sides < 0).all(axis=1).mean(), abs=0.03)


def test_any_permutation_of_axes_gives_the_same_box():
    spacing = np.array([0.1, 0.2, 0.25]) * 1e-3
    low, high = (0.02e-3, 0.03e-3, 0.05e-3), (1.07e-3, 1.33e-3, 1.61e-3)
    inside, fraction = metal_fraction(box(low, high), (0, 0, 0), spacing, (13, 9, 9), 8)
    volume = np.prod(np.subtract(high, low))
    # along y and z eight rays: 1/16 of a cell each side at most; measured 0.3 %
    assert fraction.sum() * spacing.prod() == pytest.approx(volume, rel=0.02)
    assert inside.sum() == 10 * 6 * 6


def test_screw_volume_does_not_depend_on_the_lattice():
    solid = reference_screw()
    for shift in ((0, 0, 0), (0.3, 0.4, 0.2), (0.71, 0.13, 0.5)):
        origin, spacing, shape = _lattice(solid, 100e-6, shift=shift)
        inside, fraction = metal_fraction(solid, origin, spacing, shape)
        found = fraction.sum() * spacing**3
        assert found == pytest.approx(solid.volume, rel=1e-3)  # measured <= 3e-4
        assert inside.sum() * spacing**3 == pytest.approx(solid.volume, rel=0.03)  # <= 1.3 %
        assert (fraction[inside] > 0).all()
        assert fraction[~inside].max() > 0.3


def test_lattice_volume_under_refinement():
    solid = reference_screw()
    errors = []
    for spacing in (100e-6, 50e-6, 25e-6):
        origin, spacing, shape = _lattice(solid, spacing)
        inside, fraction = metal_fraction(solid, origin, spacing, shape)
        errors.append(
            (
                fraction.sum() * spacing**3 / solid.volume - 1,
                inside.sum() * spacing**3 / solid.volume - 1,
            )
        )
    by_fraction, by_nodes = np.abs(errors).T
    # fractions: the triangulation's own volume, measured 1.5e-4 at all spacings
    assert by_fraction.max() < 5e-4
    # nodes: measured 1.2 %, 0.1 %, 0.01 %
    assert by_nodes[0] < 0.03
    assert by_nodes[2] < 0.003


def test_nodes_agree_with_opencascade():
    """Random points, most of them near the surface, where an error would be."""
    solid = reference_screw()
    rng = np.random.default_rng(11)
    low, high = (np.array(corner) for corner in solid.bounding_box)
    near = solid.points[rng.integers(len(solid.points), size=16)]
    near = near + rng.normal(scale=20e-6, size=near.shape)
    points = np.concatenate([near, rng.uniform(low, high, (8, 3))])
    mine = np.array([metal_fraction(solid, p, 1e-7, (1, 1, 1), 1)[0].item() for p in points])
    theirs = contains(solid, points)
    assert 5 < theirs.sum() < 20
    # chords of the triangulation are up to 2 um off the arcs: one of 24 points may differ
    assert (mine != theirs).sum() <= 1  # measured 0


def test_two_million_nodes_take_seconds():
    solid = reference_screw()
    metal_fraction(solid, *_lattice(solid, 200e-6))  # compiled
    origin, spacing, shape = _lattice(solid, 20.5e-6)
    start = time.perf_counter()
    _, fraction = metal_fraction(solid, origin, spacing, shape)
    elapsed = time.perf_counter() - start
    assert np.prod(shape) > 2_000_000
    assert fraction.sum() * spacing**3 == pytest.approx(solid.volume, rel=5e-4)
    assert elapsed < 10.0  # measured 0.4 s on two idle cores


def test_plane_through_nodes_has_no_speckles():
    """The end faces z = 0 and z = length of the screw lie exactly on lattice planes."""
    solid = reference_screw()
    spacing = 100e-6
    inside, _ = metal_fraction(solid, (-1.2e-3, -1.2e-3, -0.2e-3), spacing, (25, 25, 45))
    x = -1.2e-3 + spacing * np.arange(25)
    core = np.hypot(x[:, None], x) < 0.75e-3
    assert core.sum() > 150
    assert inside[core, 2].all()
    assert inside[core, 3].all()
    assert not inside[:, :, 1].any()
    assert not inside[:, :, 42].any()
    assert inside[:, :, 41].any()


def test_resolution_of_the_reference_screw():
    solid = reference_screw()
    check_resolution(solid, 100e-6)
    check_resolution(solid, (50e-6, 100e-6, 25e-6))
    with pytest.raises(ValueError) as caught:
        check_resolution(solid, (50e-6, 110e-6, 50e-6))
    assert "lattice spacing is 110 um: too coarse for the smallest feature" in str(caught.value)
    assert "200 um; allowed is at most 105.3 um" in str(caught.value)
    with pytest.raises(ValueError, match="too coarse"):
        check_resolution(solid, float("nan"))


@pytest.mark.parametrize(
    ("origin", "spacing", "shape", "samples", "says"),
    [
        ((0, 0), 1e-4, (2, 2, 2), 4, "origin is"),
        ((0, 0, 0), -1e-4, (2, 2, 2), 4, "spacing is -0.0001"),
        ((0, 0, 0), (1e-4, 0, 1e-4), (2, 2, 2), 4, "spacing is"),
        ((0, 0, 0), 1e-4, (2, 0, 2), 4, "shape is (2, 0, 2)"),
        ((0, 0, 0), 1e-4, (2, 2, 2), 0, "samples is 0"),
    ],
)
def test_bad_lattices(origin, spacing, shape, samples, says):
    with pytest.raises(ValueError) as caught:
        metal_fraction(box(), origin, spacing, shape, samples)
    assert says in str(caught.value)


def test_open_surface_is_noticed():
    points, triangles = box()
    without_a_side = triangles[(points[triangles][:, :, 0] > 0).any(axis=1)]
    with pytest.raises(ValueError, match="open or not manifold"):
        metal_fraction((points, without_a_side), (0, 0.2e-3, 0.2e-3), 0.1e-3, (5, 5, 5))


def test_two_separate_boxes_and_a_lattice_that_cuts_them():
    surface = joined(box(), box((2e-3, 0, 0), (3e-3, 1e-3, 1e-3)))
    inside, fraction = metal_fraction(surface, (0.55e-3, 0.05e-3, 0.05e-3), 0.1e-3, (20, 10, 10))
    row = inside[:, 5, 5]
    assert np.array_equal(np.flatnonzero(row), [0, 1, 2, 3, 4, 15, 16, 17, 18, 19])
    assert fraction[:, 5, 5] == pytest.approx(row.astype(float), abs=1e-9)
