"""What tests of the command line share: short scenes, and what a refusal has to be like."""

import argparse

from pipeline.cli import main
from pipeline.scene.command.options import add_scene_options, scene_from_options

PIN = ["--thread", "none"]  # a plain pin: its solid takes a tenth of a second
COARSE = ["--spacing", "300um", "--horizon", "600um", "--radial-margin", "1mm"]
COARSE += ["--axial-margin", "1mm"]  # 300 um against the smallest feature, the slot of 500 um
STAGES = ("geometry", "corrode", "map", "pull")
SCENE = ["--alloy", "Mg-5Gd", "--immersion", "0w", "8w", *PIN]


QUANTITIES = {"LENGTH": "200um", "TIME": "6h", "T": "2w", "ANGLE": "30deg", "VOLUME": "50mL"}
"""Metavariable -> something of its dimension, as typed."""


def refused(capsys, arguments: list[str], *words: str) -> str:
    """Run the command, check that it refuses in one sentence with these words, return it."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    message = captured.err
    assert message.startswith("perilife: ")
    assert message.endswith(".\n")
    assert message.count("\n") == 1, message
    assert "Traceback" not in message
    for word in words:
        assert word in message, message
    return message


def changed(*changes: str) -> list[str]:
    """The short scene with more options."""
    return [*SCENE, *changes]


def scene_of(arguments: list[str]):
    """The scene that options give."""
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    return scene_from_options(parser.parse_args(arguments))


def typed(action: argparse.Action) -> tuple[list[str], object]:
    """Something that the option can take, as typed and as a value in Python."""
    if action.nargs == 0:
        return [], True
    if action.choices is not None:
        return [action.choices[-1]], action.choices[-1]
    if action.type is int:
        return ["3"], 3
    if action.type is float:
        return ["0.25"], 0.25
    text = QUANTITIES.get(str(action.metavar), "some")
    if action.nargs in ("+", "*"):
        return [text, f"1{text}"], [text, f"1{text}"]
    return [text], text
