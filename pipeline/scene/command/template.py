"""`perilife init`: a scene file with every option of a run, its default and what it is.

Written from the parser and from a resolved scene, so that it says what the program does.
"""

from __future__ import annotations

import argparse
import json
import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import fields

from pipeline.scene.classes import AUTO
from pipeline.scene.command.arguments import SI_UNIT, options_of
from pipeline.scene.command.scene_file import KINDS, tables_of
from pipeline.scene.laws.ions import DEFAULT_MEDIUM, resolve_ions
from pipeline.scene.mechanics import PULLED_FACE_CELLS
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.units import format_length, parse_length

WIDTH = 88

FIRST = {"alloy": ["Mg-5Gd"], "immersion": ["0w", "8w"], "out": "runs/mine"}
"""Values of the options without default, where none was given."""

EXAMPLES: dict[str, object] = {
    "volume_loss": ["Mg-5Gd=measured.csv"],
    "solid": "part.step",
    "image": "scan.tif",
    "voxel": ["5um"],
    "threshold": 12000,
    "label": 1,
    "step": "6h",
    "coating": "factor=0.1,lifetime=28d",
    "keep": ["liquid"],
    "balance": "Cl",
    "bath_volume": "50mL",
    "exchange_every": "2d",
    "open_to": ["CO2"],
    "feedback": "ph_order=0.3",
    "electrodes": "anodic=1e-3,cathodic=1e-2,potential=-2,hydrogen_potential=-0.9",
    "hardening": ["mg-5gd-soft"],
    "pulls": 2,
    "samples": 200,
    "strength_tolerance": 0.01,
    "surrogate": 40,
    "until_left": 0.8,
    "until_force": "300N",
    "log": "events.jsonl",
}
"""Values of the options that do nothing where they are left out."""

HEAD = f"""\
# A run of perilife: `perilife run FILE` computes it. Options that are typed win over this file.
#
# Keys are the options of `perilife run`; units are typed as there (s min h d w, m cm mm um, deg
# rad), a bare number is SI, and files are looked for from the folder where perilife is started.
# A line with # in front of its key shows the default of resolution "quick", or an example.

kind = "{KINDS[0]}"
"""


def write_template(parser: argparse.ArgumentParser, given: argparse.Namespace) -> str:
    """The text of a scene file for the options of `parser`, those given without a # in front."""
    options, tables, defaults = options_of(parser), tables_of(parser), _defaults()
    lines = [HEAD]
    for table in ("", *dict.fromkeys(filter(None, tables.values()))):
        if table:
            lines.append(f"\n[{table}]")
        for name, action in options.items():
            if tables[name] != table or name == "scene":
                continue
            lines.append(_entry(name, action, getattr(given, name, None), defaults))
    return "\n".join(lines) + "\n"


def _entry(
    name: str, action: argparse.Action, given: object, defaults: Mapping[str, object]
) -> str:
    """The lines of one option: what it is, then key and value."""
    key = action.option_strings[-1].lstrip("-")
    text = " ".join((action.help or "").split())
    above = textwrap.fill(text, WIDTH, initial_indent="# ", subsequent_indent="# ")
    if given is None or given == action.default:
        given = FIRST.get(name)
    if given is not None:
        return f"{above}\n{key} = {_toml(given)}"
    value = defaults.get(name, action.default)
    value = list(value) if isinstance(value, tuple) else value
    example = value is None or value == []
    if example:
        value = EXAMPLES.get(name, action.metavar)
    if isinstance(value, float) and action.metavar in SI_UNIT:
        typed = _TYPED[SI_UNIT[action.metavar]](value)
        if SI_UNIT[action.metavar] != "m" or math.isclose(parse_length(typed), value, rel_tol=1e-9):
            value = typed  # else the number itself, in m: a third of a horizon
    return f"{above}\n#{key} = {_toml(value)}{'  # example' if example else ''}"


_TYPED: Mapping[str, Callable[[float], str]] = {
    "m": format_length,
    "s": lambda value: f"{value:g}s",
    "rad": lambda value: f"{math.degrees(value):g}deg",
}
"""SI unit -> how a number of it is typed."""


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_toml(entry) for entry in value)}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)  # texts, whole numbers, true and false are alike


def _defaults() -> dict[str, object]:
    """What a run takes where an option is left out, by keyword, SI; as resolved for Mg-5Gd."""
    scene, ions = resolve_scene(["Mg-5Gd"], ["8w"]), resolve_ions()
    parts = (scene.geometry.parameters, scene.domain, scene.corrosion, scene.tensile)
    found = {item.name: getattr(part, item.name) for part in parts for item in fields(part)}
    return {
        **found,
        "classes": AUTO,
        "parameters": scene.parameter_set,
        "spacing": scene.lattice.spacing,
        "horizon": scene.lattice.horizon,
        "domain": scene.domain.shape,
        "unit": "mm",
        "mesh_size": scene.mesh.size,
        "mesh_size_fine": scene.mesh.size_fine,
        "mesh_size_faces": PULLED_FACE_CELLS,
        "hold": [hold.name for hold in scene.holds],
        "bending_azimuth": 0.0,
        "medium": DEFAULT_MEDIUM,
        "minerals": list(ions.minerals),
        "activity": ions.activity,
        "flux_form": ions.flux_form,
        "closure": ions.closure,
    }
