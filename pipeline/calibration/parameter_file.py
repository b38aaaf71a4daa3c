"""A fitted parameter set as TOML, in the form that `--parameters` takes."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.record.run_folder import write_text

SET_FILE = "parameters.toml"
BIBLIOGRAPHY_FILE = "references.bib"
SOURCE = "calibration"
"""Key in the bibliography beside the set: the measurements it was fitted to."""


@dataclass(frozen=True)
class FittedConstant:
    """One constant as it is written: value (SI), kind, and a note."""

    value: float
    kind: str
    note: str = ""


@dataclass(frozen=True)
class FittedAlloy:
    """What is written for one alloy.

    constants: those fitted or held, by name, the others are the base set's; calibration: fields of
    perilife_data's Calibration; samples (n, np): in the order of calibration["parameters"].
    """

    name: str
    constants: dict[str, FittedConstant]
    calibration: dict[str, object]
    samples: NDArray[np.float64]


@dataclass(frozen=True)
class FittedScene:
    """The scene of the fit: words, nodes, and the size of the liquid's domain (m)."""

    solid: str
    domain: str
    nodes: int
    diameter: float
    height: float
    saturation: str
    boundary: str


def write_parameter_set(
    folder: Path, base: perilife_data.ParameterSet, scene: FittedScene, fitted: FittedAlloy
) -> Path:
    """Write SET_FILE and the bibliography beside it; returns the set's path.

    D_int stays stated for the lattice of the base set, from which runs derive a flux.
    """
    data = fitted.calibration["data"]
    lines = [
        f"name = {_text(f'{fitted.name} fitted to {data}')}",
        f"title = {_text(f'Fit of {fitted.name} to {data}, begun from {base.name}')}",
        f"medium = {_text(base.medium)}",
        'note = "Fitted by perilife; the constants belong to the scene below. '
        'D_int is stated for the lattice given there."',
        "",
        "[scene]",
        f"solid = {_text(scene.solid)}",
        f"domain = {_text(scene.domain)}",
        f"calibration = {_text(base.scene.calibration)}",
        f"saturation = {_text(scene.saturation)}",
        f"boundary = {_text(scene.boundary)}",
        *_quantity("scene.nodes", scene.nodes, "1", "derived"),
        *_quantity("scene.spacing", base.scene.spacing.si, "m", "derived"),
        *_quantity("scene.horizon_ratio", base.scene.horizon_ratio.si, "1", "derived"),
        *_quantity("scene.diameter", scene.diameter, "m", "derived"),
        *_quantity("scene.height", scene.height, "m", "derived"),
    ]
    units = {
        "kernel_exponent": "1", "volume_loss_scale": "1", "interface_diffusivity": "m^2/s",
        "liquid_diffusivity": "m^2/s", "saturation_concentration": "mol/m^3",
        "solid_concentration": "mol/m^3",
    }  # fmt: skip
    old = base.for_alloy(fitted.name)
    for field in fields(old):
        quantity = getattr(old, field.name)
        new = fitted.constants.get(field.name)
        key = f'alloys."{fitted.name}".{field.name}'
        if new is None:
            lines += _quantity(
                key, quantity.si, units[field.name], quantity.kind,
                f"taken from {base.name}", _shipped(quantity.source), quantity.where,
            )  # fmt: skip
        else:
            lines += _quantity(key, new.value, units[field.name], new.kind, new.note)
    lines += ["", f'[calibrations."{fitted.name}"]']
    lines += [f"{name} = {_value(value)}" for name, value in fitted.calibration.items()]
    rows = ",\n".join("  [" + ", ".join(f"{v:.6g}" for v in row) + "]" for row in fitted.samples)
    lines += [f"samples = [\n{rows},\n]"]
    bibliography = [
        f"@misc{{{SOURCE},",
        "  author = {Measurements of the user},",
        f"  title = {{Volume loss of {fitted.name}, file {_plain(data)}}},",
        f"  year = {{{datetime.now(UTC).year}}},",
        f"  note = {{SHA-256 {fitted.calibration['sha256']}}},",
        "}",
    ]
    write_text(folder / BIBLIOGRAPHY_FILE, "\n".join(bibliography) + "\n")
    path = folder / SET_FILE
    write_text(path, "\n".join(lines) + "\n")
    perilife_data.load_parameter_set(path)
    return path


def _shipped(source: str) -> str:
    """A source that the shipped bibliography has; one of an own set becomes this fit."""
    try:
        return perilife_data.load_reference(source).key
    except ValueError:
        return SOURCE


def _quantity(
    key: str,
    value: float,
    unit: str,
    kind: str,
    note: str = "",
    source: str = SOURCE,
    where: str = "this fit",
) -> list[str]:
    lines = ["", f"[{key}]", f"value = {value:.10g}", f"unit = {_text(unit)}"]
    lines += [f"source = {_text(source)}", f"where = {_text(where)}", f"kind = {_text(kind)}"]
    return lines + ([f"note = {_text(note)}"] if note else [])


def _plain(text: object) -> str:
    """Without braces, which end a field of a bibliography."""
    return str(text).replace("{", "(").replace("}", ")")


def _value(value: object) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    return repr(value)


def _text(text: object) -> str:
    """A basic TOML string: JSON's escapes are TOML's."""
    return json.dumps(str(text), ensure_ascii=False)
