"""What a liquid is made of: species, the reactions that form them, and minerals, as plain numbers.

A component is a species that the others are formed from, with water. Its number e runs over the
components, k over all species, components first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

LN10 = math.log(10.0)
MOLAR = 1000.0
"""mol/m3 in one mol/L, the standard state of the constants; molality counts as molarity."""

MINERAL_KINDS = ("equilibrium", "kinetic")
REGIONS = ("surface", "liquid")


class MineralNumbers(Protocol):
    """What a mineral is declared by; see Mineral for the units."""

    stoichiometry: Mapping[str, int]
    water: int
    log_k: float
    kind: str
    region: str
    molar_volume: float
    rate_constant: float
    specific_surface: float
    nucleation_index: float


class Declaration(Protocol):
    """What a chemistry is declared by: mappings from names to numbers, SI, log10 K in mol/L."""

    temperature: float
    components: tuple[str, ...]
    charge_number: Mapping[str, int]
    diffusivity: Mapping[str, float]
    stoichiometry: Mapping[str, Mapping[str, int]]
    water: Mapping[str, int]
    log_k: Mapping[str, float]
    minerals: Mapping[str, MineralNumbers]
    ion_size: Mapping[str, float]
    strength_coefficient: Mapping[str, float]


@dataclass(frozen=True)
class Mineral:
    """A mineral: dissolution mineral = sum_e nu_e component_e + water H2O.

    name : str
    stoichiometry : (E,) nu_e
    water : molecules of water set free
    ln_k : natural logarithm of the dissolution constant, mol/L
    kind : "equilibrium" or "kinetic"
    region : "surface" (liquid with a bond to metal) or "liquid" (everywhere)
    molar_volume : m3/mol
    rate_constant : mol/m2/s, infinite in equilibrium
    specific_surface : m2 of mineral per m3 of liquid
    nucleation_index : saturation index log10(Omega) that must be passed where there is none
    """

    name: str
    stoichiometry: np.ndarray
    water: int
    ln_k: float
    kind: str
    region: str
    molar_volume: float
    rate_constant: float = math.inf
    specific_surface: float = 0.0
    nucleation_index: float = 0.0

    @property
    def rate(self) -> float:
        """Rate constant times surface, mol/m3/s per unit of ln(Omega)."""
        return self.rate_constant * self.specific_surface


class Chemistry:
    """Species, formation reactions and minerals of one liquid at one temperature, as arrays.

    Parameters
    ----------
    declaration : Declaration
        Names and numbers, such as a reaction set of the data files at one temperature.

    Attributes
    ----------
    components, names : tuples of the names of the components (E) and of all species (K)
    stoichiometry : (K, E) nu_ke, whole numbers
    water : (K,) molecules of water bound by the formation of each species
    ln_k : (K,) ln of the formation constants, mol/L; 0 for components
    charge : (K,) charge numbers;  diffusivity : (K,) m2/s
    ion_size, strength_coefficient : (K,) m and L/mol, of the activity law `wateq`; NaN where a
        species declares none
    minerals : tuple of Mineral

    Raises
    ------
    ValueError
        For a species without charge, diffusivity or reaction, an unknown component, a reaction
        that does not conserve charge, or a number that is not finite and in range.
    """

    def __init__(self, declaration: Declaration) -> None:
        d = declaration
        self.temperature = float(d.temperature)
        self.components = tuple(d.components)
        formed = tuple(n for n in d.charge_number if n not in self.components)
        self.names = self.components + formed
        self._check(d, formed)
        self.charge = np.array([d.charge_number[n] for n in self.names], float)
        self.diffusivity = np.array([d.diffusivity[n] for n in self.names], float)
        self.ion_size = np.array([d.ion_size.get(n, math.nan) for n in self.names])
        slopes = [d.strength_coefficient.get(n, math.nan) for n in self.names]
        self.strength_coefficient = MOLAR * np.array(slopes)
        rows = [{n: 1} for n in self.components] + [d.stoichiometry[n] for n in formed]
        self.stoichiometry = np.array([self._row(row) for row in rows])
        self.water = np.array([0] * len(self.components) + [d.water[n] for n in formed], float)
        self.ln_k = LN10 * np.array([0.0] * len(self.components) + [d.log_k[n] for n in formed])
        self.minerals = tuple(self._mineral(n, m) for n, m in d.minerals.items())
        carried = self.stoichiometry @ self.charge[: len(self.components)]
        for name, given, sum_ in zip(self.names, self.charge, carried, strict=True):
            if given != sum_:
                raise ValueError(
                    f"reactions.{name}: the components carry a charge of {sum_:+g}, the species "
                    f"{given:+g}; a reaction conserves charge"
                )
        for mineral in self.minerals:
            charge = mineral.stoichiometry @ self.charge[: len(self.components)]
            if charge:
                raise ValueError(
                    f"minerals.{mineral.name}: its components carry a charge of {charge:+g}; "
                    "a mineral is neutral"
                )

    def _check(self, d: Declaration, formed: tuple[str, ...]) -> None:
        if "H" not in self.components or d.charge_number.get("H") != 1:
            raise ValueError("components: H with charge 1 must be one of them (pH, neutrality)")
        for name in self.components:
            if name not in d.charge_number:
                raise ValueError(f"components: {name} is no species")
        for name in self.names:
            value = d.diffusivity.get(name, math.nan)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(
                    f"diffusivity of {name}: {value} m2/s; it must be finite and positive"
                )
        for name in formed:
            if name not in d.stoichiometry:
                raise ValueError(f"species {name}: neither a component nor formed by a reaction")
            if not math.isfinite(d.log_k.get(name, math.nan)):
                raise ValueError(f"log_k of {name}: {d.log_k.get(name)}; it must be finite")

    def _row(self, counts: Mapping[str, int]) -> np.ndarray:
        for name in counts:
            if name not in self.components:
                raise ValueError(f"stoichiometry: {name} is no component")
        return np.array([counts.get(c, 0) for c in self.components], float)

    def _mineral(self, name: str, m: MineralNumbers) -> Mineral:
        if m.kind not in MINERAL_KINDS or m.region not in REGIONS:
            raise ValueError(
                f"minerals.{name}: kind '{m.kind}' in region '{m.region}'; allowed are "
                f"{', '.join(MINERAL_KINDS)} and {', '.join(REGIONS)}"
            )
        if m.kind == "kinetic" and not (
            math.isfinite(m.rate_constant * m.specific_surface)
            and m.rate_constant * m.specific_surface > 0
        ):
            raise ValueError(
                f"minerals.{name}: rate constant {m.rate_constant} mol/m2/s times surface "
                f"{m.specific_surface} 1/m must be finite and positive"
            )
        return Mineral(
            name,
            self._row(m.stoichiometry),
            m.water,
            LN10 * m.log_k,
            m.kind,
            m.region,
            m.molar_volume,
            m.rate_constant,
            m.specific_surface,
            m.nucleation_index,
        )

    def index(self, name: str) -> int:
        """Return the number of a species. Raises ValueError for an unknown one."""
        if name not in self.names:
            raise ValueError(f"species '{name}' is unknown; known are {', '.join(self.names)}")
        return self.names.index(name)

    @property
    def component_charge(self) -> np.ndarray:
        """Charge numbers of the components, (E,)."""
        return self.charge[: len(self.components)]

    def charge_groups(self) -> list[tuple[int, float, np.ndarray]]:
        """Per component and charge number: the weights nu_ke D_k of the species that carry it."""
        nu, z, d = self.stoichiometry, self.charge, self.diffusivity
        return [
            (e, float(charge), np.where(z == charge, nu[:, e] * d, 0.0))
            for e in range(nu.shape[1])
            for charge in np.unique(z[(nu[:, e] != 0) & (z != 0)])
        ]

    def totals(self, species: Mapping[str, float]) -> np.ndarray:
        """Return totals of the components, mol/m3, from amounts of species; H from neutrality.

        T_e = sum_k nu_ke C_k for all but H. The charge of any mixture is sum_e z_e T_e, because
        every species carries the charge of the components that it is formed from, so T_H is what
        makes it zero: a pH is a result, never an input.

        Raises ValueError for an unknown species or an amount that is negative or not finite.
        """
        totals = np.zeros(len(self.components))
        for name, amount in species.items():
            if not (math.isfinite(amount) and amount >= 0):
                raise ValueError(
                    f"total of {name}: {amount} mol/m3; it must be finite and not negative"
                )
            totals += amount * self.stoichiometry[self.index(name)]
        return self.neutral(totals)

    def neutral(self, totals: np.ndarray) -> np.ndarray:
        """Return totals (E, ...) with that of H such that the mixture carries no charge."""
        h = self.components.index("H")
        totals = np.array(totals, float)
        totals[h] = 0.0
        totals[h] = -np.tensordot(self.component_charge, totals, 1)
        return totals
