"""What a design may vary: a range of a length or a coating's number, or a list of any option."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.campaigns.options import COATING, LENGTHS
from pipeline.scene.command.options import add_scene_options
from pipeline.scene.laws.coating import CoatingScene, read_coating
from pipeline.scene.units import format_length, parse_length, parse_time

GRID = 5
"""Values of a second range."""


@dataclass(frozen=True)
class Scalar:
    """A number that a range is of: how it is read, written as its option takes it, and shown.

    grain: values tried are multiples of it, so that what is written is what is meant.
    """

    read: Callable[[str, str], float]
    write: Callable[[float], str]
    show: Callable[[float], str]
    grain: float


def _share(text: str, name: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} '{text}' is not a number; write one, as 0.1") from None


_LENGTH = Scalar(parse_length, lambda v: f"{1e6 * v:.6g}um", format_length, 1e-6)
SCALARS: dict[str, Scalar] = {
    **{name: _LENGTH for name in LENGTHS},
    "coating_factor": Scalar(_share, lambda v: f"{v:.6g}", lambda v: f"{v:.6g}", 1e-4),
    "coating_lifetime": Scalar(
        lambda text, name: parse_time(text, name).seconds,
        lambda v: f"{v / 3600:.6g}h",
        lambda v: f"{v / 86400:.6g} d",
        3600.0,
    ),
}


@dataclass(frozen=True)
class Range:
    """A number between two values, low < high, SI."""

    name: str
    low: float
    high: float

    @property
    def scalar(self) -> Scalar:
        """How the number is written."""
        return SCALARS[self.name]

    def rounded(self, value: float) -> float:
        """The nearest value that is tried."""
        return self.scalar.grain * round(value / self.scalar.grain)

    def points(self) -> list[str]:
        """`GRID` values, ends included, as their option takes them."""
        values = np.linspace(self.low, self.high, GRID)
        return [self.scalar.write(self.rounded(value)) for value in values]


@dataclass(frozen=True)
class Choice:
    """A list of values of one option, as typed."""

    name: str
    values: tuple[str, ...]

    def points(self) -> list[str]:
        """The values."""
        return list(self.values)


def read_vary(text: str) -> Range | Choice:
    """Read NAME=LOW:HIGH or NAME=A,B; ValueError with one sentence."""
    typed, equals, values = text.partition("=")
    name = typed.replace("-", "_")
    ranges = ", ".join(n.replace("_", "-") for n in SCALARS)
    if not equals or not (name in SCALARS or name in _scene_options()):
        raise ValueError(
            f"--vary is '{text}'; it must be NAME=LOW:HIGH, NAME of {ranges}, or NAME=A,B of an "
            "option of `perilife run`, as alloy=A,B"
        )
    low, colon, high = values.partition(":")
    if colon and name in SCALARS:
        scalar, words = SCALARS[name], name.replace("_", " ")
        ends = [scalar.read(end, words) for end in (low, high)]
        if not 0 <= ends[0] < ends[1] or (ends[0] == 0 and name != "coating_factor"):
            raise ValueError(f"--vary is '{text}'; the range must rise from above 0")
        return Range(name, *ends)
    listed = tuple(value.strip() for value in values.split(",") if value.strip())
    if len(listed) < 2 or len(set(listed)) < len(listed):
        more = f", or {typed}=LOW:HIGH" if name in SCALARS else ""
        raise ValueError(f"--vary is '{text}'; it must list two different values at least{more}")
    return Choice(name, listed)


def changed(options: argparse.Namespace, name: str, text: str) -> argparse.Namespace:
    """The options with another value of one; ValueError where that is not understood."""
    options = copy.copy(options)
    if name in COATING:
        if options.coating is None:
            typed = name.replace("_", "-")
            raise ValueError(f"--vary {typed} needs --coating, whose other number it keeps")
        known = read_coating(options.coating)
        numbers = {"factor": known.factor, "lifetime": known.lifetime}
        numbers[name.removeprefix("coating_")] = SCALARS[name].read(text, name.replace("_", " "))
        new = CoatingScene(**numbers)
        options.coating = f"factor={new.factor!r},lifetime={new.lifetime!r}s"
        return options
    parser = _parser()
    needed = [] if name == "alloy" else ["--alloy", *options.alloy]
    parsed = parser.parse_args([*needed, f"--{name.replace('_', '-')}", text])
    setattr(options, name, getattr(parsed, name))
    return options


class _Parser(argparse.ArgumentParser):
    """A parser that refuses in one sentence."""

    def error(self, message: str) -> None:
        raise ValueError(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(add_help=False, allow_abbrev=False)
    add_scene_options(parser, immersion=False)
    return parser


def _scene_options() -> set[str]:
    return {action.dest for action in _parser()._actions} - {"volume_loss", "model"}
