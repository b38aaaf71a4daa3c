"""Random liquids that store, open or closed, in steps of 1 s to 1 d: positive, neutral, booked."""

import dataclasses

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
from peri.transport.nernst_planck import TransportOptions
from peri.transport.stored import StoredLiquid
from tests.peri.transport.columns import MAGNESIUM


def random_liquid(rng: np.random.Generator) -> tuple[StoredLiquid, np.ndarray]:
    """A column of random spacing, horizon, medium, diffusivities and minerals; and a source."""
    name = str(rng.choice(["sbf", "nacl"]))
    minerals = ("brucite",) if rng.random() < 0.6 else ()
    numbers = perilife_data.load_reaction_set(name).at(310.15, minerals)
    spread = {n: d * 10.0 ** rng.uniform(-0.2, 0.2) for n, d in numbers.diffusivity.items()}
    chemistry = Chemistry(dataclasses.replace(numbers, diffusivity=spread))
    salt = 10.0 ** rng.uniform(1, 2.7)
    totals = {"Na": salt, "Cl": salt}
    if name == "sbf":
        totals |= {n: 10.0 ** rng.uniform(-2, 1.3) for n in ("HCO3", "HPO4", "Ca")}
        totals["Na"] += totals["HCO3"] + 2 * totals["HPO4"]
        totals["Cl"] += 2 * totals["Ca"]
    medium = speciate(chemistry, chemistry.totals(totals))
    nodes, m = int(rng.integers(3, 30)), int(rng.integers(1, 4))
    closed = rng.random() < 0.5
    h = 10.0 ** rng.uniform(-5, -4)
    count = nodes + (0 if closed else m)
    lattice = box_lattice([0.0], [count * h], h)
    held = np.arange(count) >= nodes
    space = LiquidSpace(diffusion_stencil(lattice, m * h), np.ones(count, bool), held)
    surface = np.arange(nodes) == 0
    options = TransportOptions(closure=str(rng.choice(["electroneutral", "none"])))
    liquid = StoredLiquid(space, medium, MAGNESIUM, surface, options)
    # Up to what makes a few mol/m3 of magnesium beside the metal; weaker ones drown in round-off.
    strength = 10.0 ** rng.uniform(-3, 0.3) * 1e-9 / (h * nodes * h)
    return liquid, strength * rng.random(nodes) * (rng.random(nodes) < 0.4)


@pytest.mark.parametrize(
    ("scenes", "seed"), [(20, 1), pytest.param(500, 2, marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_random_liquids(scenes: int, seed: int) -> None:
    rng, shortened, worst = np.random.default_rng(seed), 0, 0.0
    for scene in range(scenes):
        liquid, source = random_liquid(rng)
        start, step = liquid.rest(), 10.0 ** rng.uniform(0, 5)
        content = liquid.content(start)
        amounts = np.zeros((len(liquid.minerals), liquid.space.n))
        for _ in range(8):  # as the march does
            try:
                state = liquid.advance(source, content, step, start, amounts)
                break
            except (ConvergenceError, CompositionError):
                step, shortened = 0.25 * step, shortened + 1
        else:
            raise AssertionError(f"scene {scene}: no step was short enough")
        concentration = state.concentration
        if liquid.options.closure == "none":
            concentration = liquid.neutral_concentration(state)
        strength = 0.5 * liquid.chemistry.charge**2 @ concentration
        assert (concentration >= 0).all(), scene
        assert (np.abs(liquid.chemistry.charge @ concentration) <= 1e-12 * strength).all(), scene
        after = liquid.conserved(state, source, content, step)
        gained = step * liquid.released * liquid.space.total(source)
        gone = step * (liquid.leaving(state) + liquid.formed(state))
        kept = np.array([liquid.space.total(row) for row in after - content])
        held = np.array([liquid.space.total(np.abs(row)) for row in content])
        scale = np.maximum(np.abs(gained) + np.abs(gone) + np.abs(kept) + held, 1e-300)
        assert (np.abs(gained - gone - kept) / scale < 1e-10).all(), scene
        apart = np.abs(after - liquid.content(state)).max() / np.abs(content).max()
        worst = max(worst, float(apart))
    # What was found against what was booked, of the largest content: measured 2e-8 in 500 scenes,
    # of whose first steps 11 had to be shortened.
    assert worst < 1e-7
    assert shortened < 0.05 * scenes
