"""The march: conservation, bounds, exact limits, orders in time, interruption."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import ball, box_lattice
from peri.engine.march.marching import TimeStepping
from tests.peri.corrosion.scenes import WEEK, clean_liquid_loss, pin

LIQUIDS = {
    # C_sat, D_liq, D_int: clean; full of solute; fast, so that nodes dissolve
    "clean": (6.6, 1e-9, 1e-15),
    "saturating": (66.0, 1e-13, 1e-15),
    "dissolving": (2312.88, 1e-10, 1e-13),
}
SCHEMES = {
    "backward_euler": TimeStepping("backward_euler", step=0.4 * WEEK),
    "sdirk2": TimeStepping("sdirk2", step=0.4 * WEEK),
    "controlled": TimeStepping("sdirk2"),
    "forward_euler": TimeStepping("forward_euler"),
}


def check_invariants(scene, result):
    """What holds for every scene and step."""
    solid, saturated = scene.highest_concentration, scene.saturation_concentration
    history = result.history
    assert np.isfinite(result.concentration).all()
    # metal + liquid + released: measured at most 3e-11 (where the liquid is too clean to close
    # the balance of a step with), mostly 1e-15
    assert np.abs(history["balance_error"]).max() <= 1e-10
    assert 0 <= history["volume_loss"].min() and history["volume_loss"].max() <= 1
    assert result.concentration.min() >= -1e-12 * solid
    assert result.concentration.max() <= solid * (1 + 1e-12)
    # the stage knows V_L to 1e-9: measured -3.3e-11 in liquid that is full
    assert np.diff(history["volume_loss"]).min(initial=0.0) >= -1e-9
    if scene.saturation == "complementarity":
        liquid = result.concentration[~result.metal]
        # solver tolerance beyond the metal's reach: measured 3.2e-10
        assert liquid.max(initial=0.0) <= saturated * (1 + 1e-8)


CATALOGUE = [
    pytest.param(stepping, liquid, saturation, boundary, id=f"{n}-{liquid}-{saturation}-{boundary}")
    for n, stepping in SCHEMES.items()
    for liquid in LIQUIDS
    for saturation in ("complementarity", "as_published", "none")
    for boundary in ("refreshed", "no_flux")
    if not (saturation == "as_published" and stepping.scheme == "sdirk2")  # refused, see below
]


@pytest.mark.parametrize(("stepping", "liquid", "saturation", "boundary"), CATALOGUE)
def test_conservation_and_bounds(stepping, liquid, saturation, boundary):
    saturated, liquid_diffusivity, rate = LIQUIDS[liquid]
    scene = pin(
        2,
        14,
        boundary=boundary,
        saturation=saturation,
        saturation_concentration=saturated,
        liquid_diffusivity=liquid_diffusivity,
        interface_diffusivity=rate,
        kinetics=ConstantRate() if liquid == "dissolving" else VolumeLossLaw(0.1),
    )
    end = 2 * WEEK
    if stepping.scheme == "forward_euler":
        end = min(end, 300.0 / BiMaterial(scene).fastest_rate())
    result = corrode(scene, [0.3 * end, end], stepping)
    check_invariants(scene, result)
    history = result.history
    assert result.volume_loss[-1] > 0 and history["time"][-1] == end
    if boundary == "no_flux":
        assert history["released_amount"][-1] == 0.0
    elif liquid != "saturating" and stepping.scheme != "forward_euler":
        assert history["released_amount"][-1] > 0.0
    if liquid == "saturating" and saturation == "complementarity":
        assert history["saturated_nodes"].max() > 0 or stepping.scheme == "forward_euler"
    if liquid == "dissolving" and boundary == "refreshed" and stepping.scheme != "forward_euler":
        assert history["dissolved_nodes"].sum() > 0


@pytest.mark.parametrize("dimension", [1, 3])
def test_conservation_in_other_dimensions_and_with_cut_cells(dimension):
    plain = pin(dimension, 10)
    fraction = np.where(plain.metal, 0.8, 0.1)
    scene = pin(dimension, 10, metal_fraction=fraction, interface_diffusivity=1e-14)
    result = corrode(scene, [WEEK])
    check_invariants(scene, result)
    initial = fraction.sum() * scene.lattice.cell_volume * scene.solid_concentration
    assert result.history["metal_amount"][0] == pytest.approx(initial, rel=1e-13)  # round-off
    assert result.volume_loss[-1] > 0.05


def test_clean_liquid_against_the_exact_limit():
    """The well-stirred oracle to 1e-6 of V_L = 4 and 11 %, and orders in time."""
    scene = pin(saturation_concentration=0.66, liquid_diffusivity=1e-7)
    times = [WEEK, 8 * WEEK]
    exact = clean_liquid_loss(scene, times)
    assert 0.04 < exact[0] < 0.05 and 0.11 < exact[1] < 0.12
    errors = {}
    for scheme, steps in (("backward_euler", (32, 64, 128)), ("sdirk2", (32, 64, 400))):
        errors[scheme] = np.array([
            corrode(scene, times, TimeStepping(scheme, step=8 * WEEK / n)).volume_loss - exact
            for n in steps
        ])  # fmt: skip
    # measured 0.917, 0.972 and 0.955, 0.985 (backward Euler), 1.985 and 1.988 (SDIRK2)
    first = -np.diff(np.log2(np.abs(errors["backward_euler"])), axis=0)
    assert np.all((first > 0.9) & (first < 1.02))
    second = np.log2(np.abs(errors["sdirk2"][0] / errors["sdirk2"][1]))
    assert np.all((second > 1.9) & (second < 2.1))
    # backward Euler at 10.5 h: measured -8.5e-4, -4.1e-4
    assert np.abs(errors["backward_euler"][-1]).max() < 1e-3
    # SDIRK2 at 3.4 h: measured 6.5e-7, 1.7e-7
    assert np.abs(errors["sdirk2"][-1]).max() < 1e-6


def test_controlled_steps_against_the_exact_limit():
    """The default control: V_L within 0.1 % of itself in a few dozen steps."""
    scene = pin(saturation_concentration=0.66, liquid_diffusivity=1e-7)
    times = [WEEK, 8 * WEEK]
    exact = clean_liquid_loss(scene, times)
    errors = []
    for change in (0.05, 0.01):
        result = corrode(scene, times, TimeStepping(rate_change=change))
        errors.append(np.abs(result.volume_loss / exact - 1).max())
        assert 8 < result.history["time"].size < 400
    # measured 8.2e-4 in 17 steps, 4.9e-5 in 69
    assert errors[0] < 1e-3 and errors[1] < 0.25 * errors[0]


STEFAN_LAMBDA = 0.13516
STEEL = {
    "solid_concentration": 143e3,
    "saturation_concentration": 5.1e3,
    "liquid_diffusivity": 8.5e-10,
}


def stefan_front(spacing, rate_ratio, end=100.0):
    """Depth of the front from the mass lost, mouth held at zero, horizon of two spacings."""
    lattice = box_lattice((-2 * spacing,), (1.2e-4,), spacing)
    scene = CorrosionScene(
        lattice,
        2 * spacing,
        lattice.axis(0) > 0,
        interface_diffusivity=rate_ratio * STEEL["liquid_diffusivity"],
        **STEEL,
    )
    result = corrode(scene, [end], TimeStepping("backward_euler", step=1.0))
    check_invariants(scene, result)
    amount = result.history["metal_amount"]
    return (amount[0] - amount[-1]) / scene.solid_concentration


def test_stefan_dissolution_of_steel():
    """Front 2 lambda sqrt(D t) of saturated steel with the mouth held at zero, after 100 s."""
    exact = 2 * STEFAN_LAMBDA * np.sqrt(STEEL["liquid_diffusivity"] * 100.0)
    assert exact == pytest.approx(78.8e-6, rel=1e-3)
    errors = np.array([stefan_front(h, 1e3) / exact - 1 for h in (1e-5, 5e-6, 2.5e-6)])
    # measured 0.160, 0.0748, 0.0331 (0.0908, 0.0444, 0.0206 after 300 s): the front and the
    # mouth are as thick as the horizon of two spacings
    observed = -np.diff(np.log2(errors))
    assert np.all((observed > 0.9) & (observed < 1.3))  # measured 1.10, 1.18
    assert 0.025 < errors[-1] < 0.04


def test_interface_diffusivity_to_infinity_is_the_stefan_problem():
    """With growing D_int the front stops depending on it."""
    fronts = np.array([stefan_front(5e-6, ratio) for ratio in (0.1, 10.0, 1e3, 1e5)])
    assert np.all(np.diff(fronts[:3]) > 0)
    changes = np.abs(np.diff(fronts)) / fronts[-1]
    # measured 5.6e-2, 6.2e-4, 1.1e-5
    assert changes[0] > 0.01 and changes[1] < 2e-3 and changes[2] < 1e-4


def test_saturation_and_the_step():
    """Saturation against the step: V_L after 14 days for steps of 48, 12 and 3 h."""
    losses = {}
    for saturation in ("complementarity", "as_published"):
        scene = pin(
            saturation=saturation,
            saturation_concentration=6.6,
            liquid_diffusivity=1e-12,
            kinetics=ConstantRate(),
        )
        losses[saturation] = np.array([
            corrode(scene, [2 * WEEK], TimeStepping("backward_euler", step=3600.0 * h))
            .volume_loss[-1]
            for h in (48, 12, 3)
        ])  # fmt: skip
    # measured 3.887, 3.891, 3.892 %
    assert np.ptp(losses["complementarity"]) < 2e-3 * losses["complementarity"][-1]
    assert 0.035 < losses["complementarity"][-1] < 0.042
    # Algorithm 1: measured 8.20, 5.28, 3.74 %, and falling on
    assert np.all(np.diff(losses["as_published"]) < -0.01)


def test_large_steps_keep_the_kinetics():
    """A step that dissolves more than l: once the rate and V_L settled on a wrong pair."""
    scene = pin(
        saturation_concentration=231.0, liquid_diffusivity=1e-11, interface_diffusivity=1e-13
    )
    losses = [
        corrode(scene, [2 * WEEK], TimeStepping("backward_euler", step=3600.0 * h)).volume_loss[-1]
        for h in (336, 48, 12)
    ]
    # measured 18.2, 23.1, 24.0 %: backward Euler lags, and only that
    assert 0.15 < losses[0] < losses[1] < losses[2] < 0.26


def test_outputs_come_at_their_times_from_one_march():
    scene = pin(2, 12)
    times = [0.0, 1.0, 0.7 * WEEK, WEEK]
    result = corrode(scene, times, TimeStepping("sdirk2", step=0.3 * WEEK))
    assert result.concentration.shape == (4, 12, 12)
    assert np.all(np.isin(times, result.history["time"]))
    np.testing.assert_array_equal(
        result.concentration[0], np.where(scene.metal, scene.solid_concentration, 0.0)
    )
    for n, time in enumerate(times):
        row = np.flatnonzero(result.history["time"] == time)[0]
        assert result.volume_loss[n] == result.history["volume_loss"][row]
    assert np.all(np.diff(result.volume_loss) > 0)


def test_progress_is_reported():
    seen = []
    corrode(
        pin(2, 12),
        [WEEK],
        TimeStepping("sdirk2", step=0.25 * WEEK),
        progress=lambda fraction, text: seen.append((fraction, text)),
    )
    assert [fraction for fraction, _ in seen] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert seen[-1][1].startswith("day 7.0, volume loss")


class Interrupted(Exception):
    """Raised by the test's progress to stop a march."""


def interrupt_after(fraction):
    def progress(done, text):
        if done > fraction:
            raise Interrupted

    return progress


@pytest.mark.parametrize("liquid", LIQUIDS)
@pytest.mark.parametrize(
    "stepping",
    [TimeStepping("sdirk2"), TimeStepping("backward_euler", step=0.05 * WEEK)],
    ids=["sdirk2", "backward_euler"],
)
def test_an_interrupted_march_goes_on_with_the_same_numbers(liquid, stepping, tmp_path):
    saturated, liquid_diffusivity, rate = LIQUIDS[liquid]
    scene = pin(
        2,
        14,
        saturation_concentration=saturated,
        liquid_diffusivity=liquid_diffusivity,
        interface_diffusivity=rate,
    )
    times = [0.2 * WEEK, 0.7 * WEEK, WEEK]
    whole = corrode(scene, times, stepping)
    path = tmp_path / "state.h5"
    with pytest.raises(Interrupted):
        corrode(
            scene,
            times,
            stepping,
            progress=interrupt_after(0.4),
            checkpoint=path,
            checkpoint_every=0.0,
        )
    assert path.exists()
    resumed_at = []
    again = corrode(
        scene,
        times,
        stepping,
        progress=lambda fraction, text: resumed_at.append(fraction),
        checkpoint=path,
        resume=True,
    )
    assert resumed_at[0] > 0.1  # it did not start over
    for name in ("metal", "concentration", "volume_loss"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    for name, values in whole.history.items():
        np.testing.assert_array_equal(again.history[name], values)


def test_a_checkpoint_of_another_march_is_refused(tmp_path):
    scene, path = pin(2, 12), tmp_path / "state.h5"
    stepping = TimeStepping("sdirk2", step=0.25 * WEEK)
    corrode(scene, [WEEK], stepping, checkpoint=path, checkpoint_every=0.0)
    assert path.exists() and not list(tmp_path.glob("*.tmp"))
    corrode(scene, [WEEK], stepping, checkpoint=path, resume=True)
    moved = scene.metal.copy()
    moved[np.unravel_index(moved.argmax(), moved.shape)] = False
    others = [
        (pin(2, 12, interface_diffusivity=2e-15), [WEEK], stepping),
        (pin(2, 12, metal=moved), [WEEK], stepping),
        (pin(2, 12, ratio=3), [WEEK], stepping),
        (scene, [0.5 * WEEK, WEEK], stepping),
        (scene, [WEEK], TimeStepping("backward_euler", step=0.25 * WEEK)),
    ]
    for other, times, how in others:
        with pytest.raises(ValueError, match="belongs to another scene or other settings"):
            corrode(other, times, how, checkpoint=path, resume=True)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([], "at least one"),
        ([-1.0], "not negative"),
        ([float("nan")], "finite"),
        ([1.0, float("inf")], "finite"),
        ([2.0, 1.0], "ascend"),
        ([1.0, 1.0], "ascend"),
    ],
)
def test_bad_times_are_refused(times, message):
    with pytest.raises(ValueError, match=f"times: .*{message}"):
        corrode(pin(1, 10), times)


def held_disc(saturation_concentration):
    """A disc whose liquid is a layer of the horizon's width, all of it held at zero."""
    spacing, radius = 100e-6, 0.6e-3
    lattice = box_lattice((-0.8e-3,) * 2, (0.8e-3,) * 2, spacing)
    return CorrosionScene(
        lattice,
        2 * spacing,
        metal=ball(lattice, (0.0, 0.0), radius),
        domain=ball(lattice, (0.0, 0.0), radius + 2 * spacing),
        solid_concentration=1000.0,
        saturation_concentration=saturation_concentration,
        liquid_diffusivity=8e-9,
        interface_diffusivity=1e-11,
    )


def test_explicit_step_follows_its_limit_as_nodes_dissolve():
    """Without free liquid at the start only the metal limits the step: 875 s, later 0.61 s."""
    scene, times = held_disc(500.0), [1000.0, 1400.0]
    problem = BiMaterial(scene)
    at_start = 1.0 / problem.fastest_rate()
    assert not problem.free.any() and problem.metal.any() and at_start > 500.0
    result = corrode(scene, times, TimeStepping("forward_euler"))
    check_invariants(scene, result)
    steps, dissolved = result.history["step"][1:], result.history["dissolved_nodes"][1:]
    first = int(np.flatnonzero(dissolved)[0])
    assert dissolved.sum() >= 20
    assert steps[: first + 1].min() > 10.0 and steps[first + 1 :].max() < 1.0
    problem.metal = problem.sum.pad(result.metal[-1]) > 0
    problem.update_phase()
    assert dissolved[-1] == 0 and steps[-1] <= 1.0 / problem.fastest_rate()
    reference = corrode(scene, times, TimeStepping("sdirk2", rate_change=0.01))
    # measured 0.0019 and 0.0012 of V_L = 45 and 59 %, from the steps before a node dissolves
    np.testing.assert_allclose(result.volume_loss, reference.volume_loss, rtol=0.005)


def test_fixed_explicit_step_is_refused_when_the_limit_falls_below_it():
    scene = held_disc(500.0)
    step = 0.1 / BiMaterial(scene).fastest_rate()
    with pytest.raises(ValueError, match=r"stability limit of 0\.\d+ s at [1-9]"):
        corrode(scene, [1000.0], TimeStepping("forward_euler", step=step))


def test_explicit_step_where_only_the_metal_limits_it():
    """The limit of stability alone takes one step and errs by 16 %."""
    scene, times = held_disc(1e-6), [360.0]
    exact = clean_liquid_loss(scene, times)
    errors = []
    for change in (0.05, 0.025):
        result = corrode(scene, times, TimeStepping("forward_euler", rate_change=change))
        assert result.history["dissolved_nodes"].sum() == 0
        errors.append(result.volume_loss[0] / exact[0] - 1)
    assert 0 < errors[0] < 0.02  # measured 0.0146
    assert 1.7 < errors[0] / errors[1] < 2.3  # first order; measured 1.91


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6])
def test_no_second_order_step_passes_the_metal(ratio):
    """Closed liquid without a bound, steps of 1,000 stable ones: 60 % above C_solid unchecked."""
    scene = pin(
        1,
        6,
        saturation="none",
        boundary="no_flux",
        kinetics=ConstantRate(),
        liquid_diffusivity=1e-10,
        interface_diffusivity=1e-10 * ratio,
    )
    step = 1e3 / BiMaterial(scene).fastest_rate()
    result = corrode(scene, [step, 2 * step, 3 * step], TimeStepping("sdirk2", step=step))
    check_invariants(scene, result)
    assert result.history["step"].max() == step and result.volume_loss[-1] > 0.1


def test_other_refusals():
    with pytest.raises(ValueError, match="scheme: 'sdirk2' with saturation 'as_published'"):
        corrode(pin(1, 10, saturation="as_published"), [1.0])
    with pytest.raises(ValueError, match="step: controlled, with saturation 'as_published'"):
        corrode(pin(1, 10, saturation="as_published"), [1.0], TimeStepping("backward_euler"))
    with pytest.raises(ValueError, match="step: .* exceeds the explicit stability limit"):
        corrode(pin(1, 10), [1e9], TimeStepping("forward_euler", step=1e8))
