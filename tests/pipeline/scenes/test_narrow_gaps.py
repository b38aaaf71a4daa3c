"""Currents in gaps that are narrower than two horizons, beside closed forms."""

import numpy as np
import pytest

from peri.coupled.galvanic import GalvanicScene, Metal, potential
from peri.engine.lattice import Lattice
from peri.transport.potential.polarization import LinearPolarization

SPACING, KAPPA, RESISTANCE = 1e-4, 1.7, 1e-4
LAWS = LinearPolarization(-1.5, RESISTANCE), LinearPolarization(-1.0, RESISTANCE)


def error(lattice, inside, outside, exact):
    """Of the current between two metals, two spacings to the horizon."""
    metals = (Metal("inside", inside, LAWS[0]), Metal("outside", outside, LAWS[1]))
    found = potential(GalvanicScene(lattice, 2 * SPACING, metals, KAPPA))
    return abs(found.current(0)) / exact - 1


def plates(nodes):
    lattice = Lattice((-3.5 * SPACING,), (SPACING,), (nodes + 8,))
    x = lattice.axis(0)
    exact = 0.5 / (2 * RESISTANCE + nodes * SPACING / KAPPA)
    return error(lattice, x < 0, x > (nodes + 0.0) * SPACING, exact)


def ring(nodes):
    """A disc of 2.1 mm in a ring."""
    radius, h = 1.05e-3, SPACING
    side = 2 * int(np.ceil(radius / h + nodes + 4))
    lattice = Lattice(((0.5 - 0.5 * side) * h,) * 2, (h, h), (side, side))
    away, outer = np.hypot(*lattice.coordinates()), radius + nodes * h
    resistance = RESISTANCE / (2 * np.pi) * (1 / radius + 1 / outer)
    resistance += np.log(outer / radius) / (2 * np.pi * KAPPA)
    return error(lattice, away < radius, away > outer, 0.5 / resistance)


def test_plates_are_exact_down_to_one_horizon():
    assert plates(1) == pytest.approx(-0.0704, abs=1e-4)
    np.testing.assert_allclose([plates(nodes) for nodes in (2, 3, 4)], 0.0, atol=1e-8)


def test_a_staircase_of_one_horizon_is_no_worse_than_one_of_two():
    # measured -4.9, -2.0, 0.1, -1.2 %
    errors = [ring(nodes) for nodes in (1, 2, 3, 4)]
    np.testing.assert_allclose(errors[1:], 0.0, atol=0.025)
    assert errors[0] == pytest.approx(-0.049, abs=0.005)
