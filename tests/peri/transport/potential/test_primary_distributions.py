"""Electrodes without kinetics: resistances and currents that elliptic integrals give."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.electrostatics import Electrode, PotentialProblem
from peri.transport.potential.polarization import LinearPolarization

NONE = 1e-12  # ohm m^2


def cell_resistance(half_width, height, half_gap):
    """R kappa of a cell with electrodes on its floor up to the walls, by two conformal maps."""
    parameter = brentq(lambda p: ellipk(1 - p) / ellipk(p) - height / half_width, 1e-14, 1 - 1e-14)
    edge = ellipj(ellipk(parameter) * half_gap / half_width, parameter)[0]
    return 2 * ellipk(edge**2) / ellipk(1 - edge**2)


def floor_cell(spacing, half_gap, ratio=2):
    """R kappa of 20 x 10 mm on the lattice, and what was found."""
    shape = (round(20e-3 / spacing), round(10e-3 / spacing) + ratio)
    lattice = Lattice((0.5 * spacing, (0.5 - ratio) * spacing), (spacing,) * 2, shape)
    x, y = lattice.coordinates()
    below = np.broadcast_to(y < 0, shape)
    electrodes = [
        Electrode(below & (x < 10e-3 - half_gap), LinearPolarization(0.0, NONE)),
        Electrode(below & (x > 10e-3 + half_gap), LinearPolarization(1.0, NONE)),
    ]
    stencil = diffusion_stencil(lattice, ratio * spacing)
    liquid = np.broadcast_to(y > 0, shape)
    found = PotentialProblem(lattice, stencil, liquid, electrodes, 1.0).solve()
    return 1.0 / found.current(0), found


@pytest.mark.parametrize(("half_gap", "known"), [(1e-3, 1.022828), (2e-3, 1.321062)])
def test_coplanar_electrodes_in_a_cell(half_gap, known):
    """First order in the spacing: the current is infinite at the electrodes' edges."""
    exact = cell_resistance(10e-3, 10e-3, half_gap)
    assert exact == pytest.approx(known, abs=1e-6)
    off = []
    for spacing in (0.5e-3, 0.25e-3):
        resistance, found = floor_cell(spacing, half_gap)
        off.append(resistance / exact - 1)
        assert abs(found.imbalance) < 1e-12
        assert found.newton <= 8 and found.iterations <= 8 * 20
    # measured 3.6 and 1.8 % (0.92 % at 0.125 mm); 2.4 and 1.2 %
    assert 0.005 < off[1] < 0.02
    assert np.log2(off[0] / off[1]) == pytest.approx(1.0, abs=0.1)


def test_a_disk_in_a_plane():
    """Newman's disk: 4 kappa a V, half of the mean current in the middle, infinite at its rim."""
    kappa, radius, reach, ratio, h = 1.7, 1e-3, 4e-3, 2, 0.125e-3
    n = round(reach / h)
    lattice = Lattice((0.5 * h, 0.5 * h, (0.5 - ratio) * h), (h,) * 3, (n, n, n + ratio))
    x, y, z = lattice.coordinates()
    across = x**2 + y**2
    disk = np.broadcast_to(z < 0, lattice.shape) & (across < radius**2)
    liquid = np.broadcast_to(z > 0, lattice.shape)
    # Far away the exact potential is held: 2/pi acot of the oblate coordinate.
    squared = across + z**2 - radius**2
    oblate = np.sqrt(0.5 * (squared + np.sqrt(squared**2 + 4 * radius**2 * z**2))) / radius
    far = liquid & (across + z**2 > (reach - ratio * h) ** 2)
    held = np.where(far, 2 / np.pi * np.arctan2(1.0, oblate), np.nan)
    electrode = Electrode(disk, LinearPolarization(0.0, NONE), potential=1.0)
    stencil = diffusion_stencil(lattice, ratio * h)
    found = PotentialProblem(lattice, stencil, liquid, [electrode], kappa, held=held).solve()
    # a quarter of the disk; measured 0.7 % low
    total = 4 * found.current(0)
    assert total == pytest.approx(4 * kappa * radius, rel=0.02)
    mean = 4 * kappa * radius / (np.pi * radius**2)
    away = np.hypot(*((found.patches.node[:, :2].T + 0.5) * h)) / radius
    exact = 0.5 * mean / np.sqrt(1 - np.minimum(away, 0.99) ** 2)
    inner = away < 0.7
    # measured within 5 % in the inner half of the disk
    assert inner.sum() > 20
    np.testing.assert_allclose(found.density[inner], exact[inner], rtol=0.10)
    assert found.density[away > 0.9].mean() > 1.5 * mean * 0.5 / 0.99
    assert found.newton <= 8 and found.iterations <= 8 * 20
