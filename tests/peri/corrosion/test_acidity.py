"""The current of alloy 625 by the concentration of its ions."""

import numpy as np
import pytest

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.kinetics import Exposed

LAW = AcidityLaw(5600.0, reference_current=2.0)


def test_known_values():
    # Worked out from the corrected equations with five digits.
    assert LAW.current(0.0) == pytest.approx(8.921e-4, rel=1e-4)
    assert LAW.current(5600.0) == pytest.approx(3.2422, rel=1e-5)
    assert LAW.current(9999.0) == LAW.current(5600.0)
    acid = 7.405 * np.exp(-0.08036 * 3.0) - 6.498
    expected = 10 ** (1.151 * np.exp(-0.723 * acid) - 3.647)
    assert AcidityLaw(5600.0, factor=7.0).current(3000.0) == pytest.approx(7 * expected, rel=1e-13)
    seen = np.array([0.0, 3000.0])
    np.testing.assert_array_equal(LAW.rate(Exposed(concentration=seen)), LAW.current(seen) / 2.0)
    assert LAW.needs == {"concentration"}


def test_slope_is_the_derivative():
    c = np.linspace(10.0, 5500.0, 23)
    here, slope = LAW.current(c), LAW.slope(c)
    assert (slope > 0).all()
    left = [np.abs(LAW.current(c + s) - here - s * slope).max() for s in (20.0, 10.0, 5.0)]
    orders = np.log2(np.divide(left[:-1], left[1:]))
    assert (orders > 1.9).all() and (orders < 2.1).all()
    assert left[-1] < 1e-3 * here.max()
    # The uniqueness limit of an implicit step, zF h / (di/dC), is 142 s at h = 5 um.
    assert 2.5 * 96485.33212 * 5e-6 / LAW.slope(5600.0) == pytest.approx(142, abs=1)


@pytest.mark.parametrize("seen", [-1.0, 5601.0, np.nan])
def test_refuses_what_is_beyond_its_range(seen):
    with pytest.raises(ValueError, match="the law holds from 0 to the saturation_concentration"):
        LAW.rate(Exposed(concentration=np.array([1.0, seen])))


@pytest.mark.parametrize("name", ["saturation_concentration", "reference_current", "factor"])
def test_refuses_numbers_out_of_range(name):
    with pytest.raises(ValueError, match=name):
        AcidityLaw(**{"saturation_concentration": 1.0, name: 0.0})
