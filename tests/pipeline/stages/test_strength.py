"""A pull in its folder: what it writes, and how an interrupted one goes on."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.mesh import TetrahedralMesh, write_mesh
from pipeline.scene.scene import MaterialParameters, TensileScene
from pipeline.scene.units import parse_immersion_times
from pipeline.stages import strength as tensile_stage
from pipeline.stages.mapping import DAMAGE_FILE, write_damage
from pipeline.stages.strength import (
    CHECKPOINT_FILE,
    RESULT_FILE,
    TensileJob,
    first_increment,
    forget_others,
    read_result,
    run_job,
)
from tests.fem.meshes import box


@pytest.fixture
def job(tmp_path) -> TensileJob:
    points, cells = box((2, 2, 4), (1e-3, 1e-3, 2e-3))
    write_mesh(TetrahedralMesh(points, cells, {}), tmp_path)
    middle = points[cells].mean(axis=1)
    f0 = np.where(middle[:, 2] > 1e-3, 0.2, 0.05)[:, None]
    write_damage(
        tmp_path / DAMAGE_FILE, f0, parse_immersion_times(["8w"])[0], "P1-Fbar", 1.0, "nodes"
    )
    return TensileJob(
        str(tmp_path), str(tmp_path), str(tmp_path),
        MaterialParameters(43e9, 0.3, 130e6, 120e6, 10.0),
        TensileScene("P1-Fbar", final_strain=0.03),
    )  # fmt: skip


def test_a_pull_leaves_its_curve_and_its_paraview_series(job, tmp_path):
    run_job(job)
    found = read_result(tmp_path)
    assert found["status"] == "completed" and found["peak_force"] > 50
    series = (tmp_path / "tensile.pvd").read_text()
    assert series.count("<DataSet") >= 1 + found["increments"] // tensile_stage.SERIES_EVERY
    assert all(name in series for name in (p.name for p in tmp_path.glob("tensile_*.vtu")))
    assert not (tmp_path / CHECKPOINT_FILE).exists()


def test_an_interrupted_pull_goes_on_where_it_was(job, tmp_path, monkeypatch):
    run_job(job)
    whole = read_result(tmp_path)
    curve = np.loadtxt(tmp_path / "tensile.csv", delimiter=",", skiprows=1)
    (tmp_path / RESULT_FILE).unlink()
    monkeypatch.setattr(tensile_stage, "CHECKPOINT_SECONDS", 0.0)
    heard = []

    def stop_half_way(path, text):
        heard.append(float(text))
        if len(heard) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(tensile_stage, "write_text", stop_half_way)
    with pytest.raises(KeyboardInterrupt):
        run_job(job)
    assert (tmp_path / CHECKPOINT_FILE).exists()
    monkeypatch.undo()
    first = []
    keep = tensile_stage.write_text

    def listen(path, text):
        if path.name == tensile_stage.PROGRESS_FILE:
            first.append(float(text))
        keep(path, text)

    monkeypatch.setattr(tensile_stage, "write_text", listen)
    run_job(job)
    assert first[0] == pytest.approx(heard[3])  # not from the beginning
    resumed = read_result(tmp_path)
    # Measured 2e-8: the preconditioner is another one, the solutions agree to their tolerance.
    assert resumed["peak_force"] == pytest.approx(whole["peak_force"], rel=1e-6)
    again = np.loadtxt(tmp_path / "tensile.csv", delimiter=",", skiprows=1)
    assert again[:, :3] == pytest.approx(curve[:, :3], rel=1e-6)
    assert not (tmp_path / CHECKPOINT_FILE).exists()


@pytest.mark.parametrize(
    ("load", "azimuth", "reaction"), [("torsion", None, "torque"), ("bending", 0.5, "moment")]
)
def test_a_turned_solid_leaves_torque_or_moment_against_angle(
    job, tmp_path, load, azimuth, reaction
):
    test = TensileScene(
        "P1-Fbar", 0.03, lateral="clamped", load=load, bending_azimuth=azimuth, damage="cell"
    )
    job = replace(job, tensile=test)
    assert TensileJob.read(job.write()) == job
    run_job(job)
    found = read_result(tmp_path)
    curve = np.genfromtxt(tmp_path / "tensile.csv", delimiter=",", names=True)
    assert curve.dtype.names[:3] == ("strain", "angle_rad", f"{reaction}_N_m")
    # angle = strain * length / radius, 2 mm over half the diagonal of the square
    np.testing.assert_allclose(curve["angle_rad"], curve["strain"] * 2 * 2**0.5, rtol=1e-9)
    assert found["load"] == load and "peak_force" not in found
    # the metal still hardens: the largest is at the end, or before a last increment that is smaller
    # and so errs less (0.1 % of the moment, by which the lag of f makes 0.5 % of strain too strong)
    largest = int(curve[f"{reaction}_N_m"].argmax())
    assert largest >= len(curve) - 2
    # between points the peak is that of a parabola
    assert found[f"peak_{reaction}"] == pytest.approx(curve[f"{reaction}_N_m"][largest], rel=1e-4)
    assert curve[f"{reaction}_N_m"][-1] == pytest.approx(found[f"peak_{reaction}"], rel=2e-3)
    assert found["angle_at_peak"] == pytest.approx(curve["angle_rad"][largest], rel=0.02)


def test_a_checkpoint_that_is_none_starts_the_pull_anew(job, tmp_path):
    (tmp_path / CHECKPOINT_FILE).write_bytes(b"torn")
    run_job(job)
    assert read_result(tmp_path)["status"] == "completed"


def test_a_pull_that_fails_on_its_way_is_not_repeated(job, tmp_path, monkeypatch):
    (tmp_path / CHECKPOINT_FILE).write_bytes(b"kept")
    calls = []

    def fails(*_, resume, **__):
        calls.append(resume)
        raise ValueError("of the middle of a pull")

    monkeypatch.setattr("fem.strength.tensile_test", fails)
    with pytest.raises(ValueError, match="of the middle"):
        run_job(job)
    assert calls == [tmp_path / CHECKPOINT_FILE]


def test_what_another_job_left_is_removed_and_what_this_one_left_is_kept(job, tmp_path):
    left = [tmp_path / CHECKPOINT_FILE, tmp_path / "tensile_0004.vtu", tmp_path / "tensile.pvd"]
    for path in left:
        path.write_text("old")
    job.write()
    forget_others(job)
    assert all(path.exists() for path in left)
    other = TensileJob(
        job.geometry, job.damage, job.out, job.material, TensileScene("P1-Fbar", increment=0.001)
    )
    forget_others(other)
    assert not any(path.exists() for path in left)


def test_pulled_end_faces_begin_with_small_increments():
    held = TensileScene(bottom_grip=7e-4, top_grip=3e-4, increment=0.02)
    assert first_increment(held) == 0.002
    assert first_increment(replace(held, top_grip=0.0)) == 0.0002
    assert first_increment(replace(held, increment=0.001)) == 0.001
