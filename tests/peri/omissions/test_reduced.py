"""Corrosion in clean liquid: the quadrature against the scalar equation, derivatives by Taylor."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from peri.corrosion.kinetics import ButlerVolmer, ConstantRate, Exposed, Tafel, VolumeLossLaw
from peri.corrosion.rate_laws import KINETICS
from peri.omissions.reduced import RateFactor, ReducedCorrosion, factor_of
from tests.peri.corrosion.scenes import WEEK, clean_liquid_loss, pin

DAY = 86400.0
DIFFUSIVITY = 3e-15


def volume_loss_law(length):
    """10^(-V/l) and its slope."""

    def factor(loss):
        value = 10.0 ** (-loss / length)
        return RateFactor(value, {"length": value * math.log(10) * loss / length**2})

    return factor


def bond_sums(count=40, seed=0):
    """Bond sums over three decades, volumes, and as much metal that no liquid sees."""
    random = np.random.default_rng(seed)
    sums = 10.0 ** random.uniform(5.0, 8.0, count)
    sums[::5] = 0.0
    return sums, random.uniform(0.5, 1.0, count)


def by_integration(reduced, times, diffusivity, factor):
    """V_L by an integrator of ordinary differential equations, to 1e-12."""
    solution = solve_ivp(
        lambda t, z: [diffusivity * float(factor(reduced.loss_at(z[0])).value)],
        (0.0, times[-1]),
        [0.0],
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-12 / reduced.bond_sums[-1],
    )
    return reduced.loss_at(solution.y[0])


@pytest.mark.parametrize("length", [1e6, 0.5, 0.05, 0.01])
@pytest.mark.parametrize("scale", [1.0, 1.05])
def test_against_integration_in_time(length, scale):
    reduced = ReducedCorrosion(*bond_sums(), scale)
    times = DAY * np.array([0.01, 1.0, 30.0, 1000.0])
    found = reduced.volume_loss(times, DIFFUSIVITY, volume_loss_law(length))
    exact = by_integration(reduced, times, DIFFUSIVITY, volume_loss_law(length))
    assert exact[0] > 1e-6 and exact[-1] > 0.02
    # measured 3e-11 at worst
    np.testing.assert_allclose(found.value, exact, rtol=1e-9)
    np.testing.assert_allclose(found.value, reduced.loss_at(found.exposure), rtol=1e-12)


@pytest.mark.parametrize("name", ["diffusivity", "length"])
def test_derivatives_by_taylor_slopes(name):
    reduced = ReducedCorrosion(*bond_sums())
    times = DAY * np.array([1.0, 30.0, 300.0])
    base = {"diffusivity": DIFFUSIVITY, "length": 0.1}

    def loss(**changed):
        values = {**base, **changed}
        law = volume_loss_law(values["length"])
        return reduced.volume_loss(times, values["diffusivity"], law)

    at = loss()
    steps = base[name] * np.array([0.1, 0.05, 0.025, 0.0125])
    left = np.array([
        np.abs(loss(**{name: base[name] + h}).value - at.value - h * at.slopes[name]).max()
        for h in steps
    ])  # fmt: skip
    assert np.abs(at.slopes[name]).max() * steps[-1] > 10 * left[-1]
    slopes = np.log2(left[:-1] / left[1:])
    # measured 1.93 to 1.98, rising towards 2
    assert np.all((slopes > 1.9) & (slopes < 2.1))


def test_all_that_liquid_sees_goes_and_the_rest_stays():
    sums, volumes = bond_sums()
    reduced = ReducedCorrosion(sums, volumes)
    law = volume_loss_law(1e6)
    end = reduced.volume_loss(DAY * np.array([1e8, 1e12]), DIFFUSIVITY, law)
    assert reduced.largest_loss() == pytest.approx(volumes[sums > 0].sum() / volumes.sum())
    np.testing.assert_allclose(end.value, reduced.largest_loss(), rtol=1e-12)
    assert not end.slopes["diffusivity"].any() and not end.slopes["length"].any()
    over = ReducedCorrosion([1e8], [1.0], 1.5)
    assert over.volume_loss([1e12], 1e-9, law).value[0] == pytest.approx(1.0, abs=1e-14)


def test_nothing_moves_without_time_rate_or_metal():
    law = volume_loss_law(0.1)
    reduced = ReducedCorrosion(*bond_sums())
    assert reduced.volume_loss([0.0, 0.0], DIFFUSIVITY, law).value.tolist() == [0.0, 0.0]
    assert reduced.volume_loss([DAY], 0.0, law).value.tolist() == [0.0]
    for empty in (ReducedCorrosion([], []), ReducedCorrosion([0.0, 0.0], [1.0, 2.0])):
        found = empty.volume_loss([0.0, DAY], DIFFUSIVITY, law)
        assert found.value.tolist() == [0.0, 0.0] and not found.slopes["diffusivity"].any()

    def passive(loss):
        return RateFactor(np.zeros_like(loss), {"any": np.zeros_like(loss)})

    found = reduced.volume_loss([1e3 * DAY], DIFFUSIVITY, passive)
    assert found.value[0] == pytest.approx(0.0, abs=1e-15)
    assert np.isfinite(found.slopes["any"]).all()


@pytest.mark.parametrize("length", [1e-2, 1e-3, 1e-5])
def test_rates_that_fall_by_many_decades(length):
    """Endless time and a tiny l: V_L stays finite and near l log10(t)."""
    reduced = ReducedCorrosion(*bond_sums())
    times = DAY * np.logspace(0, 8, 9)
    found = reduced.volume_loss(times, DIFFUSIVITY, volume_loss_law(length))
    per_decade = np.diff(found.value)
    assert np.all(per_decade > 0) and np.all(per_decade < 1.001 * length)
    slow = DAY * np.array([1e-3, 10.0])
    np.testing.assert_allclose(
        reduced.volume_loss(slow, DIFFUSIVITY, volume_loss_law(length)).value,
        by_integration(reduced, slow, DIFFUSIVITY, volume_loss_law(length)),
        rtol=1e-8,
    )  # measured 2e-10


def test_equal_loss_by_two_rates_is_equal_exposure():
    """Damage is exp(-mu z): equal V_L means equal damage whatever the law."""
    reduced = ReducedCorrosion(*bond_sums())
    slow = reduced.volume_loss([100 * DAY], DIFFUSIVITY, volume_loss_law(0.05))
    constant = volume_loss_law(1e6)
    times = np.array([slow.exposure[0] / DIFFUSIVITY])
    fast = reduced.volume_loss(times, DIFFUSIVITY, constant)
    assert slow.value[0] == pytest.approx(fast.value[0], rel=1e-4)
    exact = reduced.loss_at(slow.exposure)
    np.testing.assert_allclose(slow.value, exact, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (([1.0, 2.0], [1.0]), "volumes"),
        (([-1.0], [1.0]), "bond_sums"),
        (([1.0], [np.nan]), "volumes"),
    ],
)
def test_wrong_parts_are_refused(arguments, word):
    with pytest.raises(ValueError, match=word):
        ReducedCorrosion(*arguments)


def test_wrong_times_and_rates_are_refused():
    reduced = ReducedCorrosion([1e8], [1.0])
    with pytest.raises(ValueError, match="times"):
        reduced.volume_loss([-1.0], DIFFUSIVITY, volume_loss_law(0.1))
    with pytest.raises(ValueError, match="diffusivity"):
        reduced.volume_loss([1.0], -1.0, volume_loss_law(0.1))


LAWS = [
    ConstantRate(),
    VolumeLossLaw(0.1),
    Tafel(0.02, 0.1),
    ButlerVolmer(0.03, 2.0, 0.4, 0.6, 300.0),
]


def test_every_law_of_the_volume_loss_is_tested_below():
    reduces = {law for law in KINETICS.values() if law.needs <= {"volume_loss"}}
    assert {type(law) for law in LAWS} == reduces


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_every_law_against_integration_of_a_scene(law):
    scene = pin(2, 14, saturation_concentration=0.66, kinetics=law)
    times = [0.5 * WEEK, 8 * WEEK]
    reduced = ReducedCorrosion.of(scene)
    found = reduced.volume_loss(times, scene.base_interface_diffusivity(), factor_of(law))
    exact = clean_liquid_loss(scene, times)
    assert exact[-1] > 0.05
    np.testing.assert_allclose(found.value, exact, rtol=1e-8)  # measured 2e-12


@pytest.mark.parametrize(
    ("law", "name"),
    [(law, field.name) for law in LAWS for field in dataclasses.fields(law)],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_every_laws_derivatives_by_taylor_slopes(law, name):
    scene = pin(2, 14, saturation_concentration=0.66)
    reduced, times = ReducedCorrosion.of(scene), [WEEK, 8 * WEEK]

    def loss(value):
        changed = dataclasses.replace(law, **{name: value})
        return reduced.volume_loss(times, 1e-15, factor_of(changed))

    base = getattr(law, name)
    at = loss(base)
    steps = base * np.array([0.08, 0.04, 0.02, 0.01])
    left = [np.abs(loss(base + h).value - at.value - h * at.slopes[name]).max() for h in steps]
    assert np.abs(at.slopes[name]).max() * steps[-1] > 10 * left[-1]
    slopes = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all((slopes > 1.85) & (slopes < 2.15))  # measured 1.91 to 2.05


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_every_laws_slope_in_the_volume_loss(law):
    losses, step = np.linspace(0.01, 0.3, 5), 1e-6
    rates = [law.rate(Exposed(losses + h)) for h in (step, -step)]
    difference = np.subtract(*rates) / (2 * step)
    expected = np.broadcast_to(law.derivatives(Exposed(losses))["volume_loss"], losses.shape)
    np.testing.assert_allclose(np.broadcast_to(difference, losses.shape), expected, rtol=1e-6)


def test_faradaic_bonds_are_refused():
    with pytest.raises(ValueError, match="'proportional' only"):
        ReducedCorrosion.of(pin(1, dissolution="faradaic"))
