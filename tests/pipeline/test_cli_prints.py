"""What the command line prints: plans, help, choices, studies, benches; and interruptions."""

import argparse
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from peri.corrosion.kinetics import Exposed
from pipeline.benches.registry import BENCHMARKS, Benchmark, Result
from pipeline.cli import main, sentence
from pipeline.record import interruption
from pipeline.record.run_folder import RunFolder
from pipeline.report import provenance
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.laws.rate_law import KINETICS
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.scene import DISSOLUTION_LAWS, OMITTABLE, scene_from_json
from pipeline.stages import corrosion as corrosion_stage
from tests.pipeline.command_line import COARSE, SCENE, changed, refused
from tests.pipeline.geometry.solids import coarse_mesh

FEW = [*COARSE, "--spacing", "200um", "--horizon", "400um"]
"""A lattice of few nodes that the slot allows."""


def test_version_and_alloys_are_printed(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"perilife \S+\n", capsys.readouterr().out)
    assert main(["alloys"]) == 0
    printed = capsys.readouterr().out
    for name in ("Mg-5Gd", "Mg-10Gd", "table-5.1"):
        assert name in printed


def test_alloys_are_one_object_with_units_and_sources(capsys):
    assert main(["alloys", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == {"alloys", "parameter_sets", "hardening", "experiments"}
    stiff = told["alloys"]["Mg-5Gd"]["quantities"]["young_modulus"]
    assert (stiff["value"], stiff["unit"], stiff["source"]) == (43.0, "GPa", "hermann2024")
    assert "interface_diffusivity" in told["parameter_sets"]["table-5.1"]["alloys"]["Mg-10Gd"]


def test_output_that_nobody_reads_is_no_error():
    read, write = os.pipe()
    os.close(read)
    try:
        command = [sys.executable, "-m", "pipeline.cli", "alloys", "--json"]
        done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_plan_tells_sizes_time_memory_and_omissions(capsys):
    assert main(["plan", *SCENE, "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    # cylinder of 2.755 mm x 4.8 mm: pin diameter 1.755 mm and the margins of Table 5.1's scene
    cells = 3.14159 / 4 * 2.755**2 * 4.8e-9 / RESOLUTIONS["quick"].spacing ** 3
    assert plan["nodes"] == pytest.approx(cells, rel=0.03)
    stages = ["geometry", "corrode", "map", "pull", "report"]
    assert list(dict.fromkeys(task["stage"] for task in plan["tasks"])) == stages
    # the surface once, then each alloy
    surface, *marches = [task for task in plan["tasks"] if task["stage"] == "corrode"]
    assert surface["what"] == "surface" and "3 rate classes" in surface["size"]
    assert [task["what"] for task in marches] == ["Mg-5Gd"]
    # tests of the intact solid may run beside the march, and save at most what they take
    seconds = {
        stage: sum(t["seconds"] for t in plan["tasks"] if t["stage"] == stage) for stage in stages
    }
    whole = sum(seconds.values())
    assert whole - seconds["pull"] < plan["seconds"] <= whole * (1 + 1e-12)
    assert main(["plan", *SCENE, "--pulls", "1", "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert alone["seconds"] == pytest.approx(sum(task["seconds"] for task in alone["tasks"]))
    assert all(task["memory"] > 0 for task in plan["tasks"])
    assert plan["omissions"] and all(item["reason"] for item in plan["omissions"])
    assert main(["plan", *SCENE, *FEW]) == 0
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
    scene = [*SCENE, *FEW]
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
        scene = [*SCENE, *FEW, "--dissolution", law]
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
    scene = scene_from_options(parser.parse_args(changed(*changes)))
    found = corrosion_stage.rate_law(scene_from_json(scene.to_json()), "Mg-5Gd")
    assert [found.rate(Exposed(v)) for v in (0.0, 0.1)] == pytest.approx(factors, rel=1e-12)
    rows = provenance.to_be_listed(provenance.parameter_rows(scene))
    assert any(row.value == law for row in rows) == (law is not None)
    assert main(["plan", *changed(*FEW, *changes), "--json"]) == 0
    named = [item["what"] for item in json.loads(capsys.readouterr().out)["omissions"]]
    assert ("the published kinetics" in named) == (law is not None)


def test_what_the_ions_use_and_is_assumed_is_listed(capsys):
    def listed(*options):
        assert main(["plan", *changed(*FEW, "--model", "nnpp", *options), "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["assumed"]
        return {row["name"]: row for row in rows if row["section"] == "Ions"}

    rows = listed()
    ion = rows["Diffusivity of MgHCO3 at 37 °C"]
    assert (ion["value"], ion["unit"], ion["kind"]) == ("6.12e-10", "m^2/s", "assumed")
    assert ion["source"] == "parkhurst2013" and "1.28 times" in ion["remark"]
    assert rows["Nucleation index of calcite"]["value"] == "1.5"
    assert not [name for name in rows if "25 °C" in name or "bobierrite" in name]
    assert "Temperature" not in rows  # of this medium it is published
    assert "Nucleation index of calcite" not in listed("--minerals", "brucite")
    rows = listed(
        "--medium", "sodium-chloride-142", "--balance", "Cl", "--feedback", "ph_order=0.3"
    )
    assert rows["Temperature"]["value"] == "37" and rows["Feedback"]["value"].startswith("pH to")
    assert "Total concentration of Na" in rows
    rows = listed("--medium", "simulated-body-fluid-tris")  # 36.5 °C, between two temperatures
    assert {f"Diffusivity of Tris at {t} °C" for t in (25, 37)} < set(rows)
    assert "Diffusivity of K at 25 °C" not in rows  # a published one


def test_studies_are_listed_and_refused_in_one_sentence(tmp_path, capsys):
    assert main(["study", "list"]) == 0
    assert "rates" in capsys.readouterr().out
    refused(capsys, ["study", "tensile-weather"], "tensile-weather", "rates, saturation")
    refused(capsys, ["study", "corrosion"], "--out")
    out = tmp_path / "studies"
    refused(capsys, ["study", "corrosion", "--alloy", "Mg-7Gd", "--out", str(out)], "Mg-7Gd")
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


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_knows_commands_and_options(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for name in ("calibrate", "campaign", "--immersion", "--hold"):
        assert name in script
    assert main(["completion", "fish"]) == 2
    assert "invalid choice: 'fish'" in capsys.readouterr().err
