"""Printed equations of localised corrosion beside the right ones, each by a calculation.

Others stand where they are used: Eqs 15 to 16 and 22 of Jafarzadeh et al. 2022 on a stretched
lattice in tests/peri/engine/test_influence.py, their probability of a bond's breaking in
tests/peri/corrosion/metal/test_bond_damage.py, Eqs 23 to 25 in tests/peri/corrosion/, the sign of
Eqs 14 to 16 and 20 of Zhao et al. 2021 in tests/peri/corrosion/interface/test_faradaic.py, Eq. 35
in tests/peri/coupled/test_galvanic.py, Tables 3 and D1 in tests/data/test_electrodes.py and
tests/peri/corrosion/test_polarization.py, the sign of Eq. 3 in the tests of Poisson's equation of
the ions.
"""

import math

import numpy as np
import pytest
from scipy import integrate, optimize, special

from peri.coupled.galvanic import GalvanicScene, Metal, potential
from peri.engine.constants import FARADAY
from peri.engine.influence import closed_constant, diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.polarization import LinearPolarization
from pipeline.scenes.couples import ae44_scene


def test_trial_current_of_the_crevice_is_not_that_of_its_micro_dissolvability():
    """2022, 5.2: k = 0.04 1/s is 3,496 z A/m2 at the start and 1,086 z travelling, not 2.22e4."""
    horizon, solid, saturated, k = 4e-6, 1.4e5, 5600.0, 0.04
    lattice = Lattice((0.0, 0.0), (1e-6,) * 2, (9, 9))
    stencil = diffusion_stencil(lattice, horizon, calibration="closed")
    # bonds of the rate k / |xi|^2 are those of D = k pi delta^2 / 4
    flux = k * math.pi * horizon**2 / 4 * stencil.front_strength(1) * solid
    assert FARADAY * flux == pytest.approx(3496, rel=2e-3)
    assert FARADAY * flux / math.log(solid / saturated) == pytest.approx(1086, rel=2e-3)
    for charge in (2.0, 2.5, 3.0):
        assert 2.22e4 / (charge * FARADAY * flux) > 2


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_integrals_of_a_faradaic_bond_run_over_both_sides(share):
    """2021, Eqs 17 and 19: from -acos(z/delta) to acos; from 0 half of the printed result."""
    horizon = 4e-6
    z, most = share * horizon, math.acos(share)

    def inner(angle: float) -> float:
        return integrate.quad(lambda xi: xi / xi, z / math.cos(angle), horizon)[0]

    whole = integrate.quad(inner, -most, most, epsabs=0, epsrel=1e-10)[0]
    half = integrate.quad(inner, 0, most, epsabs=0, epsrel=1e-10)[0]
    printed = 2 * (horizon * most - z * math.acosh(1 / share))
    assert whole == pytest.approx(printed, rel=1e-8)
    assert half == pytest.approx(0.5 * printed, rel=1e-8)


def test_profile_of_a_faradaic_front_carries_its_current():
    """Omega = 1/(z F delta^2): what the metal loses (a minus: dC/dt < 0) adds up to i/(z F)."""
    horizon, current, charge = 4e-6, 100.0, 2.0
    omega = 1.0 / (charge * FARADAY * horizon**2)

    def lost(z: float) -> float:
        return (
            -2 * omega * current * (horizon * math.acos(z / horizon) - z * math.acosh(horizon / z))
        )

    total = integrate.quad(lost, 0.0, horizon, epsabs=0, epsrel=1e-10)[0]
    assert total == pytest.approx(-current / (charge * FARADAY), rel=1e-7)


def test_potential_between_plates_meets_both_of_them():
    """2021, Eq. 32: phi_c + (y/h)(phi_a - phi_c); printed, phi_a and phi_c change places."""
    h, spacing = 20e-3, 1e-3
    lattice = Lattice((0.5 * spacing - 5e-3,), (spacing,), (30,))
    x = lattice.axis(0)
    anode, cathode = 0.1, 0.6
    metals = (
        Metal("anode", x < 0, LinearPolarization(anode, 1e-12), 143e3, 2.0),
        Metal("cathode", x > h, LinearPolarization(cathode, 1e-12)),
    )
    found = potential(GalvanicScene(lattice, 2 * spacing, metals, 2.5))
    between = (x > 0) & (x < h)
    y = h - x[between]  # from the cathode
    electrode_potential = -found.potential[between]
    np.testing.assert_allclose(electrode_potential, cathode + y / h * (anode - cathode), atol=1e-8)
    printed = anode - y / h * (anode - cathode)
    assert np.abs(electrode_potential - printed).max() > 0.4


def test_cell_of_the_couples():
    """2021, Eqs 36 and 37: the liquid's sides are 5 < y < 15 mm, the joint is at x = 10 mm."""
    scene = ae44_scene("mild-steel", 0.2e-3)
    y = scene.lattice.axis(1)
    liquid = ~scene.metal()
    assert (liquid == ((y > 5e-3) & (y < 15e-3))).all()
    x = scene.lattice.axis(0)
    steel, magnesium = (m.nodes.any(axis=1) for m in scene.metals)
    assert (steel == (x < 10e-3)).all() and (magnesium == (x > 10e-3)).all()


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("inner", [-1.6, -1.2, -0.9])
def test_mirror_node_of_a_tafel_law(sign, inner):
    """2021, A4 and A5: E = E_R - W(w0) / b with w0 = b d s i0 10^((E_R - E_0) / beta) / kappa.

    The value E of a node behind the wall with -kappa (E - E_R) / d = i((E + E_R) / 2), the current
    of the wall halfway between it and its mirror image (E_R, at the distance d).
    """
    kappa, distance, i0, slope, standard = 2.5, 1e-3, 5.0, 0.12, -1.3
    beta = sign * slope
    b = math.log(10) / (2 * beta)
    w0 = (
        sign * i0 * math.log(10) / (2 * kappa * beta) * distance * 10 ** ((inner - standard) / beta)
    )
    mirrored = inner - float(special.lambertw(w0).real) / b

    def left(e: float) -> float:
        current = sign * i0 * 10 ** ((0.5 * (e + inner) - standard) / beta)
        return kappa * (e - inner) / distance + current

    exact = optimize.brentq(left, inner - 50.0, inner + 50.0, xtol=1e-15)
    assert mirrored == pytest.approx(exact, abs=1e-12)
    # a linear potential with that current through the wall is the 1D solution, so the wall's value
    # is the mean of both
    current = sign * i0 * 10 ** ((0.5 * (mirrored + inner) - standard) / beta)
    assert -kappa * (mirrored - inner) / distance == pytest.approx(current, rel=1e-9)


@pytest.mark.parametrize("count", [1, 2])
def test_the_law_counts_once_in_a_mirror_node(count):
    """2021, A3: u(x) = u(x_R) - (d / kappa) i; printed, with its last term twice, the bonds to the
    metal carry twice what the electrode's law gives."""
    kappa, h, nodes, resistance = 2.5, 1e-3, 20, 1e-3
    rests = (0.1, 0.6)
    step = np.zeros((nodes, nodes))
    right = np.zeros(nodes)
    for row in range(nodes):
        for other in (row - 1, row + 1):
            if 0 <= other < nodes:
                step[row, [row, other]] += 1.0, -1.0
                continue
            # u_m = u - share (V + (u_m + u) / 2 - rest), a linear law of this resistance
            share = count * h / (kappa * resistance)
            rest = rests[row > 0]
            step[row, row] += share / (1 + 0.5 * share)
            right[row] += share * rest / (1 + 0.5 * share)
    u = np.linalg.solve(step, right)
    mirror = u[0] - (step[0] @ u - right[0] - (u[0] - u[1]))
    carried = kappa * (u[0] - mirror) / h
    by_law = (0.5 * (u[0] + mirror) - rests[0]) / resistance
    assert carried == pytest.approx(count * by_law, rel=1e-9)
    exact = (rests[1] - rests[0]) / (2 * resistance + nodes * h / kappa)
    # twice makes half of the resistance at each electrode: 11 % more current here
    assert carried == pytest.approx(exact if count == 1 else 1.1111 * exact, rel=1e-4)


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_constants_belong_to_the_kernel_of_the_inverse_square(dimension):
    """Jafarzadeh 2024, 1.2: D/delta, 4 D/(pi delta^2), 9 D/(2 pi delta^3) go with 1/|xi|^2."""
    delta = 3e-6
    constant = [1 / delta, 4 / (math.pi * delta**2), 9 / (2 * math.pi * delta**3)][dimension - 1]
    sphere = [2.0, 2 * math.pi, 4 * math.pi][dimension - 1]

    def diffusivity(power: int) -> float:
        """Half of the second moment along an axis of constant / |xi|^power."""
        moment = integrate.quad(lambda r: r ** (dimension + 1 - power), 0, delta)[0]
        return 0.5 * constant * sphere / dimension * moment

    assert diffusivity(2) == pytest.approx(1.0, rel=1e-12)
    assert abs(diffusivity(1) - 1.0) > 0.9  # printed: not even a diffusivity, by its dimension
    exponent = 0.5 * (2 - dimension)
    assert constant == pytest.approx(float(closed_constant(dimension, delta, exponent, "constant")))
