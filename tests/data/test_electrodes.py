"""Electrode files: what is read, and everything that is refused."""

import re
from pathlib import Path

import pytest

import perilife_data
from perilife_data.references import FOLDER

AE44 = FOLDER / "electrodes" / "ae44.toml"
STEEL = FOLDER / "electrodes" / "mild-steel.toml"
HEAD = """name = "own"
title = "Own"
reference_electrode = "SCE"
medium = "brine"
law = "LAW"

[temperature]
value = 25
unit = "degC"
source = "zhao2021"
where = "here"
kind = "assumed"
"""
POINTS = (
    HEAD.replace("LAW", "tabulated")
    + """
[curve]
potential = [-1500, -1450, -1400]
potential_unit = "mV"
current_density = [-0.1, 0.2, 0.3]
current_density_unit = "mA/cm^2"
source = "zhao2021"
where = "here"
kind = "measured"
"""
)


def own(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_shipped_numbers_are_those_printed() -> None:
    assert perilife_data.list_electrodes() == ["AA6063", "AE44", "mild-steel"]
    alloy = perilife_data.load_electrode("AE44")
    printed = alloy.as_published()
    assert [
        (p.current_density.si, p.tafel_slope.si, p.standard_potential.si)
        for p in printed.pieces.values()
    ] == [(0.014, 0.021, -1.55), (21.145, 0.166, -1.48), (58.107, 0.4, -1.41)]
    slopes = [p.tafel_slope.si for p in alloy.pieces.values()]
    assert slopes == pytest.approx([0.022019, 0.159446, 0.4], abs=5e-7)
    low, middle, high = alloy.pieces.values()
    assert low.current(-1.48) == pytest.approx(21.145, rel=1e-12)
    assert middle.current(-1.41) == pytest.approx(58.107, rel=1e-12)
    assert high.starts_at.si == -1.41 and low.starts_at is None
    (steel,) = perilife_data.load_electrode("mild-steel").pieces.values()
    assert steel.current(-0.58 - 0.153) == pytest.approx(-0.0125, rel=1e-12)
    assert list(alloy.assumed()) == ["temperature"]
    assert alloy.sources() == ["zhao2021", "deshpande2010"]


def test_points_come_in_si(tmp_path: Path) -> None:
    electrode = perilife_data.load_electrode(own(tmp_path, POINTS))
    assert electrode.curve.potentials == pytest.approx((-1.5, -1.45, -1.4), rel=1e-15)
    assert electrode.curve.currents == pytest.approx((-1.0, 2.0, 3.0), rel=1e-15)
    assert electrode.sources() == ["zhao2021"]


def test_reference_electrodes_must_agree(tmp_path: Path) -> None:
    alloy, steel = (perilife_data.load_electrode(n) for n in ("AE44", "mild-steel"))
    assert perilife_data.common_reference([alloy, steel]) == "SCE"
    text = STEEL.read_text(encoding="utf-8").replace('"SCE"', '"SHE"')
    other = perilife_data.load_electrode(own(tmp_path, text))
    with pytest.raises(ValueError, match="'AE44' is against SCE and 'mild-steel' against SHE"):
        perilife_data.common_reference([alloy, other])
    with pytest.raises(ValueError, match="none is given"):
        perilife_data.common_reference([])


REFUSALS = [
    # text, pattern, replacement, what the sentence must say
    (AE44, "medium = ", "meduim = ", "own.toml: medium is missing"),
    (AE44, r"\A", 'colour = "grey"\n', "own.toml: colour is not a known key"),
    (AE44, '"SCE"', '"saturated"', "reference_electrode is 'saturated'.* must be one of SHE, SCE"),
    (
        AE44,
        '"anodic"',
        '"cathodic"',
        "pieces.low.tafel_slope is 0.022.* V; a slope of the cathodic branch must",
    ),
    (AE44, "0.02201895\\d*", "0.021", "fall at -1.48 V from 30.16. .'low'. to 21.145 A"),
    (AE44, 'unit = "A/m\\^2"', 'unit = "V"', "current_density.unit is 'V'; a unit of current dens"),
    (AE44, "piecewise_tafel", "tafel", "pieces has 3; law 'tafel' takes one"),
    (AE44, r"value = -1.41\n", "value = -1.50\n", "'middle' and 'high' must start in asc"),
    (AE44, "pieces.middle.starts_at", "pieces.low.starts_at", "starts_at must not be given"),
    (STEEL, "-0.153", "0", "tafel_slope is 0 V; a slope of the cathodic branch must be negative"),
    (STEEL, "zhao2021", "nobody", "'nobody', which is not a key of references.bib"),
    (POINTS, "-1450", "-1550", "curve.potential goes from -1.5 V to -1.55 V; it must ascend"),
    (POINTS, "0.3", "0.1", "falls from 2 A/m.2 at -1.45 V to 1 A/m.2 at -1.4 V"),
    (POINTS, "0.2, ", "", "current_density has 2 numbers and potential 3"),
    (POINTS, "0.2", "true", "curve.current_density is .*must be a list of finite numbers"),
    (POINTS, '"mV"', '"mm"', "potential_unit is 'mm'.*must be one of V, mV"),
    (POINTS, "\\[curve\\]", "[curve]\nsauce = 1", "curve.sauce is not a known key"),
    (POINTS, "\\Z", "more = 1\n", "curve.more is not a known key"),
]


@pytest.mark.parametrize(("given", "pattern", "replacement", "message"), REFUSALS)
def test_refusals(given, pattern, replacement, message, tmp_path: Path) -> None:
    text = given if isinstance(given, str) else given.read_text(encoding="utf-8")
    text, count = re.subn(pattern, replacement, text, count=1)
    assert count == 1
    with pytest.raises(ValueError, match=message):
        perilife_data.load_electrode(own(tmp_path, text))


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match="electrode 'AE4' is unknown .did you mean AE44.*AA6063"):
        perilife_data.load_electrode("AE4")
