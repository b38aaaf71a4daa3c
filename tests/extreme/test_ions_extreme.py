"""Ions in extreme media and releases: positive, neutral, conservative, or one clear refusal."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import perilife_data
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import box_lattice
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.composition import CompositionError
from peri.transport.chemistry.speciation import speciate
from peri.transport.chemistry.species import Chemistry
from peri.transport.liquid import LiquidSpace
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions
from tests.peri.transport.chemistries import SALINE, SBF, chemistry
from tests.peri.transport.columns import MAGNESIUM, column

ROOT = Path(__file__).resolve().parents[2]


def liquid_in(chem: Chemistry, totals: dict, nodes: int = 30, **options):
    """A column with a medium of ideal activities, and the source of a unit flux."""
    h = 0.5e-3 / nodes
    lattice = box_lattice([0.0], [(nodes + 3) * h], h)
    refreshed = np.arange(nodes + 3) >= nodes
    space = LiquidSpace(diffusion_stencil(lattice, 3 * h), np.ones(nodes + 3, bool), refreshed)
    medium = speciate(chem, chem.totals(totals), "ideal")
    surface = np.arange(nodes) == 0
    liquid = QuasiSteadyLiquid(space, medium, MAGNESIUM, surface, TransportOptions(**options))
    return liquid, surface / h


def check(liquid: QuasiSteadyLiquid, source: np.ndarray, balance: float = 1e-10) -> object:
    state = liquid.solve(source)
    strength = 0.5 * liquid.chemistry.charge**2 @ state.concentration
    assert np.isfinite(state.concentration).all() and (state.concentration >= 0).all()
    assert (np.abs(state.net_charge) <= 1e-12 * strength).all()
    assert liquid.balance(state, source).max() < balance
    return state


@pytest.mark.parametrize("flux", [1e-9, 1e-6, 1e-4])
def test_media_of_ph_0_and_14(flux: float) -> None:
    chem = chemistry("nacl", 37.0, ("brucite",))
    acid, unit = liquid_in(chem, {"Cl": 1000.0, "Na": 0.0})
    state = check(acid, flux * unit, 1e-7 if flux < 1e-8 else 1e-10)
    assert acid.ph(state).min() == pytest.approx(0.0, abs=0.3)
    alkali, _ = liquid_in(chem, {"Na": 1000.0, "Cl": 0.0})
    state = check(alkali, flux * unit, 1e-7 if flux < 1e-8 else 1e-10)
    assert alkali.ph(state).max() > 13.5
    # The alkali leaves hardly any magnesium in solution.
    share = alkali.space.total(state.rates[0]) / alkali.space.total(flux * unit)
    assert share > 0.99 if flux > 1e-7 else share >= 0.0


@pytest.mark.parametrize("flux", [1e-12, 1e-9])
def test_pure_water(flux: float) -> None:
    chem = chemistry("nacl", 37.0, ("brucite",))
    liquid, unit = liquid_in(chem, {})
    state = check(liquid, flux * unit)
    if flux >= 1e-9:
        assert liquid.ph(state)[0] > 7.2  # 6.81 at rest
    assert np.abs(state.psi).max() > 0


def test_a_strong_release_into_pure_water_is_refused_in_one_sentence() -> None:
    # No salt carries the charge, so the sweeps for the potential do not contract: a stated limit.
    liquid, unit = liquid_in(chemistry("nacl", 37.0, ("brucite",)), {})
    refused = (ConvergenceError, CompositionError)
    with pytest.raises(refused, match="too little salt for this release"):
        liquid.solve(1e-6 * unit)


def test_a_release_that_would_fill_the_liquid_with_magnesium() -> None:
    chem = chemistry("nacl", 37.0, ("brucite",))
    liquid, unit = column(chem, SALINE)
    source = 1e-3 * unit  # 550 mol/m3 at the surface, were there no brucite
    state = check(liquid, source)
    share = liquid.space.total(state.rates[0]) / liquid.space.total(source)
    assert share > 0.99


def test_diffusivities_over_seven_decades() -> None:
    numbers = perilife_data.load_reaction_set("nacl").at(310.15, ())
    spread = dict(zip(numbers.diffusivity, 10.0 ** np.linspace(-7, -14, 6), strict=True))
    chem = Chemistry(dataclasses.replace(numbers, diffusivity=spread))
    liquid, unit = liquid_in(chem, SALINE, closure="none")
    state = liquid.solve(1e-9 * unit)
    assert np.isfinite(state.concentration).all() and (state.concentration >= 0).all()
    assert liquid.balance(state, 1e-9 * unit).max() < 1e-8


def test_a_node_with_one_bond_only() -> None:
    lattice = box_lattice([0.0, 0.0], [12e-5, 12e-5], 1e-5)
    liquid = np.zeros((12, 12), bool)
    liquid[:, 6:] = True
    liquid[3, 5] = True  # beside the others by one bond along the axis
    refreshed = np.zeros_like(liquid)
    refreshed[:, 10:] = True
    space = LiquidSpace(diffusion_stencil(lattice, 1e-5), liquid, refreshed)
    chem = chemistry("sbf")
    medium = speciate(chem, chem.totals(SBF))
    problem = QuasiSteadyLiquid(space, medium, MAGNESIUM, np.ones(space.n, bool))
    source = space.gather(space.sum.pad(np.where(np.arange(144).reshape(12, 12) == 41, 1e-2, 0)))
    assert source.sum() == 1e-2
    check(problem, source)


def test_elements_that_no_node_holds() -> None:
    chem = chemistry("sbf")
    bare = {"Na": 10.0, "Cl": 10.0}  # no carbonate, phosphate or calcium at all
    liquid, unit = liquid_in(chem, bare)
    state = check(liquid, 1e-7 * unit)
    for name in ("CaHCO3", "HPO4", "CO2"):
        assert (state.concentration[chem.index(name)] == 0.0).all()


@pytest.mark.slow
def test_five_hundred_random_scenes() -> None:
    rng = np.random.default_rng(500)
    chems = [chemistry("sbf"), chemistry("nacl", 37.0, ("brucite",))]
    for scene in range(500):
        chem = chems[scene % 2]
        scale = 10.0 ** rng.uniform(-0.5, 0.5)
        totals = {n: c * scale for n, c in (SALINE if scene % 2 else SBF).items()}
        liquid, unit = column(
            chem, totals, int(rng.integers(4, 40)), 10.0 ** rng.uniform(-4, -3),
            int(rng.integers(1, 4)),
        )  # fmt: skip
        source = 10.0 ** rng.uniform(-7.5, -4.5) * unit
        state = liquid.solve(source)
        strength = 0.5 * chem.charge**2 @ state.concentration
        assert (state.concentration >= 0).all(), scene
        assert (np.abs(state.net_charge) <= 1e-12 * strength).all(), scene
        assert liquid.balance(state, source).max() < 1e-10, scene


def test_no_concentration_is_clipped_anywhere() -> None:
    found = [
        f"{path.name}: {line.strip()}"
        for folder in ("transport", "coupled")
        for path in (ROOT / "peri" / folder).rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\bclip\(|maximum\([^)]*concentration|concentration[^=]*\.clip", line)
    ]
    assert found == []
