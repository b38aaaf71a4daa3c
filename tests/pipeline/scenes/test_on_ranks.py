"""Scenes of localised corrosion on MPI ranks: the digits of one process, refusals, kills."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.cli import main
from pipeline.record.machine import child_environment
from pipeline.scenes.registry import path_of
from tests.pipeline.command_line import refused
from tests.pipeline.processes import survivors
from tests.pipeline.scenes.test_implants import SCENE as IMPLANT
from tests.pipeline.scenes.test_implants import step_files
from tests.pipeline.scenes.test_scene_files import IONS, OWN
from tests.ranks import needs_mpirun

slow = pytest.mark.slow

OPEN = ("left open",)
"""Rows of a summary that are round-off."""


def summary_of(folder: Path) -> dict[str, tuple[str, str]]:
    with (folder / "summary.csv").open(newline="", encoding="utf-8") as table:
        return {row["quantity"]: (row["value"], row["unit"]) for row in csv.DictReader(table)}


def printed(folder: Path) -> dict[str, str]:
    """A summary as it is printed, to six digits; what is round-off is below 1e-12 and left out."""
    found = {}
    for name, (value, unit) in summary_of(folder).items():
        if any(word in name for word in OPEN):
            assert abs(float(value)) < 1e-10, name
        else:
            found[name] = f"{float(value):.6g} {unit}"
    return found


SCENES = {
    "own": ["run", "{own}"],
    "mask": ["scenes", "pit-304", "--spacing", "10um", "--times", "0s", "20s"],
    "film": ["scenes", "pit-lacy", "--spacing", "5um", "--times", "0s", "2s"],
    "grains": ["scenes", "intergranular", "--spacing", "4um", "--times", "0s", "10min"],
    "pencil": ["scenes", "pit-pencil", "--spacing", "10um", "--times", "0s", "200s"],
    "ae44": ["scenes", "galvanic-ae44-steel", "--spacing", "0.5mm", "--times", "0s", "1d"],
    "slab": ["scenes", "galvanic-slab", "--spacing", "2mm", "--times", "0s", "10d"],
    "implant": ["run", "{implant}"],
}
"""Each kind of scene, small."""


@needs_mpirun
@pytest.mark.parametrize(
    ("name", "ranks"),
    [("own", 2), *(pytest.param(name, n, marks=slow) for name in SCENES for n in (2, 4))],
)
def test_a_scene_on_ranks_has_the_digits_of_one_process(name, ranks, tmp_path, capsys):
    own, implant = tmp_path / "own.toml", tmp_path / "implant.toml"
    own.write_text(OWN + IONS)
    if name == "implant":
        step_files(tmp_path, 1.0)
        implant.write_text(IMPLANT.format(folder=tmp_path))
    command = [word.format(own=own, implant=implant) for word in SCENES[name]] + ["--quiet"]
    one, many = tmp_path / "one", tmp_path / "many"
    assert main([*command, "--out", str(one)]) == 0
    capsys.readouterr()
    ranked = ["--ranks", str(ranks), "--oversubscribe", "--out", str(many)]
    assert main([*command, *ranked]) == 0
    assert "plot.png" in capsys.readouterr().out
    assert printed(many) == printed(one) and len(printed(one)) >= 3
    assert sorted(p.name for p in many.iterdir()) == sorted(p.name for p in one.iterdir())
    records = [json.loads((folder / "scene.stage.json").read_text()) for folder in (one, many)]
    assert records[0]["inputs"] == records[1]["inputs"]  # with or without ranks, the same run
    assert main([*command, "--resume", "--out", str(many)]) == 0


def test_what_ranks_cannot_share_is_refused(tmp_path, capsys):
    run = ["--quiet", "--oversubscribe", "--out", str(tmp_path / "run"), "--ranks", "2"]
    crevice = ["scenes", "crevice-625", *run]
    refused(capsys, crevice, "--ranks is 2 for scene 'crevice-625'; it must be 1", "film equation")
    own = tmp_path / "own.toml"
    own.write_text(OWN + '[potential]\nrobin = "as_published"\n')
    refused(capsys, ["run", str(own), *run], "it must be 1: mirror nodes")
    refused(capsys, [*crevice[:-1], "0"], "--ranks is 0; it must be 1 to 4096")
    few = [word for word in crevice[:-1] if word != "--oversubscribe"]
    refused(capsys, [*few, "999"], "--ranks is 999 and this process may use")
    assert not (tmp_path / "run").exists()


def test_a_plan_says_what_each_rank_takes(tmp_path, capsys):
    own = tmp_path / "own.toml"
    own.write_text(OWN)  # 24 x 12 nodes
    plan = ["plan", str(own), "--oversubscribe", "--ranks"]
    assert main([*plan, "1"]) == 0
    assert "memory: about 400.3 MB\n" in capsys.readouterr().out
    assert main([*plan, "4"]) == 0
    said = capsys.readouterr().out
    assert "4 ranks: 400.1 MB the first, 400.1 MB each other" in said
    assert "the time on ranks is not measured" in said
    assert main([*plan, "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["seconds"] is None and told["memory"]["ranks"] == 2
    share, whole = told["memory"]["other"] - 400e6, 1000.0 * 24 * 12
    assert 0.5 * whole < share < 0.8 * whole < told["memory"]["first"] - 400e6 < whole
    refused(capsys, ["plan", str(path_of("crevice-625")), *plan[2:], "2"], "it must be 1")


@needs_mpirun
@slow
def test_blocks_narrower_than_the_reach_are_refused_in_a_sentence(tmp_path, capsys):
    narrow = ["scenes", "galvanic-slab", "--spacing", "8mm", "--times", "0s", "1d", "--quiet"]
    narrow += ["--ranks", "16", "--oversubscribe", "--out", str(tmp_path / "run")]
    refused(capsys, narrow, "ranks: 16 for a lattice of 18 nodes", "so use fewer")


@needs_mpirun
@slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_an_interrupted_scene_leaves_nothing_running_and_is_resumed(number, code, tmp_path):
    """After the first checkpoint; resumed in one process, to the same digits."""
    text = path_of("pit-304").read_text(encoding="utf-8").replace('"5um"', '"10um"', 1)
    scene, out = tmp_path / "pit.toml", tmp_path / "run"
    text = text.replace('step = { value = "1s"', 'step = { value = "0.25s"')  # beyond 30 s in all
    scene.write_text(text.replace('"600s"]', '"400s"]'))
    mark = f"perilife-test-{os.getpid()}-{number}"
    environment = {**child_environment(0, 1), "PERILIFE_TEST_MARK": mark}
    command = [sys.executable, "-m", "pipeline.cli", "run", str(scene), "--out", str(out)]
    ranked = [*command, "--ranks", "2", "--oversubscribe"]
    with subprocess.Popen(ranked, env=environment, stderr=subprocess.PIPE, text=True) as process:
        while not (out / "march.h5").exists():
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(number)
        said = process.communicate()[1]
        assert process.returncode == code
    if code > 0:
        assert "the same command with --resume goes on from there" in said
    end = time.monotonic() + 30.0
    while left := survivors(mark):
        assert time.monotonic() < end, f"still there: {left}"
        time.sleep(0.1)
    assert (out / "march.h5").exists() and not (out / "summary.csv").exists()
    done = subprocess.run([*command, "--resume"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert main(["run", str(scene), "--out", str(tmp_path / "whole"), "--quiet"]) == 0
    assert printed(out) == printed(tmp_path / "whole")
    kept = {p.name for p in (tmp_path / "whole").iterdir()}
    # of a process that was killed its notes stay
    notes = {"march.log", "march-job.json", "march.progress"}
    assert {p.name for p in out.iterdir()} - kept <= notes
