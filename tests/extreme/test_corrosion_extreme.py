"""Stiff and degenerate scenes: bounds, balance, a finite answer or a clear refusal."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.nodes.problem import CorrosionProblem
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from tests.peri.corrosion.scenes import pin
from tests.peri.corrosion.test_run import check_invariants

YEAR = 365.25 * 86400.0
SOLID = 66082.4


def march(scene, times, stepping=None):
    result = corrode(scene, times, stepping)
    check_invariants(scene, result)
    return result


def box_scene(metal, spacing=None, horizon=2e-4, **options):
    """A scene on an array of metal nodes, 100 um apart."""
    metal = np.asarray(metal, bool)
    lattice = Lattice(
        (0.0,) * metal.ndim, (1e-4,) * metal.ndim if spacing is None else spacing, metal.shape
    )
    settings = {
        "solid_concentration": SOLID,
        "saturation_concentration": 0.035 * SOLID,
        "liquid_diffusivity": 1e-9,
        "interface_diffusivity": 1e-14,
        **options,
    }
    return CorrosionScene(lattice, horizon, metal, **settings)


@pytest.mark.parametrize("boundary", ["refreshed", "no_flux"])
@pytest.mark.parametrize("saturated", [1e-5, 0.33])
@pytest.mark.parametrize("liquid", [1e-12, 1e-7])
@pytest.mark.parametrize("interface", [1e-17, 1e-12])
def test_corners_of_the_parameters(interface, liquid, saturated, boundary):
    """D_int, D_liq and C_sat at the ends of their ranges; 0 to 10 years, controlled steps."""
    scene = pin(
        2,
        10,
        boundary=boundary,
        interface_diffusivity=interface,
        liquid_diffusivity=liquid,
        saturation_concentration=saturated * SOLID,
    )
    result = march(scene, [0.0, 86400.0, 10 * YEAR])
    assert result.volume_loss[0] == 0.0 < result.volume_loss[1]
    # Full liquid: V_L stands still to the solver's tolerance, measured -5e-13, or to what the
    # rounding of the bonds' sums hides in a step of five years (3e-6 of the level with the largest
    # D_liq, measured 4e-7).
    bonds = CorrosionProblem(scene).discrete.largest_sum
    hidden = 4 * np.finfo(float).eps * liquid * bonds * result.history["step"].max()
    assert result.volume_loss[1] * (1 - hidden) <= result.volume_loss[2] + 1e-11


@pytest.mark.parametrize("scheme", ["backward_euler", "sdirk2"])
@pytest.mark.parametrize("step", [1.0, YEAR])
@pytest.mark.parametrize("interface", [1e-17, 1e-12])
def test_steps_of_a_second_and_a_year(step, scheme, interface):
    """D_liq dt/dx^2 from 0.1 to 3e8."""
    scene = pin(2, 10, interface_diffusivity=interface, liquid_diffusivity=1e-7)
    result = march(scene, [5 * step], TimeStepping(scheme, step=step))
    assert result.history["step"].max() == pytest.approx(step)
    assert result.volume_loss[-1] > 0


def test_a_diffusivity_jump_of_a_hundred_million():
    scene = pin(2, 10, interface_diffusivity=1e-15, liquid_diffusivity=1e-7)
    assert scene.liquid_diffusivity / scene.interface_diffusivity == pytest.approx(1e8)
    assert march(scene, [YEAR]).volume_loss[-1] > 0.05


@pytest.mark.parametrize("law", [ConstantRate(), VolumeLossLaw(0.005)])
def test_immersion_of_zero_and_ten_years(law):
    scene = pin(2, 10, kinetics=law)
    result = march(scene, [0.0])
    assert result.volume_loss[0] == 0.0 and result.history["time"].size == 1
    np.testing.assert_array_equal(result.concentration[0], scene.metal * SOLID)
    later = march(scene, [10 * YEAR]).volume_loss[0]
    assert 0.02 < later <= 1.0


@pytest.mark.parametrize("saturation", ["complementarity", "none"])
def test_complete_dissolution(saturation):
    """Nothing is left, and the march goes on past the last node."""
    scene = pin(
        2,
        10,
        saturation=saturation,
        kinetics=ConstantRate(),
        interface_diffusivity=1e-11,
        liquid_diffusivity=1e-9,
    )
    result = march(scene, [YEAR / 12, YEAR], TimeStepping("backward_euler", step=YEAR / 120))
    assert result.volume_loss[-1] == 1.0 and not result.metal[-1].any()
    assert result.history["dissolved_nodes"].sum() == scene.metal.sum()
    # all of it has left through the refreshed layer
    released, initial = (
        result.history[n][i] for n, i in (("released_amount", -1), ("metal_amount", 0))
    )
    assert released == pytest.approx(initial, rel=1e-6)


SHAPES = {
    "isolated node in 3D": np.pad(np.ones((1, 1, 1)), 3),
    "two nodes apart": np.pad(np.array([[1, 0, 0, 0, 1]]), 3),
    "wall one node thick": np.pad(np.ones((1, 9)), ((4, 4), (0, 0))),
    "cavity": np.pad(1 - np.pad(np.ones((2, 2)), 3), 3),
    "lattice of one node": np.ones((1,)),
    "one liquid node": np.zeros((1, 1)),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("boundary", ["refreshed", "no_flux"])
def test_odd_shapes(name, boundary):
    scene = box_scene(SHAPES[name], boundary=boundary)
    result = march(scene, [3600.0, YEAR])
    alone = scene.metal.all() or not scene.metal.any()
    assert (result.volume_loss[-1] == 0.0) == alone


@pytest.mark.parametrize("boundary", ["refreshed", "no_flux"])
def test_no_liquid(boundary):
    scene = box_scene(np.ones((5, 6)), boundary=boundary)
    result = march(scene, [YEAR])
    np.testing.assert_array_equal(result.concentration[0], SOLID)


def test_no_metal():
    scene = box_scene(np.zeros((5, 6, 4)))
    result = march(scene, [YEAR])
    assert result.volume_loss[0] == 0.0 and not result.concentration.any()


def test_no_domain():
    scene = box_scene(np.zeros((4, 4)), domain=np.zeros((4, 4), bool))
    assert not march(scene, [YEAR]).concentration.any()


def test_no_rate():
    scene = pin(2, 10, interface_diffusivity=0.0)
    result = march(scene, [YEAR])
    np.testing.assert_array_equal(result.concentration[0], scene.metal * SOLID)


@pytest.mark.parametrize("horizon", [(2e-4, 5e-3), 5e-3])
def test_spacing_ratio_of_25(horizon):
    """An ellipsoid that follows the cells, and a sphere that sees 50 of them along one axis."""
    metal = np.zeros((30, 7), bool)
    metal[10:20, 2:5] = True
    scene = box_scene(metal, (1e-4, 2.5e-3), horizon)
    result = march(scene, [YEAR / 50])
    assert 0.001 < result.volume_loss[0] < 1


@pytest.mark.parametrize("ratio", [1, 2, 3, 4, 6, 8])
def test_horizon_ratio_of_1_to_8(ratio):
    metal = np.zeros((24, 24), bool)
    metal[9:15, 9:15] = True
    scene = box_scene(metal, horizon=ratio * 1e-4, boundary="no_flux")
    result = march(scene, [YEAR / 50])
    assert 0.001 < result.volume_loss[0] < 1


def test_the_table_of_extremes_covers_every_corner():
    from tests.extreme import corrosion_table

    names = " ".join(name for name, *_ in corrosion_table.cases())
    for corner in ("isolated", "one node thick", "no liquid", "no metal", "25:1", "1e8",
                   "10 years", "0 s", "1 year", "1e-05", "0.33", "complete"):  # fmt: skip
        assert corner in names
