"""Chemistries of the shipped reaction sets, for the tests of transport."""

import dataclasses
from functools import cache

import perilife_data
from peri.transport.chemistry.species import Chemistry

SBF = {"HCO3": 34.88, "HPO4": 1.39, "Ca": 2.31, "Na": 142.0, "Cl": 109.9}
"""Totals of Table 5.3, mol/m3."""

SALINE = {"Na": 142.0, "Cl": 142.0}


@cache
def chemistry(name: str, celsius: float = 37.0, minerals: tuple[str, ...] = ()) -> Chemistry:
    """Return the chemistry of a shipped set."""
    numbers = perilife_data.load_reaction_set(name).at(celsius + 273.15, minerals)
    return Chemistry(numbers)


@cache
def without(
    name: str, left_out: tuple[str, ...], celsius: float = 37.0, minerals: tuple[str, ...] = ()
) -> Chemistry:
    """Return the chemistry of a shipped set less some of its formed species."""
    numbers = perilife_data.load_reaction_set(name).at(celsius + 273.15, minerals)

    def kept(mapping):
        return {n: v for n, v in mapping.items() if n not in left_out}

    return Chemistry(
        dataclasses.replace(
            numbers,
            charge_number=kept(numbers.charge_number),
            diffusivity=kept(numbers.diffusivity),
            stoichiometry=kept(numbers.stoichiometry),
            water=kept(numbers.water),
            log_k=kept(numbers.log_k),
        )
    )


PAIRS = (
    "MgOH", "MgHCO3", "MgCO3", "MgHPO4", "MgPO4", "CaHCO3",
    "CaCO3", "CaHPO4", "CaPO4", "NaHCO3", "NaCO3", "NaHPO4",
)  # fmt: skip
