"""The ball that saturates its liquid, in radial shells."""

import numpy as np
import pytest

from peri.reference.saturated_ball import saturated_ball

SCENE = (2.0, 4.5, 7768.35, 1e-5)
DAYS = np.array([1.0, 3.0, 7.0]) / 17.0845


def test_shells_converge_and_more_liquid_takes_more():
    fine = saturated_ball(*SCENE, DAYS)
    # 0.921, 2.750 and 6.376 % by a script of its own with more shells and steps
    np.testing.assert_allclose(fine, [0.00921, 0.02750, 0.06376], rtol=3e-4)
    coarse = saturated_ball(*SCENE, DAYS, shells=32, steps=100)
    np.testing.assert_allclose(coarse, fine, rtol=1e-3)
    assert (saturated_ball(2.0, 4.5, 7768.35, 1.2e-5, DAYS, 32, 100) > 1.1 * coarse).all()


def test_where_nothing_saturates_the_loss_is_the_flux_through_the_surface():
    # Fresh metal in clean liquid loses 4 pi (R^2 - 1/36), the kernel's own closed form.
    short = np.array([1e-4])
    found = saturated_ball(2.0, 4.5, 1e4, 0.5, short, 128, 100)[0]
    assert found / short[0] == pytest.approx(3 / 8 * (4 - 1 / 36), rel=5e-3)


def test_metal_that_would_go_is_refused():
    with pytest.raises(ValueError, match="times: metal reaches C_sat at"):
        saturated_ball(2.0, 4.5, 1e4, 0.5, [1.0], 16, 50)


def test_liquid_narrower_than_the_horizon_is_refused():
    with pytest.raises(ValueError, match="radius, edge: 2.0 and 2.5 horizons"):
        saturated_ball(2.0, 2.5, 1e4, 0.5, [1.0])
