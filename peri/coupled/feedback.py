"""What the metal's kinetics reads of the liquid: pH, ions and minerals beside each metal node."""

from __future__ import annotations

import numpy as np

from peri.coupled.surroundings import Surroundings
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidState

OF_THE_LIQUID = frozenset({"ph", "chloride", "magnesium", "layer"})
"""Quantities of peri.corrosion.kinetics.Exposed that come from here."""


def medium_beside(medium: Solution) -> dict[str, np.ndarray | float]:
    """What metal in fresh medium sees: no magnesium but the medium's own, no layer."""
    return {
        "ph": float(medium.ph[0]),
        "chloride": _total(medium, "Cl"),
        "magnesium": _total(medium, "Mg"),
        "layer": 0.0,
    }


def _total(medium: Solution, component: str) -> float:
    names = medium.chemistry.components
    return float(medium.totals[names.index(component), 0]) if component in names else 0.0


def beside_metal(
    around: Surroundings, state: LiquidState, amounts: np.ndarray
) -> dict[str, np.ndarray | float]:
    """The mean over each metal node's bonds to liquid, as padded fields of the box around it.

    state : of the liquid;  amounts : (M, n) minerals, mol/m3.  The layer's thickness is the volume
    of the minerals per volume of liquid times the width of a cell, the liquid cell being what
    stands in front of the metal.
    """
    discrete, space, liquid = around.discrete, around.space, around.liquid
    if discrete.box is None:
        return {}
    chemistry = liquid.chemistry
    volume = discrete.take(space.all_volume)
    bonds = discrete.box(volume)
    sees = bonds > 0

    def mean(values: np.ndarray, held: float) -> np.ndarray:
        field = discrete.take(space.all_volume * space.spread(values, held))
        return np.divide(discrete.box(field), bonds, out=np.full(bonds.shape, held), where=sees)

    totals = chemistry.stoichiometry.T @ state.concentration
    edge = chemistry.stoichiometry.T @ liquid.edge
    h = chemistry.components.index("H")
    # The refreshed layer's pH is the medium's, moved by what it holds of H now.
    fresh = float(liquid.medium.concentration[h, 0])
    held = float(liquid.medium.ph[0]) + float(np.log10(fresh / liquid.edge[h]))
    found: dict[str, np.ndarray | float] = {"ph": mean(liquid.ph(state), held)}
    for name, component in (("chloride", "Cl"), ("magnesium", "Mg")):
        if component in chemistry.components:
            e = chemistry.components.index(component)
            found[name] = mean(totals[e], float(edge[e]))
    width = float(np.prod(around.discrete.scene.lattice.spacing)) ** (
        1.0 / around.discrete.scene.lattice.dimension
    )
    thickness = np.zeros(space.n)
    for mineral, amount in zip(chemistry.minerals, amounts, strict=True):
        thickness += mineral.molar_volume * amount * width
    found["layer"] = mean(thickness, 0.0)
    return found
