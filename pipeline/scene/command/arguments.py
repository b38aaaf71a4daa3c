"""Values by the names of options, turned into the arguments that a command line would have.

Python's keywords and a scene file's keys go this way, so that there is one place that reads and
checks options: the parser and what builds a scene from its result.
"""

from __future__ import annotations

import argparse
import operator
import os
from collections.abc import Callable, Iterable, Mapping
from numbers import Real

from perilife_data import did_you_mean
from pipeline.scene.units import parse_angle, parse_length, parse_time, parse_volume

SI_UNIT = {"LENGTH": "m", "TIME": "s", "T": "s", "ANGLE": "rad", "F": "N"}
"""Metavariable of the options whose values are typed with a unit -> unit of a bare number."""

LEAST_BARE = {"T": 3600.0}
"""Metavariable -> the least bare number above 0, SI: who writes 8 for weeks does not mean 8 s."""

READERS: Mapping[str, Callable[[str, str], object]] = {
    "LENGTH": parse_length,
    "TIME": parse_time,
    "T": parse_time,
    "ANGLE": parse_angle,
    "VOLUME": parse_volume,
}
"""Metavariable -> what reads the text of such an option, given the option's name as well."""

AUTOMATIC = {"spacing": "auto"}
"""Option by keyword -> the word that it takes in place of a quantity."""


def options_of(parser: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """The options of a parser by their names as keywords (`mesh_size`), help left out."""
    return {
        keyword(action.option_strings[-1]): action
        for action in parser._actions
        if action.option_strings and not isinstance(action, argparse._HelpAction)
    }


def arguments_of(options: Mapping[str, argparse.Action], values: Mapping[str, object]) -> list[str]:
    """The arguments that say what `values` say by the names of options (keywords or dashed).

    A value is text as typed, a number (SI where the option is typed with a unit), a list of these
    where the option takes several, true or false where it takes none; None and false: left out.

    The names must be known (`unknown_name`).  Raises ValueError with one sentence for a value of a
    kind that the option does not take, and for a bare number below LEAST_BARE.
    """
    arguments = []
    for name, value in values.items():
        action = options[keyword(name)]
        if value is None:
            continue
        flag, words = action.option_strings[-1], action.option_strings[-1].lstrip("-")
        if action.nargs == 0:
            if not isinstance(value, bool):
                raise ValueError(f"{words} is {value!r}; it must be true or false")
            arguments += [flag] if value else []
            continue
        several = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
        repeated = isinstance(action, argparse._AppendAction)
        if several and action.nargs not in ("+", "*") and not repeated:
            raise ValueError(f"{words} is {value!r}; it must be one value, not a list")
        entries = [_text(words, entry, action.metavar) for entry in (value if several else [value])]
        for group in [[entry] for entry in entries] if repeated else [entries]:
            arguments += [flag, *group]
    return arguments


def check_units(options: Mapping[str, argparse.Action], given: argparse.Namespace) -> None:
    """Read what was typed with a unit as a run would; ValueError with one sentence."""
    for name, action in options.items():
        read, typed = READERS.get(str(action.metavar)), getattr(given, name, None)
        if read is None or typed in (None, AUTOMATIC.get(name)):
            continue
        for text in typed if isinstance(typed, list) else [typed]:
            read(text, name.replace("_", " "))


def unknown_name(options: Mapping[str, argparse.Action], names: Iterable[str]) -> str:
    """The first name that is no option's, quoted and with the nearest that is, or ""."""
    for name in names:
        if keyword(name) not in options:
            return f"'{name}'{did_you_mean(name, options)}"
    return ""


def _text(words: str, value: object, metavar: object) -> str:
    """A value as it would be typed."""
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if text.startswith("-") and not text[1:2].isdigit():
            raise ValueError(f"{words} is '{text}'; it must not begin with a hyphen")
        return text
    if isinstance(value, Real) and not isinstance(value, bool):
        number = operator.index(value) if hasattr(value, "__index__") else float(value)
        if 0 < number < LEAST_BARE.get(str(metavar), 0.0):
            raise ValueError(
                f"{words}: {number:g} is {number:g} {SI_UNIT[str(metavar)]}; write {number:g}w, "
                f"{number:g}d or {number:g}h"
            )
        return f"{number!r}{SI_UNIT.get(str(metavar), '')}"
    raise ValueError(f"{words} is {value!r}; it must be text, a number or a list of these")


def keyword(name: str) -> str:
    """The name of an option as a keyword: `mesh_size` of `--mesh-size`."""
    return name.lstrip("-").replace("-", "_")
