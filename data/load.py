"""Reads alloys, media and parameter sets from TOML and refuses whatever is not plainly right.

A quantity is a table with `value`, `unit`, `source`, `where`, `kind` and, where it helps,
`conditions` and `note`. Every refusal is a ValueError of one sentence: file, field, value, what
is allowed.
"""

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from math import isfinite
from pathlib import Path

from . import limits
from .limits import Limits
from .names import did_you_mean
from .own_files import file_meant, refuse_another_kind, refuse_unfilled
from .references import FOLDER, Reference, read_references, shipped_references
from .schema import (
    KINDS,
    Alloy,
    Calibration,
    CalibrationScene,
    CorrosionParameters,
    Element,
    Medium,
    OwnCorrosion,
    ParameterSet,
    Quantity,
    Species,
)
from .units import UNITS

CALIBRATIONS = ("closed", "discrete")
SATURATIONS = ("as_published", "complementarity", "none")
BOUNDARIES = ("refreshed", "no_flux")
DOMAINS = ("cylinder", "ball")

_MOST_SAMPLES = 100_000


class Table:
    """One TOML table: hands out its entries by name, checked, and refuses what is left over."""

    def __init__(self, name: str, entries: object, file: str, sources: Mapping[str, Reference]):
        self.name, self.file, self.sources = name, file, sources
        if not isinstance(entries, dict):
            raise ValueError(f"{file}: {name} is {entries!r}; it must be a table")
        self.entries = dict(entries)

    def _field(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key

    def fail(self, key: str, what: str) -> ValueError:
        """Return the error that says what is wrong with an entry."""
        return ValueError(f"{self.file}: {self._field(key)} {what}")

    def _take(self, key: str) -> object:
        if key not in self.entries:
            raise self.fail(key, "is missing")
        return self.entries.pop(key)

    def text(self, key: str, default: str | None = None, allowed: tuple[str, ...] = ()) -> str:
        """Return a string, one of `allowed` where that is given."""
        if default is not None and key not in self.entries:
            return default
        value = self._take(key)
        if not isinstance(value, str) or not (value.strip() or default == ""):
            raise self.fail(key, f"is {value!r}; it must be a text in quotes")
        if allowed and value not in allowed:
            raise self.fail(
                key,
                f"is '{value}'{did_you_mean(value, allowed)}; it must be one of "
                f"{', '.join(allowed)}",
            )
        return value

    def texts(self, key: str) -> list[str]:
        """Return a list of different strings, one at least."""
        values = self._take(key)
        good = isinstance(values, list) and all(isinstance(v, str) and v.strip() for v in values)
        if not good or not values or len(set(values)) < len(values):
            raise self.fail(key, f"is {values!r}; it must be a list of different names")
        return values

    def number(self, key: str) -> float:
        """Return a finite number without a unit."""
        value = self._take(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise self.fail(key, f"is {value!r}; it must be a finite number without quotes")
        return float(value)

    def numbers(self, key: str) -> list[float]:
        """Return a list of finite numbers without units."""
        values = self._take(key)
        good = isinstance(values, list) and all(
            isinstance(v, int | float) and not isinstance(v, bool) and isfinite(v) for v in values
        )
        if not good or not values:
            raise self.fail(key, f"is {values!r}; it must be a list of finite numbers")
        return [float(v) for v in values]

    def integer(self, key: str, lowest: int, highest: int, default: int | None = None) -> int:
        """Return a whole number within a range."""
        if default is not None and key not in self.entries:
            return default
        value = self._take(key)
        if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
            raise self.fail(
                key, f"is {value!r}; it must be a whole number from {lowest} to {highest}"
            )
        return value

    def source(self, key: str) -> str:
        """Return a key of the bibliography."""
        source = self.text(key)
        if source not in self.sources:
            beside = f"neither of the shipped one nor of one in the folder of {self.file}"
            raise self.fail(key, f"is '{source}', which is not a key of references.bib, {beside}")
        return source

    def source_or_none(self, key: str) -> str:
        """Return a key of the bibliography, or an empty text where the entry is left out."""
        return self.source(key) if key in self.entries else ""

    def table(self, key: str) -> "Table":
        """Return an inner table."""
        return Table(self._field(key), self._take(key), self.file, self.sources)

    def tables(self, key: str) -> dict[str, "Table"]:
        """Return the tables inside an inner table, by name; there must be one at least."""
        outer = self.table(key)
        if not outer.entries:
            raise self.fail(key, "is empty; it must hold one entry at least")
        return {name: outer.table(name) for name in list(outer.entries)}

    def quantity(self, key: str, allowed: Limits) -> Quantity:
        """Return a quantity of the right dimension, within its range and with a known source."""
        return self.table(key).as_quantity(allowed)

    def as_quantity(self, allowed: Limits) -> Quantity:
        """Read this table itself as a quantity."""
        value = self._take("value")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail("value", f"is {value!r}; it must be a number without quotes")
        unit = self.text("unit")
        known = UNITS[allowed.dimension]
        if unit not in known:
            raise self.fail(
                "unit",
                f"is '{unit}'; a unit of {allowed.dimension} is needed, one of {', '.join(known)}",
            )
        quantity = Quantity(
            value=float(value),
            unit=unit,
            dimension=allowed.dimension,
            source=self.source("source"),
            where=self.text("where"),
            kind=self.text("kind", allowed=tuple(KINDS)),
            conditions=self.text("conditions", default=""),
            note=self.text("note", default=""),
        )
        self.done()
        if not allowed.hold(quantity.si):
            si_unit = next(iter(known))
            unit_text = "" if si_unit == "1" else f" {si_unit}"
            raise ValueError(
                f"{self.file}: {self.name} is {quantity}; it must be {allowed}{unit_text}"
            )
        return quantity

    def quantities(self, needed: dict[str, Limits], optional: dict[str, Limits] | None = None):
        """Return the quantities by name; the optional ones only where they are given."""
        given = {k: v for k, v in (optional or {}).items() if k in self.entries}
        return {key: self.quantity(key, allowed) for key, allowed in {**needed, **given}.items()}

    def done(self) -> None:
        """Refuse what nobody has taken."""
        if self.entries:
            raise self.fail(sorted(self.entries)[0], "is not a known key")


def read(path: Path) -> Table:
    """Return a TOML file as a table that knows the sources it may name."""
    try:
        with path.open("rb") as file:
            entries = tomllib.load(file)
    except FileNotFoundError:
        near = did_you_mean(path.name, (file.name for file in path.parent.glob("*.toml")))
        raise FileNotFoundError(f"{path}: there is no such file{near}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a valid TOML file: {error}") from None
    except RecursionError:
        raise ValueError(f"{path}: not a file of this kind: it is nested too deeply") from None
    refuse_unfilled(path.name, entries)
    sources = shipped_references()
    beside = path.parent / "references.bib"
    if FOLDER not in path.resolve().parents and beside.exists():
        sources = {**sources, **read_references(beside)}
    return Table("", entries, path.name, sources)


def _natural(text: str) -> list:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", text)]


@cache
def shipped(folder: str) -> dict[str, Path]:
    """Return the shipped files of a folder by the name that each gives itself."""
    found = {read(path).text("name"): path for path in (FOLDER / folder).glob("*.toml")}
    return {name: found[name] for name in sorted(found, key=_natural)}


def path_of(folder: str, what: str, name: str | Path) -> Path:
    """Return the path of a shipped file by its name, or the path given."""
    if isinstance(name, Path) or name.endswith(".toml"):
        return refuse_another_kind(what, Path(name))
    if name not in shipped(folder):
        near = file_meant(name) or did_you_mean(name, shipped(folder))
        raise ValueError(
            f"{what} '{name}' is unknown{near}; known are {', '.join(shipped(folder))}"
        )
    return shipped(folder)[name]


def list_alloys() -> list[str]:
    """Return the names of the shipped alloys."""
    return list(shipped("alloys"))


def list_media() -> list[str]:
    """Return the names of the shipped media."""
    return list(shipped("media"))


def list_parameter_sets() -> list[str]:
    """Return the names of the shipped parameter sets."""
    return list(shipped("parameter_sets"))


@cache
def load_elements() -> Mapping[str, Element]:
    """Return the elements that alloys may be made of, by symbol."""
    file = read(FOLDER / "elements.toml")
    elements = {}
    for symbol in list(file.entries):
        table = file.table(symbol)
        elements[symbol] = Element(symbol, **table.quantities(limits.ELEMENT))
        table.done()
    return elements


def load_alloy(name: str | Path) -> Alloy:
    """Return an alloy by its name, or from a .toml file of one's own.

    A file of one's own may name the shipped sources and those of a references.bib beside it.
    Raises ValueError for an unknown name (naming the known ones), whatever is wrong in the
    file, or the name of a shipped alloy with other numbers; FileNotFoundError where there is no
    such file.
    """
    path = path_of("alloys", "alloy", name)
    file = read(path)
    elements = load_elements()
    dissolving = file.text("dissolving_element", allowed=tuple(elements))
    given: dict[str, Quantity] = {}
    composition = file.table("mass_fractions")  # empty for an unalloyed metal
    for symbol in list(composition.entries):
        if symbol not in elements:
            raise ValueError(
                f"{file.file}: mass_fractions.{symbol} is no element of elements.toml; "
                f"known are {', '.join(elements)}"
            )
        given[symbol] = composition.quantity(symbol, limits.MASS_FRACTION)
    fractions = _with_balance(file, dissolving, given)
    density = _mixture_density(fractions, elements)
    molar_mass = elements[dissolving].molar_mass
    solid_concentration = Quantity(
        value=fractions[dissolving].si * density.si / molar_mass.si,
        unit="mol/m^3",
        dimension="concentration",
        source="",
        where=f"mass fraction of {dissolving} times density over molar mass of {dissolving}",
        kind="derived",
    )
    alloy = Alloy(
        name=file.text("name"),
        title=file.text("title"),
        dissolving_element=dissolving,
        mass_fractions=fractions,
        elements={symbol: elements[symbol] for symbol in fractions},
        density=density,
        solid_concentration=solid_concentration,
        corrosion=_own_corrosion(file, solid_concentration),
        **file.quantities(limits.ALLOY, limits.ALLOY_OPTIONAL),
    )
    file.done()
    if alloy.ultimate_tensile_strength.si <= alloy.yield_stress.si:
        raise file.fail(
            "ultimate_tensile_strength",
            f"is {alloy.ultimate_tensile_strength}; it must be above the yield_stress, "
            f"{alloy.yield_stress}",
        )
    strain = alloy.yield_stress.si / alloy.young_modulus.si
    if strain > limits.LARGEST_YIELD_STRAIN:
        raise file.fail(
            "yield_stress",
            f"is {alloy.yield_stress}, {strain:.3g} of the young_modulus, {alloy.young_modulus}; "
            f"it must be at most {limits.LARGEST_YIELD_STRAIN:g} of it",
        )
    _check_name(file, path, alloy)
    return alloy


def _own_corrosion(file: Table, solid_concentration: Quantity) -> OwnCorrosion | None:
    """The constants in an alloy's own file; C_solid is that of the composition unless given."""
    if "corrosion" not in file.entries:
        return None
    table = file.table("corrosion")
    medium = table.text("medium", allowed=tuple(list_media()))
    scene = _calibration_scene(table.table("scene"))
    parameters = _corrosion_parameters(table, solid_concentration)
    return OwnCorrosion(medium, scene, parameters)


def _check_name(file: Table, path: Path, alloy: Alloy) -> None:
    """Refuse a file of one's own that has the name of a shipped alloy and other numbers."""
    named = {name.casefold(): shipped_path for name, shipped_path in shipped("alloys").items()}
    namesake = named.get(alloy.name.casefold())
    if namesake is None or namesake.resolve() == path.resolve():
        return
    own, theirs = alloy.quantities(), load_alloy(namesake).quantities()
    for key in {**theirs, **own}:
        here, there = own.get(key), theirs.get(key)
        if here is None or there is None or here.si != there.si:
            raise file.fail(
                "name",
                f"is '{alloy.name}', a shipped alloy whose {key} is {there or 'not given'}, "
                f"not {here or 'left out'}; give the alloy another name",
            )


def _with_balance(file: Table, dissolving: str, given: dict[str, Quantity]) -> dict[str, Quantity]:
    if dissolving in given:
        raise ValueError(
            f"{file.file}: mass_fractions.{dissolving} must not be given; "
            "the dissolving element is the balance"
        )
    rest = 1.0 - sum(fraction.si for fraction in given.values())
    if not rest > 0:
        raise file.fail("mass_fractions", f"sum to {1 - rest:g}; they must sum to less than 1")
    balance = Quantity(rest, "1", "dimensionless", "", "1 less the other mass fractions", "derived")
    return {dissolving: balance, **given}


def _mixture_density(
    fractions: Mapping[str, Quantity], elements: Mapping[str, Element]
) -> Quantity:
    """1/rho = sum_k w_k / rho_k: the volumes of the elements add up, no mixing volume."""
    specific_volume = sum(w.si / elements[symbol].density.si for symbol, w in fractions.items())
    return Quantity(
        value=1.0 / specific_volume,
        unit="kg/m^3",
        dimension="density",
        source="",
        where="1/rho = sum_k w_k/rho_k over the elements",
        kind="derived",
        conditions="volumes of the elements add up",
    )


def load_medium(name: str | Path) -> Medium:
    """Return a medium by its name, or from a .toml file of one's own. Raises as load_alloy."""
    path = path_of("media", "medium", name)
    file = read(path)
    species = {}
    for symbol, table in (file.tables("species") if "species" in file.entries else {}).items():
        species[symbol] = Species(**table.quantities(limits.SPECIES))
        table.done()
    medium = Medium(
        name=file.text("name"),
        title=file.text("title"),
        species=species,
        reactions=_reactions_of(file, path.parent),
        first_published=file.source_or_none("first_published"),
        note=file.text("note", default=""),
        **file.quantities(limits.MEDIUM, limits.MEDIUM_OPTIONAL),
    )
    file.done()
    return medium


def _reactions_of(file: Table, folder: Path) -> str:
    """A shipped set by its name, or the path of one's own beside the medium's file."""
    name = file.entries.get("reactions")
    if isinstance(name, str) and name.endswith(".toml"):
        return str(folder / file.text("reactions"))
    return file.text("reactions", default="", allowed=("", *shipped("reactions")))


def load_parameter_set(name: str | Path) -> ParameterSet:
    """Return a parameter set by its name, or from a .toml file of one's own.

    Raises as load_alloy.
    """
    file = read(path_of("parameter_sets", "parameter set", name))
    scene = _calibration_scene(file.table("scene"))
    alloys = {alloy: _corrosion_parameters(table) for alloy, table in file.tables("alloys").items()}
    loaded = ParameterSet(
        name=file.text("name"),
        title=file.text("title"),
        medium=file.text("medium", allowed=tuple(list_media())),
        scene=scene,
        alloys=alloys,
        first_published=file.source_or_none("first_published"),
        note=file.text("note", default=""),
        calibrations=_calibrations(file),
    )
    file.done()
    return loaded


def _calibration_scene(table: Table) -> CalibrationScene:
    """The scene that constants were fitted in."""
    scene = CalibrationScene(
        solid=table.text("solid"),
        domain=table.text("domain", allowed=DOMAINS),
        calibration=table.text("calibration", allowed=CALIBRATIONS),
        saturation=table.text("saturation", allowed=SATURATIONS),
        boundary=table.text("boundary", allowed=BOUNDARIES),
        **table.quantities(limits.CALIBRATION_SCENE, limits.CALIBRATION_SCENE_OPTIONAL),
    )
    table.done()
    return scene


def _corrosion_parameters(table: Table, solid: Quantity | None = None) -> CorrosionParameters:
    """The constants of one alloy; solid: its C_solid where the table has none."""
    known = dict(limits.CORROSION_PARAMETERS)
    own = {}
    if solid is not None and "solid_concentration" not in table.entries:
        del known["solid_concentration"]
        own = {"solid_concentration": solid}
    parameters = CorrosionParameters(**table.quantities(known), **own)
    table.done()
    if parameters.saturation_concentration.si >= parameters.solid_concentration.si:
        raise table.fail(
            "saturation_concentration",
            f"is {parameters.saturation_concentration}; it must be below the "
            f"solid_concentration, {parameters.solid_concentration}",
        )
    return parameters


def _calibrations(file: Table) -> Mapping[str, Calibration]:
    """The calibrations of a parameter set's file, by alloy; none where it has none."""
    if "calibrations" not in file.entries:
        return {}
    return {alloy: _calibration(table) for alloy, table in file.tables("calibrations").items()}


def _calibration(table: Table) -> Calibration:
    names = tuple(table.texts("parameters"))
    unknown = [name for name in names if name not in limits.CORROSION_PARAMETERS]
    if unknown:
        known = ", ".join(limits.CORROSION_PARAMETERS)
        raise table.fail("parameters", f"has '{unknown[0]}'; known are {known}")
    found = Calibration(
        data=table.text("data"),
        sha256=table.text("sha256"),
        measurements=table.integer("measurements", 1, 10**6),
        loss=table.number("loss"),
        scatter=table.number("scatter"),
        scatter_estimated=table.text("scatter_is", allowed=("given", "estimated")) == "estimated",
        parameters=names,
        samples=_samples(table, names),
        not_seen=tuple(table.texts("not_seen")) if "not_seen" in table.entries else (),
    )
    table.done()
    return found


def _samples(table: Table, names: tuple[str, ...]) -> tuple[tuple[float, ...], ...]:
    rows = table._take("samples")
    if not isinstance(rows, list) or not 1 <= len(rows) <= _MOST_SAMPLES:
        raise table.fail("samples", f"must be a list of 1 to {_MOST_SAMPLES} rows")
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != len(names):
            raise table.fail("samples", f"row {number} must have {len(names)} numbers")
        for name, value in zip(names, row, strict=True):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            allowed = limits.CORROSION_PARAMETERS[name]
            if not is_number or not isfinite(value) or not allowed.hold(value):
                raise table.fail(
                    "samples", f"row {number} has {name} {value!r}; it must be {allowed}"
                )
    return tuple(tuple(float(value) for value in row) for row in rows)
