"""Solids from images: volumes by voxel size, fractions, islands, edges, meshes."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.image_files import Image
from pipeline.geometry.patches import surface_patches
from pipeline.geometry.scans import level_surface, metal_of_image, solid_from_image
from pipeline.geometry.solids import tetrahedral_mesh
from pipeline.geometry.surface import (
    check_surface,
    solid_of_surface,
    surface_volume_and_area,
)
from pipeline.geometry.voxel_mask import VoxelMask, voxel_fraction
from pipeline.geometry.voxels import metal_fraction
from pipeline.scene.image import ImageFile
from pipeline.stages.geometry import read_surface, write_surface
from tests.pipeline.geometry.scans import ball, write_mha, write_slices, write_tiff
from tests.pipeline.geometry.solids import reference_screw

RADIUS = 0.5e-3
BALL = 4 / 3 * np.pi * RADIUS**3
SHIFTS = np.random.default_rng(3).uniform(-0.5, 0.5, (4, 3))


def mask_of(metal: np.ndarray, voxel) -> VoxelMask:
    """Voxels from the origin on."""
    return VoxelMask(metal, (0.0, 0.0, 0.0), tuple(np.broadcast_to(voxel, 3).tolist()))


def source(path="", **how) -> ImageFile:
    """An image file whose content does not matter."""
    return ImageFile(str(path), "", **({"label": 1} if not how else how))


def metal_in(values: np.ndarray, voxel=10e-6, **how):
    """What is metal in an array."""
    voxel = tuple(np.broadcast_to(voxel, 3).tolist())
    return metal_of_image(Image(values, voxel, (0.0, 0.0, 0.0)), source(**how), "scan.mha")


def observed_order(voxels, errors) -> float:
    """Slope of a line through the logarithms."""
    return float(np.polyfit(np.log(voxels), np.log(errors), 1)[0])


def test_the_volume_of_a_ball_is_of_second_order_in_the_voxel_size():
    voxels = [100e-6, 70e-6, 50e-6, 35e-6, 25e-6]
    errors = []
    for voxel in voxels:
        volumes = []
        for shift in SHIFTS:
            mask = mask_of(ball(RADIUS, voxel, shift * voxel), voxel)
            points, triangles, _ = level_surface(mask, "ball")
            volumes.append(surface_volume_and_area(points, triangles)[0])
            assert volumes[-1] == pytest.approx(mask.volume, rel=1e-4)
        errors.append(np.sqrt(np.mean((np.array(volumes) / BALL - 1) ** 2)))
    # Root mean square over places of the ball: 1.7 to 0.079 %, order 2.2; the count of lattice
    # points in a ball scatters by its radius in voxels, over R^3, so the order is 2.
    assert 1.7 < observed_order(voxels, errors) < 2.6
    assert errors[-1] < 2e-3


@pytest.mark.slow
def test_the_volume_of_a_screw_converges_with_the_voxel_size():
    """Of the reference screw: first order at least, as its faces are planes of voxels."""
    solid = reference_screw()
    voxels, errors, areas = [100e-6, 70e-6, 50e-6, 35e-6, 25e-6], [], []
    for voxel in voxels:
        volumes = []
        for shift in SHIFTS:
            low = np.array(solid.bounding_box[0]) + voxel * (shift - 3.0)
            shape = np.ceil((np.array(solid.bounding_box[1]) - low) / voxel).astype(int) + 3
            metal = metal_fraction(solid, low, voxel, shape, samples=1)[0]
            points, triangles, _ = level_surface(mask_of(metal, voxel), "screw")
            check_surface(points, triangles, "screw")
            volume, area = surface_volume_and_area(points, triangles)
            volumes.append(volume / solid.volume - 1)
        areas.append(abs(area / solid.area - 1))
        errors.append(np.sqrt(np.mean(np.square(volumes))))
    assert 0.8 < observed_order(voxels, errors) < 2.6
    assert errors[-1] < 5e-3
    assert areas[-1] < 0.1 and areas[-1] < areas[0]


@pytest.mark.parametrize("voxel", [(20e-6, 20e-6, 20e-6), (20e-6, 30e-6, 60e-6)])
def test_a_lattice_takes_up_every_voxel_once(voxel):
    mask = VoxelMask(ball(RADIUS, voxel), (1e-3, -2e-3, 5e-6), voxel)
    middle = np.add(mask.corner, np.multiply(voxel, mask.metal.shape) / 2)
    origin = middle - 13 * 53e-6
    share = voxel_fraction(mask, origin, 53e-6, (27, 27, 27))
    # single precision within the sums, 1e-8 measured
    assert share.sum() * 53e-6**3 == pytest.approx(mask.volume, rel=1e-6)
    assert 0.0 <= share.min() and share.max() <= 1.0 + 1e-6 and share[13, 13, 13] > 0.999999
    i, j, k = np.argwhere((share > 0.3) & (share < 0.7))[5]  # a cell at the surface by hand
    low = origin + 53e-6 * (np.array([i, j, k]) - 0.5)
    edges = [
        np.add(mask.corner[a], voxel[a] * np.arange(mask.metal.shape[a] + 1)) for a in range(3)
    ]
    common = [
        np.clip(np.minimum(e[1:], low[a] + 53e-6) - np.maximum(e[:-1], low[a]), 0, None)
        for a, e in enumerate(edges)
    ]
    by_hand = np.einsum("i,j,k,ijk", *common, mask.metal.astype(float)) / 53e-6**3
    assert share[i, j, k] == pytest.approx(by_hand, rel=1e-6)


def test_the_nodes_in_the_metal_are_those_whose_voxel_is():
    metal = np.random.default_rng(1).random((7, 6, 5)) < 0.5
    mask = VoxelMask(metal, (1.0, 2.0, 3.0), (0.5, 0.25, 1.0))
    from pipeline.geometry.voxel_mask import voxel_inside

    inside = voxel_inside(mask, (0.75, 1.875, 2.5), (0.5, 0.25, 1.0), (9, 8, 7))
    assert np.array_equal(inside[1:8, 1:7, 1:6], metal)  # nodes in the middles of the voxels
    assert inside.sum() == metal.sum() > 0


def test_islands_are_left_out_and_said(tmp_path, caplog):
    values = ball(RADIUS, 25e-6).astype(np.uint8)
    whole = int(values.sum())
    values[1, 1, 1] = values[1, -2, 3] = values[1, -2, 4] = 1
    write_mha(tmp_path / "scan.mha", values, 25e-6)
    with caplog.at_level(logging.WARNING):
        solid = solid_from_image(source(tmp_path / "scan.mha"))
    assert "scan.mha: metal that hangs on nothing is left out, bodies 2, voxels 3" in caplog.text
    assert solid.image["removed_voxels"] == 3 and solid.image["metal_voxels"] == whole
    assert solid.volume == pytest.approx(whole * 25e-6**3, rel=1e-4)


def test_a_second_body_is_refused():
    one = ball(RADIUS, 50e-6)
    with pytest.raises(
        ValueError, match="scan.mha has 2 bodies of metal, the second 1 of the first"
    ):
        metal_in(np.concatenate([one, one]).astype(np.uint8))


def test_voxels_that_share_an_edge_only_do_not_hang_together():
    values = np.zeros((30, 30, 30), np.uint8)
    values[5:20, 5:20, 5:20] = 1
    values[20, 20, 5:20] = 1
    mask, facts = metal_in(values)
    assert mask.metal.sum() == 15**3 and facts["removed_voxels"] == 15


def test_metal_at_the_edge_is_named_and_capped_only_on_request():
    values = np.zeros((20, 20, 20), np.int16)
    values[5:15, 5:15, 4:] = 300
    values[0, 0, 0] = 300  # an island at the edge does not count
    with pytest.raises(ValueError, match=r"cut by the image's edge at \+z \(100 voxels\)"):
        metal_in(values, threshold=300.0)
    mask, facts = metal_in(values, threshold=300.0, cap=True)
    assert facts["cut_by_edge"] == ["+z"]
    assert mask.corner == pytest.approx((45e-6, 45e-6, 35e-6))  # half a voxel before the middle
    points, triangles, _ = level_surface(mask, "block")
    check_surface(points, triangles, "block")
    # the flat faces lie within a few per cent of a voxel of where they are (0.3 um measured)
    assert points[:, 2].max() == pytest.approx(195e-6, abs=1e-6)


def test_a_threshold_or_label_without_metal_is_refused():
    values = ball(RADIUS, 100e-6) * np.int16(-50)
    with pytest.raises(ValueError, match="threshold is 7; no voxel .* go from -50 to 0"):
        metal_in(values, threshold=7.0)
    with pytest.raises(ValueError, match="threshold is -60; every voxel"):
        metal_in(values, threshold=-60.0)
    with pytest.raises(ValueError, match="label is 3; no voxel"):
        metal_in(values, label=3)
    assert metal_in(values, label=-50)[0].metal.sum() == (values < 0).sum()


def test_a_wire_as_thin_as_a_voxel_is_refused():
    values = np.zeros((9, 9, 40), np.uint8)
    values[4, 4, 3:-3] = 1
    mask = metal_in(values)[0]
    with pytest.raises(ValueError, match="wire has parts about as thin as a voxel"):
        level_surface(mask, "wire")


def test_the_surface_bounds_the_voxels_and_is_meshed(tmp_path):
    """Anisotropic voxels, a cavity, grey values with noise; what is stored is read back equal."""
    voxel = (20e-6, 20e-6, 30e-6)
    metal = ball(RADIUS, voxel)
    middle = [n // 2 for n in metal.shape]
    metal[tuple(slice(m - 6, m + 6) for m in middle)] = False
    noise = np.random.default_rng(0).normal(0, 8, metal.shape)
    write_tiff(tmp_path / "scan.tif", (60 + 120 * metal + noise).astype(np.uint8))
    solid = solid_from_image(source(tmp_path / "scan.tif", voxel=voxel, threshold=120.0))
    assert solid.voxels.volume == metal.sum() * np.prod(voxel)
    mesh = tetrahedral_mesh(solid, 0.2e-3, 0.08e-3)
    assert abs(mesh.quality["volume_error"]) < 0.02  # -1 % measured: chords of the round surface
    assert mesh.quality["min_shape"] > 0.05
    write_surface(tmp_path, solid)
    again = read_surface(tmp_path)
    assert np.array_equal(again.voxels.metal, solid.voxels.metal)
    lattice = ((0.0, 0.0, 0.0), 50e-6, (24, 24, 24))
    both = zip(metal_fraction(again, *lattice), metal_fraction(solid, *lattice), strict=True)
    for ours, theirs in both:
        assert np.array_equal(ours, theirs) and ours.sum() > 1000


@pytest.mark.parametrize("name", ["sphere", "ring", "two shells"])
def test_every_patch_of_a_surface_is_a_disc(name):
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, 41)] * 3, indexing="ij", sparse=True)
    metal = x**2 + y**2 + z**2 < 0.8
    if name == "ring":
        metal = (np.hypot(x, y) - 0.6) ** 2 + z**2 < 0.06
    elif name == "two shells":
        metal &= x**2 + y**2 + z**2 > 0.2
    points, triangles, _ = level_surface(mask_of(metal, 1e-5), name)
    patch = surface_patches(points, triangles)
    assert patch.min() == 0 and patch.max() >= 15
    for number in range(patch.max() + 1):
        own = triangles[patch == number]
        edges = np.sort(own[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, times = np.unique(edges, axis=0, return_counts=True)
        assert len(np.unique(own)) - len(edges) + len(own) == 1
        rim = edges[times == 1]  # one loop: every vertex of the rim has two of its edges
        assert (np.unique(rim, return_counts=True)[1] == 2).all()
    solid = replace(solid_of_surface(name, points, triangles), voxels=mask_of(metal, 1e-5))
    mesh = tetrahedral_mesh(solid, 60e-6, 30e-6)
    assert abs(mesh.quality["volume_error"]) < 0.05  # 3.4 % (ring, 49 um thick) measured: chords
    assert mesh.quality["min_shape"] > 0.03  # 0.06 and more measured


def test_a_folder_of_slices_is_a_solid(tmp_path):
    write_slices(tmp_path / "scan", ball(RADIUS, 50e-6).astype(np.uint8))
    solid = solid_from_image(source(tmp_path / "scan", voxel=(50e-6,) * 3, label=1))
    assert solid.volume == pytest.approx(BALL, rel=0.02)
    assert solid.area == pytest.approx(4 * np.pi * RADIUS**2, rel=0.02)
