"""The command line, the machine and the run folder: what is found before the first stage."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.cli import main
from pipeline.planning import readiness
from pipeline.planning.opening import difference, open_run
from pipeline.record import machine
from pipeline.record.run_folder import RunFolder
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.stages.geometry import build_solid
from tests.pipeline.command_line import SCENE, STAGES, changed, refused, scene_of


def test_more_memory_than_there_is_is_refused_before_starting(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(machine, "available_memory", lambda: 100_000_000)
    out = tmp_path / "run"
    refused(capsys, ["run", *SCENE, "--out", str(out)], "memory", "100.0 MB are available")
    assert not out.exists()


def test_a_scene_of_absurd_size_is_refused_by_this_machine(tmp_path, capsys):
    out = tmp_path / "run"
    huge = ["--spacing", "2um", "--horizon", "4um"]
    refused(capsys, ["run", *changed(*huge), "--out", str(out)], "memory", "available")
    assert not out.exists()


def test_what_fits_into_the_memory_is_offered_and_fits(capsys, monkeypatch):
    for available, arguments, option in (
        (1.2e9, SCENE, "--pulls"),  # two pulls at a time take more, one takes less
        (0.6e9, [*SCENE, "--pulls", "1"], "--mesh-size"),
        (2.0e9, [*SCENE, "--spacing", "14um", "--horizon", "112um"], "--spacing"),
    ):
        monkeypatch.setattr(machine, "available_memory", lambda most=available: most)
        monkeypatch.setattr(machine, "processor_cores", lambda: 2)
        scene = scene_of([a for a in arguments if a not in ("--pulls", "1")])
        solid = build_solid(scene)
        pulls = 1 if "--pulls" in arguments else None
        with pytest.raises(MemoryError, match="choose (--.*)$") as refusal:
            readiness.check_machine(scene, solid, Path.cwd(), workers=pulls, stages=STAGES)
        offered = re.search(r"choose (.*?)(?:, or.*)?$", str(refusal.value))[1].split()
        assert offered[0] == option
        if option == "--pulls":
            pulls, offered = int(offered[1]), []
        there = [a for a in arguments if a not in ("--pulls", "1")]
        scene = scene_of([*there, *offered])
        readiness.check_machine(scene, solid, Path.cwd(), workers=pulls, stages=STAGES)


def test_dolfinx_that_cannot_be_imported_is_found_before_the_first_stage(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "dolfinx.py").write_text("raise ImportError('libdolfinx.so is another')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    out = tmp_path / "run"
    words = ["libdolfinx.so is another", "python3-dolfinx-real", "perilife map"]
    refused(capsys, ["run", *SCENE, "--out", str(out)], *words)
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
    refused(capsys, run, "mpirun was not found", "--np 2")
    other = tmp_path / "mpirun"  # starts two processes, as one of another MPI does
    other.write_text('#!/bin/sh\nshift 2\n"$@" && "$@"\n')
    other.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{path}")
    refused(capsys, run, "2 processes that do not know of one another")
    assert not out.exists()


def test_too_little_disk_is_refused_before_starting(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(machine, "free_disk", lambda folder: 1000)
    out = tmp_path / "run"
    refused(capsys, ["run", *SCENE, "--out", str(out)], "disk", "1.0 kB are free")
    assert not out.exists()


def test_a_place_that_cannot_be_written_is_refused(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("mine")
    refused(capsys, ["run", *SCENE, "--out", str(blocked)], "is a file")
    refused(capsys, ["run", *SCENE, "--out", str(blocked / "run")], "is a file")
    assert blocked.read_text() == "mine"
    refused(capsys, ["run", *SCENE, "--out", "/proc/perilife/run"], "/proc")


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path, capsys):
    (tmp_path / "letter.txt").write_text("dear")
    run = ["run", *SCENE, "--out", str(tmp_path)]
    for more in ([], ["--resume"]):
        told = refused(capsys, [*run, *more], "not empty", "no scene.json", "another --out")
        assert "--resume" not in told
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_a_run_folder_of_another_scene_is_refused_and_untouched(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(scene_of(SCENE), out, resume=False) as (folder, solid):
        assert solid is not None
        before = folder.scene_file.read_text()
    assert sorted(p.name for p in out.iterdir()) == ["scene.json"]
    refused(capsys, ["run", *SCENE, "--out", str(out)], "not empty", "--resume")
    other = ["run", *changed("--rate-change", "0.3"), "--out", str(out), "--resume"]
    quick = RESOLUTIONS["quick"].rate_change
    words = f"corrosion.rate_change is {quick:g} there and 0.3 here"
    refused(capsys, other, "another scene", words)
    assert folder.scene_file.read_text() == before
    asked = scene_of(SCENE)
    (alloy,) = asked.alloys
    material = replace(alloy.material, q1=1.5 * (1 + 1e-15))
    near = replace(asked, alloys=(replace(alloy, material=material),))
    later = replace(near, immersion=scene_of(changed("--immersion", "12w")).immersion)
    assert difference(asked, later).startswith("immersion is 0w 8w there and 12w here; 2 fields")


def test_the_same_scene_is_reopened_with_resume(tmp_path):
    for _ in range(2):
        with open_run(scene_of(SCENE), tmp_path / "run", resume=True) as (folder, _):
            assert (folder.path / ".lock").exists()
    assert not (folder.path / ".lock").exists()


def test_a_run_folder_in_use_is_refused(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(scene_of(SCENE), out, resume=False) as (folder, _):
        refusal = ["run", *SCENE, "--out", str(out), "--resume"]
        refused(capsys, refusal, "in use by process")
        refused(capsys, ["corrode", "--out", str(out)], "in use by process")
        assert folder.scene_file.exists()


def test_a_refusal_during_the_first_stage_takes_the_new_folder_away(tmp_path):
    out = tmp_path / "deep" / "run"
    with pytest.raises(ValueError, match="no mesh"), open_run(scene_of(SCENE), out, False):
        assert (out / "scene.json").exists()
        raise ValueError("no mesh")
    assert not (tmp_path / "deep").exists()


def test_a_refusal_after_a_finished_stage_keeps_the_folder(tmp_path):
    out = tmp_path / "run"
    with pytest.raises(ValueError), open_run(scene_of(SCENE), out, False) as (folder, _):
        folder.geometry.mkdir()
        (folder.geometry / "geometry.stage.json").write_text("{}")
        raise ValueError("later")
    assert (out / "scene.json").exists()


def test_stage_commands_refuse_what_is_no_run_folder(tmp_path, capsys):
    for stage in ("corrode", "map", "pull", "report"):
        refused(capsys, [stage, "--out", str(tmp_path / "absent")], "does not exist")
        refused(capsys, [stage, str(tmp_path / "absent"), "--quiet"], "does not exist")
        refused(capsys, [stage, "--out", str(tmp_path)], "no scene.json")
    assert list(tmp_path.iterdir()) == []


def test_stage_commands_ask_for_the_stage_before_them(tmp_path, capsys):
    out = tmp_path / "run"
    with open_run(scene_of(SCENE), out, resume=False):
        pass
    refused(capsys, ["corrode", "--out", str(out)], "`perilife geometry`")
    refused(capsys, ["corrode", "--out", str(out), "--alloy", "Mg-10Gd"], "Mg-10Gd", "has Mg-5Gd")
    refused(capsys, ["map", "--out", str(out), "--immersion", "4w"], "4w", "has 0w, 8w")
    alone = tmp_path / "alone"  # 0w is mapped and pulled though nobody asked the run for it
    with open_run(scene_of(changed("--immersion", "8w")), alone, resume=False):
        pass
    for stage in ("map", "pull"):
        intact = [stage, "--out", str(alone), "--immersion", "0w"]
        refused(capsys, intact, f"`perilife {'geometry' if stage == 'map' else 'map'}`")


def test_a_scene_file_that_is_damaged_is_named(tmp_path, capsys):
    folder = RunFolder(tmp_path)
    folder.scene_file.write_text("{")
    refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "not JSON")
    folder.scene_file.write_text("[" * 100_000)
    refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "nested too deeply")
    folder.scene_file.write_bytes(b"\xff\xfe")
    refused(capsys, ["corrode", "--out", str(tmp_path)], "scene.json", "not JSON")
    folder.scene_file.write_text(json.dumps({"schema_version": 99}))
    refused(capsys, ["corrode", "--out", str(tmp_path)], "schema version", "99")


def test_commands_that_are_not_there_are_refused(capsys):
    refused(capsys, [], "no command")
    refused(capsys, ["dance"], "dance")
    refused(capsys, ["corode"], "corode", "did you mean corrode?")
    refused(capsys, ["alloys", "--resume"], "unrecognized arguments: --resume (of another command)")
    refused(capsys, ["bench", "dance"], "dance", "quick-stages")
    refused(capsys, ["bench", "quick"], "did you mean quick-stages?")
    refused(capsys, ["study", "tensil", "--out", "x"], "did you mean tensile?")


def test_a_mistyped_option_is_named_before_whatever_else_is_wrong(capsys):
    missing = refused(capsys, ["run", "--imersion", "8w"], "--imersion (did you mean --immersion?)")
    assert "required" not in missing
    refused(capsys, ["--bogus", "run"], "unrecognized arguments: --bogus")
    refused(
        capsys, ["plan", "no-such.toml", "--bogus=3", "-x"], "unrecognized arguments: --bogus=3 -x"
    )
    refused(capsys, ["plan", "--to", "vtu"], "unrecognized arguments: --to (of another command)")
    refused(capsys, ["run", "--bending-azimuth", "-3deg"], "required: --alloy")
    refused(capsys, ["corrode", "--", "--bogus"], "required: --out")
