"""The current of alloy 625 by the concentration of its ions."""

import numpy as np
import pytest

from peri.corrosion import CorrosionScene, corrode
from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.kinetics import Exposed
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping

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


def test_beyond_saturation_the_rate_is_that_at_it():
    seen = np.array([-1.0, 5601.0])
    np.testing.assert_array_equal(
        LAW.rate(Exposed(concentration=seen)), LAW.current(np.array([0.0, 5600.0])) / 2.0
    )
    with pytest.raises(ValueError, match="concentration: it must be finite"):
        LAW.rate(Exposed(concentration=np.array([1.0, np.nan])))


@pytest.mark.parametrize("name", ["saturation_concentration", "reference_current", "factor"])
def test_refuses_numbers_out_of_range(name):
    with pytest.raises(ValueError, match=name):
        AcidityLaw(**{"saturation_concentration": 1.0, name: 0.0})


def test_refuses_saturation_beyond_the_fit():
    """At 1e5 mol/m^3 the current would be 1e122 A/m^2."""
    with pytest.raises(ValueError, match=r"saturation_concentration: 5700.0 mol/m\^3; .* 5600"):
        AcidityLaw(5700.0)


def test_a_front_marches_by_the_concentration_up_to_saturation():
    """A flat front of 150 um in a closed column, with the printed current and 300 times of it."""
    lattice = Lattice((0.0,), (5e-6,), (60,))
    law = AcidityLaw(5600.0, reference_current=3.2422)
    flux = 3.2422 / (2.5 * 96485.33212)
    for factor, hours in ((1.0, (1, 10)), (300.0, (1, 100))):
        scene = CorrosionScene(
            lattice,
            15e-6,
            np.arange(60) < 30,
            solid_concentration=1.4e5,
            saturation_concentration=5600.0,
            liquid_diffusivity=7.2e-10,
            dissolution_flux=factor * flux,
            dissolution="faradaic",
            boundary="no_flux",
            kinetics=law,
        )
        done = corrode(scene, [h * 3600.0 for h in hours], TimeStepping(rate_change=0.1))
        # In clean liquid i(0) t / (zF C_solid): 8.921e-4 A/m^2 for an hour, a share of 150 um.
        clean = factor * 8.921e-4 / (2.5 * 96485.33212 * 1.4e5) * 3600.0 / 150e-6
        faster = done.volume_loss[0] / clean
        assert 1.0 - 1e-4 < faster < (1.001 if factor == 1.0 else 1.02)
        assert np.abs(done.history["balance_error"]).max() < 1e-12
        liquid = [c[~m].max() for c, m in zip(done.concentration, done.metal, strict=True)]
        assert max(liquid) <= 5600.0 * (1 + 1e-8)  # 4e-10 above measured
    # The column is full: 150 um of C_sat over 1.4e5, a share of 0.04.
    assert done.volume_loss[-1] == pytest.approx(0.04, rel=1e-6)
