"""A scene file: the options of a run in TOML, or the resolved scene that a run has stored.

    kind = "life-cycle"
    alloy = ["Mg-5Gd"]
    immersion = ["0w", "8w"]
    out = "runs/mine"

    [corrosion]
    spacing = "50um"

The keys are the names of the options of `perilife run`, in tables by the groups of its help or at
the top.  The file becomes arguments in front of those that were typed, which win.
"""

from __future__ import annotations

import argparse
import json
import math
import tomllib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from perilife_data import did_you_mean
from perilife_data.own_files import kind_of
from pipeline.scene.command.arguments import arguments_of, keyword, options_of, unknown_name
from pipeline.scene.command.parser import OneSentenceParser
from pipeline.scene.scene import Scene, SceneError, scene_from_json

LOCALISED = ("pit", "crevice", "galvanic", "intergranular", "couple")
"""Kinds of localised corrosion; pipeline.scenes reads their files."""
KINDS = ("life-cycle", *LOCALISED)
"""What a scene file can describe; the first where it does not say."""

GIVEN_BY = {
    "alloy": "--alloy",
    "parameter set": "--parameters",
    "hardening": "--hardening",
    "medium": "--medium",
}
"""Kind of a file of one's own -> the option that takes it, where it was given as a scene."""

GIVEN_BY_ENDING = {
    **dict.fromkeys((".step", ".stp", ".brep", ".stl"), "--solid"),
    **dict.fromkeys((".tif", ".tiff", ".mha", ".nrrd", ".nii"), "--image"),
}
"""Ending of a file that is no scene -> the option that takes it."""

STORED = ".json"
"""Ending of a resolved scene; everything else is TOML."""


def take_scene_file(
    parser: OneSentenceParser,
    known: Callable[[], argparse.ArgumentParser],
    without: Collection[str] = (),
    stored: bool = True,
    localised: bool = False,
) -> None:
    """Let a command take a scene file, as an argument that belongs to no option or by --scene.

    known: a parser with every option that the file may name; those that `parser` lacks, and those
    in `without`, are for other commands.  stored: whether a resolved scene will do, too.
    localised: whether a scene of localised corrosion will, too, in either form: it is left to the
    command (`localised_kind`).
    """
    which = "TOML, or scene.json of a run" if stored else "TOML"
    parser.add_argument("scene_file", nargs="?", metavar="SCENE", help=f"scene file: {which}")
    parser.add_argument("--scene", metavar="FILE", help="the same by name")

    if localised:
        defaults = {name: action.default for name, action in options_of(parser).items()}
        parser.set_defaults(defaults=defaults)

    def expand(arguments: list[str]) -> list[str]:
        own = options_of(parser)
        path, rest = _named(own, arguments)
        if path is None:
            return arguments
        local = localised and localised_kind(path) is not None
        if path.suffix == STORED or local:
            if not (stored or local):
                raise ValueError(f"scene file is '{path}'; it must be TOML for this command")
            for name in ("alloy", "immersion", *(("out",) if local and "out" in own else ())):
                own[name].required = False
            return ["--scene", str(path), *rest]
        values = read_scene_file(path, known())
        typed = {keyword(word.partition("=")[0]) for word in rest if word.startswith("--")}
        values = {
            name: value
            for name, value in values.items()
            if name in own and name not in typed and name not in without
        }
        try:
            return [*arguments_of(own, values), *rest]
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    parser.expand = expand


def _named(
    options: Mapping[str, argparse.Action], arguments: list[str]
) -> tuple[Path | None, list[str]]:
    """The scene file among the arguments, and the others.

    It is what follows --scene, and what no option takes.
    """
    found: list[str] = []
    rest: list[str] = []
    takes: float = 0
    for word in arguments:
        if word.startswith("--"):
            name, equals, value = word.partition("=")
            action = options.get(keyword(name))
            # of --help and an option that is not known, too: what the word is, the parser says
            takes = 0 if equals else 1 if action is None else _WORDS.get(action.nargs, 1)
            if keyword(name) == "scene" and equals:
                found.append(value)
                continue
        elif takes == 0 and not word.startswith("-"):
            found.append(word)
            continue
        else:
            takes = max(takes - 1, 0)
            if rest[-1:] == ["--scene"]:
                found.append(word)
                rest.pop()
                continue
        rest.append(word)
    for name in found:
        option = GIVEN_BY_ENDING.get(Path(name).suffix.lower())
        if option:
            raise ValueError(
                f"scene file is '{name}', which is no scene; give it as {option} {name}"
            )
    if len(found) > 1:
        raise ValueError(f"scene file is '{found[0]}' and '{found[1]}'; it must be one")
    return (Path(found[0]), rest) if found else (None, arguments)


_WORDS = {0: 0, "+": math.inf, "*": math.inf}
"""Words after an option by its nargs, where that is not one."""


def read_content(path: Path) -> dict:
    """What stands in a TOML or JSON file.

    Raises FileNotFoundError or ValueError with one sentence for a file that is not there or not
    of its kind.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == STORED else tomllib.loads(text)
    except FileNotFoundError:
        raise FileNotFoundError(f"scene file is '{path}'; there is no such file") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"'{path}' is not JSON: {error}") from None
    except UnicodeDecodeError:
        raise ValueError(f"scene file '{path}' is no text in UTF-8, which it must be") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        said = str(error) or "it is nested too deeply"
        raise ValueError(f"scene file '{path}' is not valid TOML: {said}") from None
    return content if isinstance(content, dict) else {}


def localised_kind(path: Path | str | None) -> str | None:
    """The kind of a file of localised corrosion; None for every other, and without a file."""
    try:
        kind = None if path is None else read_content(Path(path)).get("kind")
    except (OSError, ValueError):
        return None  # whoever reads it as a file of a life cycle says what is wrong
    return kind if kind in LOCALISED else None


def read_scene_file(path: Path, parser: argparse.ArgumentParser) -> dict[str, object]:
    """Values of a scene file by the keyword of their option.

    Raises FileNotFoundError or ValueError with one sentence for a file that is not there or not
    TOML, an unknown kind, a key that is no option, stands in another table or twice.
    """
    content = read_content(path)
    _refuse_data(path, content)
    kind = content.pop("kind", KINDS[0])
    if kind in LOCALISED:
        raise ValueError(f"{path}: kind is {kind!r}; for this command it must be {KINDS[0]}")
    if kind not in KINDS:
        near = did_you_mean(str(kind), KINDS)
        raise ValueError(f"{path}: kind is {kind!r}{near}; it must be {' or '.join(KINDS)}")
    options, tables = options_of(parser), tables_of(parser)
    values: dict[str, object] = {}
    for name, entry in content.items():
        table = isinstance(entry, Mapping)
        if table and name not in tables.values():
            near = did_you_mean(name, set(tables.values()))
            known = ", ".join(dict.fromkeys(filter(None, tables.values())))
            raise ValueError(f"{path}: table [{name}] is not known{near}; it must be of {known}")
        for key, value in entry.items() if table else [(name, entry)]:
            unknown = unknown_name(options, [key])
            if unknown:
                raise ValueError(
                    f"{path}: key {unknown} is no option of a run; `perilife init` lists them"
                )
            option = keyword(key)
            if table and tables[option] != name:
                right = f"in [{tables[option]}]" if tables[option] else "at the top"
                raise ValueError(f"{path}: key '{key}' stands in [{name}]; it must stand {right}")
            if option in values:
                raise ValueError(f"{path}: key '{key}' is there twice; it must be there once")
            values[option] = value
    return values


def _refuse_data(path: Path, content: Mapping[str, object]) -> None:
    """Refuse the file of an alloy, a medium, ... where a scene is to be, naming its option."""
    kind = kind_of(content)
    if kind in GIVEN_BY:
        raise ValueError(
            f"scene file is '{path}', which is the file of a{'n' * (kind == 'alloy')} {kind}; "
            f"give it as {GIVEN_BY[kind]} {path}"
        )


def tables_of(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Table of each option by keyword: the first word of its group in the help, "" at the top."""
    standard = {parser._positionals, parser._optionals}
    found = dict.fromkeys(options_of(parser), "")
    for group in parser._action_groups:
        if group in standard:
            continue
        table = str(group.title).replace(",", " ").split()[0]
        for action in group._group_actions:
            found[keyword(action.option_strings[-1])] = table
    return found


def read_stored(path: Path | str) -> Scene:
    """The resolved scene of a run from its scene.json; one sentence where that cannot be."""
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"scene file is '{path}'; there is no such file") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"'{path}' is not JSON: {error}") from None
    except RecursionError:
        raise SceneError(f"'{path}' is no scene: it is nested too deeply") from None
    return scene_from_json(content)
