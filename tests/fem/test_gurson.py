"""The porous yield function and its return mapping."""

import numpy as np
import pytest

from fem.constitutive import Material, VoceHardening
from fem.constitutive.gurson import LAGGED, LIMIT, SHEAR, _bracketed, return_map, yield_function
from fem.constitutive.material import uniaxial_yield

MATERIAL = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))
PARAMETERS, HARDENING = MATERIAL.parameters(), MATERIAL.hardening.parameters()
RNG = np.random.default_rng(11)


def test_closed_forms_of_the_yield_surface():
    """Stress over yield stress at q1 = 1.5."""
    assert uniaxial_yield(MATERIAL, 0.1) == pytest.approx(0.83428, abs=5e-6)  # digits printed
    assert uniaxial_yield(MATERIAL, 0.3) == pytest.approx(0.52130, abs=5e-6)
    hydrostatic = 2 / 3 * np.arccosh((1 + 0.15**2) / 0.3)
    assert hydrostatic == pytest.approx(1.26475, abs=5e-6)
    shear = (1 - 1.5 * 0.2) / np.sqrt(3)
    assert shear == pytest.approx(0.40415, abs=5e-6)
    # Phi of order one: round-off of a dozen operations
    assert abs(yield_function(0.0, hydrostatic, 1.0, 0.1, PARAMETERS)) < 1e-13
    assert abs(yield_function(np.sqrt(3) * shear, 0.0, 1.0, 0.2, PARAMETERS)) < 1e-13
    assert abs(yield_function(1.0, 5.0, 1.0, 0.0, PARAMETERS)) < 1e-13  # J2: no pressure


def _random_trials(count):
    """Trial states from hardly plastic to 10 % strain at once, both signs, f to f_max."""
    size = 10 ** RNG.uniform(-4, -1, count)
    volume = size * RNG.uniform(-1, 1, count) * RNG.choice([1.0, 0.1, 1e-4, 0.0], count)
    mises = 3 * PARAMETERS[SHEAR] * size * RNG.choice([1.0, 1e-3, 0.0], count, p=[0.8, 0.1, 0.1])
    damage = RNG.choice([0.0, 1e-9, 1e-3, 0.1, 0.5, 0.65, PARAMETERS[LIMIT]], count)
    strain = RNG.uniform(0, 0.3, count)
    return volume, mises, strain, damage


def test_return_map_reaches_the_yield_surface_everywhere():
    plastic = 0
    for volume, mises, strain, damage in zip(*_random_trials(4000), strict=True):
        a, beta, new_strain, f, flow, *_ = return_map(
            volume, mises, 1.0, strain, damage, PARAMETERS, 0, HARDENING
        )
        pressure = PARAMETERS[0] * (volume - a)
        phi = yield_function(beta * mises, pressure, flow, f, PARAMETERS)
        assert np.isfinite([a, beta, new_strain, f, phi]).all()
        assert 0 <= beta <= 1 and 0 <= f <= PARAMETERS[LIMIT] and abs(a) <= abs(volume)
        if new_strain > strain:
            plastic += 1
            # tolerance of the return mapping is 1e-11 of the squared strength, which the nested
            # bisection of the hardest states meets too: measured 9.8e-12 beside 1e-12 of round-off
            assert abs(phi) <= 1e-10 * (1 - 1.5 * f) ** 2 + 1e-12
            growth = 1 - (1 - damage) * np.exp(-a)
            assert f == pytest.approx(min(max(growth, 0), PARAMETERS[LIMIT]), abs=1e-14)
        else:
            assert phi <= 1e-9
    assert plastic > 2000


def test_newton_and_bracketing_agree():
    compared = 0
    for volume, mises, strain, damage in zip(*_random_trials(300), strict=True):
        a, beta, new_strain, *_ = return_map(
            volume, mises, 1.0, strain, damage, PARAMETERS, 0, HARDENING
        )
        if new_strain == strain:
            continue
        other_a, other_beta = _bracketed(
            volume, mises, 1.0, strain, damage, PARAMETERS, 0, HARDENING
        )
        compared += 1
        # both solve to 1e-10 of the residual: measured 2e-10 in beta, a within 1e-12
        assert other_a == pytest.approx(a, rel=1e-8, abs=1e-12)
        assert other_beta == pytest.approx(beta, rel=1e-8, abs=1e-12)
    assert compared > 100


def test_hydrostatic_return_needs_no_deviator():
    """q_trial = 0: pure growth of pores, at the closed-form pressure."""
    a, beta, strain, f, flow, *_ = return_map(0.02, 0.0, 1.0, 0.0, 0.1, PARAMETERS, 0, HARDENING)
    assert a > 0 and 0 < beta < 1
    pressure = PARAMETERS[0] * (0.02 - a)
    closed = 2 / 3 * np.arccosh((1 + (1.5 * f) ** 2) / (3 * f)) * flow
    assert pressure == pytest.approx(closed, rel=1e-12)  # measured 1e-15
    assert strain == pytest.approx(np.sqrt(2) / 3 * a, rel=1e-12)
    assert 1 - f == pytest.approx(0.9 * np.exp(-a), rel=1e-13)


def test_nucleation_and_coalescence():
    """GTN options: nucleated volume is that of the normal distribution; f* runs ahead of f."""
    from scipy.stats import norm

    material = Material(
        43e9, 0.3, MATERIAL.hardening, nucleated_fraction=0.04, nucleation_strain=0.1,
        nucleation_deviation=0.05, coalescence=0.15, failure=0.25,
    )  # fmt: skip
    p = material.parameters()
    _, _, strain, f, *_ = return_map(0.0, 4e9, 1.0, 0.0, 0.0, p, 0, HARDENING)
    expected = 0.04 * (norm.cdf((strain - 0.1) / 0.05) - norm.cdf(-0.1 / 0.05))
    assert strain > 0.05 and f == pytest.approx(expected, rel=1e-10)  # a = 0 in shear
    assert p[LIMIT] < 0.25
    # (5.40) with f* = 1/q1 at f = failure: strength gone
    assert uniaxial_yield(material, 0.25) < 1e-6
    assert uniaxial_yield(material, 0.15) == pytest.approx(
        uniaxial_yield(MATERIAL, 0.15), rel=1e-12
    )


def test_pores_close_within_the_step_and_the_tangent_is_that_of_the_step():
    """LAGGED: growth by f of the start, closing as without; derivatives by differences."""
    lagged = PARAMETERS.copy()
    lagged[LAGGED] = 1.0
    nearly_closed = 0
    for damage in (3e-4, 8e-4, 3e-3, 0.02, 0.3):
        for size, turn in np.ndindex(12, 6):
            volume = -(10 ** np.linspace(-3.5, -1.5, 12)[size])  # to 1.1 GPa
            mises = 3e9 * np.linspace(0.02, 1.5, 6)[turn]

            def solved(v, q, parameters=lagged, damage=damage):
                # J by the trial volume strain, as a step has it
                return return_map(v, q, np.exp(v), 0.02, damage, parameters, 0, HARDENING)

            found = solved(volume, mises)
            same = solved(volume, mises, PARAMETERS)
            assert found == pytest.approx(same, rel=1e-7, abs=1e-12)  # as the solution is: 1e-10
            if found[2] == 0.02:
                continue
            nearly_closed += found[3] < 0.01 * damage
            dv, dq = 1e-5 * abs(volume), 1e-5 * mises
            for k in (0, 1):
                by_v = (solved(volume + dv, mises)[k] - solved(volume - dv, mises)[k]) / (2 * dv)
                by_q = (solved(volume, mises + dq)[k] - solved(volume, mises - dq)[k]) / (2 * dq)
                # solutions are good to 1e-10, so differences to 1e-5
                assert found[5 + k] == pytest.approx(by_v, rel=1e-3, abs=1e-4)
                assert found[7 + k] * mises == pytest.approx(by_q * mises, rel=1e-3, abs=1e-4)
    assert nearly_closed >= 10
    growing = (0.01, 3e8, 1.0, 0.02, 0.1)
    grown, implicit = (return_map(*growing, p, 0, HARDENING) for p in (lagged, PARAMETERS))
    assert grown[3] > 0.1 and grown[1] > implicit[1] + 1e-4
