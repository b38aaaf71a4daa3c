"""Conductivity by concentration: its law, and potentials in liquids whose kappa varies."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from peri.corrosion.polarization.tafel import TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, potential
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.conductivity import IonConductivity, TabulatedConductivity
from peri.transport.potential.electrostatics import Electrode, PotentialProblem
from peri.transport.potential.polarization import LinearPolarization


def test_brine_of_a_tenth_molar():
    """F^2/(R T) (D+ + D-) C with 1.33e-9 and 2.03e-9 m2/s: 1.262 S/m by hand at 298.15 K."""
    law = IonConductivity(0.0, 1.0, 1.33e-9, 2.03e-9)
    assert float(law.of(np.array(100.0))) == pytest.approx(1.2619, rel=1e-3)
    twice = IonConductivity(0.5, 2.0, 0.7e-9)
    step = (twice.of(np.array(301.0)) - twice.of(np.array(300.0))).item()
    assert step == pytest.approx(twice.slope, rel=1e-9)
    with pytest.raises(ValueError, match="medium: -1.0 S/m"):
        IonConductivity(-1.0, 2.0, 1e-9)
    with pytest.raises(ValueError, match="concentration: it must be finite and not negative"):
        law.of(np.array([1.0, -1.0]))


def test_a_couple_in_liquid_of_varying_conductivity():
    """Plates with ions between them, 0 to 3 mol/L: V / (int dx / kappa + 2 R_p)."""
    h, m, cells = 0.1e-3, 2, 100
    lattice = Lattice((0.5 * h - (m + 1) * h,), (h,), (cells + 2 * (m + 1),))
    x = lattice.axis(0)
    law, length = IonConductivity(0.2, 2.0, 0.7e-9), cells * h
    ions = 3000.0 * np.clip(x / length, 0.0, 1.0) ** 2
    metals = (
        Metal("one", x < 0, LinearPolarization(0.0, 1e-3)),
        Metal("other", x > length, LinearPolarization(1.0, 1e-3)),
    )
    found = potential(GalvanicScene(lattice, m * h, metals, law.of(ions)))
    across = quad(lambda s: 1.0 / float(law.of(np.array(3000.0 * (s / length) ** 2))), 0, length)[0]
    assert found.current(0) == pytest.approx(1.0 / (across + 2e-3), rel=5e-3)  # 3.7e-3 high
    assert abs(found.imbalance) < 1e-12
    with pytest.raises(ValueError, match="conductivity: .* the lattice has"):
        GalvanicScene(lattice, m * h, metals, np.ones(3))
    with pytest.raises(ValueError, match="conductivity: 0.0 S/m"):
        GalvanicScene(lattice, m * h, metals, 0.0 * ions)


def test_a_crevice_whose_end_is_full_of_ions():
    """25:1 lattice, kappa(C) of a seed, wall of Tafel, held mouth: its equation by shooting."""
    cells, m, ratio = 12, 2, 25
    width, depth = 25e-6, 12.7e-3
    h = width / cells
    columns = round(depth / (ratio * h))
    lattice = Lattice(
        ((0.5 - m) * ratio * h, (0.5 - m) * h), (ratio * h, h), (columns + m, cells + m)
    )
    x, y = (np.broadcast_to(a, lattice.shape) for a in lattice.coordinates())
    law, wall = IonConductivity(0.5, 2.5, 7.2e-10), TafelCurve(10.0, 0.1, 0.0)

    def ions(place):
        return 5600.0 / (1.0 + np.exp(-(place - 8e-3) / 0.5e-3))

    electrode = Electrode((y < 0) & (x > 0), wall)
    held = np.where((y > 0) & (x < 0), 0.0, np.nan)
    stencil = diffusion_stencil(lattice, (m * ratio * h, m * h))
    found = PotentialProblem(
        lattice, stencil, y > 0, [electrode], law.of(ions(x)), held=held
    ).solve()

    def mouth(tip):
        """E at the mouth for E at the closed end, where no current flows."""
        done = solve_ivp(
            lambda s, v: [v[1] / law.of(ions(np.array(s))), wall.current(v[0]) / width],
            (depth, 0.0), [tip, 0.0], rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        return done.y[0, -1]

    tip = brentq(mouth, -0.3, -1e-3, xtol=1e-9)
    plain = PotentialProblem(
        lattice, stencil, y > 0, [electrode], float(law.of(np.array(0.0))), held=held
    ).solve()
    # measured -0.25067 and -0.25035 V; -0.2804 V where the ions do not count
    assert -np.nanmean(found.potential[-1]) == pytest.approx(tip, rel=3e-3)
    assert -np.nanmean(plain.potential[-1]) < 1.1 * tip


def test_measured_points_are_joined_by_straight_lines():
    """MgCl2 at 20 degC (CRC Handbook, Section 5), mass per cent as mol/m3 by its density."""
    law = TabulatedConductivity((0.0, 213.0, 546.0, 1137.0), (1e-4, 3.12, 6.69, 10.8))
    found = law.of(np.array([0.0, 106.5, 546.0, 1137.0]))
    np.testing.assert_allclose(found, [1e-4, 0.5 * (1e-4 + 3.12), 6.69, 10.8], rtol=1e-12)
    # independent ions conduct 74 % more than measured at 0.2 mol/L and three times at 1.1
    dilute = IonConductivity(0.0, 2.0, 0.706e-9, temperature=293.15)
    assert 1.3 < float(dilute.of(np.array(213.0))) / 3.12 < 2.0
    for c, kappa, words in (
        ((0.0,), (1.0,), "two points or more"),
        ((0.0, 1.0), (1.0,), "as many of each"),
        ((1.0, 2.0), (1.0, 1.0), "ascend from 0"),
        ((0.0, 2.0, 1.0), (1.0,) * 3, "ascend from 0"),
        ((0.0, 1.0), (1.0, 0.0), "finite and positive"),
    ):
        with pytest.raises(ValueError, match=words):
            TabulatedConductivity(c, kappa)
    with pytest.raises(ValueError, match="the law's points end at 1137 mol/m"):
        law.of(np.array([1200.0]))
