"""Reaction sets: what they hold, how they are read between temperatures, what is refused."""

import math
import re
from pathlib import Path

import pytest

import perilife_data
from perilife_data.reactions import load_reaction_set
from perilife_data.references import FOLDER

SBF = FOLDER / "reactions" / "sbf.toml"
CELSIUS = 273.15


def change(folder: Path, pattern: str, replacement: str) -> Path:
    """Write a copy of the set `sbf` with the first match of a pattern replaced."""
    text, count = re.subn(pattern, replacement, SBF.read_text(encoding="utf-8"), count=1)
    assert count == 1, f"{pattern!r} is not in sbf.toml"
    copy = folder / "sbf.toml"
    copy.write_text(text, encoding="utf-8")
    return copy


def test_the_sets_hold_the_species_they_say() -> None:
    sizes = {n: len(load_reaction_set(n).species) for n in perilife_data.list_reaction_sets()}
    # Ten species, H2PO4, CO2 and twelve pairs; K, SO4, Tris and seven more; six; as printed.
    assert sizes == {
        "sbf": 24, "sbf-tris": 34, "nacl": 6, "sbf-published": 10, "nacl-published": 6,
    }  # fmt: skip


def test_media_refer_to_sets() -> None:
    assert perilife_data.load_medium("simulated-body-fluid").reactions == "sbf"
    assert perilife_data.load_medium("sodium-chloride-142").reactions == "nacl"
    assert perilife_data.load_medium("rat-tibia").reactions == ""


def test_numbers_at_the_temperatures_given_are_those_of_the_file() -> None:
    loaded = load_reaction_set("sbf")
    for celsius, diffusivity, log_k in ((25, 9.31e-9, -13.9948), (37, 10.75e-9, -13.6203)):
        numbers = loaded.at(celsius + CELSIUS, ("brucite",))
        # exp(log(x)): round-off only
        assert numbers.diffusivity["H"] == pytest.approx(diffusivity, rel=1e-14)
        assert numbers.log_k["OH"] == log_k
        assert set(numbers.minerals) == {"brucite"}
        assert numbers.minerals["brucite"].rate_constant == math.inf


def test_between_temperatures_numbers_follow_van_t_hoff_and_arrhenius() -> None:
    loaded = load_reaction_set("sbf")
    low, middle, high = (loaded.at(t + CELSIUS, ("calcite",)) for t in (25.0, 30.0, 37.0))
    share = (1 / 303.15 - 1 / 298.15) / (1 / 310.15 - 1 / 298.15)
    assert middle.log_k["CO2"] == pytest.approx(
        low.log_k["CO2"] + share * (high.log_k["CO2"] - low.log_k["CO2"]), rel=1e-14
    )
    assert middle.diffusivity["Na"] == pytest.approx(
        low.diffusivity["Na"] ** (1 - share) * high.diffusivity["Na"] ** share, rel=1e-13
    )
    rates = [n.minerals["calcite"].rate_constant for n in (low, middle, high)]
    assert rates[0] < rates[1] < rates[2]
    # log k -5.81 with 23.5 kJ/mol; the file rounds to four digits
    assert math.log10(rates[2]) == pytest.approx(
        -5.81 - 23.5e3 / (8.314462618 * math.log(10)) * (1 / 310.15 - 1 / 298.15), abs=3e-4
    )


@pytest.mark.parametrize(
    ("celsius", "minerals", "says"),
    [
        (37, ("bobierrite",), "log_k of bobierrite is not known at 37 degC; it is known at 25"),
        (45, (), "the diffusivity of H is not known at 45 degC; it is known at 25 to 37 degC"),
        (20, (), "is not known at 20 degC"),
        (37, ("halite",), "mineral 'halite' is not in the set 'sbf'; it holds brucite"),
    ],
)
def test_what_is_not_known_is_refused(celsius: float, minerals, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        load_reaction_set("sbf").at(celsius + CELSIUS, minerals)


REFUSALS = [
    (r"\A", "colour = 'grey'\n", "sbf.toml: colour is not a known key"),
    (r'unit = "m\^2/s", ', "", "species.H.diffusivity.at_25_degC.unit is missing"),
    (r'source = "parkhurst2013", ', "", "species.H.diffusivity.at_25_degC.source is missing"),
    (r'unit = "m\^2/s"', 'unit = "mm"', "a unit of diffusivity is needed"),
    ("at_25_degC", "at_25", "species.H.diffusivity.at_25 must be named like at_37_degC"),
    ("charge_number = -2", "charge_number = -2.5", "it must be a whole number from -4 to 4"),
    (
        "charge_number = -1\ncomposition = { O = 1, H = 1 }",
        "charge_number = 0\ncomposition = { O = 1, H = 1 }",
        "reactions.OH does not conserve charge: the components carry -1, not +0",
    ),
    (
        "stoichiometry = { H = 2, CO3 = 1 }\nwater = -1",
        "stoichiometry = { H = 2, CO3 = 1 }",
        "reactions.CO2 does not conserve H: 2 atoms of components and water against 0",
    ),
    (
        "stoichiometry = { Ca = 5, PO4 = 3, H = -1 }",
        "stoichiometry = { Ca = 5, PO4 = 2, H = -1 }",
        "minerals.hydroxyapatite does not conserve O",
    ),
    (
        "stoichiometry = { H = 1, CO3 = 1 }",
        "stoichiometry = { H = 1, CO2 = 1 }",
        "reactions.HCO3.stoichiometry.CO2 is no component; components are H, CO3",
    ),
    (
        r"\[reactions.H2PO4\]",
        "[reactions.H3PO4]",
        "species.H2PO4 is neither a component nor formed by a reaction of the file",
    ),
    (r'components = \["H", ', "components = [", "reactions.OH.stoichiometry.H is no component"),
    ('kind = "equilibrium"', 'kind = "slow"', "must be one of equilibrium, kinetic"),
    (r"nucleation_index = [^\n]*", "", "minerals.calcite.nucleation_index is missing"),
    ('activity = "fixed"', 'activity = "sit"', "it must be one of davies, wateq, fixed, ideal"),
]


@pytest.mark.parametrize(("pattern", "replacement", "says"), REFUSALS)
def test_a_bad_file_is_refused_in_one_sentence(
    pattern: str, replacement: str, says: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=re.escape(says)) as refusal:
        load_reaction_set(change(tmp_path, pattern, replacement))
    assert "\n" not in str(refusal.value)


def test_a_species_is_added_by_toml_alone(tmp_path: Path) -> None:
    text = SBF.read_text(encoding="utf-8").replace(
        'components = ["H", ', 'components = ["Tris", "H", '
    )
    quantity = (
        '{{ value = {}, unit = "{}", source = "parkhurst2013", where = "here", kind = "assumed" }}'
    )
    for name, charge, hydrogen in (("Tris", 0, 11), ("TrisH", 1, 12)):
        text += (
            f"\n[species.{name}]\ncharge_number = {charge}\n"
            f"composition = {{ C = 4, H = {hydrogen}, N = 1, O = 3 }}\n"
            f"diffusivity.at_37_degC = {quantity.format('0.8e-9', 'm^2/s')}\n"
        )
    text += (
        "\n[reactions.TrisH]\nstoichiometry = { Tris = 1, H = 1 }\n"
        f"log_k.at_37_degC = {quantity.format('7.77', '1')}\n"
    )
    own = tmp_path / "own.toml"
    own.write_text(text, encoding="utf-8")
    numbers = load_reaction_set(own).at(310.15)
    assert numbers.log_k["TrisH"] == 7.77
    assert numbers.components[0] == "Tris"


def test_an_unknown_set_is_refused() -> None:
    with pytest.raises(ValueError, match="reaction set 'seawater' is unknown; known are"):
        load_reaction_set("seawater")


def test_used_are_the_values_around_a_temperature_and_of_the_minerals_asked_for() -> None:
    loaded = load_reaction_set("sbf")
    at_37 = loaded.used(37.0 + CELSIUS, ("calcite",))
    assert at_37["species.H.diffusivity.310.15"].si == 10.75e-9
    assert not [name for name in at_37 if name.endswith(".298.15")]
    assert {n.split(".")[1] for n in at_37 if n.startswith("minerals.")} == {"calcite"}
    both = {"species.H.diffusivity.298.15", "species.H.diffusivity.310.15"}
    assert both < set(loaded.used(30.0 + CELSIUS))
    assert len(loaded.used(37.0 + CELSIUS)) < len(loaded.used(30.0 + CELSIUS))
