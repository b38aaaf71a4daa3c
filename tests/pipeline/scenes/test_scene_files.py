"""Scene files of localised corrosion: shipped ones, one's own, stored ones; what is refused."""

import csv
import json
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from peri.corrosion.interface.faradaic import Faradaic
from peri.corrosion.kinetics import VolumeLossLaw
from peri.engine.constants import FARADAY
from peri.engine.lattice import Lattice
from perilife_data import TO_BE_LISTED, load_parameter_set
from perilife_data.references import FOLDER
from pipeline.cli import main
from pipeline.scenes import crevices, grains, implants, pits, pits_2d
from pipeline.scenes.couples import ae44_scene
from pipeline.scenes.files import read_scene
from pipeline.scenes.keys import Given
from pipeline.scenes.metals import Beside
from pipeline.scenes.registry import KINDS, path_of, shipped
from tests.pipeline.command_line import refused

EXAMPLES = Path(__file__).parents[3] / "pipeline/examples"
OWN = """
kind = "galvanic"
immersion = ["0s", "2h"]

[lattice]
spacing = "1mm"
low = ["0mm", "0mm"]
high = ["24mm", "12mm"]

[liquid]
medium = "sodium-chloride-142"

[metals.tin]
shape = "box"
low = ["0mm", "0mm"]
high = ["8mm", "4mm"]
law = "linear"
rest_potential = "-500mV"
resistance = "0.1 ohm m^2"

[metals.pin]
shape = "ball"
centre = ["15mm", "0mm"]
radius = "3mm"
law = "butler-volmer"
exchange_current_density = "0.01 mA/cm^2"
rest_potential = -1.2
dissolves = "yes"
alloy = "Mg-5Gd"
self_corrosion = { value = "1e-7 mol/(m^2 s)", source = "my notebook", kind = "measured" }
"""


IONS = """
[ions]
diffusivity = "7e-10 m^2/s"
saturation_concentration = "200 mol/m^3"
renewed = "top"
"""


def init(capsys, *arguments: str) -> str:
    assert main(["init", *arguments]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", list(shipped()))
def test_what_init_prints_is_the_shipped_scene(name, tmp_path, capsys):
    file = tmp_path / f"{name}.toml"
    text = init(capsys, "--kind", name)
    file.write_text(text)
    again, scene = read_scene(file), read_scene(path_of(name))
    assert again.values == scene.values and again.times == scene.times
    assert again.title == scene.title and again.out == "runs/mine"
    keys = {key.split(".")[-1] for key in KINDS[scene.kind].keys}
    said = {line.lstrip("#").split(" = ")[0] for line in text.splitlines() if " = " in line}
    assert keys <= said and "# " not in said
    # every example is one that its key takes
    for key, spec in KINDS[scene.kind].keys.items():
        spec.read(spec.example, key)


def test_a_kind_has_an_example(capsys):
    for kind, entry in KINDS.items():
        assert f'kind = "{kind}"' in init(capsys, "--kind", kind)
        assert read_scene(path_of(entry.example)).kind == kind


def same(one: object, other: object) -> None:
    """Two scenes with equal fields; numbers and places but for the round-off of their units."""
    for item in fields(one):
        mine, theirs = getattr(one, item.name), getattr(other, item.name)
        if isinstance(mine, Lattice):
            assert mine.shape == theirs.shape
            np.testing.assert_allclose(mine.origin, theirs.origin, rtol=1e-12)
            np.testing.assert_allclose(mine.spacing, theirs.spacing, rtol=1e-12)
        elif isinstance(mine, np.ndarray | float):
            np.testing.assert_allclose(mine, theirs, rtol=1e-12)
        elif is_dataclass(mine):
            same(mine, theirs)
        elif isinstance(mine, tuple) and mine and is_dataclass(mine[0]):
            for a, b in zip(mine, theirs, strict=True):
                same(a, b)
        else:
            assert mine == theirs or type(mine) is type(theirs) is Faradaic, item.name


def test_a_metal_takes_the_constants_of_a_fit(tmp_path):
    """As a life cycle turns them into a flux; what the file says itself goes before them."""

    def pin(text: str):
        (tmp_path / "own.toml").write_text(text)
        ready = read_scene(tmp_path / "own.toml").prepared()
        return ready.march.args[0].metals[1], ready

    self_corrosion = OWN[OWN.index("self_corrosion") :]
    plain = OWN.replace(self_corrosion, 'parameters = "table-5.1"\n')
    metal, ready = pin(plain)
    constants = load_parameter_set("table-5.1").for_alloy("Mg-5Gd")
    # 1.85e-6 mol/(m2 s), as in screw-in-titanium-plate.toml
    assert metal.self_corrosion == pytest.approx(2 * FARADAY * 1.85e-6, rel=3e-3)
    assert metal.solid_concentration == constants.solid_concentration.si
    assert metal.kinetics == VolumeLossLaw(constants.volume_loss_scale.si)
    assert ready.beside["Mg-5Gd, parameters: interface_diffusivity"].value == 2.8779e-15
    # a file of one's own, twice as fast
    text = (FOLDER / "parameter_sets" / "table-5.1.toml").read_text(encoding="utf-8")
    (tmp_path / "fit.toml").write_text(text.replace("2.8779e-15", "5.7558e-15"))
    faster, _ = pin(plain.replace("table-5.1", str(tmp_path / "fit.toml")))
    assert faster.self_corrosion == pytest.approx(2 * metal.self_corrosion, rel=1e-12)
    slower, _ = pin(plain + self_corrosion)
    assert slower.self_corrosion == pytest.approx(2 * FARADAY * 1e-7, rel=1e-12)
    # the alloy's own file
    own = pin(plain.replace("table-5.1", "own").replace("Mg-5Gd", str(EXAMPLES / "my-alloy.toml")))
    assert own[0].kinetics == VolumeLossLaw(0.25)


def test_the_files_make_the_scenes_of_the_studies():
    def made(name: str):
        return read_scene(path_of(name)).prepared().march.args[0]

    for name, scene in (
        ("pit-pencil", pits.pencil_scene(5e-6)),
        ("pit-304", pits_2d.masked_scene(5e-6)),
        ("pit-lacy", pits_2d.lacy_scene(2.5e-6)),
        ("intergranular", grains.grain_scene(1e-6)),
        ("crevice-625", crevices.crevice_625(3e-3, 1016)),
    ):
        same(made(name), scene)
    # the lattice's places differ by round-off: cells of a box, and counted from its corner
    one, other = made("galvanic-ae44-aa6063"), ae44_scene("AA6063")
    np.testing.assert_allclose(one.lattice.origin, other.lattice.origin, rtol=1e-9)
    assert one.lattice.shape == other.lattice.shape and one.conductivity == other.conductivity
    for mine, theirs in zip(one.metals, other.metals, strict=True):
        assert np.array_equal(mine.nodes, theirs.nodes) and mine.law == theirs.law
        assert mine.solid_concentration == theirs.solid_concentration


def test_a_file_follows_its_ions(tmp_path, capsys):
    """More current as the liquid conducts more; a plan says what leaving them out would change."""
    file, out, currents = tmp_path / "own.toml", tmp_path / "runs", []
    for name, more in (("without", ""), ("with", IONS)):
        file.write_text(OWN + more)
        assert main(["run", str(file), "--out", str(out / name), "--quiet"]) == 0
        with (out / name / "summary.csv").open(newline="", encoding="utf-8") as table:
            found = {row["quantity"]: float(row["value"]) for row in csv.DictReader(table)}
        currents.append(found["current at the end"])
    assert currents[1] > 1.005 * currents[0] > 0
    assert 0 < found["metal and ions left open, largest"] < 1e-13
    assert 0 < found["most ions dissolved, at the end"] <= 200.0
    with h5py.File(out / "with" / "result.h5") as stored:
        kappa = stored["conductivity"][-1]
        assert stored["ions"].attrs["unit"] == "mol/m3" and stored["salt"].shape[0] == 2
        assert np.nanmax(kappa) > 1.1 * np.nanmin(kappa)
    capsys.readouterr()
    assert main(["plan", str(file), "--json"]) == 0
    said = {o["name"]: o for o in json.loads(capsys.readouterr().out)["omissions"]}
    assert not said["ions"]["applied"] and said["ions"]["bound"] > 1e-3
    points = 'concentrations = ["0 mol/m^3", 200]\nconductivities = [2, 3]\n'
    for table, words in (
        (IONS.replace("7e-10", "0"), "ions.diffusivity is '0 m^2/s'; it must be above 0"),
        (IONS.replace('"top"', '"left"'), "must be one of nowhere, top, edges"),
        (IONS + points, "[ions] ions: 2 S/m without any by their law"),
        (IONS + "conductivities = [2, 3]\n", "ions.concentrations is missing"),
        ('[ions]\nrenewed = "top"\n', "ions.renewed is given, but a scene with these"),
    ):
        file.write_text(OWN + table)
        refused(capsys, ["plan", str(file)], words)


def test_a_file_of_ones_own_runs_and_its_stored_scene_repeats_it(tmp_path, capsys):
    file, first, second = tmp_path / "own.toml", tmp_path / "one", tmp_path / "two"
    file.write_text(OWN)
    assert main(["run", str(file), "--out", str(first), "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "deepest at the end" in printed and " um\n" in printed
    with (first / "summary.csv").open(newline="", encoding="utf-8") as table:
        found = {row["quantity"]: row for row in csv.DictReader(table)}
    assert float(found["share of pin lost"]["value"]) > 0
    assert found["deepest at the end"]["unit"] == "m"
    stored = json.loads((first / "scene.json").read_text(encoding="utf-8"))
    assert stored["values"]["metals.pin.self_corrosion"]["source"] == "my notebook"
    assert stored["values"]["lattice.horizon"]["kind"] == "assumed"
    # F^2/(RT) (D_Na + D_Cl) 142 mol/m^3 at 37 degC by hand: 2.18 S/m
    kappa = stored["data"]["sodium-chloride-142: conductivity"]["value"]
    assert kappa == pytest.approx(96485.33**2 / (8.314463 * 310.15) * 142 * (1.70e-9 + 2.55e-9),
                                  rel=0.01)  # fmt: skip
    scene = first / "scene.json"
    assert main(["run", "--scene", str(scene), "--out", str(second), "--quiet"]) == 0
    assert (second / "summary.csv").read_bytes() == (first / "summary.csv").read_bytes()
    capsys.readouterr()
    stored["data"]["Mg-5Gd: density"]["value"] *= 2
    scene.write_text(json.dumps(stored))
    out = ["--out", str(tmp_path / "three")]
    refused(capsys, ["run", "--scene", str(scene), *out], "Mg-5Gd: density has changed")
    scene.write_text(json.dumps({**stored, "values": {"a.b": {}}}))
    refused(capsys, ["run", "--scene", str(scene), *out], "no scene that a run has stored")


def test_plan_and_json(tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    assert main(["plan", str(file)]) == 0
    assert "own (galvanic) to 2h" in capsys.readouterr().out
    assert main(["plan", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "galvanic"
    options = ["--out", str(tmp_path / "run"), "--quiet", "--json", "--immersion", "1min"]
    assert main(["run", str(file), *options]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["summary"]["current at the start"][1] == "A/m"
    horizon = {"name": "lattice.horizon", "value": 2e-3, "unit": "m", "kind": "assumed"}
    assert horizon | {"source": "", "where": "two spacings"} in told["assumed"]


def test_what_is_listed_as_assumed_is_what_the_scene_uses(tmp_path, capsys):
    """Of an alloy that dissolves not its strength, of a set not what the scene gives itself."""

    def listed(text: str) -> dict[str, str]:
        (tmp_path / "own.toml").write_text(text)
        assumed = read_scene(tmp_path / "own.toml").prepared().assumed
        return {name: value.kind for name, value in assumed.items() if ": " in name}

    plain = OWN.replace('medium = "sodium-chloride-142"', 'conductivity = "2 S/m"')
    assert listed(plain) == {}
    of_medium = {"temperature", "species.Na.total_concentration", "species.Cl.total_concentration"}
    found = {name.split(": ", 1)[1] for name in listed(OWN)}
    assert found == of_medium | {f"{ion}: diffusivity.310.15" for ion in ("Na", "Cl")}
    of_set = plain.replace('alloy = "Mg-5Gd"', 'alloy = "Mg-5Gd"\nparameters = "table-5.1"')
    called = "Mg-5Gd, parameters: "
    whole = listed(of_set[: of_set.index("self_corrosion")])
    constants = load_parameter_set("table-5.1").for_alloy("Mg-5Gd").quantities()
    used = ("interface_diffusivity", "kernel_exponent", "solid_concentration", "volume_loss_scale")
    doubted = {n: q.kind for n, q in constants.items() if q.kind in TO_BE_LISTED}
    lattice = {called + "horizon_ratio": "assumed"}  # that the D_int is for
    assert whole == {called + n: doubted[n] for n in used if n in doubted} | lattice
    # D_int is not in use where the scene has the rate itself
    less = listed(of_set)
    assert called + "solid_concentration" in less and set(less) < set(whole)
    own = of_set + "solid_concentration = 7e4\nvolume_loss_scale = 0.1\n"
    assert listed(own) == {}
    (tmp_path / "own.toml").write_text(own.replace("1e-7 mol", "0 mol"))
    refused(capsys, ["plan", str(tmp_path / "own.toml")], "metals.pin.volume_loss_scale", "no use")


def test_of_the_alloy_that_is_pulled_its_mechanics_are_listed():
    values, beside = read_scene(path_of("screw-in-titanium-plate")).values, Beside()
    given = Given(dict(values), "plate")
    pull = implants._pull(given, "screw", {"screw": None}, beside)
    assert set(beside.values) == {f"Mg-5Gd: {name}" for name in implants.MECHANICS}
    found = beside.values["Mg-5Gd: yield_stress"]
    assert (found.value, found.unit, found.kind) == (130e6, "Pa", "assumed")
    assert pull.alloy.yield_stress.si == found.value and found.source == "harmuth2019"


CHANGES = [
    ('kind = "galvanic"', 'kind = "galvanik"', ["did you mean galvanic?"]),
    ("[lattice]", "[latice]", ["'latice'", "did you mean lattice?"]),
    ('spacing = "1mm"', 'spacin = "1mm"', ["lattice.spacin", "did you mean spacing?"]),
    ('spacing = "1mm"', 'spacing = "1kg"', ["lattice.spacing is '1kg'", "unit of length"]),
    ('spacing = "1mm"', 'spacing = "0mm"', ["above 0 m"]),
    ('spacing = "1mm"', 'spacing = "1mm"\nhorizon = "0.5mm"', ["at least the spacing"]),
    ('spacing = "1mm"', 'spacing = "1mm"\nhorizon = "5mm"', ["half of the narrowest gap"]),
    ('high = ["24mm", "12mm"]', 'high = ["24mm"]', ["lattice.high has 1 entries", "2"]),
    ("[liquid]\n", '[liquid]\nconductivity = "1 S/m"\n', ["one of liquid.conductivity"]),
    ('shape = "ball"', 'shape = "bal"', ["did you mean ball?"]),
    ('radius = "3mm"', 'radius = "3mm"\ndiameter = "4mm"', ["metals.pin.diameter", "no use"]),
    ('radius = "3mm"', 'radius = "9mm"', ["belong to two of tin, pin"]),
    ('alloy = "Mg-5Gd"', 'alloy = "Mg5Gd"', ["did you mean Mg-5Gd?"]),
    ('alloy = "Mg-5Gd"', "solid_concentration = 7e4", ["metals.pin.charge_number is missing"]),
    ('law = "linear"', 'law = "linear"\nelectrode = "AE44"', ["one of metals.tin.electrode"]),
    ('resistance = "0.1 ohm m^2"', "resistance = -1", ["metals.tin.resistance", "above 0"]),
    ('kind = "measured"', 'kind = "mesured"', ["did you mean measured?"]),
    ('source = "my notebook"', 'sorce = "my notebook"', ["did you mean source?"]),
    ('immersion = ["0s", "2h"]', 'immersion = ["2h", "1h"]', ["must rise"]),
    ('immersion = ["0s", "2h"]', "immersion = 3", ["list of times"]),
    ('kind = "galvanic"', 'kind = "galvanic"\nalloy = "Mg-5Gd"', ["'alloy'", "at the top"]),
    ('shape = "ball"', 'shape = "screw"', ["three axes"]),
    ('kind = "galvanic"', 'kind = "couple"', ["an implant has 3"]),
    ('"Mg-5Gd"', '"Mg-5Gd"\nparameters = "table-9"', ["parameter set 'table-9' is unknown"]),
    ('"Mg-5Gd"', '"WE43"\nparameters = "table-5.1"', ["no alloy 'WE43'", "Mg-5Gd, Mg-10Gd"]),
    ('"Mg-5Gd"', '"WE43"\nparameters = "own"', ["no [corrosion]", "calibrate"]),
    ('alloy = "Mg-5Gd"', 'parameters = "own"', ["metals.pin.alloy is missing"]),
    ('dissolves = "yes"', 'parameters = "own"', ["metals.pin.", "no use for it"]),
]


@pytest.mark.parametrize(("old", "new", "words"), CHANGES)
def test_what_a_file_must_not_hold_is_refused(old, new, words, tmp_path, capsys):
    file, out = tmp_path / "own.toml", tmp_path / "run"
    assert old in OWN
    file.write_text(OWN.replace(old, new, 1))
    refused(capsys, ["run", str(file), "--out", str(out)], *words)
    assert not out.exists()


@pytest.mark.parametrize(("option", "key"), [("--parameters", "parameters"), ("--solid", "file")])
def test_an_option_of_a_life_cycle_is_refused_with_a_metals_key(option, key, tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    words = f"{option} is of a life cycle", f"a couple has it as {key} of [metals.NAME]"
    for command in ("plan", "run"):
        refused(capsys, [command, str(file), option, "x.toml"], *words)


def changed(name: str, *lines: tuple[str, str]) -> str:
    """A shipped scene with other values; a key without a value is left out."""
    text = path_of(name).read_text(encoding="utf-8")
    for key, value in lines:
        text, count = re.subn(
            rf"^{key} = .*$", f"{key} = {value}" if value else "", text, flags=re.MULTILINE
        )
        assert count, key
    return text


OF_OTHER_KINDS = [
    ("pit-lacy", ("critical_concentration", "0.99"), ["critical_concentration is 0.99", "0.98"]),
    ("pit-lacy", ("passive_share", "1.0"), ["passive_share is 1", "below 1"]),
    ("pit-lacy", ("rupture", "0.99"), ["film.rupture is 0.99", "at most 0.98"]),
    ("pit-lacy", ("rupture", ""), ["film.rupture_width is given", "no use for it"]),
    (
        "pit-304",
        ("step", '"1s"\n[salt]\nconductivity = "0.01 S/m"'),
        ["salt.tafel_slope is missing"],
    ),
    (
        "pit-pencil",
        ("current_density", '"5100 A/m^2"\n[salt]\ntafel_slope = "0.1V"'),
        ["salt.tafel_slope is given", "no use for it"],
    ),
    ("pit-304", ("charge_number", ""), ["metal.charge_number is missing"]),
    ("pit-304", ("saturation_concentration", "2e5"), ["must be below metal.solid_concentration"]),
    ("pit-304", ("opening", ""), ["geometry.opening is missing"]),
    ("pit-pencil", ("spacing", '"1pm"'), ["'1pm'"]),
    ("pit-pencil", ("spacing", '"1e-6um"'), ["makes 4e+08 nodes"]),
    ("crevice-625", ("charge_number", ""), ["metal.charge_number is missing"]),
    ("crevice-625", ("saturation_concentration", "6000"), ["known up to 5600 mol/m^3"]),
    ("crevice-625", ("spacing", '"10mm"'), ["half of the length of 12.7 mm"]),
    ("crevice-625", ("law", '"constant"'), ["metal.current_density is missing"]),
    ("crevice-625", ("gap_at_end", '"0um"'), ["geometry.gap_at_end is '0um'", "above 0 m"]),
    ("crevice-625", ("gap_at_mouth", '"5mm"'), ["gap_at_mouth is 5 mm", "15 %", "10 % at most"]),
    ("crevice-625", ("diffusivity", '"1e-13 m^2/s"'), ["across the gap by up to 60 %"]),
    ("crevice-625", ("seed", '"13mm"'), ["geometry.seed is 13 mm", "length of 12.7 mm"]),
    ("crevice-625", ("seed_concentration", "1.2"), ["at most 1"]),
    ("intergranular", ("along", '"1um"'), ["[grains]", "at least two spacings"]),
    ("intergranular", ("seed", "-1"), ["damage.seed is -1", "at least 0"]),
    ("galvanic-slab", ("resistance", "0"), ["above 0 ohm m^2"]),
]


@pytest.mark.parametrize(("name", "line", "words"), OF_OTHER_KINDS)
def test_what_other_kinds_refuse(name, line, words, tmp_path, capsys):
    file, out = tmp_path / "own.toml", tmp_path / "run"
    file.write_text(changed(name, line))
    refused(capsys, ["run", str(file), "--out", str(out)], *words)
    assert not out.exists()


def test_a_boundary_of_one_spacing_and_mixed_references_are_refused(tmp_path, capsys):
    file, out = tmp_path / "own.toml", ["--out", str(tmp_path / "run")]
    file.write_text(changed("intergranular", ("across", '"15um"\nboundary_width = "1um"')))
    refused(capsys, ["run", str(file), *out], "boundary_width", "at least two spacings")
    steel = (FOLDER / "electrodes" / "mild-steel.toml").read_text(encoding="utf-8")
    steel = steel.replace('"SCE"', '"SHE"').replace('"mild-steel"', '"steel"')
    (tmp_path / "steel.toml").write_text(steel)
    text = changed("galvanic-ae44-steel")
    file.write_text(text.replace('value = "mild-steel"', f'value = "{tmp_path}/steel.toml"'))
    refused(capsys, ["run", str(file), *out], "against SHE", "against SCE", "all must be")


def test_a_plan_names_what_a_scene_has_no_unknowns_for(capsys):
    """Each with its error: none where it is exact, a percentage, or no bound that helps."""
    rows = {
        "pit-lacy": ["metal", "saturated liquid", "passive metal", "transport"],
        "pit-pencil": ["metal", "saturated liquid", "transport"],
        "crevice-625": ["width of the gap", "saturated stretch"],
        "galvanic-slab": ["potential", "kinetics", "renewal"],
    }
    for name, expected in rows.items():
        assert main(["plan", str(path_of(name)), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)["omissions"]
        assert [row["name"] for row in found] == expected, name
    assert main(["plan", str(path_of("crevice-625"))]) == 0
    text = capsys.readouterr().out
    assert "at most 0.0083 % of the concentration" in text and "none" in text
    assert main(["plan", str(path_of("galvanic-slab"))]) == 0
    assert "no bound below 100 %" in capsys.readouterr().out


def test_reductions_are_refused_by_name(tmp_path, capsys):
    file = tmp_path / "own.toml"
    run = ["run", str(file), "--quiet", "--out"]
    file.write_text(OWN)
    assert main([*run, str(tmp_path / "one")]) == 0
    assert "left out: renewal, bound" in capsys.readouterr().out
    file.write_text(OWN + '[reduce]\nkeep = ["renewal"]\n')
    assert main([*run, str(tmp_path / "two")]) == 0
    assert "left out" not in capsys.readouterr().out
    file.write_text(OWN + '[reduce]\nkeep = ["renewl"]\n')
    refused(capsys, [*run, str(tmp_path / "three")], "did you mean renewal?")


def test_mirror_nodes_are_an_option_of_galvanic_scenes(tmp_path, capsys):
    file = tmp_path / "own.toml"
    run = ["run", str(file), "--quiet", "--out"]
    file.write_text(OWN + '[potential]\nrobin = "as_published"\n')
    assert main([*run, str(tmp_path / "one")]) == 0
    assert "left out" not in capsys.readouterr().out  # no bound holds for them
    with (tmp_path / "one" / "summary.csv").open(newline="", encoding="utf-8") as table:
        found = {row["quantity"]: float(row["value"]) for row in csv.DictReader(table)}
    assert 1e-6 < found["currents left open, largest"] < 0.2
    assert main(["plan", str(file)]) == 0
    assert "not of mirror nodes" in " ".join(capsys.readouterr().out.split())
    file.write_text(OWN + '[potential]\nrobin = "mirror"\n')
    refused(capsys, [*run, str(tmp_path / "two")], "potential.robin is 'mirror'", "as_published")
    text = OWN.replace('low = ["0mm", "0mm"]\nhigh = ["24', 'low = ["0mm", "0mm"]\nhigh = ["600')
    text = text.replace('"12mm"', '"400mm"') + '[potential]\nrobin = "as_published"\n'
    file.write_text(text)
    refused(capsys, [*run, str(tmp_path / "two")], "potential.robin", "at most 200,000 nodes")
    couple = path_of("screw-in-titanium-plate").read_text(encoding="utf-8")
    file.write_text(couple + '[potential]\nrobin = "as_published"\n')
    refused(capsys, [*run, str(tmp_path / "two")], "'potential' is not known")


def test_liquid_far_below_saturation_is_left_out(tmp_path, capsys):
    scene = ["scenes", "intergranular", "--spacing", "4um", "--times", "0s", "10min", "--quiet"]
    assert main([*scene, "--out", str(tmp_path / "run")]) == 0
    printed = capsys.readouterr().out
    assert "left out: transport, bound" in printed and "0 of what is lost" in printed
    file, run = tmp_path / "own.toml", tmp_path / "two"
    text = changed("intergranular", ("spacing", '"4um"'), ("immersion", '["0s", "10min"]'))
    file.write_text(text + '[reduce]\nkeep = ["transport"]\n')
    assert main(["run", str(file), "--quiet", "--out", str(run)]) == 0
    kept = capsys.readouterr().out
    assert "left out" not in kept
    share = "share of the metal lost"
    lost = [next(line for line in text.splitlines() if share in line) for text in (printed, kept)]
    assert lost[0] == lost[1]


def test_what_belongs_to_another_command_is_refused(tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    run = ["run", str(file), "--out", str(tmp_path / "run")]
    refused(capsys, [*run, "--alloy", "Mg-5Gd"], "--alloy is of a life cycle", "--spacing")
    refused(capsys, [*run, "--np", "2"], "--np is of a life cycle")
    refused(capsys, ["run", str(file)], "say where with --out DIR")
    refused(capsys, ["geometry", str(file), "--out", "x"], "must be life-cycle")
    refused(capsys, ["init", "--kind", "pitt"], "did you mean pit?")
    refused(capsys, ["init", "--kind", "pit", "--np", "2"], "--np is of a life cycle")
