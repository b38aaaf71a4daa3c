"""The command line: each refusal is one sentence, exit code 2, and leaves nothing behind."""

import argparse
import itertools
import json
import os
import re
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import perilife_data
from peri.corrosion.kinetics import Exposed
from pipeline.benches.registry import BENCHMARKS, Benchmark, Result
from pipeline.cli import main, sentence
from pipeline.record import interruption, machine
from pipeline.record.run_folder import RunFolder
from pipeline.report import provenance
from pipeline.scene.options import add_scene_options, scene_from_options
from pipeline.scene.rate_law import KINETICS
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.scene import DISSOLUTION_LAWS, OMITTABLE, scene_from_json
from pipeline.stages import corrosion as corrosion_stage
from pipeline.stages import readiness
from pipeline.stages.geometry import build_solid
from pipeline.stages.opening import open_run
from pipeline.stages.sizes import with_fitting_spacing
from tests.pipeline.geometry.solids import coarse_mesh

PIN = ["--thread", "none"]  # a plain pin: its solid takes a tenth of a second
COARSE = ["--spacing", "300um", "--horizon", "600um", "--radial-margin", "1mm"]
COARSE += ["--axial-margin", "1mm"]  # 300 um against the smallest feature, the slot of 500 um
STAGES = ("geometry", "corrode", "map", "pull")
SCENE = ["--alloy", "Mg-5Gd", "--immersion", "0w", "8w", *PIN]


def _refused(capsys, arguments: list[str], *words: str) -> str:
    """Run the command, check that it refuses in one sentence with these words, return it."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    message = captured.err
    assert message.startswith("perilife: ")
    assert message.endswith(".\n")
    assert message.count("\n") == 1, message
    assert "Traceback" not in message
    for word in words:
        assert word in message, message
    return message


def _changed(*changes: str) -> list[str]:
    return [*SCENE, *changes]


@pytest.mark.parametrize(
    "scene, words",
    [
        (["--alloy", "Mg-7Gd", "--immersion", "8w"], ["Mg-7Gd", "Mg-5Gd", "Mg-10Gd"]),
        (["--alloy", "Mg-5Gd", "Mg-5Gd", "--immersion", "8w"], ["Mg-5Gd", "without repetition"]),
        (["--alloy", "Mg-5Gd", "--immersion=-1w"], ["-1w", "negative", "at least 0"]),
        (["--alloy", "Mg-5Gd", "--immersion", "-1w"], ["-1w", "negative", "at least 0"]),
        (["--alloy", "Mg-5Gd", "--immersion", "5300w"], ["5300w, 101.6 years", "100 years"]),
        (["--alloy", "Mg-5Gd", "--immersion", "1e400w"], ["1e400w", "infinite"]),
        (["--alloy", "mg5gd", "--immersion", "8w"], ["'mg5gd'", "did you mean Mg-5Gd?"]),
        (["--alloy", "Mg-5Gd", "--immersion", "0.1w", "16.8h"], ["16.8h", "same time"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8w", "1w"], ["1w", "8w", "must rise"]),
        (["--alloy", "Mg-5Gd", "--immersion", "7d", "1w"], ["7d", "1w", "same time"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8 months"], ["8 months", "unit out of s, min"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8"], ["'8'", "unit"]),
        (["--alloy", "absent.toml", "--immersion", "8w"], ["absent.toml", "no such file"]),
        (_changed("--resolution", "medium"), ["medium", "quick, standard, fine"]),
        (_changed("--parameters", "table-9"), ["table-9", "table-5.1"]),
        (_changed("--saturation", "maybe"), ["maybe", "complementarity"]),
        (_changed("--kinetics", "tafel:overpotential=0.1,slope=-1"), ["slope: -1.0", "positive"]),
        (_changed("--kinetics", "tafel"), ["'tafel'", "overpotential, slope"]),
        (_changed("--dissolution", "linear"), ["'linear'", "one of proportional, faradaic"]),
        (
            _changed("--dissolution", "faradaic", "--saturation", "as_published")
            + ["--scheme", "backward_euler"],
            ["as_published", "complementarity or none where dissolution is faradaic"],
        ),
        (
            _changed("--dissolution", "faradaic", "--scheme", "forward_euler"),
            ["forward_euler", "sdirk2 or backward_euler where dissolution is faradaic"],
        ),
        (_changed(*COARSE), ["300 um", "at most 250 um", "--spacing 250um, or --spacing auto"]),
        (_changed(*COARSE, "--slot-depth", "20um"), ["--spacing 10um --horizon 80um"]),
        (_changed("--spacing", "100"), ["spacing '100'", "100um"]),
        (_changed("--spacing", "100furlong"), ["100furlong", "m, cm, mm, um, inch"]),
        (_changed("--horizon", "50um"), ["horizon is 50 um", "1 to 8"]),
        (_changed("--radial-margin", "100um"), ["radial margin is 100 um", "300 um"]),
        (_changed("--step", "0s"), ["step is 0.0", "above 0"]),
        (_changed("--rate-change", "2"), ["rate change is 2.0"]),
        (_changed("--diameter=-2mm"), ["diameter '-2mm' is negative"]),
        (_changed("--diameter", "-2mm"), ["diameter '-2mm' is negative"]),
        (_changed("--mesh-size", "-.2mm"), ["mesh size '-.2mm' is not understood"]),
        (_changed("--step", "-1d"), ["step '-1d' is negative"]),
        (_changed("--top-grip", "-1mm"), ["top grip '-1mm' is negative"]),
        (_changed("--load", "bending", "--bending-azimuth", "1e400deg"), ["1e400deg", "infinite"]),
        (_changed("--resolution", "quik"), ["did you mean quick?"]),
        (_changed("--element", "p2"), ["did you mean P2?"]),
        (_changed("--thread", "helix"), ["did you mean helical?"]),
        (_changed("--kinetics", "taffel:slope=1"), ["did you mean tafel?"]),
        (_changed("--spacng", "1um"), ["--spacng", "did you mean --spacing?"]),
        (_changed("--slot-width", "3mm"), ["slot", "3"]),
        (_changed("--thread", "left"), ["'left'", "helical"]),
        (_changed("--final-strain", "0"), ["final strain is 0.0"]),
        (_changed("--increment", "0.5"), ["increment is 0.5", "0.1"]),
        (_changed("--element", "Q1"), ["'Q1'", "P2"]),
        (_changed("--load", "shear"), ["load is 'shear'", "axial, torsion, bending"]),
        (_changed("--load", "torsion", "--lateral", "free"), ["'free'", "clamped", "torsion"]),
        (_changed("--load", "bending", "--bending-azimuth", "30"), ["'30'", "deg, rad"]),
        (
            _changed("--load", "torsion", "--bending-azimuth", "1rad"),
            ["azimuth is 1rad", "left out where the load is torsion"],
        ),
        (
            _changed("--bending-azimuth", "30deg"),
            ["30deg", "left out where the load is axial"],
        ),
        (_changed("--mesh-size", "100um", "--mesh-size-fine", "200um"), ["200 um", "100 um"]),
        (_changed("--np", "0"), ["--np is 0"]),
        (_changed("--np", "3"), ["--np is 3", "2 cores", "at most 2", "--oversubscribe"]),
        (_changed("--pulls", "3"), ["--pulls is 3 and", "at most 2", "--oversubscribe"]),
        (_changed("--np", "2", "--pulls", "2"), ["--pulls is 2 of 2 ranks each", "at most 1"]),
        (_changed("--unit", "mm"), ["--unit", "--solid"]),
        (_changed("--volume-loss", "mine.csv"), ["mine.csv", "ALLOY=FILE.csv"]),
        (_changed("--volume-loss", "Mg-5Gd=absent.csv"), ["absent.csv", "no such file"]),
        (_changed("--frobnicate"), ["--frobnicate"]),
        (["--immersion", "8w"], ["--alloy"]),
    ],
)
def test_a_scene_that_cannot_be_computed_is_refused(tmp_path, capsys, monkeypatch, scene, words):
    monkeypatch.setattr(machine, "processor_cores", lambda: 2)
    out = tmp_path / "run"
    _refused(capsys, ["run", "--out", str(out), *scene], *words)
    assert not out.exists()


@pytest.mark.parametrize("command", ["geometry", "plan"])
def test_other_commands_refuse_the_same_scene(tmp_path, capsys, command):
    out = tmp_path / "run"
    folder = [] if command == "plan" else ["--out", str(out)]
    _refused(capsys, [command, *folder, *_changed(*COARSE)], "300 um", "250 um")
    assert not out.exists()


def _facet(a, b, c) -> str:
    corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in (a, b, c))
    return f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"


def _tetrahedron(shift: float = 0.0, open_: bool = False) -> str:
    p = [(shift + x, y, z) for x, y, z in ((0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4))]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    return "".join(_facet(*(p[i] for i in face)) for face in faces[: 3 if open_ else 4])


def _solid(*parts: str) -> str:
    return "solid part\n" + "".join(parts) + "endsolid part\n"


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("open.stl", _solid(_tetrahedron(open_=True)), ["open.stl"]),
        ("crossing.stl", _solid(_tetrahedron(), _tetrahedron(shift=1.0)), ["crossing.stl"]),
        ("empty.stl", "", ["empty.stl"]),
        ("part.step", "this is no STEP file\n", ["part.step"]),
        ("part.obj", "v 0 0 0\n", ["part.obj", ".step, .stp, .brep, .stl"]),
    ],
)
def test_a_file_that_bounds_no_solid_is_refused(tmp_path, capsys, name, text, words):
    path, out = tmp_path / name, tmp_path / "run"
    path.write_text(text)
    base = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", str(out)]
    _refused(capsys, [*base, "--solid", str(path)], *words)
    assert not out.exists()


@pytest.mark.parametrize("kind", ["binary", "text", "neither"])
def test_a_surface_of_too_many_triangles_is_refused_unread(tmp_path, capsys, kind):
    path, out = tmp_path / "huge.stl", tmp_path / "run"
    count = 6_000_000
    if kind == "text":
        facets = _tetrahedron().encode()
        size = len(facets) // 4 * count
        begin = b"solid part\n" + 5000 * facets
    else:
        size = 84 + 50 * count
        begin = bytes(80) + count.to_bytes(4, "little") if kind == "binary" else b"x" * 84
    with path.open("wb") as file:  # a sparse file: its size is told, its blocks are not there
        file.write(begin)
        file.truncate(size)
    arguments = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--solid", str(path), "--out", str(out)]
    said = _refused(capsys, ["run", *arguments], "huge.stl", "triangles", "at most 5,000,000")
    if kind == "binary":
        assert "has 6,000,000" in said
    if kind == "text":  # the first MiB says how long a facet is
        found = int(re.search(r"about ([\d,]+) triangles", said)[1].replace(",", ""))
        assert found == pytest.approx(count, rel=0.01)
    assert not out.exists()


def test_a_data_file_without_end_is_refused(tmp_path, capsys):
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    scene = ["--alloy", str(tmp_path / "deep.toml"), "--immersion", "8w"]
    _refused(capsys, ["plan", *scene], "deep.toml", "nested too deeply")


def test_lengths_typed_in_two_units_are_the_same_scene():
    """In doubles 70 * 1e-6 is not 0.07 * 1e-3, but what was typed is."""
    a = _scene([*SCENE, "--mesh-size", "300um", "--spacing", "70um", "--diameter", "2.1mm"])
    b = _scene([*SCENE, "--mesh-size", "0.3mm", "--spacing", "0.07mm", "--diameter", "2100um"])
    assert 70 * 1e-6 != 0.07 * 1e-3 and 2100 * 1e-6 != 2.1 * 1e-3
    assert a.hash() == b.hash()
    _scene([*SCENE, "--mesh-size", "0.3mm", "--mesh-size-fine", "300um"])


def test_a_missing_file_or_a_wrong_unit_of_a_solid_is_refused(tmp_path, capsys):
    base = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", str(tmp_path / "run")]
    _refused(capsys, [*base, "--solid", "absent.stl"], "absent.stl", "no such file")
    (tmp_path / "part.stl").write_text(_solid(_tetrahedron()))
    part = ["--solid", str(tmp_path / "part.stl")]
    _refused(capsys, [*base, *part, "--unit", "furlong"], "furlong", "m, cm, mm, um, inch")
    _refused(capsys, [*base, *part, "--pitch", "0.3mm"], "--pitch", "--solid")
    assert not (tmp_path / "run").exists()


def test_a_poisson_ratio_of_one_half_in_an_own_alloy_is_refused(tmp_path, capsys):
    folder = Path(perilife_data.__file__).parent / "alloys"
    text = (folder / "mg-5gd.toml").read_text()
    changed, count = re.subn(r"(\[poisson_ratio\]\s*\nvalue = )\S+", r"\g<1>0.5", text)
    assert count == 1
    own = tmp_path / "own.toml"
    own.write_text(changed)
    out = tmp_path / "run"
    arguments = ["run", "--alloy", str(own), "--immersion", "8w", "--out", str(out), *PIN]
    _refused(capsys, arguments, "poisson_ratio is 0.5", "below 0.5")
    assert not out.exists()


def test_the_spacing_that_a_refusal_offers_will_do_and_auto_takes_it(capsys):
    for pitch, offered in (("0.4mm", "100um"), ("0.31mm", "77.5um"), ("0.2222mm", "55.5um")):
        screw = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--pitch", pitch]
        message = _refused(capsys, ["plan", *screw, "--spacing", "120um"], "--spacing auto")
        assert f"(--spacing {offered}, or" in message
        fitted, _ = with_fitting_spacing(_scene([*screw, "--spacing", "auto"]))
        assert fitted.hash() == _scene([*screw, "--spacing", offered]).hash()
    # the preset's will do
    assert with_fitting_spacing(_scene([*SCENE, "--spacing", "auto"]))[0] == _scene(SCENE)


def test_auto_looks_for_the_smallest_feature_of_a_solid_from_a_file(tmp_path, capsys):
    path = tmp_path / "part.stl"
    path.write_text(_solid(_tetrahedron()))
    scene = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--solid", str(path), "--spacing", "auto"]
    found, solid = with_fitting_spacing(_scene(scene))
    assert solid.smallest_feature > 0.2e-3 and found.lattice.spacing == 100e-6
    small = [*scene, "--unit", "um"]
    _refused(capsys, ["plan", *small], "smallest feature", "at most 8 of them (--horizon")


def test_more_memory_than_there_is_is_refused_before_starting(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 100_000_000)
    out = tmp_path / "run"
    _refused(capsys, ["run", *SCENE, "--out", str(out)], "memory", "100.0 MB are available")
    assert not out.exists()


def test_a_scene_of_absurd_size_is_refused_by_this_machine(tmp_path, capsys):
    out = tmp_path / "run"
    huge = ["--spacing", "2um", "--horizon", "4um"]
    _refused(capsys, ["run", *_changed(*huge), "--out", str(out)], "memory", "available")
    assert not out.exists()


def test_what_fits_into_the_memory_is_offered_and_fits(capsys, monkeypatch):
    for available, arguments, option in (
        (1.2e9, SCENE, "--pulls"),  # two pulls at a time take more, one takes less
        (0.6e9, [*SCENE, "--pulls", "1"], "--mesh-size"),
        (2.0e9, [*SCENE, "--spacing", "14um", "--horizon", "112um"], "--spacing"),
    ):
        monkeypatch.setattr(machine, "available_memory", lambda most=available: most)
        monkeypatch.setattr(machine, "processor_cores", lambda: 2)
        scene = _scene([a for a in arguments if a not in ("--pulls", "1")])
        solid = build_solid(scene)
        pulls = 1 if "--pulls" in arguments else None
        with pytest.raises(MemoryError, match="choose (--.*)$") as refusal:
            readiness.check_machine(scene, solid, Path.cwd(), workers=pulls, stages=STAGES)
        offered = re.search(r"choose (.*?)(?:, or.*)?$", str(refusal.value))[1].split()
        assert offered[0] == option
        if option == "--pulls":
            pulls, offered = int(offered[1]), []
        there = [a for a in arguments if a not in ("--pulls", "1")]
        scene = _scene([*there, *offered])
        readiness.check_machine(scene, solid, Path.cwd(), workers=pulls, stages=STAGES)


def test_dolfinx_that_cannot_be_imported_is_found_before_the_first_stage(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "dolfinx.py").write_text("raise ImportError('libdolfinx.so is another')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    out = tmp_path / "run"
    words = ["libdolfinx.so is another", "python3-dolfinx-real", "perilife map"]
    _refused(capsys, ["run", *SCENE, "--out", str(out)], *words)
    assert not out.exists()
    assert main(["plan", *SCENE, "--json"]) == 0
    checks = {c["what"]: c for c in json.loads(capsys.readouterr().out)["machine"]}
    assert "libdolfinx.so is another" in checks["dolfinx"]["problem"]
    assert checks["memory"]["problem"] == checks["disk"]["problem"] == ""


def test_an_mpirun_that_is_not_there_or_of_another_mpi_is_found_before_the_first_stage(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("dolfinx")
    monkeypatch.setattr(machine, "processor_cores", lambda: 2)
    out = tmp_path / "run"
    run = ["run", *SCENE, "--np", "2", "--out", str(out)]
    path = os.environ["PATH"]
    monkeypatch.setenv("PATH", str(tmp_path))
    _refused(capsys, run, "mpirun was not found", "--np 2")
    other = tmp_path / "mpirun"  # starts two processes, as one of another MPI does
    other.write_text('#!/bin/sh\nshift 2\n"$@" && "$@"\n')
    other.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{path}")
    _refused(capsys, run, "2 processes that do not know of one another")
    assert not out.exists()


def test_too_little_disk_is_refused_before_starting(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(machine, "free_disk", lambda folder: 1000)
    out = tmp_path / "run"
    _refused(capsys, ["run", *SCENE, "--out", str(out)], "disk", "1.0 kB are free")
    assert not out.exists()


def test_a_place_that_cannot_be_written_is_refused(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("mine")
    _refused(capsys, ["run", *SCENE, "--out", str(blocked)], "is a file")
    _refused(capsys, ["run", *SCENE, "--out", str(blocked / "run")], "is a file")
    assert blocked.read_text() == "mine"
    _refused(capsys, ["run", *SCENE, "--out", "/proc/perilife/run"], "/proc")


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path, capsys):
    (tmp_path / "letter.txt").write_text("dear")
    run = ["run", *SCENE, "--out", str(tmp_path)]
    for more in ([], ["--resume"]):
        told = _refused(capsys, [*run, *more], "not empty", "no scene.json", "another --out")
        assert "--resume" not in told
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def _scene(arguments: list[str]):
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    return scene_from_options(parser.parse_args(arguments))


def test_a_run_folder_of_another_scene_is_refused_and_untouched(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(_scene(SCENE), out, resume=False) as (folder, solid):
        assert solid is not None
        before = folder.scene_file.read_text()
    assert sorted(p.name for p in out.iterdir()) == ["scene.json"]
    _refused(capsys, ["run", *SCENE, "--out", str(out)], "not empty", "--resume")
    other = ["run", *_changed("--rate-change", "0.3"), "--out", str(out), "--resume"]
    quick = RESOLUTIONS["quick"].rate_change
    words = f"corrosion.rate_change is {quick:g} there and 0.3 here"
    _refused(capsys, other, "another scene", words)
    assert folder.scene_file.read_text() == before


def test_the_same_scene_is_reopened_with_resume(tmp_path):
    for _ in range(2):
        with open_run(_scene(SCENE), tmp_path / "run", resume=True) as (folder, _):
            assert (folder.path / ".lock").exists()
    assert not (folder.path / ".lock").exists()


def test_a_run_folder_in_use_is_refused(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(_scene(SCENE), out, resume=False) as (folder, _):
        refusal = ["run", *SCENE, "--out", str(out), "--resume"]
        _refused(capsys, refusal, "in use by process")
        _refused(capsys, ["corrode", "--out", str(out)], "in use by process")
        assert folder.scene_file.exists()


def test_a_refusal_during_the_first_stage_takes_the_new_folder_away(tmp_path):
    out = tmp_path / "deep" / "run"
    with pytest.raises(ValueError, match="no mesh"), open_run(_scene(SCENE), out, False):
        assert (out / "scene.json").exists()
        raise ValueError("no mesh")
    assert not (tmp_path / "deep").exists()


def test_a_refusal_after_a_finished_stage_keeps_the_folder(tmp_path):
    out = tmp_path / "run"
    with pytest.raises(ValueError), open_run(_scene(SCENE), out, False) as (folder, _):
        folder.geometry.mkdir()
        (folder.geometry / "geometry.stage.json").write_text("{}")
        raise ValueError("later")
    assert (out / "scene.json").exists()


def test_stage_commands_refuse_what_is_no_run_folder(tmp_path, capsys):
    for stage in ("corrode", "map", "pull", "report"):
        _refused(capsys, [stage, "--out", str(tmp_path / "absent")], "does not exist")
        _refused(capsys, [stage, "--out", str(tmp_path)], "no scene.json")
    assert list(tmp_path.iterdir()) == []


def test_stage_commands_ask_for_the_stage_before_them(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(_scene(SCENE), out, resume=False):
        pass
    _refused(capsys, ["corrode", "--out", str(out)], "`perilife geometry`")
    _refused(capsys, ["corrode", "--out", str(out), "--alloy", "Mg-10Gd"], "Mg-10Gd", "has Mg-5Gd")
    _refused(capsys, ["map", "--out", str(out), "--immersion", "4w"], "4w", "has 0w, 8w")


def test_a_scene_file_that_is_damaged_is_named(tmp_path, capsys):
    folder = RunFolder(tmp_path)
    folder.scene_file.write_text("{")
    _refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "not JSON")
    folder.scene_file.write_text("[" * 100_000)
    _refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "nested too deeply")
    folder.scene_file.write_bytes(b"\xff\xfe")
    _refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "not JSON")
    folder.scene_file.write_text(json.dumps({"schema_version": 99}))
    _refused(capsys, ["corrode", "--out", str(tmp_path)], "schema version", "99")


def test_commands_that_are_not_there_are_refused(capsys):
    _refused(capsys, [], "no command")
    _refused(capsys, ["dance"], "dance")
    _refused(capsys, ["corode"], "corode", "did you mean corrode?")
    _refused(capsys, ["bench", "dance"], "dance", "quick-stages")
    _refused(capsys, ["bench", "quick"], "did you mean quick-stages?")
    _refused(capsys, ["study", "tensil", "--out", "x"], "did you mean tensile?")


def test_version_and_alloys_are_printed(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"perilife \S+\n", capsys.readouterr().out)
    assert main(["alloys"]) == 0
    printed = capsys.readouterr().out
    for name in ("Mg-5Gd", "Mg-10Gd", "table-5.1"):
        assert name in printed


def test_plan_tells_sizes_time_memory_and_omissions(capsys):
    assert main(["plan", *SCENE, "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    # cylinder of 2.755 mm x 4.8 mm: pin diameter 1.755 mm and the margins of Table 5.1's scene
    assert plan["nodes"] == pytest.approx(3.14159 / 4 * 2.755**2 * 4.8 * 1e3, rel=0.03)
    assert {task["stage"] for task in plan["tasks"]} == {"geometry", "corrode", "map", "pull"}
    assert plan["seconds"] == pytest.approx(sum(task["seconds"] for task in plan["tasks"]))
    assert all(task["memory"] > 0 for task in plan["tasks"])
    assert plan["omissions"] and all(item["reason"] for item in plan["omissions"])
    assert main(["plan", *SCENE]) == 0
    assert "What is left out" in capsys.readouterr().out


def test_plan_knows_the_size_of_the_mesh_of_the_screw(capsys):
    edges = ["--mesh-size", "0.3mm", "--mesh-size-fine", "0.2mm"]
    assert main(["plan", *SCENE[:-2], *edges, "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    cells = coarse_mesh().cells
    sides = np.sort(cells[:, list(itertools.combinations(range(4), 2))].reshape(-1, 2), axis=1)
    nodes = len(np.unique(cells)) + len(np.unique(sides, axis=0))
    assert plan["unknowns"] == pytest.approx(3 * nodes, rel=0.1)  # measured 1.2 %


def test_plan_names_what_can_be_kept_as_keep_wants_it(capsys):
    scene = [*SCENE, *COARSE, "--spacing", "200um", "--horizon", "400um"]
    assert main(["plan", *scene, "--json"]) == 0
    named = [item["what"] for item in json.loads(capsys.readouterr().out)["omissions"]]
    of_march = [what.removeprefix("Mg-5Gd: ") for what in named if what.startswith("Mg-5Gd: ")]
    offered = [what for what in of_march if "not offered" not in what]
    assert sorted(offered) == sorted(OMITTABLE) and len(of_march) == len(offered) + 2
    assert main(["plan", *scene, "--keep", *offered, "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["omissions"]
    assert all(item["error"].startswith("kept") for item in left if item["what"][8:] in offered)


def test_help_lists_the_numbers_of_every_law_of_the_rate():
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    told = " ".join(parser.format_help().split())
    for numbers in KINETICS.values():
        assert ", ".join(numbers) in told


def test_the_law_of_a_bond_is_a_choice(tmp_path, capsys):
    """Faraday's law dissolves more: its bonds keep their flux while a node empties."""
    lost = {}
    for law in DISSOLUTION_LAWS:
        out = str(tmp_path / law)
        scene = [*SCENE, "--spacing", "200um", "--horizon", "400um", "--dissolution", law]
        scene += ["--radial-margin", "1mm", "--axial-margin", "1mm"]
        assert main(["geometry", *scene, "--out", out, "--quiet"]) == 0
        assert main(["corrode", "--out", out, "--quiet"]) == 0
        folder = RunFolder(Path(out))
        record = folder.read_record(folder.corrosion("Mg-5Gd"), "corrode")
        lost[law] = record.numbers["volume_loss"][-1]
        capsys.readouterr()
        assert main(["plan", *scene, "--json"]) == 0
        named = [item["what"] for item in json.loads(capsys.readouterr().out)["omissions"]]
        assert ("the published law of a bond" in named) == (law == "faradaic")
        stored = scene_from_json(json.loads(folder.scene_file.read_text()))
        rows = provenance.to_be_listed(provenance.parameter_rows(stored))
        assert any(row.value == "faradaic" for row in rows) == (law == "faradaic")
    # measured 15.05 % against 13.54 %, 1.111 times
    assert 1.08 < lost["faradaic"] / lost["proportional"] < 1.14


@pytest.mark.parametrize(
    "law, factors",
    [
        (None, (1.0, 10 ** (-0.1 / 0.2355))),  # l of Table 5.1 for Mg-5Gd
        ("constant", (1.0, 1.0)),
        ("volume_loss:length=0.1", (1.0, 0.1)),
        ("tafel:overpotential=0.02,slope=0.1", (10**0.2, 10**0.2)),
    ],
)
def test_the_law_of_the_rate_is_a_choice(capsys, law, factors):
    changes = [] if law is None else ["--kinetics", law]
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    scene = scene_from_options(parser.parse_args(_changed(*changes)))
    found = corrosion_stage.rate_law(scene_from_json(scene.to_json()), "Mg-5Gd")
    assert [found.rate(Exposed(v)) for v in (0.0, 0.1)] == pytest.approx(factors, rel=1e-12)
    rows = provenance.to_be_listed(provenance.parameter_rows(scene))
    assert any(row.value == law for row in rows) == (law is not None)
    assert main(["plan", *_changed(*changes), "--json"]) == 0
    named = [item["what"] for item in json.loads(capsys.readouterr().out)["omissions"]]
    assert ("the published kinetics" in named) == (law is not None)


def test_studies_are_listed_and_refused_in_one_sentence(tmp_path, capsys):
    assert main(["study", "list"]) == 0
    assert "rates" in capsys.readouterr().out
    _refused(
        capsys, ["study", "tensile-weather"], "tensile-weather", "corrosion, rates, saturation"
    )
    _refused(capsys, ["study", "corrosion"], "--out")
    out = tmp_path / "studies"
    _refused(capsys, ["study", "corrosion", "--alloy", "Mg-7Gd", "--out", str(out)], "Mg-7Gd")
    assert not out.exists()


def test_bench_prints_exactly_one_object(capsys, monkeypatch):
    fake = Benchmark("a test", lambda: [Result("speed", 2.0, "1/s", ">= 1")], list)
    monkeypatch.setitem(BENCHMARKS, "fake", fake)
    assert main(["bench", "fake", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == {"name", "small", "load", "machine", "results"}
    assert printed["results"] == [
        {"quantity": "speed", "value": 2.0, "unit": "1/s", "target": ">= 1"}
    ]
    assert main(["bench", "fake", "--small", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"] == []
    assert main(["bench", "list"]) == 0
    listed = capsys.readouterr().out
    assert "quick-stages" in listed and "fake" in listed


def test_errors_of_the_system_become_one_sentence():
    import errno

    full = OSError(errno.ENOSPC, "No space left on device", "/data/run")
    assert sentence(full) == "there is no space left to write '/data/run'."
    denied = PermissionError(errno.EACCES, "Permission denied", "/data/run")
    assert sentence(denied) == "there is no right to write or read '/data/run'."
    assert sentence(ValueError("two\nlines")) == "two lines."


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interruption_that_python_drops_is_not_lost():
    """The exception of a signal that arrives within a finaliser is printed and forgotten."""

    class Finalised:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)  # the handler runs here

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        interruption.listen()
        interruption.check()
        Finalised()
        with pytest.raises(KeyboardInterrupt):
            interruption.check()
        interruption.listen()
        interruption.check()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
