"""Polarization laws: known values, exact slopes, bounds, refusals."""

import numpy as np
import pytest

from peri.corrosion.kinetics import Exposed
from peri.corrosion.polarization import (
    POLARIZATION,
    ButlerVolmerCurve,
    PiecewiseTafelCurve,
    PolarizedRate,
    TabulatedCurve,
    TafelCurve,
)

STEEL = TafelCurve(0.00125, -0.153, -0.58)
PRINTED = (
    TafelCurve(0.014, 0.021, -1.55),
    TafelCurve(21.145, 0.166, -1.48),
    TafelCurve(58.107, 0.400, -1.41),
)
AE44 = PiecewiseTafelCurve(PRINTED, (-1.48, -1.41), as_published=True)
# Each law, and potentials that lie away from joints.
LAWS = {
    "tafel": (TafelCurve(2.0, 0.06, -1.2), np.linspace(-1.6, -0.9, 23)),
    "cathodic tafel": (STEEL, np.linspace(-1.6, -0.2, 23)),
    "piecewise_tafel": (AE44.continuous(), np.linspace(-1.7, -1.2, 23) + 1e-3),
    "butler_volmer": (
        ButlerVolmerCurve(0.3, -0.4, 2, 0.3, 0.6, 298.15),
        np.linspace(-0.7, 0.0, 23),
    ),
    "tabulated": (
        TabulatedCurve((-1.6, -1.5, -1.45, -1.3), (-4.0, -1.0, 2.0, 2.5)),
        np.linspace(-1.59, -1.31, 23) + 1e-3,
    ),
}


def test_every_law_is_tested():
    assert set(POLARIZATION) <= set(LAWS)
    assert {type(law) for law, _ in LAWS.values()} == set(POLARIZATION.values())


@pytest.mark.parametrize("name", LAWS)
def test_slopes_are_the_derivatives(name):
    law, potential = LAWS[name]
    here, slope = law.current(potential), law.slope(potential)
    assert here.shape == slope.shape == potential.shape and (slope > 0).all()
    # Taylor remainders |i(E + h) - i(E) - h i'(E)| fall with h^2.
    remainders = []
    for step in (1e-4, 5e-5, 2.5e-5):
        remainders.append(np.abs(law.current(potential + step) - here - step * slope).max())
    orders = np.log2(np.divide(remainders[:-1], remainders[1:]))
    assert (orders > 1.9).all() and (orders < 2.1).all()  # 1.99 to 2.01 measured
    assert remainders[-1] < 1e-4 * (np.abs(2.5e-5 * slope).max() + np.abs(here).max())
    one = law.current(float(potential[3]))
    assert np.shape(one) == () and one == here[3]


@pytest.mark.parametrize("name", LAWS)
def test_far_from_the_curve_it_stays_finite_and_rises(name):
    law, _ = LAWS[name]
    potential = np.linspace(-9.0, 9.0, 4001)
    current = law.current(potential)
    assert np.isfinite(current).all() and np.isfinite(law.slope(potential)).all()
    # Round-off of a fall of nothing in a curve of up to 1e30 and more.
    assert (np.diff(current) >= -1e-12 * np.abs(current[:-1])).all()
    assert (law.slope(potential) >= 0).all()


def test_known_values():
    # A factor ten per slope, Eq. 13
    assert STEEL.current(-0.58) == -0.00125
    assert STEEL.current(-0.58 - 0.153 * 3) == pytest.approx(-1.25, rel=1e-13)
    below, above = (float(AE44.current(-1.48 + s)) for s in (-1e-12, 1e-12))
    assert below == pytest.approx(30.16, abs=5e-3) and above == pytest.approx(21.145, abs=1e-3)
    below, above = (float(AE44.current(-1.41 + s)) for s in (-1e-12, 1e-12))
    assert below == pytest.approx(55.83, abs=5e-3) and above == pytest.approx(58.107, abs=1e-3)
    slopes = [p.tafel_slope for p in AE44.continuous().pieces]
    assert slopes == pytest.approx([0.022019, 0.159446, 0.4], abs=5e-7)
    for joint in AE44.joints:
        low, high = (AE44.continuous().current(joint + s) for s in (-1e-13, 1e-13))
        assert low == pytest.approx(high, rel=1e-10)
    law = ButlerVolmerCurve(0.3, -0.4)
    assert law.current(-0.4) == 0.0
    # 2 i_0 sinh(z F eta / 2RT) for equal transfer
    scaled = 96485.33212 / (8.314462618 * 310.15)
    assert law.current(-0.3) == pytest.approx(0.6 * np.sinh(scaled * 0.1), rel=1e-12)
    table, _ = LAWS["tabulated"]
    np.testing.assert_allclose(
        table.current(np.array(table.potentials)), table.currents, rtol=1e-14
    )


def test_two_plates_of_tafel_laws_share_one_current():
    """AE44 (its last piece) 10 mm from steel in 2.5 S/m: 44.7105 A/m^2 where i_a = -i_c."""
    anode, conductivity, gap = PRINTED[2], 2.5, 10e-3
    low, high = 0.0, 500.0
    for _ in range(80):  # bisection of the ohmic drop between the two potentials
        i = 0.5 * (low + high)
        at_anode = anode.standard_potential + anode.tafel_slope * np.log10(
            i / anode.current_density
        )
        drop = i * gap / conductivity
        wanted = -float(STEEL.current(at_anode + drop))
        low, high = (i, high) if wanted > i else (low, i)
    assert i == pytest.approx(44.7105, abs=5e-5)
    assert float(anode.current(at_anode)) == pytest.approx(i, rel=1e-12)


def test_dissolution_follows_the_anodic_current():
    law, potential = LAWS["butler_volmer"]
    kinetics = PolarizedRate(law, 2.0)
    assert kinetics.needs == {"potential"} and not kinetics.is_global
    rate = kinetics.rate(Exposed(potential=potential))
    np.testing.assert_array_equal(rate, np.maximum(law.current(potential), 0) / 2)
    assert (rate[potential < -0.4] == 0).all() and (rate[potential > -0.4] > 0).all()
    away = potential[np.abs(potential + 0.4) > 1e-3]
    step = 1e-7
    difference = kinetics.rate(Exposed(potential=away + step)) - kinetics.rate(
        Exposed(potential=away - step)
    )
    # Central difference: step^2 times a third derivative of 1e4 of the slope.
    np.testing.assert_allclose(
        kinetics.slope(Exposed(potential=away)), difference / (2 * step), rtol=1e-6, atol=1e-6
    )
    table, _ = LAWS["tabulated"]
    with pytest.raises(ValueError, match=r"potential: -1.2 V lies outside .* from -1.6 to -1.3"):
        PolarizedRate(table, 1.0).rate(Exposed(potential=np.array([-1.4, -1.2])))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TafelCurve(0.0, 0.1, 0.0), "current_density: 0.0 A/m"),
        (lambda: TafelCurve(1.0, 0.0, 0.0), "tafel_slope: 0.0 V"),
        (lambda: TafelCurve(1.0, 0.1, np.nan), "standard_potential: nan V"),
        (lambda: ButlerVolmerCurve(-1.0, 0.0), "exchange_current_density: -1"),
        (lambda: ButlerVolmerCurve(1.0, 0.0, temperature=0), "temperature: 0 K"),
        (lambda: PiecewiseTafelCurve(PRINTED, (-1.48,)), "joints: 1 for 3 pieces"),
        (lambda: PiecewiseTafelCurve(PRINTED, (-1.41, -1.48)), "joints: .* ascend"),
        (lambda: PiecewiseTafelCurve((PRINTED[0], STEEL), (-1.0,)), "pieces: anodic and cathodic"),
        (
            lambda: PiecewiseTafelCurve(PRINTED, (-1.48, -1.41)),
            "at -1.48 V the current falls from 30.162 to 21.145 .* a slope of 0.0220",
        ),
        (lambda: TabulatedCurve((0.0,), (1.0,)), "two points"),
        (lambda: TabulatedCurve((0.0, 0.0), (1.0, 2.0)), "0.0 V is followed by 0.0 V"),
        (
            lambda: TabulatedCurve((0.0, 0.1, 0.2), (1.0, 2.0, 1.5)),
            "2.0 A/m.2 at 0.1 V is followed by 1.5 A/m.2 at 0.2 V",
        ),
        (lambda: PolarizedRate(STEEL, 0.0), "reference_current: 0.0"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message):
        make()
