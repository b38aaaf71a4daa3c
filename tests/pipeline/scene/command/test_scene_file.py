"""Scene files: what `perilife init` writes is what the options say, and nothing else is taken."""

import argparse
import json
import math
import tomllib
from pathlib import Path

import pytest

from pipeline import LifeCycle
from pipeline.cli import build_parser, main
from pipeline.record.stage_hashes import corrosion_hash, geometry_hash, map_hash, pull_hash
from pipeline.run import every_option, scene_of
from pipeline.scene.command.arguments import keyword, options_of
from pipeline.scene.command.scene_file import GIVEN_BY_ENDING, tables_of
from pipeline.scene.image import SUFFIXES
from pipeline.scene.resolve import SOLID_SUFFIXES
from pipeline.scene.scene import Scene
from tests.pipeline.command_line import refused, typed

EXAMPLES = Path(__file__).parents[4] / "pipeline/examples"
OPTIONS = [
    *("--alloy", "Mg-10Gd", "Mg-5Gd", "--immersion", "1w", "8w", "--hold", "slot", "faces"),
    *("--spacing", "50um", "--kinetics", "tafel:overpotential=0.02,slope=0.1", "--keep", "liquid"),
    *("--diameter", "2.1mm", "--final-strain", "0.08", "--coating", "factor=0.1,lifetime=28d"),
    *("--resolution", "standard", "--np", "2", "--oversubscribe", "--out", "runs/x"),
]


def written(capsys, path: Path, *options: str) -> Path:
    """The file that `perilife init` prints for these options."""
    assert main(["init", *options]) == 0
    path.write_text(capsys.readouterr().out)
    return path


def asked(*arguments: str) -> argparse.Namespace:
    """What `perilife run` understands."""
    return build_parser().parse_args(["run", *arguments])


def hashes(scene: Scene) -> list[str]:
    """Those of all stages."""
    tests = [(a.name, t, h) for a in scene.alloys for t in scene.with_intact() for h in scene.holds]
    return [
        geometry_hash(scene),
        *(corrosion_hash(scene, alloy.name) for alloy in scene.alloys),
        *(map_hash(scene, *test) for test in tests),
        *(pull_hash(scene, *test) for test in tests),
    ]


def test_no_file_is_written_for_an_alloy_that_is_not_known(tmp_path, capsys) -> None:
    for name, said in (("Unobtainium", "known are"), ("Mg-5GD", "did you mean Mg-5Gd?")):
        assert main(["init", "--alloy", "Mg-10Gd", name]) == 2
        printed, told = capsys.readouterr()
        assert printed == ""
        assert told.count("\n") == 1 and f"alloy '{name}' is unknown" in told and said in told
    assert main(["init", "--alloy", str(tmp_path / "none.toml")]) == 2
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("--diameter", "1 parsec"), ("--immersion", "8 months"), ("--voxel", "5kg"),
        ("--step", "100um"), ("--bending-azimuth", "30s"), ("--bath-volume", "50"),
        ("--spacing", "wide"),
    ],
)  # fmt: skip
def test_no_file_is_written_for_a_unit_that_no_run_would_read(option, text, capsys) -> None:
    refused(capsys, ["init", option, text], option[2:].replace("-", " "), text, "unit out of")


def test_a_bare_time_is_of_an_hour_at_least_or_zero(tmp_path) -> None:
    file = tmp_path / "scene.toml"
    for immersion in ("[0, 3600]", "['0w', '1h']", "['0s', '3600s']"):
        file.write_text(f"alloy = 'Mg-5Gd'\nimmersion = {immersion}\n")
        asked_for = scene_of(asked(str(file), "--out", "x")).immersion
        assert [time.seconds for time in asked_for] == [0.0, 3600.0]


def test_a_file_given_for_another_is_named(tmp_path, capsys) -> None:
    alloy = str(EXAMPLES / "my-alloy.toml")
    out = ["--out", str(tmp_path / "run")]
    for command in (["run", alloy, *out], ["plan", alloy], ["run", "--scene", alloy, *out]):
        refused(capsys, command, "is the file of an alloy", f"give it as --alloy {alloy}")
    scene, time = str(EXAMPLES / "scene.toml"), ["--immersion", "8w"]
    words = "is the file of a scene", f"perilife run {scene}"
    refused(capsys, ["run", "--alloy", scene, *time, *out], "alloy is", *words)
    sets = ["run", "--alloy", "Mg-5Gd", *time, *out, "--parameters"]
    refused(capsys, [*sets, scene], "parameter set is", *words)
    refused(capsys, [*sets, alloy], "parameter set is", "the file of an alloy")


def test_a_solid_or_an_image_given_as_a_scene_is_named_with_its_option(capsys) -> None:
    assert set(GIVEN_BY_ENDING) == {*SOLID_SUFFIXES, *SUFFIXES} - {".nii.gz"}
    for given in (["part.STEP"], ["--scene", "part.stl"], ["scene.toml", "part.stp"]):
        refused(capsys, ["plan", *given], "is no scene", f"--solid {given[-1]}")
    refused(capsys, ["run", "scan.tif", "--out", "x"], "--image scan.tif")


def test_measurements_are_of_an_alloy_of_the_scene(tmp_path) -> None:
    data, alloy = tmp_path / "mine.csv", str(EXAMPLES / "my-alloy.toml")
    data.write_text("immersion time [w],volume loss [%]\n1,4\n")
    both = {"alloy": [alloy, "Mg-5Gd"], "immersion": "8w"}
    for name in ("Mg-example", alloy):
        found = LifeCycle(**both, volume_loss=[f"{name}={data}"]).scene.measured_volume_loss
        assert found == {"Mg-example": str(data)}
    with pytest.raises(ValueError, match="is of 'Mg-10Gd'; it must be of Mg-example or Mg-5Gd"):
        LifeCycle(**both, volume_loss=[f"Mg-10Gd={data}"])


def test_a_file_says_what_the_options_say(tmp_path, capsys) -> None:
    path = written(capsys, tmp_path / "scene.toml", *OPTIONS)
    by_file, by_options = asked(str(path)), asked(*OPTIONS)
    assert vars(by_file) == vars(by_options)
    scene = scene_of(by_options)
    assert hashes(scene_of(by_file)) == hashes(scene)
    assert LifeCycle(scene=path).scene.hash() == scene.hash()
    # and the stored scene of a run repeats it
    stored = tmp_path / "scene.json"
    stored.write_text(json.dumps(scene.to_json()))
    again = scene_of(asked("--scene", str(stored), "--out", "runs/y"))
    assert again == scene and hashes(again) == hashes(scene)


def test_every_option_comes_back_from_a_file(tmp_path, capsys) -> None:
    given = []
    for name, action in options_of(every_option()).items():
        words, value = typed(action)
        if name == "alloy":  # which must be known
            words = value = ["Mg", "WE43"]
        given += [action.option_strings[-1], *words]
        assert action.default != value, name
    path = written(capsys, tmp_path / "scene.toml", *given)
    assert not commented(path.read_text())
    assert vars(asked(str(path))) == vars(asked(*given))


def test_what_is_typed_wins_wherever_the_file_stands(tmp_path, capsys) -> None:
    measured = ["--volume-loss", "Mg-5Gd=a.csv", "--volume-loss", "Mg-10Gd=b.csv"]
    path = str(written(capsys, tmp_path / "scene.toml", *OPTIONS, *measured))
    typed = ["--spacing=100um", "--hold", "shank", "--volume-loss", "Mg-5Gd=c.csv"]
    for arguments in (
        [path, *typed],
        ["--scene", path, *typed],
        [*typed, f"--scene={path}"],
        ["--quiet", path, *typed],
        [*typed, path],
    ):
        options = asked(*arguments)
        assert options.spacing == "100um" and options.hold == ["shank"]
        assert options.volume_loss == ["Mg-5Gd=c.csv"]
        assert options.alloy == ["Mg-10Gd", "Mg-5Gd"] and options.out == "runs/x"


def test_help_is_no_scene_file(capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["run", "-h"])
    assert end.value.code == 0 and "SCENE" in capsys.readouterr().out
    run = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", "run"]
    refused(capsys, [*run, "-x"], "unrecognized arguments: -x")


def commented(text: str) -> dict[str, tuple[object, bool]]:
    """Value of each key behind a #, and whether it is an example."""
    lines = [line[1:] for line in text.splitlines() if line[:1] == "#" and line[1:2].strip()]
    found = {}
    for line in lines:
        ((key, value),) = tomllib.loads(line).items()
        found[key] = (value, line.endswith("# example"))
    return found


def numbers(content: object) -> object:
    """Nested numbers rounded to 12 digits: 0.7 mm as typed, and as a sum of doubles."""
    if isinstance(content, dict):
        return {key: numbers(value) for key, value in content.items()}
    if isinstance(content, list):
        return [numbers(value) for value in content]
    if isinstance(content, float) and content:
        return round(content, 11 - math.floor(math.log10(abs(content))))
    return content


def test_the_template_has_every_option_and_the_defaults_are_those_of_a_run(
    tmp_path, capsys
) -> None:
    text = written(capsys, tmp_path / "scene.toml").read_text()
    said = tomllib.loads(text)
    shown = commented(text)
    given = {key for key, value in said.items() if not isinstance(value, dict)} - {"kind"}
    assert sorted(map(keyword, [*given, *shown])) == sorted(options_of(every_option()))
    assert max(map(len, text.splitlines())) <= 100
    base = {"alloy": said["alloy"], "immersion": said["immersion"], "out": said["out"]}
    whole = LifeCycle(**base)
    ions = ("medium", "minerals", "activity", "flux_form", "closure", "balance")
    bath = {"model": "nnpp", "bath_volume": "10mL"}
    needs = {"bending_azimuth": {"load": "bending"}} | dict.fromkeys(ions, {"model": "nnpp"})
    needs |= {"feedback": {"model": "nnpp"}, "electrodes": {"model": "nnpp"}}
    needs |= {"bath_volume": {"model": "nnpp"}, "exchange_every": bath, "open_to": bath}
    for key, (value, example) in shown.items():
        name = keyword(key)
        if name in ("solid", "unit", "image", "voxel", "threshold", "label", "cap"):
            continue
        beside = needs.get(name, {})
        if name == "volume_loss":
            (tmp_path / "measured.csv").write_text("immersion time [w],volume loss [%]\n1,4\n")
            value = [f"Mg-5Gd={tmp_path / 'measured.csv'}"]
        found = LifeCycle(**base, **{name: value, **beside})
        plain = LifeCycle(**base, **beside) if beside else whole
        if example:
            assert vars(found._options) != vars(plain._options), key
        else:
            assert numbers(found.scene.to_json()) == numbers(plain.scene.to_json()), key
            default = getattr(plain._options, name)
            assert default in (None, [], getattr(found._options, name)), key


def test_the_tables_are_the_groups_of_the_help() -> None:
    tables = tables_of(every_option())
    assert tables["pitch"] == "geometry" and tables["horizon"] == "corrosion"
    assert tables["medium"] == "ions" and tables["hold"] == "tensile" and tables["out"] == ""


@pytest.mark.parametrize(
    "text, words",
    [
        ("spacng = '50um'", ["'spacng'", "did you mean spacing?", "perilife init"]),
        ("[corrosion]\nspacng = '50um'", ["'spacng'", "did you mean spacing?"]),
        ("[tensile]\nhorizon = '50um'", ["'horizon' stands in [tensile]", "in [corrosion]"]),
        ("[tensile]\nalloy = 'Mg-5Gd'", ["'alloy' stands in [tensile]", "at the top"]),
        ("[corosion]\nhorizon = '50um'", ["[corosion]", "did you mean corrosion?"]),
        ("mesh_size = '1mm'\n[tensile]\nmesh-size = '2mm'", ["'mesh-size' is there twice"]),
        ("kind = 'pitting'", ["kind is 'pitting'", "life-cycle"]),
        ("kind = ", ["not valid TOML"]),
        ("a = " + 5000 * "[", ["not valid TOML"]),
        ("resume = 'yes'", ["resume is 'yes'", "true or false"]),
        ("spacing = ['50um', '100um']", ["one value, not a list"]),
        ("alloy = ['--resume']", ["'--resume'", "hyphen"]),
        ("alloy = 2026-01-01", ["alloy is", "text, a number or a list"]),
        ("alloy = ['Mg-5Gd']", ["--immersion"]),
        ("alloy = 'mg5gd'\nimmersion = '8w'", ["did you mean Mg-5Gd?"]),
        ("alloy = 'Mg-5Gd'\nimmersion = '8w'\nclasses = 2.5", ["rate classes", "2.5"]),
        ("immersion = 12", ["immersion: 12 is 12 s", "write 12w, 12d or 12h"]),
        ("immersion = [0, 1.5]", ["immersion: 1.5 is 1.5 s", "1.5w"]),
        ("[ions]\nexchange-every = 2", ["exchange-every: 2 is 2 s", "2d"]),
        ("[parameters]\n[alloys.X]", ["file of a parameter set", "--parameters"]),
    ],
)
def test_what_a_file_must_not_hold_is_refused(tmp_path, capsys, text, words) -> None:
    path, out = tmp_path / "scene.toml", tmp_path / "run"
    path.write_text(text)
    refused(capsys, ["run", str(path), "--out", str(out)], *words)
    assert not out.exists()


def test_a_stored_scene_stands_alone(tmp_path, capsys) -> None:
    stored = tmp_path / "scene.json"
    stored.write_text(json.dumps(LifeCycle("Mg-5Gd", "8w").scene.to_json()))
    out = ["--out", str(tmp_path / "run")]
    refused(capsys, ["run", str(stored), *out, "--hold", "slot"], "--hold", "every number", "TOML")
    refused(capsys, ["run", str(stored)], "--out")
    refused(capsys, ["run", str(stored), str(stored), *out], "must be one")
    refused(capsys, ["design", str(stored), *out], "must be TOML")
    stored.write_text("{")
    refused(capsys, ["run", str(stored), *out], "is not JSON")
    stored.write_text('{"schema_version": 1}')
    refused(capsys, ["run", str(stored), *out], "schema version", "must be 2")
    solid = tmp_path / "part.step"
    solid.write_text("one")
    stored.write_text(json.dumps(LifeCycle("Mg-5Gd", "8w", solid=solid).scene.to_json()))
    assert scene_of(asked(str(stored), *out)).geometry.path == str(solid)
    solid.write_text("two")
    refused(capsys, ["run", str(stored), *out], "part.step", "changed after")
    refused(capsys, ["run", "absent.toml", *out], "absent.toml", "no such file")
    assert not (tmp_path / "run").exists()


def test_a_file_of_a_run_serves_plan_and_fit(tmp_path, capsys) -> None:
    path = str(written(capsys, tmp_path / "scene.toml", *OPTIONS))
    parser = build_parser()
    plan = parser.parse_args(["plan", path])
    assert plan.spacing == "50um" and plan.np == 2 and not hasattr(plan, "out")
    fit = parser.parse_args(["calibrate", path, "--out", "fit"])
    assert fit.spacing == "50um" and fit.out == "fit" and not hasattr(fit, "immersion")
    refused(capsys, ["calibrate", path], "--out")
