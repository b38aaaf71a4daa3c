"""Rate classes of a run: shares of the domain, what is kept between runs, and a small march."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.run import corrode
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from pipeline.geometry.surface import solid_of_surface
from pipeline.planning.plan import scene_omissions
from pipeline.scene.classes import one_rate_because
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import SceneError
from pipeline.stages import corrosion as stage
from pipeline.stages.by_nodes import by_nodes
from pipeline.stages.exposure import share_of_ball, share_of_cylinder, solid_exposure
from tests.peri.bodies import ball

LATTICE = Lattice((-1.13, -1.02, -1.07), (0.11, 0.11, 0.11), (21, 20, 21))


def small_ball(radius=3e-4):
    surface = ball(radius, 3, scaled=True)
    return solid_of_surface("ball", surface.vertices, surface.facets)


def test_shares_of_the_domain():
    inside = share_of_ball(LATTICE, (0.01, -0.02, 0.0), 0.8)
    assert inside.min() == 0 and inside.max() == 1 and ((0 < inside) & (inside < 1)).any()
    volume = inside.sum() * LATTICE.cell_volume
    assert volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=1e-4)
    drum = share_of_cylinder(LATTICE, (0.01, -0.02, 0.0), 0.7, 1.33)
    assert drum.sum() * LATTICE.cell_volume == pytest.approx(np.pi * 0.49 * 1.33, rel=1e-4)


def test_the_surface_s_part_is_kept(tmp_path, monkeypatch):
    solid, spacing = small_ball(), 1e-4
    lattice = Lattice((-5e-4,) * 3, (spacing,) * 3, (11, 11, 11))
    fraction = share_of_ball(lattice, (0.0, 0.0, 0.0), 3e-4)
    arguments = (solid, lattice, 2e-4, fraction, 2, 0.0, "constant", tmp_path / "new")

    first = solid_exposure(*arguments)
    monkeypatch.setattr("pipeline.stages.exposure.cell_exposure", None)
    again = solid_exposure(*arguments)
    assert np.array_equal(first.metal.exposure, again.metal.exposure)
    assert np.array_equal(first.liquid, again.liquid)
    with pytest.raises(TypeError):  # another lattice is another file
        solid_exposure(solid, replace(lattice, origin=(0.0,) * 3), *arguments[2:])


def test_scene_with_classes():
    scene = resolve_scene(["Mg-5Gd"], ["0w", "8w"], "quick")
    settings = replace(scene.corrosion, classes=3)
    scene = replace(scene, corrosion=settings)
    solid = small_ball()
    region = stage.liquid_domain(scene, solid.points)
    lattice, domain = stage.domain_lattice(scene, region)
    metal, fraction = stage.metal_of(scene, lattice, solid)
    exposure = stage.exposure_of(scene, lattice, region, solid, fraction)
    march = stage.corrosion_scene(scene, "Mg-5Gd", lattice, domain, metal, fraction, exposure)
    assert np.array_equal(march.metal, fraction > 0)
    assert march.capacity()[march.metal].sum() == pytest.approx(fraction.sum())
    assert exposure.held.max() == 1 and (exposure.held <= exposure.inside).all()
    result = corrode(march, [0.0, 5 * 86400.0], TimeStepping("sdirk2", rate_change=0.2))
    nodes = by_nodes(result, metal)
    assert np.array_equal(nodes.scene.metal, metal)
    lost = [
        (r.scene.capacity() * (r.scene.solid_concentration - r.concentration[1]))[r.scene.metal]
        for r in (result, nodes)
    ]
    # Measured: round-off; elsewhere a node may stand for its least, a twentieth of a cell.
    assert lost[1].sum() == pytest.approx(lost[0].sum(), rel=1e-4)
    outside = march.metal & ~metal
    assert outside.any() and nodes.concentration[1][outside].max() <= march.saturation_concentration
    assert (nodes.concentration[0][metal] == march.solid_concentration).all()
    assert replace(settings, dissolution="faradaic", saturation="none").classes
    with pytest.raises(SceneError, match="saturation where there are rate classes"):
        replace(settings, saturation="none")
    with pytest.raises(SceneError, match="rate classes"):
        replace(settings, classes=9)
    assert stage.exposure_of(
        replace(scene, corrosion=replace(settings, classes=0)), lattice, region, solid, fraction
    ) is None  # fmt: skip


def test_auto_takes_classes_where_the_scene_allows_them():
    def scene(**corrosion):
        return resolve_scene(["Mg-5Gd"], ["0w", "8w"], "quick", corrosion=corrosion)

    taken = scene()
    assert taken == scene(classes="auto") and taken.corrosion.classes == 3
    assert one_rate_because(taken) == ""
    nodes = scene(classes=0)
    assert nodes.corrosion == replace(taken.corrosion, classes=0)
    plain = scene(classes="auto", scheme="forward_euler")
    assert plain.corrosion.classes == 0
    assert "time scheme where there are rate classes is 'forward_euler'" in one_rate_because(plain)
    assert "as --classes 0 asks" in one_rate_because(nodes)
    unmoved = resolve_scene(["Mg-5Gd"], ["0w"])
    assert unmoved.corrosion.classes == 0 and "only time zero" in one_rate_because(unmoved)
    left_out = [entry.what for entry in scene_omissions(nodes)]
    assert "the spread of the rate within a cell" in left_out
    assert "the spread of the rate within a cell" not in [
        entry.what for entry in scene_omissions(taken)
    ]
