"""Files of results: any set of named fields with unit and dimensions, on a lattice (HDF5)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike

from peri.engine.lattice import Lattice

Attribute = str | int | float | np.generic


@dataclass(frozen=True)
class Field:
    """Values under a name.

    unit : SI, as written; "" where nothing is said of it.  dimensions : what each axis of the
    values runs over, such as ("time", "x", "y"); () where nothing is said of them.

    Raises
    ------
    ValueError
        Where there are dimensions, but not one for each axis.
    """

    values: ArrayLike
    unit: str = ""
    dimensions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        if self.dimensions and len(self.dimensions) != len(shape):
            raise ValueError(
                f"dimensions: {', '.join(self.dimensions)}; values of shape {shape} need one for "
                "each axis"
            )


def axes_of(lattice: Lattice) -> tuple[str, ...]:
    """The lattice's axes as dimensions of a field: x, y, z as far as there are."""
    return tuple("xyz"[: lattice.dimension])


def write_result(
    path: Path,
    lattice: Lattice,
    fields: Mapping[str, Field],
    history: Mapping[str, Field],
    attributes: Mapping[str, Attribute],
    schema_version: int,
) -> None:
    """Write fields by name, a march's history below `history/` and the lattice below `lattice/`.

    The file stands under its name once it is whole.  Fields on the lattice are compressed.
    """
    grid = {
        "origin": Field(lattice.origin, "m"),
        "spacing": Field(lattice.spacing, "m"),
        "shape": Field(lattice.shape),
    }
    found = {f"lattice/{name}": field for name, field in grid.items()}
    found |= fields
    found |= {f"history/{name}": field for name, field in history.items()}
    temporary = Path(path).with_name(Path(path).name + ".tmp")
    try:
        with h5py.File(temporary, "w") as file:
            file.attrs["schema_version"] = schema_version
            for name, field in found.items():
                values = np.asarray(field.values)
                on_lattice = name in fields and values.shape[-lattice.dimension :] == lattice.shape
                how = {"compression": "lzf"} if on_lattice else {}
                data = file.create_dataset(name, data=values, **how)
                if field.unit:
                    data.attrs["unit"] = field.unit
                if field.dimensions:
                    data.attrs["dimensions"] = ", ".join(field.dimensions)
            for name, value in attributes.items():
                file.attrs[name] = value
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_result(
    path: Path, what: str, schema_version: int
) -> tuple[dict[str, Field], dict[str, Attribute]]:
    """Fields, by their path in the file, and attributes of a file of `write_result`.

    what : which result is asked for, for the message.

    Raises
    ------
    ValueError
        If the file has another schema version.
    """
    fields: dict[str, Field] = {}

    def take(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            named = item.attrs.get("dimensions", "")
            dimensions = tuple(named.split(", ")) if named else ()
            fields[name] = Field(item[()], item.attrs.get("unit", ""), dimensions)

    with h5py.File(path, "r") as file:
        if file.attrs.get("schema_version") != schema_version:
            raise ValueError(f"{path}: not a {what} result of schema {schema_version}")
        file.visititems(take)
        return fields, dict(file.attrs)
