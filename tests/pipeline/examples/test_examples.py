"""The examples run as they are; those that take more than seconds are slow."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline import LifeCycle
from pipeline.cli import build_parser
from pipeline.report.provenance import parameter_rows, references
from pipeline.run import scene_of

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = ROOT / "pipeline" / "examples"
DATA = {"README.md", "measured.csv", "my-alloy.toml", "references.bib"}


def commands() -> dict[str, list[str]]:
    """How each example is run, from the table of their README, the file last."""
    rows = re.findall(
        r"^\| `([\w.]+)`.*\| `([^`]*)` \|$", (EXAMPLES / "README.md").read_text(), re.M
    )
    return {name: command.split() for name, command in rows}


@pytest.fixture
def place(tmp_path) -> tuple[Path, dict[str, str]]:
    """A folder to work in, and an environment whose `perilife` and `python` are these."""
    bins = tmp_path / "bin"
    bins.mkdir()
    for name, command in (("perilife", "-m pipeline.cli"), ("python", "")):
        path = bins / name
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}" {command} "$@"\n')
        path.chmod(0o755)
    paths = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}".rstrip(os.pathsep)
    search = f"{bins}{os.pathsep}{os.environ['PATH']}"
    return tmp_path, {**os.environ, "PYTHONPATH": paths, "PATH": search}


def run(name: str, place: tuple[Path, dict[str, str]]) -> str:
    """What an example prints."""
    folder, environment = place
    *command, last = commands()[name]
    assert last == name
    done = subprocess.run(
        [*command, str(EXAMPLES / name)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_file_is_told_of_and_says_what_it_costs() -> None:
    there = {path.name for path in EXAMPLES.iterdir() if path.is_file()}
    assert set(commands()) == there - DATA
    for name in commands():
        assert "Cost: " in (EXAMPLES / name).read_text()


def test_the_scene_file_is_one() -> None:
    options = build_parser().parse_args(["run", str(EXAMPLES / "scene.toml")])
    scene = scene_of(options)
    assert [hold.name for hold in scene.holds] == ["slot"] and options.out == "runs/slotted-end"
    assert scene.geometry.parameters.length == 5e-3 and len(scene.alloys) == 2


def test_the_alloy_of_ones_own_can_be_corroded() -> None:
    scene = LifeCycle(EXAMPLES / "my-alloy.toml", "4w").scene
    (alloy,) = scene.alloys
    assert alloy.name == "Mg-example" and alloy.corrosion.interface_diffusivity == 2e-15
    named = references(parameter_rows(scene), scene)  # its own sources, too
    assert named["examplelab2026"] == "Nobody (2026). Numbers made up for an example."


@pytest.mark.slow
def test_an_alloy_of_ones_own(place) -> None:
    printed = run("own_alloy.py", place)
    assert (
        "Mg-example" in printed
        and "examplelab2026: Nobody (2026). Numbers made up for an example.\n" in printed
    )
    assert 0.5 < float(re.search(r"^0\.\d+$", printed, re.M)[0]) < 1.0


@pytest.mark.slow
def test_three_lines_and_export(place) -> None:
    printed = run("three_lines.py", place)
    assert "84 % of the strength, 373 N, are left" in printed
    assert (place[0] / "three_lines.png").stat().st_size > 10_000
    printed = run("export.py", place)
    assert "tetrahedra" in printed
    (deck,) = (place[0] / "runs").rglob("*.inp")
    assert deck.read_text().startswith("*") and str(deck.relative_to(place[0])) in printed


@pytest.mark.slow
def test_the_scene_file_runs_and_runs_again(place) -> None:
    assert "report: runs/slotted-end/report.html" in run("scene.toml", place)
    table = (place[0] / "runs/slotted-end/summary.csv").read_bytes()
    assert table.count(b"\n") == 5
    run("scene.toml", place)
    assert (place[0] / "runs/slotted-end/summary.csv").read_bytes() == table


@pytest.mark.slow
def test_measurements_become_bands(place) -> None:
    printed = run("calibrate.sh", place)
    assert "of the samples of the constants" in printed
    assert (place[0] / "runs/bands/bands.csv").is_file()


@pytest.mark.slow
def test_the_two_packages_by_themselves_print_what_the_readme_says(capsys) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    _, *blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    code = "".join(blocks)
    loss, force, status = re.search(r"# 20 seconds: ([\d.]+), (\d+) N, (\w+)", code).groups()
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out.split()
    assert float(printed[0].strip("[]")) == pytest.approx(float(loss), abs=1e-4)
    assert float(printed[1]) == pytest.approx(float(force), abs=0.5)
    assert printed[2] == status
