"""Sets of dissolved species, reactions and minerals: what a medium is made of, as data.

A set names its components (the species that every other one is formed from, with water) and, for
each other species, one reaction that forms it. Stoichiometry, charges and compositions are whole
numbers; diffusivities, equilibrium constants and the rest are quantities with unit, source and
kind, given at one or more temperatures. Elements and charge are checked on reading.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from . import limits
from .limits import Limits
from .load import Table, path_of, read, shipped
from .schema import Quantity, Record
from .units import to_si

ACTIVITIES = ("davies", "wateq", "fixed", "ideal")
MINERAL_KINDS = ("equilibrium", "kinetic")
REGIONS = ("surface", "liquid")
WATER = {"H": 2, "O": 1}
_AT = re.compile(r"at_(\d+(?:\.\d+)?)_degC")


@dataclass(frozen=True)
class DissolvedSpecies(Record):
    """A dissolved species: charge number, atoms of each element, D (m^2/s) by temperature (K).

    ion_size, strength_coefficient : a0 and b of the activity law `wateq`; None: the law is
    Davies' for this species, as in PHREEQC.
    """

    charge_number: int
    composition: Mapping[str, int]
    diffusivity: Mapping[float, Quantity]
    ion_size: Quantity | None = None
    strength_coefficient: Quantity | None = None


@dataclass(frozen=True)
class FormationReaction(Record):
    """sum_e nu_e component_e + `water` H2O = species; log10 K in mol/L, by temperature (K)."""

    stoichiometry: Mapping[str, int]
    water: int
    log_k: Mapping[float, Quantity]


@dataclass(frozen=True)
class MineralData(Record):
    """mineral = sum_e nu_e component_e + `water` H2O, with log10 K of this dissolution in mol/L.

    A kinetic mineral has a rate constant (mol/m^2/s), a surface per volume of liquid (1/m) and
    the saturation index log10(Omega) that it must pass before it forms where there is none.
    """

    title: str
    composition: Mapping[str, int]
    stoichiometry: Mapping[str, int]
    water: int
    kind: str
    region: str
    log_k: Mapping[float, Quantity]
    molar_volume: Quantity
    rate_constant: Mapping[float, Quantity] = field(default_factory=dict)
    specific_surface: Quantity | None = None
    nucleation_index: Quantity | None = None


@dataclass(frozen=True)
class InhibitorData(Record):
    """A component that covers the metal: rate times 1 - efficiency K C / (1 + K C)."""

    component: str
    adsorption_constant: Quantity  # K, m^3/mol
    efficiency: Quantity


@dataclass(frozen=True)
class ReactionSet(Record):
    """Species, reactions and minerals that belong together; `at` gives numbers in SI."""

    name: str
    title: str
    components: tuple[str, ...]
    species: Mapping[str, DissolvedSpecies]
    reactions: Mapping[str, FormationReaction]
    minerals: Mapping[str, MineralData]
    activity: str
    inhibitor: InhibitorData | None = None
    first_published: str = ""
    note: str = ""

    def at(self, temperature: float, minerals: tuple[str, ...] = ()) -> "ReactionNumbers":
        """Return the numbers at a temperature (K), between those that the set holds.

        ln D, log10 K and the logarithm of a rate constant are linear in 1/T (Arrhenius, van 't
        Hoff with constant enthalpy). Raises ValueError for an unknown mineral and for a
        temperature at which a number is not known.
        """
        for mineral in minerals:
            if mineral not in self.minerals:
                raise ValueError(
                    f"mineral '{mineral}' is not in the set '{self.name}'; "
                    f"it holds {', '.join(self.minerals) or 'none'}"
                )

        def between(values: Mapping[float, Quantity], what: str, log: bool) -> float:
            return _between(values, temperature, f"{self.name}: {what}", log)

        return ReactionNumbers(
            temperature=temperature,
            components=self.components,
            charge_number={n: s.charge_number for n, s in self.species.items()},
            diffusivity={
                n: between(s.diffusivity, f"the diffusivity of {n}", True)
                for n, s in self.species.items()
            },
            ion_size={n: s.ion_size.si for n, s in self.species.items() if s.ion_size},
            strength_coefficient={
                n: s.strength_coefficient.si
                for n, s in self.species.items()
                if s.strength_coefficient
            },
            stoichiometry={n: dict(r.stoichiometry) for n, r in self.reactions.items()},
            water={n: r.water for n, r in self.reactions.items()},
            log_k={n: between(r.log_k, f"log_k of {n}", False) for n, r in self.reactions.items()},
            minerals={
                n: MineralNumbers(
                    stoichiometry=dict(m.stoichiometry),
                    water=m.water,
                    log_k=between(m.log_k, f"log_k of {n}", False),
                    kind=m.kind,
                    region=m.region,
                    molar_volume=m.molar_volume.si,
                    rate_constant=(
                        between(m.rate_constant, f"rate_constant of {n}", True)
                        if m.kind == "kinetic"
                        else math.inf
                    ),
                    specific_surface=m.specific_surface.si if m.specific_surface else 0.0,
                    nucleation_index=m.nucleation_index.si if m.nucleation_index else 0.0,
                )
                for n, m in self.minerals.items()
                if n in minerals
            },
            inhibitor=self.inhibitor
            and InhibitorNumbers(
                self.inhibitor.component,
                self.inhibitor.adsorption_constant.si,
                self.inhibitor.efficiency.si,
            ),
        )

    def used(self, temperature: float, minerals: tuple[str, ...] = ()) -> dict[str, Quantity]:
        """Return the quantities that `at` reads for a temperature (K), by dotted name."""
        read = replace(
            self,
            species={
                n: replace(s, diffusivity=_around(s.diffusivity, temperature))
                for n, s in self.species.items()
            },
            reactions={
                n: replace(r, log_k=_around(r.log_k, temperature))
                for n, r in self.reactions.items()
            },
            minerals={
                n: replace(
                    m,
                    log_k=_around(m.log_k, temperature),
                    rate_constant=_around(m.rate_constant, temperature),
                )
                for n, m in self.minerals.items()
                if n in minerals
            },
        )
        return read.quantities()


@dataclass(frozen=True)
class MineralNumbers:
    """A mineral at one temperature, SI; log_k stays log10 in mol/L."""

    stoichiometry: dict[str, int]
    water: int
    log_k: float
    kind: str
    region: str
    molar_volume: float
    rate_constant: float
    specific_surface: float
    nucleation_index: float


@dataclass(frozen=True)
class InhibitorNumbers:
    """An inhibitor, SI."""

    component: str
    adsorption_constant: float
    efficiency: float


@dataclass(frozen=True)
class ReactionNumbers:
    """A set at one temperature (K): plain numbers in SI; log_k stays log10 in mol/L."""

    temperature: float
    components: tuple[str, ...]
    charge_number: dict[str, int]
    diffusivity: dict[str, float]
    stoichiometry: dict[str, dict[str, int]]
    water: dict[str, int]
    log_k: dict[str, float]
    minerals: dict[str, MineralNumbers]
    inhibitor: InhibitorNumbers | None = None
    ion_size: dict[str, float] = field(default_factory=dict)
    strength_coefficient: dict[str, float] = field(default_factory=dict)


def _between(values: Mapping[float, Quantity], temperature: float, what: str, log: bool) -> float:
    known = sorted(values)
    if temperature < known[0] - 1e-6 or temperature > known[-1] + 1e-6:
        span = " to ".join(f"{t - 273.15:g}" for t in dict.fromkeys((known[0], known[-1])))
        raise ValueError(
            f"{what} is not known at {temperature - 273.15:g} degC; it is known at {span} degC"
        )
    numbers = [math.log(values[t].si) if log else values[t].si for t in known]
    if len(known) == 1:
        result = numbers[0]
    else:
        upper = next((i for i, t in enumerate(known) if t >= temperature), len(known) - 1)
        upper = max(upper, 1)
        low, high = 1 / known[upper - 1], 1 / known[upper]
        share = (1 / temperature - low) / (high - low)
        result = numbers[upper - 1] + share * (numbers[upper] - numbers[upper - 1])
    return math.exp(result) if log else result


def _around(values: Mapping[float, Quantity], temperature: float) -> dict[float, Quantity]:
    """The value at a temperature (K), else the nearest below and above."""
    near = [t for t in values if abs(t - temperature) < 1e-6]
    if not near:
        below = [t for t in values if t < temperature]
        above = [t for t in values if t > temperature]
        near = [*([max(below)] if below else []), *([min(above)] if above else [])]
    return {t: values[t] for t in near}


def list_reaction_sets() -> list[str]:
    """Return the names of the shipped reaction sets."""
    return list(shipped("reactions"))


def load_reaction_set(name: str | Path) -> ReactionSet:
    """Return a reaction set by its name, or from a .toml file of one's own.

    Raises ValueError for an unknown name or whatever is wrong in the file (unknown keys, missing
    units, a species without a reaction, a reaction that does not conserve an element or the
    charge), FileNotFoundError where there is no such file.
    """
    file = read(path_of("reactions", "reaction set", name))
    components = tuple(file.texts("components"))
    species = {n: _species(table) for n, table in file.tables("species").items()}
    reactions = {n: _reaction(table, components) for n, table in _optional(file, "reactions")}
    minerals = {n: _mineral(table, components) for n, table in _optional(file, "minerals")}
    loaded = ReactionSet(
        name=file.text("name"),
        title=file.text("title"),
        components=components,
        species=species,
        reactions=reactions,
        minerals=minerals,
        activity=file.text("activity", allowed=ACTIVITIES),
        inhibitor=_inhibitor(file, components) if "inhibitor" in file.entries else None,
        first_published=file.source_or_none("first_published"),
        note=file.text("note", default=""),
    )
    file.done()
    _check_names(file, loaded)
    for n, reaction in reactions.items():
        _check_balance(
            file,
            f"reactions.{n}",
            loaded,
            reaction,
            species[n].composition,
            species[n].charge_number,
        )
    for n, mineral in minerals.items():
        _check_balance(file, f"minerals.{n}", loaded, mineral, mineral.composition, 0)
    return loaded


def _optional(file: Table, key: str) -> list[tuple[str, Table]]:
    return list(file.tables(key).items()) if key in file.entries else []


def _quantity_or_none(table: Table, key: str, allowed: Limits) -> Quantity | None:
    return table.quantity(key, allowed) if key in table.entries else None


def _species(table: Table) -> DissolvedSpecies:
    species = DissolvedSpecies(
        charge_number=table.integer("charge_number", -4, 4),
        composition=_counts(table, "composition", lowest=1),
        diffusivity=_by_temperature(table, "diffusivity", limits.SPECIES_DIFFUSIVITY),
        ion_size=_quantity_or_none(table, "ion_size", limits.ION_SIZE),
        strength_coefficient=_quantity_or_none(
            table, "strength_coefficient", limits.STRENGTH_COEFFICIENT
        ),
    )
    if (species.ion_size is None) != (species.strength_coefficient is None):
        raise table.fail("ion_size", "and strength_coefficient go together; give both or neither")
    table.done()
    return species


def _reaction(table: Table, components: tuple[str, ...]) -> FormationReaction:
    reaction = FormationReaction(
        stoichiometry=_counts(table, "stoichiometry", -9, components),
        water=table.integer("water", -20, 20, default=0),
        log_k=_by_temperature(table, "log_k", limits.LOG_K),
    )
    table.done()
    return reaction


def _mineral(table: Table, components: tuple[str, ...]) -> MineralData:
    kind = table.text("kind", allowed=MINERAL_KINDS)
    kinetic = kind == "kinetic"
    mineral = MineralData(
        title=table.text("title"),
        composition=_counts(table, "composition", lowest=1),
        stoichiometry=_counts(table, "stoichiometry", -9, components),
        water=table.integer("water", -20, 20, default=0),
        kind=kind,
        region=table.text("region", allowed=REGIONS),
        log_k=_by_temperature(table, "log_k", limits.LOG_K),
        molar_volume=table.quantity("molar_volume", limits.MOLAR_VOLUME),
        rate_constant=(
            _by_temperature(table, "rate_constant", limits.RATE_CONSTANT) if kinetic else {}
        ),
        specific_surface=(
            table.quantity("specific_surface", limits.SPECIFIC_SURFACE) if kinetic else None
        ),
        nucleation_index=(
            table.quantity("nucleation_index", limits.NUCLEATION_INDEX) if kinetic else None
        ),
    )
    table.done()
    return mineral


def _inhibitor(file: Table, components: tuple[str, ...]) -> InhibitorData:
    table = file.table("inhibitor")
    inhibitor = InhibitorData(
        component=table.text("component", allowed=components),
        adsorption_constant=table.quantity("adsorption_constant", limits.ADSORPTION_CONSTANT),
        efficiency=table.quantity("efficiency", limits.EFFICIENCY),
    )
    table.done()
    return inhibitor


def _counts(
    table: Table, key: str, lowest: int, allowed: tuple[str, ...] | None = None
) -> dict[str, int]:
    inner = table.table(key)
    counts = {}
    for name in list(inner.entries):
        if allowed is not None and name not in allowed:
            raise inner.fail(name, f"is no component; components are {', '.join(allowed)}")
        counts[name] = inner.integer(name, lowest, 99)
        if counts[name] == 0:
            raise inner.fail(name, "is 0; leave it out")
    if not counts:
        raise table.fail(key, "is empty; it must hold one entry at least")
    return counts


def _by_temperature(table: Table, key: str, allowed: Limits) -> dict[float, Quantity]:
    found = {}
    for name, inner in table.tables(key).items():
        match = _AT.fullmatch(name)
        if match is None:
            raise table.fail(f"{key}.{name}", "must be named like at_37_degC")
        found[to_si(float(match[1]), "degC", "temperature")] = inner.as_quantity(allowed)
    return found


def _check_names(file: Table, loaded: ReactionSet) -> None:
    for component in loaded.components:
        if component not in loaded.species:
            raise file.fail("components", f"names {component}, which is no species of the file")
        if component in loaded.reactions:
            raise file.fail(f"reactions.{component}", "forms a component; components are given")
    if "H" not in loaded.components:
        raise file.fail("components", "must hold H, which neutrality and pH are read from")
    for name in loaded.species:
        if name not in loaded.components and name not in loaded.reactions:
            raise file.fail(
                f"species.{name}", "is neither a component nor formed by a reaction of the file"
            )
    for name in loaded.reactions:
        if name not in loaded.species:
            raise file.fail(f"reactions.{name}", "forms no species of the file")


def _check_balance(
    file: Table,
    where: str,
    loaded: ReactionSet,
    reaction: FormationReaction | MineralData,
    composition: Mapping[str, int],
    charge: int,
) -> None:
    """Refuse a reaction whose sides differ in an element or in charge."""

    def count(element: str) -> int:
        return reaction.water * WATER.get(element, 0) + sum(
            n * loaded.species[c].composition.get(element, 0)
            for c, n in reaction.stoichiometry.items()
        )

    elements = {e for c in reaction.stoichiometry for e in loaded.species[c].composition}
    for element in sorted(elements | set(WATER) | set(composition)):
        if count(element) != composition.get(element, 0):
            raise file.fail(
                where,
                f"does not conserve {element}: {count(element)} atoms of components and water "
                f"against {composition.get(element, 0)}",
            )
    carried = sum(n * loaded.species[c].charge_number for c, n in reaction.stoichiometry.items())
    if carried != charge:
        raise file.fail(
            where, f"does not conserve charge: the components carry {carried:+d}, not {charge:+d}"
        )
