"""Chemistries of the shipped reaction sets, for the tests of transport."""

from functools import cache

import perilife_data
from peri.transport.species import Chemistry

SBF = {"HCO3": 34.88, "HPO4": 1.39, "Ca": 2.31, "Na": 142.0, "Cl": 109.9}
"""Totals of Table 5.3, mol/m3."""

SALINE = {"Na": 142.0, "Cl": 142.0}


@cache
def chemistry(name: str, celsius: float = 37.0, minerals: tuple[str, ...] = ()) -> Chemistry:
    """Return the chemistry of a shipped set."""
    numbers = perilife_data.load_reaction_set(name).at(celsius + 273.15, minerals)
    return Chemistry(numbers)
