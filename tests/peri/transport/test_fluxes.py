"""Bond fluxes of ions: equilibrium, order, positivity, and the two ways to sum them."""

import numpy as np
import pytest

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import box_lattice
from peri.engine.operators import NonlocalSum
from peri.transport.fluxes import FLUX_FORMS, largest_bond_step, migration


def row_of(nodes: int, spacing: float = 1.0, m: int = 3) -> NonlocalSum:
    lattice = box_lattice([0.0], [nodes * spacing], spacing)
    return NonlocalSum(diffusion_stencil(lattice, m * spacing), lattice.shape)


def inflow(form: str, bonds: NonlocalSum, c: np.ndarray, psi: np.ndarray, z: float) -> np.ndarray:
    """Diffusion and migration together, on the lattice."""
    volume = bonds.pad(np.ones(bonds.lattice_shape))
    c, psi = bonds.pad(c), bonds.pad(psi)
    diffusion = bonds(volume * c) - c * bonds(volume)
    return bonds.crop(diffusion + migration(form, bonds, volume, c, psi, z))


def by_bonds(form: str, stencil, c: np.ndarray, psi: np.ndarray, z: float) -> np.ndarray:
    """The same bond by bond, from the formulas."""
    out = np.zeros_like(c)
    reach = len(stencil.octant) - 1
    for i in range(len(c)):
        for j in range(max(0, i - reach), min(len(c), i + reach + 1)):
            if i == j:
                continue
            u = z * (psi[j] - psi[i])
            if form == "sqra":
                f = np.exp(u / 2) * c[j] - np.exp(-u / 2) * c[i]
            elif form == "sg":
                f = c[j] * -u / np.expm1(-u) - c[i] * u / np.expm1(u)
            else:
                f = c[j] - c[i] + u * (c[i] + c[j]) * (1.0 if form == "as_published" else 0.5)
            out[i] += stencil.octant[abs(i - j)] * f
    return out


@pytest.mark.parametrize("form", FLUX_FORMS)
@pytest.mark.parametrize("z", [-3.0, 1.0, 2.0])
def test_convolutions_equal_the_sum_over_bonds(form: str, z: float) -> None:
    rng = np.random.default_rng(3)
    bonds = row_of(30)
    c, psi = rng.uniform(1, 2, 30), rng.normal(size=30)
    exact = by_bonds(form, bonds.stencil, c, psi, z)
    error = np.abs(inflow(form, bonds, c, psi, z) - exact).max() / np.abs(exact).max()
    assert error < 1e-14  # measured 4e-16


@pytest.mark.parametrize("form", ["sqra", "sg"])
@pytest.mark.parametrize("step", [0.1, 1.0, 10.0, 390.0])
def test_no_flux_in_boltzmann_equilibrium(form: str, step: float) -> None:
    bonds = row_of(40)
    psi = np.where(np.arange(40) < 20, 0.0, step)
    c = np.exp(-psi)
    size = bonds.octant.sum()
    assert np.abs(inflow(form, bonds, c, psi, 1.0)).max() <= 1e-14 * size
    wrong = np.abs(inflow("mean", bonds, c, psi, 1.0)).max()
    assert wrong > 1e-6 * size  # the mean form does carry a flux


def local_error(form: str, nodes: int, m: int) -> float:
    """Largest error of smooth fields' inflow against the local equation's, of 16."""
    bonds = row_of(nodes, 1.0 / nodes, m)
    x = (np.arange(nodes) + 0.5) / nodes
    c, psi = 2.0 + np.sin(4 * x), np.cos(3 * x)
    slope, field = 4 * np.cos(4 * x), -3 * np.sin(3 * x)
    exact = -16 * np.sin(4 * x) + slope * field + c * -9 * np.cos(3 * x)
    inner = slice(nodes // 4, -nodes // 4)
    return float(np.abs(inflow(form, bonds, c, psi, 1.0) - exact)[inner].max())


@pytest.mark.parametrize("form", ["sqra", "sg", "mean"])
def test_the_local_equation_is_approached_with_second_order_in_the_spacing(form: str) -> None:
    errors = [local_error(form, nodes, 3) for nodes in (40, 80, 160)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.9).all() and (orders < 2.1).all()
    assert errors[-1] < 0.05  # of 16; measured 0.01


@pytest.mark.parametrize("form", ["sqra", "sg", "mean"])
def test_the_local_equation_is_approached_with_second_order_in_the_horizon(form: str) -> None:
    # One lattice, horizons of 32, 16 and 8 spacings: 0.1 to 0.025 of the row.
    errors = [local_error(form, 320, m) for m in (32, 16, 8)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.9).all() and (orders < 2.1).all()
    assert errors[-1] < 0.05  # measured 0.023


def test_as_published_moves_ions_twice_as_fast() -> None:
    bonds = row_of(20)
    volume = bonds.pad(np.ones(20))
    c, psi = bonds.pad(np.linspace(1, 2, 20)), bonds.pad(np.linspace(0, 1, 20))
    mean = migration("mean", bonds, volume, c, psi, 1.0)
    assert np.abs(mean).max() > 0.01
    assert migration("as_published", bonds, volume, c, psi, 1.0) == pytest.approx(2 * mean)


def test_amounts_are_conserved_in_a_closed_row() -> None:
    rng = np.random.default_rng(5)
    bonds = row_of(25)
    for form in FLUX_FORMS:
        total = inflow(form, bonds, rng.uniform(0, 5, 25), rng.normal(size=25), 2.0).sum()
        assert abs(total) < 1e-12 * bonds.octant.sum() * 25


def test_ten_volts_over_one_bond_stay_finite() -> None:
    bonds = row_of(10)
    psi = np.where(np.arange(10) < 5, 0.0, 10.0 / 0.0257)
    for form in FLUX_FORMS:
        assert np.isfinite(inflow(form, bonds, np.ones(10), psi, 2.0)).all(), form


def test_the_largest_step_bounds_every_bond() -> None:
    bonds = row_of(30)
    psi = np.sin(np.arange(30.0))
    volume = bonds.pad(np.ones(30))
    steps = [np.abs(psi[k:] - psi[:-k]).max() for k in (1, 2, 3)]
    assert largest_bond_step(bonds.pad(psi), volume, bonds) >= max(steps)


def test_an_unknown_form_is_refused() -> None:
    bonds = row_of(5)
    field = bonds.pad(np.ones(5))
    with pytest.raises(ValueError, match="flux_form: 'upwind'; allowed are sqra, sg, mean"):
        migration("upwind", bonds, field, field, field, 1.0)
