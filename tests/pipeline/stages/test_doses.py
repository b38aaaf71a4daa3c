"""Damage by exposures: exact in clean liquid on any lattice, else what each cell has lost."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from peri.corrosion.classes.volumes import class_bond_sums, constant_of
from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.surface.exposure import exposure
from peri.engine.surface.rate_classes import cell_exposure
from peri.omissions.well_stirred import well_stirred
from pipeline.geometry.mesh import cell_volumes, refine_tetrahedra
from pipeline.stages.doses import (
    damage_by_dose,
    doses,
    part_means,
    skin_exposure,
    skin_points,
)
from tests.peri.bodies import ball, ball_exposure
from tests.peri.engine.surface.test_rate_classes import share_of_ball
from tests.pipeline.geometry.solids import BODIES, body, box

RADIUS, HORIZON, DAY = 4e-4, 2e-4, 86400.0
KERNEL = (HORIZON, 0.0, "constant")
SURFACE = ball(RADIUS, 3)


@pytest.fixture(scope="module", params=[2, 3])
def scene(request) -> CorrosionScene:
    spacing = HORIZON / request.param
    count = 2 * int(np.ceil((RADIUS + HORIZON) / spacing)) + 1
    lattice = Lattice((-0.5 * (count - 0.8) * spacing,) * 3, (spacing,) * 3, (count,) * 3)
    share = share_of_ball(lattice, RADIUS)
    return CorrosionScene(
        lattice, HORIZON, share > 0, solid_concentration=66082.4, saturation_concentration=0.66,
        liquid_diffusivity=1e-6, dissolution_flux=1.85e-6, kinetics=ConstantRate(),
        exposure=cell_exposure(lattice, SURFACE, HORIZON, share, 3),
    )  # fmt: skip


def _points() -> np.ndarray:
    rng = np.random.default_rng(1)
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return way * (RADIUS - 1e-5 - rng.uniform(0.0, 1.0, (500, 1)) * 0.9 * HORIZON)


def test_in_clean_liquid_every_cell_has_the_same_dose_and_points_their_own_damage(scene):
    end = 20 * DAY
    z = constant_of(scene) * scene.base_interface_diffusivity() * end
    found = doses(scene, well_stirred(scene, [0.0, end]).concentration)
    assert found is not None
    # the last digit of what a cell still holds, over the little that the slowest see
    assert np.nanmax(np.abs(found[0] / z)) < 1e-6
    there = np.isfinite(found[1])
    seeing = np.unique(scene.exposure.metal.cell[class_bond_sums(scene) > 0])
    speaking = scene.exposure.metal.fraction.ravel()[seeing] >= 0.02
    assert np.array_equal(np.flatnonzero(there), seeing[speaking]) and not speaking.all()
    # cells that have lost less than 1e-4 know their dose to fewer digits: measured 2e-6
    assert np.abs(found[1][there] / z - 1).max() < 1e-5
    points = _points()
    seen = exposure(points, SURFACE, *KERNEL)[None]
    lattice = scene.lattice
    damage = damage_by_dose(points[None], seen, lattice.origin, lattice.spacing, found[1])[0]
    exact = -np.expm1(-z * ball_exposure(RADIUS - np.linalg.norm(points, axis=1), RADIUS, HORIZON))
    # facets of the ball of 1280: measured 0.011
    assert np.abs(damage - exact).max() < 0.02 < np.ptp(exact)
    outside = damage_by_dose(
        2 * points[None], np.full((1, 500), np.inf), lattice.origin, lattice.spacing, found[1]
    )
    assert (outside == 1.0).all()


def test_a_cell_loses_by_its_dose_what_it_has_lost(scene):
    metal = scene.exposure.metal
    rng = np.random.default_rng(2)
    left = rng.uniform(0.0, 1.0, scene.lattice.shape)
    seeing = np.bincount(metal.cell, metal.exposure, left.size).reshape(left.shape) > 0
    left[~seeing] = 1.0
    left.ravel()[np.flatnonzero(seeing)[:2]] = 0.0, 1.0
    found = doses(scene, scene.solid_concentration * left[None])[0].ravel()
    kept = metal.volume * np.exp(-metal.exposure * np.nan_to_num(found[metal.cell]))
    told = seeing & (metal.fraction >= 0.02)
    assert np.array_equal(told.ravel(), np.isfinite(found)) and told.sum() < seeing.sum()
    kept = np.bincount(metal.cell, kept, left.size)[told.ravel()]
    share = metal.fraction[told]
    blind = np.bincount(metal.cell, metal.volume * (metal.exposure == 0), left.size)
    blind = blind[told.ravel()] / share
    np.testing.assert_allclose(kept / share, np.maximum(left[told], blind), atol=1e-9)


def test_points_below_the_surface_are_exact_for_the_logarithm_of_the_depth():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0.3, 0.4, 3]])
    at, volume = skin_points(corners, np.array([[0, 1, 2, 3]]), 0)  # its first face: 1, 2, 3
    assert at.shape == (1, 4, 3) and volume.sum() == pytest.approx(1.0, rel=1e-14)
    lam = np.linalg.solve(np.vstack([corners.T, np.ones(4)]), np.vstack([at[0].T, np.ones(4)]))
    assert (lam > 0).all()
    assert volume[0] @ lam.T == pytest.approx(np.full(4, 0.25), abs=1e-7)
    assert (lam * volume) @ lam.T == pytest.approx((np.ones((4, 4)) + np.eye(4)) / 20, abs=1e-7)
    assert volume[0] @ np.log(lam[0]) == pytest.approx(-11 / 6, abs=1e-6)
    # two cells, in parts: only those with a face at the surface have such points
    points = np.vstack([corners, [[1.0, 2, 2]]])
    at, volume = skin_points(points, np.array([[0, 1, 2, 3], [1, 2, 4, 3]]))
    assert at.shape == (2, 32, 3) and np.ptp(volume.reshape(16, 4), axis=1).min() < 1e-12
    means = part_means(at[..., 0], volume)
    finer, parts = refine_tetrahedra(points, np.array([[0, 1, 2, 3], [1, 2, 4, 3]]))
    assert means.ravel() == pytest.approx(finer[parts][..., 0].mean(axis=1), abs=1e-7)
    assert volume.sum(axis=1) == pytest.approx(
        np.abs(cell_volumes(points, np.array([[0, 1, 2, 3], [1, 2, 4, 3]]))), rel=1e-12
    )


def test_points_below_a_facet_are_as_deep_below_the_surface(tmp_path):
    """A cell on a face of a box that lies 3 um outside of the cell's own, 5 um outside of it."""
    corners = 1e-4 * np.array([[0.2, 0.3, 1.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for gap in (3e-6, -5e-6):
        surface, triangles = box((-1e-3, -1e-3, -gap), (1e-3, 1e-3, 1e-3))
        solid = SimpleNamespace(points=surface, triangles=triangles)
        mesh = (corners, np.array([[0, 1, 2, 3]]))
        seen = skin_exposure(*mesh, solid, KERNEL, tmp_path, halvings=0)
        assert np.array_equal(skin_exposure(*mesh, solid, KERNEL, tmp_path, halvings=0), seen)
        depth = skin_points(*mesh, 0)[0][..., 2]
        below = (depth - gap * (1.0 - depth / 1e-4) + gap) / HORIZON
        flat = 2 * np.pi * (np.log(1 / below) - 1 + below)  # of a half-space
        assert seen == pytest.approx(flat, rel=1e-6) and np.ptp(depth) > 1e-5
    assert len(list(tmp_path.iterdir())) == 2


def test_where_exposures_do_not_say_what_went_there_are_no_doses(scene):
    solid = scene.solid_concentration
    whole = np.full((1, *scene.lattice.shape), solid)
    assert doses(replace(scene, dissolution="faradaic"), whole) is None
    metal = scene.exposure.metal
    deep = np.bincount(metal.cell, metal.exposure, whole[0].size).reshape(whole[0].shape) == 0
    whole[0][deep & (metal.fraction > 0)] = 0.5 * solid
    assert deep[metal.fraction > 0].any() and doses(scene, whole) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", BODIES)
def test_bodies_lose_on_the_mesh_what_their_cells_lose(name, tmp_path):
    """Ball, torus and slotted plate, mesh and lattice of `quick`, before anything is scaled."""
    from pipeline.calibration.models import Implant
    from pipeline.geometry.solids import tetrahedral_mesh
    from pipeline.scene.resolve import resolve_scene
    from pipeline.stages.damage_map import conserved

    scene = resolve_scene(["Mg-5Gd"], ["24w"], "quick")
    implant = Implant(scene, body(name), tmp_path)
    mesh = tetrahedral_mesh(implant.solid, scene.mesh.size, scene.mesh.size_fine)
    points, weights = skin_points(mesh.points, mesh.cells)
    seen = skin_exposure(mesh.points, mesh.cells, implant.solid, KERNEL)
    times = [7 * DAY, 56 * DAY, 168 * DAY]
    result = well_stirred(implant.corrosion(scene, "Mg-5Gd"), times)
    left = 1.0 - result.concentration / result.scene.solid_concentration
    lattice = implant.lattice
    held = np.where(result.scene.metal, result.scene.metal_fraction, 0.0) * lattice.spacing[0] ** 3
    for field, dose in zip(left, doses(result.scene, result.concentration), strict=True):
        damage = damage_by_dose(points, seen, lattice.origin, lattice.spacing, dose)
        _, _, lost = conserved(damage, weights, float((field * held).sum()))
        assert lost["lattice_lost_volume"] > 0.02 * implant.solid.volume
        # measured at most 0.8 (ball), 1.0 (torus) and -1.0 % (plate, after a week)
        assert abs(lost["relative_difference"]) < 0.012
        print(name, lost["relative_difference"], lost["lattice_lost_volume"] / implant.solid.volume)


@pytest.mark.slow
def test_the_screw_by_exposures_is_the_same_on_two_lattices(tmp_path):
    """Mg-5Gd after 24 weeks on 7,320 cells: what carries in layers of 0.1 mm (MEASURED.md)."""
    from fem.quadrature import sampling_points
    from pipeline.calibration.models import Implant
    from pipeline.geometry.solids import tetrahedral_mesh
    from pipeline.scene.resolve import resolve_scene
    from pipeline.stages.by_nodes import by_nodes
    from pipeline.stages.damage_map import conserved, conserving_map

    solid, carried, seen, missed = None, {}, None, {}
    for ratio in (2, 3):
        whole = resolve_scene(["Mg-5Gd"], ["24w"], "quick", spacing=HORIZON / ratio)
        implant = Implant(whole, solid, tmp_path)
        solid, lattice = implant.solid, implant.lattice
        if seen is None:
            mesh = tetrahedral_mesh(solid, whole.mesh.size, whole.mesh.size_fine)
            evenly = sampling_points(mesh.points, mesh.cells)
            points, weights = skin_points(mesh.points, mesh.cells)
            seen = skin_exposure(mesh.points, mesh.cells, solid, KERNEL)
            ends = mesh.points[:, 2].min(), mesh.points[:, 2].max()
        result = well_stirred(implant.corrosion(whole, "Mg-5Gd"), [7 * DAY, 56 * DAY, 168 * DAY])
        dose, nodes = doses(result.scene, result.concentration), by_nodes(result, implant.metal)
        place = (lattice.origin, lattice.spacing)
        for number in range(3):
            by_node, _, lost = conserving_map(
                *evenly, *place, nodes.concentration[number], implant.metal,
                nodes.scene.solid_concentration, nodes.scene.capacity(),
            )  # fmt: skip
            by_seen = damage_by_dose(points, seen, *place, dose[number])
            by_seen, _, found = conserved(by_seen, weights, lost["lattice_lost_volume"])
            missed[ratio, number] = found["relative_difference"]
            if number < 2:
                continue
            maps = {"nodes": (*evenly, by_node), "exposures": (points, weights, by_seen)}
            for name, (at, held, damage) in maps.items():
                edges = np.linspace(*ends, 41)
                left = held * (1.0 - 1.5 * np.minimum(damage, 2 / 3))
                volume = np.histogram(at[..., 2], edges, weights=held)[0]
                layers = np.histogram(at[..., 2], edges, weights=left)[0] / volume
                carried[ratio, name] = layers[7:33].min(), layers[-1]
                print(ratio, name, carried[ratio, name])
    # after 1, 8 and 24 weeks -0.7, 0.1 and 0.2 % on a third of the horizon, -0.8, 0.1 and 0.1 % on
    # half of it; points spread evenly over a cell miss 4.9, 1.5 and 0.1 %
    assert max(map(abs, missed.values())) < 0.01
    assert carried[3, "exposures"] == pytest.approx((0.7488, 0.1714), abs=5e-4)
    assert carried[2, "exposures"] == pytest.approx(carried[3, "exposures"], abs=2e-3)
    assert carried[3, "nodes"] == pytest.approx((0.7337, 0.1284), abs=5e-4)
