"""Files of the corrosion stage."""

import csv

import h5py
import numpy as np
import pytest

from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.nodes.problem import CorrosionProblem
from peri.corrosion.results import (
    read_corrosion,
    write_corrosion,
    write_history,
    write_image_series,
)
from peri.corrosion.run import HISTORY, corrode
from peri.engine.march.checkpoints import CheckpointError, read_checkpoint, write_checkpoint
from peri.engine.march.marching import TimeStepping
from tests.peri.corrosion.scenes import WEEK, pin


@pytest.fixture(scope="module")
def result():
    return corrode(pin(2, 12), [0.0, WEEK], TimeStepping("sdirk2", step=0.5 * WEEK))


def test_what_is_written_is_read_back(result, tmp_path):
    path = tmp_path / "corrosion.h5"
    write_corrosion(path, result)
    read = read_corrosion(path)
    np.testing.assert_array_equal(read["concentration"], result.concentration)
    np.testing.assert_array_equal(read["times"], result.times)
    np.testing.assert_array_equal(read["volume_loss"], result.volume_loss)
    np.testing.assert_array_equal(read["metal"], result.scene.metal)
    np.testing.assert_array_equal(read["remaining_metal"], result.metal)
    np.testing.assert_array_equal(read["capacity"], result.scene.capacity())
    np.testing.assert_array_equal(read["lattice/spacing"], result.scene.lattice.spacing)
    for name in HISTORY:
        np.testing.assert_array_equal(read[f"history/{name}"], result.history[name])
    assert read["solid_concentration"] == result.scene.solid_concentration
    assert [p.name for p in tmp_path.iterdir()] == ["corrosion.h5"]  # no temporary file stays
    with h5py.File(path) as file:
        assert file["concentration"].attrs["unit"] == "mol/m3"
        assert file["concentration"].attrs["dimensions"] == "time, x, y"
        assert file["times"].attrs["unit"] == "s"


def test_the_file_is_that_of_schema_1(result, tmp_path):
    """Every dataset with its type, shape, compression and attributes: other programs read them."""
    path = tmp_path / "corrosion.h5"
    write_corrosion(path, result)
    found = {}

    def take(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = (str(item.dtype), item.shape, item.compression, dict(item.attrs))

    with h5py.File(path) as file:
        file.visititems(take)
        numbers = {name: value.dtype for name, value in file.attrs.items()}
    metres, seconds, amount, one = ({"unit": unit} for unit in ("m", "s", "mol", "1"))
    field = {"unit": "mol/m3", "dimensions": "time, x, y"}
    assert found == {
        "lattice/origin": ("float64", (2,), None, metres),
        "lattice/spacing": ("float64", (2,), None, metres),
        "lattice/shape": ("int64", (2,), None, {}),
        "metal": ("bool", (12, 12), "lzf", {}),
        "domain": ("bool", (12, 12), "lzf", {}),
        "capacity": ("float64", (12, 12), "lzf", {}),
        "times": ("float64", (2,), None, seconds),
        "concentration": ("float64", (2, 12, 12), "lzf", field),
        "remaining_metal": ("bool", (2, 12, 12), "lzf", {}),
        "volume_loss": ("float64", (2,), None, {}),
        "history/time": ("float64", (3,), None, seconds),
        "history/step": ("float64", (3,), None, seconds),
        "history/volume_loss": ("float64", (3,), None, one),
        "history/metal_amount": ("float64", (3,), None, amount),
        "history/liquid_amount": ("float64", (3,), None, amount),
        "history/released_amount": ("float64", (3,), None, amount),
        "history/balance_error": ("float64", (3,), None, one),
        "history/saturated_nodes": ("int64", (3,), None, one),
        "history/dissolved_nodes": ("float64", (3,), None, one),
        "history/iterations": ("int64", (3,), None, one),
    }
    real = dict.fromkeys(["solid_concentration", "saturation_concentration", "wall_time"], "f8")
    assert numbers == {"schema_version": "i8", **real}


def test_another_schema_is_refused(result, tmp_path):
    path = tmp_path / "corrosion.h5"
    write_corrosion(path, result)
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = 999
    with pytest.raises(ValueError, match="not a corrosion result of schema 1"):
        read_corrosion(path)


def test_history_as_csv_carries_units(result, tmp_path):
    write_history(tmp_path / "history.csv", result.history)
    with open(tmp_path / "history.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == result.history["time"].size == 3
    assert "time_s" in rows[0] and "volume_loss" in rows[0] and "released_amount_mol" in rows[0]
    # twelve digits are written
    assert float(rows[-1]["volume_loss"]) == pytest.approx(result.volume_loss[-1], rel=1e-11)


def test_image_series(result, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    series = write_image_series(tmp_path, result)
    assert series.read_text().count("<DataSet") == 2
    image = pyvista.read(tmp_path / "corrosion_001.vti")
    assert image.dimensions == (12, 12, 1)
    values = np.asarray(image["concentration"]).reshape((12, 12), order="F")
    # single precision
    np.testing.assert_allclose(values, result.concentration[1], rtol=1e-6)
    damage = np.asarray(image["corrosion_damage"]).reshape((12, 12), order="F")
    assert np.isnan(damage[~result.scene.metal]).all()
    assert np.nanmax(damage) > 0 and np.nanmin(damage) >= 0
    phase = np.asarray(image["phase"]).reshape((12, 12), order="F")
    np.testing.assert_array_equal(phase, 1 + result.metal[1])


def test_checkpoints_know_whose_they_are(tmp_path):
    path = tmp_path / "state.h5"
    arrays = {"a": np.arange(3.0), "group/b": np.eye(2)}
    write_checkpoint(path, "mark", arrays)
    read = read_checkpoint(path, "mark")
    assert set(read) == set(arrays)
    np.testing.assert_array_equal(read["group/b"], np.eye(2))
    with pytest.raises(CheckpointError, match="belongs to another scene"):
        read_checkpoint(path, "other")
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(CheckpointError, match="cannot be read"):
        read_checkpoint(path, "mark")


def test_fingerprint_sees_every_input():
    def mark(tolerance=1e-9, **options):
        return CorrosionProblem(pin(2, 12, **options), tolerance).key()

    others = [
        mark(saturation_concentration=1.0),
        mark(boundary="no_flux"),
        mark(metal=np.zeros((12, 12), bool)),
        mark(kinetics=VolumeLossLaw(0.2)),
        mark(1e-10),
    ]
    assert mark() == mark()
    assert len({mark(), *others}) == 6
