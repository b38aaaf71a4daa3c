"""One-dimensional liquid columns: metal on the left, refreshed medium on the right."""

import numpy as np

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import box_lattice
from peri.transport.chemistry.speciation import Solution, speciate
from peri.transport.chemistry.species import Chemistry
from peri.transport.liquid import LiquidSpace
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions

MAGNESIUM = {"Mg": 1.0, "OH": 2.0}


def medium_of(chemistry: Chemistry, totals: dict[str, float], activity: str = "davies") -> Solution:
    """The medium at its own ionic strength."""
    return speciate(chemistry, chemistry.totals(totals), activity)


def column(
    chemistry: Chemistry,
    totals: dict[str, float],
    nodes: int = 40,
    length: float = 0.5e-3,
    m: int = 3,
    **options,
) -> tuple[QuasiSteadyLiquid, np.ndarray]:
    """A column of `nodes` free nodes and m refreshed ones; and the source of a unit flux."""
    h = length / nodes
    lattice = box_lattice([0.0], [(nodes + m) * h], h)
    refreshed = np.arange(nodes + m) >= nodes
    stencil = diffusion_stencil(lattice, m * h)
    space = LiquidSpace(stencil, np.ones(nodes + m, bool), refreshed)
    surface = np.arange(nodes) == 0
    source = surface / h
    liquid = QuasiSteadyLiquid(
        space, medium_of(chemistry, totals), MAGNESIUM, surface, TransportOptions(**options)
    )
    return liquid, source
