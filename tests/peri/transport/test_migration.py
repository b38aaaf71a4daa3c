"""What migration adds to the components of a liquid, against the sum over the bonds of each ion."""

import math

import numpy as np
import pytest

from peri.engine.solvers import ConvergenceError
from peri.transport.fluxes import migration, sqra, steps_of
from peri.transport.migration import LARGEST_EXPONENT, Migration
from tests.peri.transport.chemistries import SBF, chemistry
from tests.peri.transport.columns import column


@pytest.mark.parametrize("form", ["sqra", "sg", "mean"])
def test_components_carry_what_their_ions_carry(form: str) -> None:
    chem = chemistry("sbf")
    liquid, unit = column(chem, SBF, 40)
    state, space = liquid.solve(3e-6 * unit), liquid.space
    psi = 50.0 * state.psi  # up to a tenth of RT/F
    found = Migration(form, space, chem).inflow(state.concentration, liquid.edge, psi)
    wanted = np.zeros_like(found)
    for k, (c, edge) in enumerate(zip(state.concentration, liquid.edge, strict=True)):
        fields = space.spread(c, edge), space.spread(psi)
        moved = migration(form, space.sum, space.all_volume, *fields, chem.charge[k])
        wanted += np.multiply.outer(
            chem.stoichiometry[k] * chem.diffusivity[k], space.gather(moved)
        )
    assert np.abs(wanted).min(axis=1).max() > 0
    assert found == pytest.approx(wanted, abs=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("u", [1e-12, 1e-6, 0.03, 1.0, 30.0, 600.0, 2 * LARGEST_EXPONENT])
def test_a_bond_carries_its_flux_up_to_the_largest_drop(u: float) -> None:
    """Against the series of exp for a small drop and ln of the flux, which is a double, for any."""
    c = np.array([1e5, 3.0])  # here, there
    with np.errstate(all="raise", under="ignore"):
        grow, shrink = steps_of(2.0, np.array([0.0, 0.5 * u]))
        found = sqra(
            c, (grow, shrink), (grow * c)[::-1], c[::-1], shrink[::-1], np.ones(2)
        )  # of two nodes, each the other's only neighbour
    half = 0.5 * u
    if u <= 1e-6:  # half^3 / 6 is below the round-off of half
        up, down = half + half**2 / 2, -half + half**2 / 2
        wanted = np.array([up * c[1] - down * c[0], down * c[0] - up * c[1]])
        assert found == pytest.approx(wanted, rel=1e-14)
        return
    # what is left of exp(u/2) C_j - exp(-u/2) C_i when diffusion is taken out
    up, down = (half + math.log1p(-math.exp(-half))), -math.expm1(-half)
    wanted = up + math.log(c[1]) + math.log1p(down * c[0] * math.exp(-up) / c[1])
    assert np.log(found[0]) == pytest.approx(wanted, rel=1e-14)
    assert found[1] == pytest.approx(-found[0], rel=1e-13)


@pytest.mark.parametrize("factor, fits", [(0.99, True), (1.01, False), (100.0, False)])
def test_a_potential_of_a_round_that_lost_its_way_is_refused(factor: float, fits: bool) -> None:
    chem = chemistry("sbf")
    liquid, unit = column(chem, SBF, 40)
    state = liquid.solve(3e-6 * unit)
    psi = np.zeros(liquid.space.n)
    psi[0] = factor * 2 * LARGEST_EXPONENT / np.abs(chem.charge).max()
    moved = Migration("sqra", liquid.space, chem)
    with np.errstate(over="raise", invalid="raise"):
        if fits:
            assert np.isfinite(moved.inflow(state.concentration, liquid.edge, psi)).all()
            return
        with pytest.raises(ConvergenceError, match="RT/F in the liquid"):
            moved.inflow(state.concentration, liquid.edge, psi)
