"""Python's keywords are the command's options, and give the same scene."""

import argparse
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pipeline
from pipeline import LifeCycle
from pipeline.api.life_cycle import read_keywords
from pipeline.cli import build_parser
from pipeline.scene.command.arguments import options_of
from tests.pipeline.command_line import scene_of, typed

ROOT = Path(__file__).resolve().parents[3]
APART = {"json", "scene"}
"""What the command prints; the scene file, of which test_scene_file.py tells."""


def of_the_command() -> dict[str, argparse.Action]:
    """The options of `perilife run` by keyword, from the command's own parser."""
    parser = build_parser()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    found = options_of(commands.choices["run"])
    return {name: action for name, action in found.items() if name not in APART}


@pytest.mark.parametrize("name", of_the_command())
def test_every_option_of_the_command_has_its_keyword(name: str) -> None:
    action = of_the_command()[name]
    words, value = typed(action)
    base = {"alloy": "A", "immersion": "8w", "out": "here"}
    base.pop(name, None)
    given = read_keywords({**base, name: value})
    arguments = [action.option_strings[-1], *words]
    for key, text in base.items():
        arguments += [f"--{key}", text]
    asked = vars(build_parser().parse_args(["run", *arguments]))
    shared = {key: asked[key] for key in vars(given)}
    assert vars(given) == shared
    assert shared[action.dest] == getattr(given, action.dest) != action.default
    # and the command has nothing more that a run could depend on
    assert set(asked) - set(shared) == {"action", "command", "verbose", "version", "json"}


def test_help_and_completion_know_every_keyword() -> None:
    signature = inspect.signature(LifeCycle)
    assert set(signature.parameters) == set(of_the_command()) | {"scene"}
    assert signature.bind("Mg-5Gd", "8w", hold="slot").arguments["hold"] == "slot"
    assert signature.parameters["ranks"].default == 1


def test_numbers_are_si_and_texts_are_as_typed() -> None:
    asked = scene_of(
        ["--alloy", "Mg-5Gd", "--immersion", "1w", "8w", "--spacing", "50um", "--hold", "slot"]
        + ["--diameter", "2.1mm", "--load", "bending", "--bending-azimuth", "0.5rad"]
    )
    found = LifeCycle(
        "Mg-5Gd", ["1w", "8w"], spacing=np.float64(50e-6), hold=("slot",), diameter=2.1e-3,
        load="bending", bending_azimuth=0.5,
    )  # fmt: skip
    assert found.scene == asked
    assert LifeCycle("Mg-5Gd", 56 * 86400).scene.immersion[0].seconds == 56 * 86400
    assert LifeCycle("Mg-5Gd", "8w", step=None).scene.corrosion.step is None


@pytest.mark.parametrize(
    "keywords, error, words",
    [
        ({"spacng": "50um"}, TypeError, ["'spacng'", "did you mean spacing?"]),
        ({"strength_left": 0.5}, TypeError, ["'strength_left'", "did you mean strength_tolerance"]),
        ({"alloy": "mg5gd"}, ValueError, ["'mg5gd'", "did you mean Mg-5Gd?"]),
        ({"alloy": None}, ValueError, ["--alloy"]),
        ({"spacing": "100"}, ValueError, ["spacing '100'", "100um"]),
        ({"spacing": ["100um", "50um"]}, ValueError, ["spacing", "one value, not a list"]),
        ({"spacing": {"m": 1}}, ValueError, ["spacing", "text, a number or a list"]),
        ({"spacing": True}, ValueError, ["spacing is True"]),
        ({"resume": "yes"}, ValueError, ["resume is 'yes'", "true or false"]),
        ({"classes": 2.5}, ValueError, ["classes", "2.5"]),
        ({"immersion": 8}, ValueError, ["immersion: 8 is 8 s", "write 8w, 8d or 8h"]),
        ({"diameter": -2e-3}, ValueError, ["-0.002m", "negative"]),
        ({"hold": ["--resume"]}, ValueError, ["hold is '--resume'", "hyphen"]),
    ],
)
def test_what_cannot_be_is_refused_at_once(keywords: dict, error: type, words: list[str]) -> None:
    with pytest.raises(error) as refusal:
        LifeCycle(**{"alloy": "Mg-5Gd", "immersion": "8w", **keywords})
    for word in words:
        assert word in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_package_is_light_until_it_is_used() -> None:
    heavy = "{'vtk', 'vtkmodules', 'pyvista', 'gmsh', 'dolfinx', 'numba', 'scipy', 'matplotlib'}"
    code = (
        "import sys, pipeline, peri\n"
        "assert not any(name.startswith('pipeline.') for name in sys.modules)\n"
        "from pipeline import LifeCycle\n"
        f"assert not {heavy} & set(sys.modules), {heavy} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, env={"PYTHONPATH": "."})
    assert set(pipeline.__all__) <= set(dir(pipeline))
    with pytest.raises(AttributeError, match="has no attribute 'Lifecycle'"):
        pipeline.Lifecycle  # noqa: B018
