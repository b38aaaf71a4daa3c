"""The order of the stages, what is repeated and what is kept, and the table (stages are stood in
for; tests/end_to_end runs the real ones)."""

import contextlib
import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline import life_cycle
from pipeline.life_cycle import StagedRun
from pipeline.record.progress import LineProgress, Progress
from pipeline.record.run_folder import RunFolder, RunFolderError, StageRecord, write_text
from pipeline.record.stage_hashes import STAGE_REVISION
from pipeline.record.summary import read_summary
from pipeline.scene.scene import (
    AlloyScene,
    CorrosionParameters,
    CorrosionSettings,
    DomainSettings,
    HoldScene,
    LatticeSettings,
    MaterialParameters,
    MeshSettings,
    Scene,
    ScrewGeometry,
    TensileScene,
)
from pipeline.scene.units import parse_immersion_times

FINER = MeshSettings(0.2e-3, 0.1e-3)
MESH = MeshSettings(0.3e-3, 0.2e-3)
FORCES = {"0w": 400.0, "1w": 300.0, "8w": 0.0}


def _holds(*names: str, mesh: MeshSettings = MESH) -> tuple[HoldScene, ...]:
    faces = dataclasses.replace(mesh, size_bottom=5e-5, size_top=5e-5)
    return tuple(HoldScene(n, faces if n == "faces" else mesh, TensileScene()) for n in names)


def _scene(*labels: str, **changes) -> Scene:
    alloy = AlloyScene(
        name="Mg-A",
        corrosion=CorrosionParameters(66082.4, 0.6608, 8.6822e-9, 2.8779e-15, 0.2355),
        material=MaterialParameters(43e9, 0.3, 130e6, 120e6, 10.0),
    )
    fields = {
        "resolution": "quick",
        "parameter_set": "a test",
        "geometry": ScrewGeometry(),
        "immersion": parse_immersion_times(labels),
        "alloys": (alloy,),
        "lattice": LatticeSettings(100e-6, 200e-6),
        "domain": DomainSettings(),
        "corrosion": CorrosionSettings(),
        "holds": _holds("shank"),
    }
    return Scene(**{**fields, **changes})


@pytest.fixture
def calls(monkeypatch) -> list[str]:
    """Stand-ins for the stages that record that they were called and leave a file each."""
    made: list[str] = []

    def geometry(scene, folder, solid=None):
        made.append("geometry")
        write_text(folder / "mesh.h5", "mesh")
        return [folder / "mesh.h5"], {"cells": 1}

    def corrode(scene, alloy, geometry, out, advanced=None, checkpoint_every=30.0):
        made.append(f"corrode {alloy}")
        write_text(out / "corrosion.h5", "fields")
        losses = [0.0, 0.05, 0.15][: len(scene.with_intact())]
        return [out / "corrosion.h5"], {"volume_loss": losses}

    def map_damage(scene, alloy, moment, hold, geometry, corrosion, out):
        made.append(f"map {alloy} {moment.label} {hold.name}")
        write_text(out / "damage.h5", "f0")
        return [out / "damage.h5"], {"mean_corrosion_damage": 0.1 * moment.days / 7}

    def pulls(jobs, started, finished, **how):
        for key, job in jobs.items():
            made.append(key)
            out = Path(job.out)
            force = FORCES[out.parent.name]
            result = {"peak_force": force, "elongation_at_peak": 0.02, "status": "completed"}
            write_text(out / "tensile.json", json.dumps(result))
            write_text(out / "tensile.csv", "elongation,force_N\n")
            finished(key, 1.0)

    class Queue:
        """Does at once what it is given."""

        def __init__(self, **how):
            self.how = how

        def add(self, jobs, seconds):
            assert seconds.keys() == jobs.keys()
            pulls(jobs, **self.how)

        meanwhile = contextlib.nullcontext

    def intact(moment, hold, geometry, out):
        write_text(out / "damage.h5", "f0")

    def report(folder):
        made.append("report")
        write_text(folder / "report.html", "report")
        return folder / "report.html"

    monkeypatch.setattr("pipeline.stages.geometry.write_geometry", geometry)
    monkeypatch.setattr("pipeline.stages.corrosion.corrode_in_folder", corrode)
    monkeypatch.setattr("pipeline.stages.mapping.map_in_folder", map_damage)
    monkeypatch.setattr("pipeline.stages.mapping.map_intact", intact)
    monkeypatch.setattr(life_cycle, "run_jobs", pulls)
    monkeypatch.setattr(life_cycle, "PullQueue", Queue)
    seconds = dict.fromkeys(("shank", "slot", "faces"), 1.0)
    monkeypatch.setattr(StagedRun, "_expected", lambda self: (seconds, 1))
    monkeypatch.setattr(life_cycle.Crew, "prepare", lambda self, elements: None)
    monkeypatch.setattr("pipeline.report.report.write_report", report)
    return made


def test_a_test_that_was_stopped_is_said(tmp_path, calls, monkeypatch):
    said = []
    monkeypatch.setattr(Progress, "note", lambda self, text: said.append(text))
    result = {"peak_force": 1.0, "elongation_at_peak": 0.02, "status": "stopped: no way"}
    monkeypatch.setattr(life_cycle, "read_result", lambda folder: result)
    StagedRun(_scene("0w"), tmp_path).run()
    assert "pull Mg-A 0w shank: stopped: no way; its peak is a lower bound" in said


def test_stages_run_in_order_and_fill_the_table(tmp_path, calls):
    rows = StagedRun(_scene("0w", "1w", "8w"), tmp_path).run()
    assert calls == [
        "geometry",
        "pull Mg-A 0w shank",  # intact, so it need not wait for the march
        "corrode Mg-A",
        *(f"map Mg-A {t} shank" for t in FORCES),
        *(f"pull Mg-A {t} shank" for t in ("1w", "8w")),
        "report",
    ]
    assert (tmp_path / "summary.csv").read_text().splitlines() == [
        "alloy,hold,immersion_days,volume_loss,mean_corrosion_damage,peak_force_N,strength_ratio,"
        "elongation_at_peak,status,degradation_rate_mm_per_year",
        "Mg-A,shank,0,0,0,400,1,0.02,completed,",
        "Mg-A,shank,7,0.05,0.1,300,0.75,0.02,completed,",
        "Mg-A,shank,56,0.15,0.8,0,0,0.02,completed,",
    ]
    assert read_summary(tmp_path / "summary.csv") == rows


def test_what_a_stage_found_is_said_as_soon_as_it_ends(tmp_path, calls, capsys):
    StagedRun(_scene("0w", "1w"), tmp_path, progress=LineProgress(sys.stderr)).run()
    said = capsys.readouterr().err
    assert "corrode Mg-A: done in 0.0 s: 5.0 % of the metal lost\n" in said
    assert "pull Mg-A 0w shank: done in 1.0 s: 400 N\n" in said
    assert "pull Mg-A 1w shank: done in 1.0 s: 300 N, 75 % left\n" in said


def test_the_intact_solid_is_pulled_even_when_time_zero_is_not_asked_for(tmp_path, calls, capsys):
    progress = LineProgress(sys.stderr)
    rows = StagedRun(_scene("1w", "8w"), tmp_path, progress=progress).run()
    assert "pull Mg-A 0w shank" in calls
    assert [row.immersion_days for row in rows] == [7, 56]
    assert [row.strength_ratio for row in rows] == [0.75, 0.0]
    assert [row.volume_loss for row in rows] == [0.05, 0.15]
    assert "time zero was not asked for" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("load", "element", "said"),
    [("torsion", "P1-Fbar", True), ("bending", "P1", True), ("torsion", "P2", False)]
    + [("axial", "P1-Fbar", False)],
)
def test_cells_that_lock_are_named_before_they_are_turned(
    tmp_path, calls, capsys, load, element, said
):
    scene = _scene("0w")
    azimuth = 0.0 if load == "bending" else None
    test = dataclasses.replace(
        scene.tensile, load=load, element=element, bending_azimuth=azimuth, lateral="clamped"
    )
    held = dataclasses.replace(scene, holds=(HoldScene("shank", MESH, test),))
    cycle = StagedRun(held, tmp_path, progress=LineProgress(sys.stderr))
    with pytest.raises(RunFolderError):  # nothing is mapped yet
        cycle.pull([("Mg-A", held.immersion[0], held.holds[0])])
    words = "of a plastic bar in torsion by 59 % with P1, 7 % with P1-Fbar"
    assert (words in capsys.readouterr().err) == said


def test_a_finished_run_is_kept(tmp_path, calls):
    scene = _scene("0w", "1w", "8w")
    first = StagedRun(scene, tmp_path).run()
    calls.clear()
    assert StagedRun(scene, tmp_path).run() == first
    assert calls == []
    StagedRun(scene, tmp_path).report(again=True)
    assert calls == ["report"]


def test_a_lost_output_is_made_again_with_what_needs_it(tmp_path, calls):
    scene = _scene("0w", "1w")
    StagedRun(scene, tmp_path).run()
    calls.clear()
    (tmp_path / "Mg-A" / "1w" / "shank" / "damage.h5").unlink()
    (tmp_path / "Mg-A" / "0w" / "shank" / "tensile.csv").unlink()
    StagedRun(scene, tmp_path).run()
    assert calls == ["pull Mg-A 0w shank", "map Mg-A 1w shank", "report"]


def test_another_mesh_repeats_all_but_the_corrosion(tmp_path, calls):
    StagedRun(_scene("0w", "8w"), tmp_path).run()
    calls.clear()
    StagedRun(_scene("0w", "8w", holds=_holds("shank", mesh=FINER)), tmp_path).run()
    assert calls[0] == "geometry"
    assert "corrode Mg-A" not in calls
    assert {"map Mg-A 8w shank", "pull Mg-A 8w shank"} <= set(calls)


def test_one_geometry_and_one_corrosion_serve_every_way_of_holding(tmp_path, calls):
    rows = StagedRun(_scene("0w", "8w", holds=_holds("shank", "slot", "faces")), tmp_path).run()
    assert calls.count("geometry") == calls.count("corrode Mg-A") == 1
    assert [(row.hold, row.immersion_days) for row in rows] == [
        (hold, days) for hold in ("shank", "slot", "faces") for days in (0, 56)
    ]
    jobs = {hold: tmp_path / "Mg-A" / "8w" / hold for hold in ("shank", "slot", "faces")}
    assert all((place / "tensile.csv").is_file() for place in jobs.values())
    # what only one way of holding needs is all that is made again
    calls.clear()
    (jobs["slot"] / "tensile.csv").unlink()
    StagedRun(_scene("0w", "8w", holds=_holds("shank", "slot", "faces")), tmp_path).run()
    assert calls == ["pull Mg-A 8w slot", "report"]


def test_pulls_of_older_code_are_repeated(tmp_path, calls, monkeypatch):
    scene = _scene("0w", "8w")
    StagedRun(scene, tmp_path).run()
    calls.clear()
    monkeypatch.setitem(STAGE_REVISION, "pull", STAGE_REVISION["pull"] + 1)
    StagedRun(scene, tmp_path).run()
    assert calls == ["pull Mg-A 0w shank", "pull Mg-A 8w shank", "report"]
    calls.clear()
    monkeypatch.setitem(STAGE_REVISION, "report", STAGE_REVISION["report"] + 1)
    StagedRun(scene, tmp_path).run()
    assert calls == ["report"]


def test_an_interrupted_stage_is_not_complete(tmp_path, calls, monkeypatch):
    def interrupted(*arguments, **keywords):
        raise KeyboardInterrupt

    scene = _scene("0w", "8w")
    cycle = StagedRun(scene, tmp_path)
    cycle.geometry()
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.stages.corrosion.corrode_in_folder", interrupted)
        with pytest.raises(KeyboardInterrupt):
            cycle.corrode("Mg-A")
    with pytest.raises(RunFolderError, match="`perilife corrode`"):
        cycle.map("Mg-A", scene.immersion[0], scene.holds[0])
    calls.clear()
    StagedRun(scene, tmp_path).run()
    assert calls[:2] == ["pull Mg-A 0w shank", "corrode Mg-A"]


def test_a_damaged_file_is_named_and_its_stage_done_again(tmp_path, calls, capsys):
    scene = _scene("0w", "1w")
    cycle = StagedRun(scene, tmp_path, progress=LineProgress(sys.stderr))
    cycle.run()
    table = (tmp_path / "summary.csv").read_text()
    made = {
        "geometry/mesh.h5": "geometry",
        "Mg-A/corrosion/corrosion.h5": "corrode Mg-A",
        "Mg-A/1w/shank/damage.h5": "map Mg-A 1w shank",
        "Mg-A/1w/shank/tensile.json": "pull Mg-A 1w shank",
        "Mg-A/0w/shank/tensile.csv": "pull Mg-A 0w shank",
        "report.html": "report",
    }
    for name, again in made.items():
        path = tmp_path / name
        whole = path.read_bytes()
        edited = whole.replace(whole[-1:], b"?")
        for damaged, word in (
            (whole[:-1], f"'{name}' has {len(whole) - 1} bytes where {len(whole)} were written"),
            (edited, f"'{name}' was changed after it was written"),
            (None, f"'{name}' is missing"),
        ):
            path.unlink() if damaged is None else path.write_bytes(damaged)
            calls.clear()
            capsys.readouterr()
            cycle.run()
            assert calls[0] == again and set(calls) <= {again, "report"}
            assert f"{word}; stage '{again.split()[0]}' is done again" in capsys.readouterr().err
            assert path.read_bytes() == whole
            assert (tmp_path / "summary.csv").read_text() == table


def test_a_stage_command_refuses_to_build_on_a_damaged_file(tmp_path, calls):
    scene = _scene("0w", "1w")
    cycle = StagedRun(scene, tmp_path)
    cycle.run()
    (tmp_path / "Mg-A" / "1w" / "shank" / "damage.h5").write_text("f1")
    changed = r"'Mg-A/1w/shank/damage.h5' was changed.*perilife map"
    with pytest.raises(RunFolderError, match=changed):
        cycle.pull([("Mg-A", scene.immersion[1], scene.holds[0])])


def test_a_record_needs_its_inputs_and_its_outputs(tmp_path):
    folder = RunFolder(tmp_path)
    out = tmp_path / "part" / "out.txt"
    write_text(out, "x")
    written = folder.fingerprints([out])
    # printf x | sha256sum
    digest = "2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"
    assert written == {"part/out.txt": {"bytes": 1, "sha256": digest}}
    record = StageRecord("work", "hash", 1.5, outputs=written, numbers={"n": 3})
    folder.write_record(tmp_path / "part", record)
    assert folder.complete(tmp_path / "part", "work", "hash") == record
    assert folder.damage(tmp_path / "part", "work", "hash") == ""
    assert folder.complete(tmp_path / "part", "work", "other") is None
    assert folder.damage(tmp_path / "part", "work", "other") == ""
    assert folder.complete(tmp_path / "part", "play", "hash") is None
    assert folder.damage(tmp_path / "part", "play", "hash") == ""
    out.unlink()
    assert folder.complete(tmp_path / "part", "work", "hash") is None
    assert folder.damage(tmp_path / "part", "work", "hash") == "'part/out.txt' is missing"


def test_a_damaged_record_counts_as_none_and_is_named(tmp_path):
    folder = RunFolder(tmp_path)
    path = tmp_path / "work.stage.json"
    folder.write_record(tmp_path, StageRecord("work", "hash", 1.5, numbers={"loss": 0.25}))
    assert folder.complete(tmp_path, "work", "hash")
    edited = path.read_text().replace("0.25", "0.52")
    for text in ("", "{", "[]", '{"stage": "work"}', "[" * 100_000, edited):
        path.write_text(text)
        assert folder.complete(tmp_path, "work", "hash") is None
        assert "'work.stage.json' is not as it" in folder.damage(tmp_path, "work", "hash")


def test_a_failed_write_leaves_the_old_file_and_no_temporary(tmp_path, monkeypatch):
    target = tmp_path / "file.txt"
    write_text(target, "old")

    def full(*arguments, **keywords):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError):
        write_text(target, "new")
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_the_command_starts_without_the_heavy_libraries():
    """`perilife --version` must not wait for gmsh, Numba, VTK or dolfinx."""
    heavy = ("gmsh", "numba", "pyvista", "vtk", "dolfinx", "mpi4py")
    code = (
        "import sys; from pipeline.cli import main; main(['--version']);"
        f"print([name for name in {heavy!r} if name in sys.modules])"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert ended.stdout.splitlines()[-1] == "[]"


def test_the_scene_does_not_change_while_it_is_used():
    with pytest.raises(dataclasses.FrozenInstanceError):
        _scene("0w").holds[0].mesh.size = 1.0
