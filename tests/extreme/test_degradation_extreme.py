"""Metal and liquid at their ends: all metal gone, pockets that open, nodes full of mineral."""

import dataclasses

import numpy as np
import pytest

import perilife_data
from peri.corrosion.kinetics import ConstantRate
from peri.coupled.degradation import Degradation
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import ball, box_lattice
from peri.engine.march.marching import TimeStepping, march
from peri.transport.chemistry.speciation import speciate
from peri.transport.chemistry.species import MOLAR, Chemistry
from peri.transport.liquid import LiquidSpace
from peri.transport.stored import StoredLiquid
from tests.peri.coupled.test_degradation import medium
from tests.peri.coupled.test_vessels import BARE, DAY, HOUR, crumb
from tests.peri.transport.chemistries import SALINE, SBF, chemistry
from tests.peri.transport.columns import MAGNESIUM

FAST = {"saturation_concentration": 20000.0, "kinetics": ConstantRate()}
LONG = TimeStepping(rate_change=0.5)


@pytest.mark.slow
def test_metal_used_up_leaves_liquid_and_no_debt() -> None:
    problem = Degradation(crumb(1e-3, half=0.7e-3, **FAST), medium("nacl", ("brucite",)), BARE)
    done = march(problem, [0.0, 30 * DAY], LONG)
    history, last = done.history, done.outputs[-1]
    assert problem.stores  # so fast a release never comes to rest
    assert history["volume_loss"][-1] == 1.0 and not last["metal"].any()
    # What nodes held when they turned liquid has dissolved, too; so has all brucite.
    assert history["hydrogen_amount"][-1] == pytest.approx(history["metal_amount"][0], rel=1e-6)
    assert history["brucite_amount"].max() > 1e-6 and history["brucite_amount"][-1] == 0.0
    assert history["element_error"].max() < 1e-10  # measured 2e-11
    assert last["lowest"] >= 0 and last["net_charge"] < 1e-12
    assert np.isfinite(last["ph"]).all() and np.nanmin(last["minerals"]) >= 0


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.2e-3, 0.32e-3])
def test_a_closed_vessel_takes_all_the_metal_even_beyond_its_pores(radius: float, caplog) -> None:
    """At one concentration metal and liquid hold less than C_sat: at most 136 of 512 nodes."""
    scene = crumb(1e-3, boundary="no_flux", saturation="none", **FAST)
    scene = dataclasses.replace(scene, metal=ball(scene.lattice, (0, 0, 0), radius))
    problem = Degradation(scene, medium("nacl", ("brucite",)), BARE)
    done = march(problem, [HOUR, 60 * DAY], LONG)
    history, last = done.history, done.outputs[-1]
    assert history["volume_loss"][-1] == 1.0
    # All that the metal lost has reached the ions, also from nodes that the metal's march held
    # back because their liquid held more than they did.
    metal = history["metal_amount"][0]
    assert done.state.numbers["taken"] == pytest.approx(metal, rel=1e-9)
    assert history["brucite_amount"][-1] == pytest.approx(metal, rel=1e-3)
    assert history["element_error"].max() < 1e-10  # measured 2e-12
    # Minerals take no room in the model, and a vessel that they would fill is told.
    assert ("minerals take" in caplog.text) == (last["fullest"] > 1.0)
    assert (last["fullest"] > 1.0) == (radius > 0.3e-3)  # measured 0.74 and 1.2


@pytest.mark.slow
def test_a_pocket_that_opens_in_mid_run_takes_part_from_then_on() -> None:
    lattice = box_lattice([-0.9e-3] * 3, [0.9e-3] * 3, 0.1e-3)
    inside = ball(lattice, (0, 0, 0), 0.12e-3)
    scene = dataclasses.replace(
        crumb(1e-4, half=0.9e-3, **FAST),
        metal=ball(lattice, (0, 0, 0), 0.4e-3) & ~inside,
        domain=ball(lattice, (0, 0, 0), 0.9e-3),
    )
    problem = Degradation(scene, medium("nacl", ("brucite",)), BARE, storage=False)
    first, last = march(problem, [0.1 * DAY, 40 * DAY], LONG).outputs
    assert first["pockets"] == inside.sum() and last["pockets"] == 0.0
    assert np.isnan(first["ph"][inside]).all() and np.isfinite(last["ph"][inside]).all()
    assert last["net_charge"] < 1e-12 and last["lowest"] >= 0


def test_nodes_without_any_bond_keep_what_is_released_into_them() -> None:
    lattice = box_lattice([0.0], [20e-5], 1e-5)
    wet = np.ones(20, bool)
    wet[[9, 11]] = False  # node 10 has no bond at a horizon of one spacing
    space = LiquidSpace(diffusion_stencil(lattice, 1e-5), wet, np.zeros(20, bool))
    chem = chemistry("nacl", 37.0, ("brucite",))
    liquid = StoredLiquid(space, speciate(chem, chem.totals(SALINE)), MAGNESIUM, np.ones(18, bool))
    start = liquid.rest()
    (alone,) = np.flatnonzero(space.degree == 0)
    source = np.where(np.arange(18) == alone, 1e-5, 0.0)
    state = liquid.advance(source, liquid.content(start), HOUR, start, np.zeros((1, 18)))
    magnesium = liquid.content(state)[chem.components.index("Mg")]
    assert magnesium[alone] == pytest.approx(HOUR * 1e-5, rel=1e-9)
    others = np.arange(18) != alone
    assert liquid.ph(state)[others] == pytest.approx(float(liquid.medium.ph[0]), abs=1e-9)
    assert liquid.stored_balance(state, source, liquid.content(start), HOUR).max() < 1e-10


ACIDS = (("H", "OH", None), ("H", "CO3", "HCO3"), ("H", "HCO3", "CO2"), ("H", "PO4", "HPO4"),
         ("H", "HPO4", "H2PO4"))  # fmt: skip
"""a + b = product (None: water), each with one rate constant of association, L/mol/s."""


def finite_rates(rate: float, step: float) -> float:
    """Largest relative difference from equilibrium after a backward Euler step of finite rates.

    SBF without ion pairs, to which 2 mol/m3 of HCl and 3 of CO2 come at once.  Unknowns are the
    extents x of the reactions, k step (a b - product / K) = x.
    """
    numbers = perilife_data.load_reaction_set("sbf").at(310.15, ())
    keep = {*numbers.components, *(p for _, _, p in ACIDS if p), "OH"}
    names = ("charge_number", "diffusivity", "stoichiometry", "water", "log_k")
    few = {n: {k: v for k, v in getattr(numbers, n).items() if k in keep} for n in names}
    chem = Chemistry(dataclasses.replace(numbers, **few))
    start = speciate(chem, chem.totals(SBF), "ideal").concentration[:, 0]
    for name, amount in (("H", 2.0), ("Cl", 2.0), ("CO2", 3.0)):
        start[chem.index(name)] += amount
    totals = (chem.stoichiometry.T @ start)[:, None]
    wanted = speciate(chem, totals, "ideal").concentration[:, 0]
    nu, ln_k = np.zeros((len(ACIDS), start.size)), np.zeros(len(ACIDS))
    for r, (a, b, product) in enumerate(ACIDS):
        nu[r, [chem.index(a), chem.index(b)]] = -1.0
        if product:
            nu[r, chem.index(product)] = 1.0
        formed = chem.ln_k[chem.index(product)] if product else 0.0
        ln_k[r] = formed - chem.ln_k[chem.index(b)] - np.log(MOLAR) * (1 if product else 2)
    x = np.linalg.lstsq(nu.T, wanted - start, rcond=None)[0]
    pace, taken = rate / MOLAR * step, -(nu < 0).astype(float)
    for _ in range(30):
        c = start + x @ nu
        pairs = np.array([c[nu[r] < 0] for r in range(len(ACIDS))])
        product = np.array([c[row > 0].sum() if row.any() else 1.0 for row in nu.clip(min=0)])
        back = product / np.exp(ln_k)
        residual = (pairs.prod(axis=1) - back - x / pace) / back
        slope = -np.eye(x.size) / (pace * back)[:, None]
        for r, row in enumerate(taken):
            first, second = np.flatnonzero(row)
            slope[r] += (nu[:, first] * c[second] + nu[:, second] * c[first]) / back[r]
            if (nu[r] > 0).any():
                slope[r] -= nu[:, nu[r] > 0][:, 0] / np.exp(ln_k[r]) / back[r]
        change = np.linalg.solve(slope, -residual)
        while ((start + (x + change) @ nu)[wanted > 0] <= 0).any():
            change *= 0.5
        x = x + change
    assert np.abs(residual).max() < 1e-10
    return float(np.abs((start + x @ nu)[wanted > 0] / wanted[wanted > 0] - 1.0).max())


@pytest.mark.parametrize("step", [3 * HOUR, DAY])
def test_acid_base_rates_up_to_1e11_end_a_step_in_equilibrium(step: float) -> None:
    found = [finite_rates(rate, step) for rate in (1e7, 1e9, 1e11)]
    # Measured 1.2e-3, 1.2e-5 and 1.2e-7 after 3 h: first order in one over the rate.
    assert found[-1] < 1e-6 and found[0] > 1e-5
    assert np.diff(np.log10(found)) == pytest.approx([-2.0, -2.0], abs=0.01)
