"""The reduced scene of clean liquid against an independent solution and against the march."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from peri.omissions.planning import liquid_bound
from peri.omissions.reduced import ReducedCorrosion
from peri.omissions.well_stirred import clean_march, well_stirred
from tests.peri.corrosion.scenes import WEEK, clean_liquid_loss, pin

TIMES = [0.5 * WEEK, WEEK, 8 * WEEK]


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_against_the_scalar_equation(dimension):
    scene = pin(dimension, saturation_concentration=0.66)
    result = well_stirred(scene, TIMES)
    exact = clean_liquid_loss(scene, TIMES)
    assert exact[-1] > 0.05
    # the quadrature against an integration in time to 1e-12: measured 2e-12
    np.testing.assert_allclose(result.volume_loss, exact, rtol=1e-8)


def test_against_the_march_node_by_node():
    scene = pin(2, 14, saturation_concentration=0.66, liquid_diffusivity=1e-7)
    reduced = well_stirred(scene, TIMES)
    marched = corrode(scene, TIMES, TimeStepping("sdirk2", step=WEEK / 24))
    metal = scene.metal
    difference = reduced.concentration[:, metal] - marched.concentration[:, metal]
    assert np.ptp(reduced.concentration[-1][metal]) > 0.1 * scene.solid_concentration
    # steps of 7 h, second order: measured 4.9e-6 and 2.3e-6
    assert np.abs(difference).max() < 1e-5 * scene.solid_concentration
    assert np.abs(reduced.volume_loss - marched.volume_loss).max() < 5e-6


def test_steps_in_clean_liquid_are_of_second_order():
    scene = pin(2, 14, saturation_concentration=0.66)
    end = WEEK
    exact = well_stirred(scene, [end]).volume_loss[0]
    assert exact > 0.03
    errors = [clean_march(scene, [end / n] * n)[-1] / exact - 1 for n in (16, 32, 64, 128)]
    orders = np.log2(np.abs(np.array(errors[:-1]) / errors[1:]))
    # measured 1.996, 1.998, 1.999 and 2.0e-6
    assert np.all((orders > 1.9) & (orders < 2.1)) and abs(errors[-1]) < 1e-5


@pytest.mark.parametrize("kinetics", [VolumeLossLaw(0.1), ConstantRate()])
@pytest.mark.parametrize("liquid_diffusivity", [1e-10, 1e-9])
def test_the_march_in_the_same_steps_differs_by_what_the_liquid_does(liquid_diffusivity, kinetics):
    scene = pin(3, 14, liquid_diffusivity=liquid_diffusivity, kinetics=kinetics)
    whole = corrode(scene, TIMES, TimeStepping("sdirk2", rate_change=0.2))
    clean = clean_march(scene, whole.history["step"][1:])
    share = liquid_bound(scene).max() / scene.solid_concentration
    difference = 1 - whole.history["volume_loss"][1:] / clean
    exact = well_stirred(scene, TIMES[-1:]).volume_loss[-1]
    # measured 0.04 to 0.77 of the bound over the steps, largest of them 0.65 and 0.77; the error
    # in time of these long steps is 0.3 and 0.5 %
    assert np.all((0 < difference) & (difference < share / (1 - share)))
    assert difference.max() > 0.3 * share
    assert abs(clean[-1] / exact - 1) > 10 * difference.max()


def test_the_mass_balance_is_computed_from_the_nodes_and_can_fail(monkeypatch):
    scene = pin(2, 14, saturation_concentration=0.66)
    history = well_stirred(scene, TIMES).history
    metal = history["metal_amount"]
    assert metal[-1] < 0.9 * metal[0]
    # round-off of two different sums, over nodes and over rate classes: measured 2e-15
    assert np.abs(history["balance_error"]).max() < 1e-13
    gone = ReducedCorrosion.dissolved_at
    monkeypatch.setattr(ReducedCorrosion, "dissolved_at", lambda self, z: 0.99 * gone(self, z))
    wrong = well_stirred(scene, TIMES).history["balance_error"]
    assert wrong[-1] == pytest.approx(-0.01 * (1 - metal[-1] / metal[0]), rel=1e-6)
