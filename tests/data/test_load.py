"""What the loader makes of a file, and everything it refuses."""

import dataclasses
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import perilife_data
from perilife_data.references import FOLDER, read_references
from perilife_data.units import UNITS, to_si

MG5GD = FOLDER / "alloys" / "mg-5gd.toml"
TABLE51 = FOLDER / "parameter_sets" / "table-5.1.toml"
FLUID = FOLDER / "media" / "simulated-body-fluid.toml"
LOADERS = {
    MG5GD: perilife_data.load_alloy,
    TABLE51: perilife_data.load_parameter_set,
    FLUID: perilife_data.load_medium,
}


def change(path: Path, folder: Path, pattern: str, replacement: str) -> Path:
    """Write a copy of a shipped file with the first match of a pattern replaced."""
    text, count = re.subn(
        pattern, replacement, path.read_text(encoding="utf-8"), count=1, flags=re.DOTALL
    )
    assert count == 1, f"{pattern!r} is not in {path.name}"
    copy = folder / path.name
    copy.write_text(text, encoding="utf-8")
    return copy


def in_table(table: str, key: str) -> str:
    """Return a pattern that matches the line of a key within a table, up to the line's end."""
    return rf"(\[{re.escape(table)}\]\n(?:[^\[]*?\n)??){key} = [^\n]*"


@pytest.mark.parametrize("path", LOADERS, ids=lambda path: path.stem)
def test_an_unchanged_copy_loads_to_the_same(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "own.toml"
    copy.write_bytes(path.read_bytes())
    assert LOADERS[path](copy) == LOADERS[path](str(copy)) == LOADERS[path](path)


REFUSALS = [
    # file, pattern, replacement, what the sentence must say
    (MG5GD, r"\A", "colour = 'grey'\n", "mg-5gd.toml: colour is not a known key"),
    (
        MG5GD,
        in_table("q1", "value"),
        r"\1value = 1.5\nerror = 0.1",
        r"q1.error is not a known key",
    ),
    (MG5GD, r"\[q1\].*\Z", "", "q1 is missing"),
    (MG5GD, in_table("q1", "value"), r"\1", "q1.value is missing"),
    (MG5GD, in_table("young_modulus", "unit"), r"\1", "young_modulus.unit is missing"),
    (MG5GD, in_table("young_modulus", "source"), r"\1", "young_modulus.source is missing"),
    (MG5GD, in_table("young_modulus", "where"), r"\1", "young_modulus.where is missing"),
    (MG5GD, in_table("young_modulus", "kind"), r"\1", "young_modulus.kind is missing"),
    (
        MG5GD,
        in_table("young_modulus", "unit"),
        r'\1unit = "psi"',
        "young_modulus.unit is 'psi'; a unit of pressure is needed, one of Pa, kPa, MPa, GPa",
    ),
    (
        MG5GD,
        in_table("young_modulus", "unit"),
        r'\1unit = "mm"',
        "young_modulus.unit is 'mm'; a unit of pressure",
    ),
    (
        MG5GD,
        in_table("young_modulus", "source"),
        r'\1source = "hearsay"',
        "young_modulus.source is 'hearsay', which is not a key of references.bib",
    ),
    (
        MG5GD,
        in_table("young_modulus", "kind"),
        r'\1kind = "guessed"',
        "young_modulus.kind is 'guessed'; it must be one of measured, fitted, not_identified, ",
    ),
    (
        MG5GD,
        in_table("young_modulus", "where"),
        r'\1where = " "',
        "young_modulus.where is ' '; it must be a text",
    ),
    (
        MG5GD,
        in_table("young_modulus", "value"),
        r'\1value = "43"',
        "young_modulus.value is '43'; it must be a number without quotes",
    ),
    (
        MG5GD,
        in_table("young_modulus", "value"),
        r"\1value = true",
        "young_modulus.value is True; it must be a number",
    ),
    (
        MG5GD,
        in_table("young_modulus", "value"),
        r"\1value = -43",
        "young_modulus is -43 GPa; it must be above 0 and at most 1e.12 Pa",
    ),
    (MG5GD, in_table("young_modulus", "value"), r"\1value = nan", "young_modulus is nan GPa"),
    (MG5GD, in_table("young_modulus", "value"), r"\1value = inf", "young_modulus is inf GPa"),
    (
        MG5GD,
        in_table("poisson_ratio", "value"),
        r"\1value = 0.5",
        "poisson_ratio is 0.5; it must be above -1 and below 0.5",
    ),
    (MG5GD, in_table("yield_stress", "value"), r"\1value = 0", "yield_stress is 0 MPa"),
    (
        MG5GD,
        in_table("young_modulus", "unit"),
        r'\1unit = "Pa"',
        r"yield_stress is \d+ MPa, .* of the young_modulus, 43 Pa; it must be at most 0.05 of it",
    ),
    (
        MG5GD,
        in_table("yield_stress", "value"),
        r"\1value = 220",
        "ultimate_tensile_strength is 220 MPa; it must be above the yield_stress, 220 MPa",
    ),
    (
        MG5GD,
        in_table("mass_fractions.Gd", "value"),
        r"\1value = 100",
        "mass_fractions.Gd is 100 %; it must be above 0 and below 1",
    ),
    (MG5GD, r"mass_fractions\.Gd", "mass_fractions.Xx", "mass_fractions.Xx is no element"),
    (
        MG5GD,
        r"mass_fractions\.Gd",
        "mass_fractions.Mg",
        "mass_fractions.Mg must not be given; the dissolving element is the balance",
    ),
    (
        MG5GD,
        r"\Z",
        '\n[mass_fractions.Fe]\nvalue = 1\nunit = "%"\n',
        "mass_fractions.Fe is no element",
    ),
    (
        MG5GD,
        r"dissolving_element = \"Mg\"",
        'dissolving_element = "Fe"',
        "dissolving_element is 'Fe'; it must be one of Mg, Gd",
    ),
    (MG5GD, r"name = \"[^\"]*\"", "name = 5", "name is 5; it must be a text in quotes"),
    (MG5GD, r"\[q1\].*\Z", "q1 = 1.5", "is not a known key|q1 is 1.5; it must be a table"),
    (MG5GD, r"\[q1\]", "[q1", "mg-5gd.toml: not a valid TOML file"),
    (
        TABLE51,
        in_table("alloys.Mg-5Gd.saturation_concentration", "value"),
        r"\1value = 7e4",
        "alloys.Mg-5Gd.saturation_concentration is 70000 mol/m.3; it must be below the solid_conc",
    ),
    (
        TABLE51,
        in_table("alloys.Mg-5Gd.interface_diffusivity", "value"),
        r"\1value = -1e-15",
        "alloys.Mg-5Gd.interface_diffusivity is -1e-15 m.2/s; it must be above 0",
    ),
    (
        TABLE51,
        in_table("alloys.Mg-5Gd.kernel_exponent", "value"),
        r"\1value = 1",
        "kernel_exponent is 1; it must be at least 0 and below 1",
    ),
    (
        TABLE51,
        in_table("scene", "saturation"),
        r'\1saturation = "maybe"',
        "scene.saturation is 'maybe'; it must be one of as_published, complementarity, none",
    ),
    (TABLE51, r"\[scene\]", "[scene]\ncolour = 1", "scene.colour is not a known key"),
    (TABLE51, r"medium = \"[^\"]*\"", 'medium = "beer"', "medium is 'beer'; it must be one of"),
    (
        TABLE51,
        r"first_published = \"[^\"]*\"",
        'first_published = "hearsay"',
        "first_published is 'hearsay', which is not a key of references.bib",
    ),
    (TABLE51, r"\[alloys\..*\Z", "[alloys]", "alloys is empty"),
    (
        FLUID,
        in_table("temperature", "value"),
        r"\1value = -300",
        "temperature is -300 degC; it must be at least 273.15 and at most 373.15 K",
    ),
    (
        FLUID,
        in_table("species.Ca.total_concentration", "value"),
        r"\1value = -2.31",
        "species.Ca.total_concentration is -2.31 mol/m.3; it must be at least 0",
    ),
    (
        FLUID,
        in_table("species.Ca.charge_number", "value"),
        r"\1value = 7",
        "species.Ca.charge_number is 7; it must be at least -4 and at most 4",
    ),
]


@pytest.mark.parametrize(
    ("path", "pattern", "replacement", "message"),
    REFUSALS,
    ids=[f"{index}-{message[:40]}" for index, (_, _, _, message) in enumerate(REFUSALS)],
)
def test_refusal(path: Path, pattern: str, replacement: str, message: str, tmp_path: Path) -> None:
    broken = change(path, tmp_path, pattern, replacement)
    with pytest.raises(ValueError, match=message) as refusal:
        LOADERS[path](broken)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith((path.name, str(broken)))


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (
            perilife_data.load_alloy,
            "alloy 'Mg-7Gd' is unknown (did you mean Mg-5Gd?); known are AZ31, Mg, Mg-5Gd, "
            "Mg-10Gd, WE43",
        ),
        (perilife_data.load_medium, "medium 'Mg-7Gd' is unknown; known are cell-culture-medium"),
        (perilife_data.load_parameter_set, "parameter set 'Mg-7Gd' is unknown; known are table-5"),
    ],
)
def test_an_unknown_name_is_answered_with_the_known_ones(load, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        load("Mg-7Gd")


def test_a_missing_file_and_a_missing_alloy(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"own.toml: there is no such file$"):
        perilife_data.load_alloy(tmp_path / "own.toml")
    (tmp_path / "mg-zn.toml").touch()
    (tmp_path / "mg-zn.txt").touch()
    with pytest.raises(ValueError, match=r"unknown \(a file of one's own must end in .toml\)"):
        perilife_data.load_alloy(str(tmp_path / "mg-zn.txt"))
    with pytest.raises(FileNotFoundError, match=r"no such file \(did you mean mg-zn.toml\?\)"):
        perilife_data.load_alloy(tmp_path / "Mg-Zn.toml")
    with pytest.raises(ValueError, match="set 'table-5.1' has no alloy 'WE43'; it holds Mg-5Gd"):
        perilife_data.load_parameter_set("table-5.1").for_alloy("WE43")


def test_an_alloy_of_ones_own_brings_its_own_sources(tmp_path: Path) -> None:
    own = change(MG5GD, tmp_path, in_table("q1", "source"), r'\1source = "me2026"')
    with pytest.raises(ValueError, match="q1.source is 'me2026', which is not a key"):
        perilife_data.load_alloy(own)
    (tmp_path / "references.bib").write_text(
        "@misc{me2026,\n  author = {Me},\n  title = {Own work},\n  year = {2026},\n}\n"
    )
    assert perilife_data.load_alloy(own).q1.source == "me2026"
    assert perilife_data.load_alloy("Mg-5Gd").q1.source == "hermann2024"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("@misc{a,\n  author = {A},\n  title = {T},\n}\n", "entry 'a' lacks year"),
        ("@misc{a, author = {A}}\n", "an entry cannot be read"),
        ("@misc{a,\n  author = {A},\n  title = {T},\n  year = {1},\n}\n" * 2, "given twice"),
    ],
)
def test_bibliographies_that_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "references.bib"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_references(path)


@pytest.mark.parametrize(
    ("value", "unit", "dimension", "expected"),
    [
        (43, "GPa", "pressure", 43e9),
        (37, "degC", "temperature", 310.15),
        (1.738, "g/cm^3", "density", 1738.0),
        (24.305, "g/mol", "molar mass", 24.305e-3),
        (143, "mol/L", "concentration", 143e3),
        (2.5, "mmol/L", "concentration", 2.5),
        (100, "um", "length", 1e-4),
        (1e-5, "cm^2/s", "diffusivity", 1e-9),
        (8, "w", "time", 56 * 86400.0),
        (5, "%", "dimensionless", 0.05),
    ],
)
def test_conversion_to_si(value: float, unit: str, dimension: str, expected: float) -> None:
    # One multiplication and one addition: equal up to one rounding.
    assert to_si(value, unit, dimension) == pytest.approx(expected, rel=3e-16)


@given(
    value=st.floats(-1e6, 1e6),
    pair=st.sampled_from([(d, u) for d, units in UNITS.items() for u in units]),
)
def test_every_unit_is_increasing_and_foreign_units_are_refused(value, pair) -> None:
    dimension, unit = pair
    assert to_si(value + 1.0, unit, dimension) > to_si(value, unit, dimension)
    for other, units in UNITS.items():
        if unit not in units:
            with pytest.raises(ValueError, match=f"'{re.escape(unit)}' is not a unit of {other}"):
                to_si(value, unit, other)


def test_a_quantity_reads_as_a_number_in_si_and_prints_as_given() -> None:
    quantity = perilife_data.load_alloy("Mg-5Gd").young_modulus
    assert (float(quantity), quantity.si, str(quantity)) == (43e9, 43e9, "43 GPa")
    with pytest.raises(dataclasses.FrozenInstanceError):
        quantity.value = 1.0
