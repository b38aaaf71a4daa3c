"""Checkpoints of a march: named arrays under the hash of everything that determines the march."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np

SCHEMA_VERSION = 1


class CheckpointError(ValueError):
    """A checkpoint that is of another march, or cannot be read."""


def fingerprint(
    scene: object, times: Iterable[float], stepping: object, solver_tolerance: float
) -> str:
    """Hash of everything that determines a march."""
    digest = hashlib.sha256()
    for name, value in sorted(vars(scene).items()):
        if isinstance(value, np.ndarray):
            digest.update(name.encode() + np.ascontiguousarray(value).tobytes())
        elif not name.startswith("_"):
            digest.update(f"{name}={value!r}".encode())
    digest.update(repr((list(times), stepping, solver_tolerance)).encode())
    return digest.hexdigest()


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
