"""Checkpoints and the ParaView series of a tensile test."""

import h5py
import numpy as np
import pytest

pytest.importorskip("dolfinx")

from fem.results import Checkpoint, CheckpointError, ParaviewSeries
from fem.strength import TensileSettings, tensile_test
from tests.fem.meshes import box
from tests.fem.restart_run import MATERIAL, Interrupted, run, scene
from tests.ranks import run_on_ranks


def check(resumed, whole, rtol):
    """The same curve, counts and displacements."""
    # sizes follow what f lags: measured 2e-11 on other ranks
    np.testing.assert_allclose(resumed["elongation"], whole.history["elongation"], rtol=1e-9)
    np.testing.assert_array_equal(resumed["lost_cells"], whole.history["lost_cells"])
    for name in ("force", "work", "dissipated", "largest_plastic_strain", "largest_damage"):
        np.testing.assert_allclose(resumed[name], whole.history[name], rtol=rtol, atol=1e-12)


@pytest.mark.parametrize("element", ["P1-Fbar", "P2"])
def test_resumed_equals_uninterrupted(tmp_path, element):
    whole = run(element, "whole", None)
    assert whole.lost_cells > whole.history["lost_cells"][3]
    with pytest.raises(Interrupted):
        run(element, "interrupted", tmp_path / "checkpoint.h5")
    resumed = run(element, "resumed", tmp_path / "checkpoint.h5")
    # Newton tolerance 1e-8 of the reaction: measured 7e-11 and 1.0e-9 of the force
    check(resumed.history, whole, 2e-8)
    seen = ~np.isnan(whole.displacement)
    np.testing.assert_allclose(
        resumed.displacement[seen], whole.displacement[seen], atol=1e-7 * whole.elongation[-1]
    )


@pytest.mark.slow
def test_one_rank_goes_on_with_two_and_back(tmp_path):
    """Interrupted on one rank and resumed on two; and the other way round."""
    whole = run("P2", "whole", None)
    checkpoint, output, theirs = (tmp_path / name for name in ("one.h5", "two.npz", "two.h5"))
    with pytest.raises(Interrupted):
        run("P2", "interrupted", checkpoint)
    run_on_ranks(2, "tests.fem.restart_run", "P2", checkpoint, output, theirs)
    # Newton tolerance 1e-8 of the reaction: measured 7e-11 to 1.3e-10
    check(np.load(output), whole, 2e-8)
    check(run("P2", "resumed", theirs).history, whole, 2e-8)


def test_checkpoint_of_a_finished_test_goes_on_to_larger_strain(tmp_path):
    points, cells = box((1, 1, 2), (1e-3, 1e-3, 2e-3))
    checkpoint = tmp_path / "folder" / "checkpoint.h5"
    settings = {"element": "P1", "full_curve": True, "tolerance": 1e-9, "damage": "implicit"}
    tensile_test(
        points, cells, 0.1, MATERIAL, TensileSettings(maximum_strain=0.02, **settings),
        observers=[Checkpoint(checkpoint, every=2)],
    )  # fmt: skip
    with h5py.File(checkpoint) as file:
        assert file["cells/plastic"].shape == (12, 1, 6) and file["nodes/ends"].shape == (12, 2)
    longer = TensileSettings(maximum_strain=0.04, **settings)
    on = tensile_test(points, cells, 0.1, MATERIAL, longer, resume=checkpoint)
    whole = tensile_test(points, cells, 0.1, MATERIAL, longer)
    assert on.elongation[-1] == pytest.approx(0.04 * 2e-3)
    assert on.force[-1] == pytest.approx(whole.force[-1], rel=1e-5)  # other increments


def test_a_test_that_had_ended_is_over_when_it_is_resumed(tmp_path):
    """Interrupted between its last increment and its result, past its peak or in two parts."""
    points, cells = box((1, 1, 3), (1e-3, 1e-3, 3e-3))
    middle = abs(points[cells, 2].mean(axis=1) - 1.5e-3) < 0.5e-3
    for full_curve, most in ((False, 0.5), (True, 0.65)):
        settings = TensileSettings("P1", maximum_strain=0.3, full_curve=full_curve)
        test = (points, cells, np.where(middle, most, 0.0), MATERIAL, settings)
        path = tmp_path / f"{most}.h5"
        whole = tensile_test(*test, observers=[Checkpoint(path)])
        resumed = tensile_test(*test, resume=path)
        assert whole.status == resumed.status == "past_peak"
        assert (whole.reaction[-1] == 0.0) == full_curve
        np.testing.assert_array_equal(resumed.reaction, whole.reaction)


def test_refuses_the_checkpoint_of_another_test(tmp_path):
    points, cells = box((1, 1, 2), (1e-3, 1e-3, 2e-3))
    settings = TensileSettings(element="P1", maximum_strain=0.004)
    path = tmp_path / "checkpoint.h5"
    tensile_test(points, cells, 0.1, MATERIAL, settings, observers=[Checkpoint(path)])
    with pytest.raises(ValueError, match="another mesh, damage"):
        tensile_test(points, cells, 0.2, MATERIAL, settings, resume=path)
    with h5py.File(path, "a") as file:  # as one without what f grew by
        file.attrs["schema_version"] = 1
        del file["cells/growth"]
    with pytest.raises(CheckpointError, match="another version"):
        tensile_test(points, cells, 0.1, MATERIAL, settings, resume=path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        tensile_test(points, cells, 0.1, MATERIAL, settings, resume=tmp_path / "absent.h5")
    with pytest.raises(ValueError, match="every"):
        Checkpoint(path, every=0)


def test_paraview_series(tmp_path):
    """Each file holds what is left of the solid, in the order of the input's cells."""
    pyvista = pytest.importorskip("pyvista")
    points, cells, f0 = scene("P2")
    settings = TensileSettings(maximum_strain=0.03, full_curve=True, maximum_increment=0.005)
    result = tensile_test(
        points, cells, f0, MATERIAL, settings, observers=[ParaviewSeries(tmp_path, every=2)]
    )
    files = sorted(tmp_path.glob("*.vtu"))
    last = len(result.force) - 1
    shown = {0, int(np.argmax(result.force)), last, *range(2, last + 1, 2)}
    assert [int(file.stem[-4:]) for file in files] == sorted(shown)
    text = (tmp_path / "tensile.pvd").read_text()
    assert all(f'file="{file.name}"' in text for file in files)
    assert not list(tmp_path.glob(".*"))
    intact, first, last = (pyvista.read(files[n]) for n in (0, 1, -1))
    assert not intact.point_data["displacement_m"].any()
    assert not intact.cell_data["cauchy_stress_Pa"].any()
    assert first.n_cells == len(cells) - result.dead_cells - result.loose_cells
    assert first.n_cells > last.n_cells >= len(cells) - result.dead_cells - result.lost_cells
    number = first.cell_data["cell"]
    assert np.all(np.diff(number) > 0)
    np.testing.assert_allclose(
        first.points[first.cells.reshape(-1, 5)[:, 1:]], points[cells[number]], rtol=1e-12
    )
    grown = first.cell_data["damage_variable"] - np.minimum(f0, 0.6667)[number].mean(axis=1)
    assert grown.min() > -0.05 and grown.max() > 1e-4
    assert 10e6 < first.cell_data["mises_kirchhoff_Pa"].max() < 300e6
    assert first.cell_data["plastic_strain"].max() > 1e-3
    top = first.points[:, 2] == points[:, 2].max()
    at = float(text.split('timestep="')[2].split('"')[0]) / 100
    np.testing.assert_allclose(first.point_data["displacement_m"][top, 2], at * 4e-3, rtol=1e-9)


def test_a_series_ends_where_nothing_is_left_between_the_grips(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    points, cells = box((1, 1, 3), (1e-3, 1e-3, 3e-3))
    damage = np.where(points[cells, 2].mean(axis=1) < 1e-3, 0.65, 0.0)  # one end tears off whole
    result = tensile_test(
        points, cells, damage, MATERIAL, TensileSettings("P1", maximum_strain=0.3, full_curve=True),
        observers=[ParaviewSeries(tmp_path)],
    )  # fmt: skip
    assert result.reaction[-1] == 0.0 and result.lost_cells == len(cells)
    text, files = (tmp_path / "tensile.pvd").read_text(), sorted(tmp_path.glob("*.vtu"))
    assert text.count("<DataSet") == len(files) > 3
    assert pyvista.read(files[-1]).n_cells == len(cells)


def test_the_stress_of_the_series_bears_the_force(tmp_path):
    """Integral of the axial Cauchy stress over the stretched bar = force times its length."""
    pyvista = pytest.importorskip("pyvista")
    points, cells, f0 = scene("P1")
    settings = TensileSettings("P1", maximum_strain=0.02, maximum_increment=0.005, tolerance=1e-8)
    result = tensile_test(
        points, cells, f0, MATERIAL, settings, observers=[ParaviewSeries(tmp_path)]
    )
    found = pyvista.read(sorted(tmp_path.glob("*.vtu"))[1])
    where = found.points + found.point_data["displacement_m"]
    corner = where[found.cells.reshape(-1, 5)[:, 1:]]
    volume = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6
    stress = found.cell_data["cauchy_stress_Pa"]
    # rounding of the file's single precision; the axial stress is not the equivalent one here
    force = float(volume @ stress[:, 2]) / np.ptp(where[:, 2])
    assert force == pytest.approx(result.force[1], rel=1e-5)
    assert abs(float(volume @ stress[:, 0])) < 1e-4 * float(volume @ stress[:, 2])
    deviator = stress - stress[:, :3].mean(axis=1, keepdims=True) * [1, 1, 1, 0, 0, 0]
    weights = np.array([1, 1, 1, 2, 2, 2])
    mises = np.sqrt(1.5 * (weights * deviator**2).sum(axis=1))
    ratio = mises / found.cell_data["mises_kirchhoff_Pa"]
    assert np.ptp(ratio[np.isfinite(ratio)]) < 0.05  # 1 / det F
