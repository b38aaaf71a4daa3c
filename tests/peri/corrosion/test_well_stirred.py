"""The reduced scene of clean liquid against an independent solution and against the march."""

import numpy as np
import pytest

from peri.corrosion.run import corrode
from peri.corrosion.well_stirred import well_stirred
from peri.marching import TimeStepping
from tests.peri.corrosion.scenes import WEEK, clean_liquid_loss, pin

TIMES = [0.5 * WEEK, WEEK, 8 * WEEK]


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_against_the_scalar_equation(dimension):
    scene = pin(dimension, saturation_concentration=0.66)
    result = well_stirred(scene, TIMES)
    exact = clean_liquid_loss(scene, TIMES)
    assert exact[-1] > 0.05
    # tolerances of 1e-10 and 1e-12 of the two integrations: measured 4e-10
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
