"""Files of named fields with unit and dimensions."""

import h5py
import numpy as np
import pytest

from peri.engine.lattice import box_lattice
from peri.engine.results import Field, axes_of, read_result, write_result

LATTICE = box_lattice([0.0, 0.0], [0.4, 0.6], 0.1)


def stress() -> Field:
    values = np.arange(48.0).reshape(2, *LATTICE.shape)
    return Field(values, "Pa", ("component", *axes_of(LATTICE)))


def test_fields_of_any_shape_come_back_with_unit_and_dimensions(tmp_path):
    path = tmp_path / "result.h5"
    fields = {
        "stress": stress(),
        "broken": Field(np.array([0, 3], np.uint64), dimensions=("bond",)),
        "names": Field(np.array(["a", "bc"], "S")),
    }
    history = {"time": Field([0.0, 1.5], "s", ("step",))}
    write_result(path, LATTICE, fields, history, {"load": "axial"}, 3)
    found, attributes = read_result(path, "fracture", 3)
    assert attributes == {"schema_version": 3, "load": "axial"}
    expected = {**fields, "history/time": history["time"]}
    assert {name for name in found if not name.startswith("lattice/")} == set(expected)
    for name, field in expected.items():
        np.testing.assert_array_equal(found[name].values, field.values)
        assert np.asarray(found[name].values).dtype == np.asarray(field.values).dtype
        assert (found[name].unit, found[name].dimensions) == (field.unit, field.dimensions)
    assert found["lattice/spacing"].unit == "m"
    np.testing.assert_array_equal(found["lattice/shape"].values, LATTICE.shape)
    with h5py.File(path) as file:
        assert file["stress"].compression == "lzf" and file["broken"].compression is None
    with pytest.raises(ValueError, match="not a fracture result of schema 4"):
        read_result(path, "fracture", 4)


def test_a_failed_write_leaves_the_file_before_it(tmp_path):
    path = tmp_path / "result.h5"
    write_result(path, LATTICE, {"stress": stress()}, {}, {}, 1)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_result(path, LATTICE, {"stress": Field(np.array([object()]))}, {}, {}, 1)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["result.h5"]


def test_dimensions_name_every_axis():
    with pytest.raises(
        ValueError, match=r"dimensions: x, y; .* shape \(3,\) need one for each axis"
    ):
        Field(np.zeros(3), "m", ("x", "y"))
