"""Checkpoints of a march: named arrays under the hash of everything that determines the march."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import h5py
import numpy as np

SCHEMA_VERSION = 2


class CheckpointError(ValueError):
    """A checkpoint that is of another march, or cannot be read."""


def fingerprint(*parts: object) -> str:
    """Hash of everything that determines a march, the same in every process.

    Parts are numbers, words, arrays, tuples, mappings, dataclasses (every field that does not
    begin with an underscore counts) and objects with a method `key()`, which returns such parts.

    Raises
    ------
    TypeError
        For an object that could only be told by its address in memory.
    """
    digest = hashlib.sha256(f"schema {SCHEMA_VERSION}".encode())
    for piece in _pieces(parts):
        digest.update(piece)
        digest.update(b"\0")
    return digest.hexdigest()


def _pieces(part: object) -> Iterator[bytes]:
    if isinstance(part, np.ndarray):
        yield f"{part.dtype.str}{part.shape}".encode()
        yield np.ascontiguousarray(part).tobytes()
    elif part is None or isinstance(part, str | bytes | bool | int | float | complex | np.generic):
        yield repr(part).encode()
    elif isinstance(part, tuple | list):
        yield f"{len(part)} in order".encode()
        for item in part:
            yield from _pieces(item)
    elif isinstance(part, Mapping):
        yield f"{len(part)} by name".encode()
        for name in sorted(part):
            yield str(name).encode()
            yield from _pieces(part[name])
    elif callable(getattr(part, "key", None)):
        yield type(part).__qualname__.encode()
        yield from _pieces(part.key())  # type: ignore[attr-defined]
    elif is_dataclass(part) and not isinstance(part, type):
        yield type(part).__qualname__.encode()
        yield from _pieces(
            {f.name: getattr(part, f.name) for f in fields(part) if not f.name.startswith("_")}
        )
    else:
        name = type(part).__name__
        raise TypeError(
            f"{name}: nothing tells two of them apart for a checkpoint; make it a dataclass or "
            "give it a method key() that returns what determines it"
        )


def write_checkpoint(path: Path, mark: str, arrays: dict[str, np.ndarray]) -> None:
    """Write named arrays under a temporary name and move them into place."""
    temporary = path.with_name(path.name + ".tmp")
    with h5py.File(temporary, "w") as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs["fingerprint"] = mark
        for name, values in arrays.items():
            file[name] = values
    os.replace(temporary, path)


def read_checkpoint(path: Path, mark: str) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint.

    Raises
    ------
    CheckpointError
        If it belongs to another march or cannot be read.
    """
    arrays: dict[str, np.ndarray] = {}
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("fingerprint") != mark:
                raise CheckpointError(
                    f"checkpoint: {path} belongs to another scene or other settings"
                )
            file.visititems(
                lambda name, item: (
                    arrays.__setitem__(name, item[()]) if isinstance(item, h5py.Dataset) else None
                )
            )
    except (OSError, RuntimeError) as error:
        raise CheckpointError(f"checkpoint: {path} cannot be read ({error})") from error
    return arrays
