"""Scene files of localised corrosion: TOML that a person writes, and the scene.json of a run.

    kind = "galvanic"
    immersion = ["0s", "3d"]
    out = "runs/mine"

    [lattice]
    spacing = "0.1mm"

Keys of the tables: those of the kind (pipeline.scenes.registry); a value is a text with its unit, a
number in SI, or a table that says where it comes from (pipeline.scenes.keys).
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from perilife_data import did_you_mean
from pipeline.scene.command.scene_file import read_content
from pipeline.scene.units import ImmersionTime, parse_immersion_times, parse_length
from pipeline.scenes.keys import Given, Key, read_values
from pipeline.scenes.outcome import Prepared, Value
from pipeline.scenes.registry import KINDS

TOP = ("kind", "title", "immersion", "out")
"""Keys above the tables."""
WIDTH = 88


@dataclass(frozen=True)
class SceneFile:
    """What a file says.  name : how the scene is called.  values : of its tables, SI."""

    name: str
    kind: str
    title: str
    times: tuple[ImmersionTime, ...]
    out: str | None
    values: Mapping[str, Value]
    beside: Mapping[str, Value] | None = None

    def prepared(self) -> Prepared:
        """The scene, checked and ready to run.

        Raises ValueError for what does not fit, and where a stored scene used data that have
        changed since.
        """
        ready = KINDS[self.kind].prepare(Given(dict(self.values), self.name))
        if self.beside is not None:
            for name, now in ready.beside.items():
                before = self.beside.get(name)
                if before is None or before.value != now.value:
                    raise ValueError(
                        f"{self.name}: {name} has changed since this scene was stored; run its "
                        "TOML file"
                    )
        return ready

    def changed(self, spacing: str | None, times: Sequence[str] | None) -> SceneFile:
        """With another spacing or other times, as typed; a horizon grows to two spacings."""
        values = dict(self.values)
        if spacing is not None:
            length = parse_length(spacing, "spacing")
            values["lattice.spacing"] = Value(length, "m", "", "typed", "given")
            horizon = values.get("lattice.horizon")
            if horizon is not None and float(horizon.value) < 2 * length:  # type: ignore[arg-type]
                values["lattice.horizon"] = Value(2 * length, "m", "", "two spacings", "given")
        moments = self.times if times is None else _times(list(times), "--immersion")
        return SceneFile(self.name, self.kind, self.title, moments, self.out, values, self.beside)


def read_scene(path: Path) -> SceneFile:
    """A scene from a TOML file, or from the scene.json of a run.

    Raises FileNotFoundError or ValueError with one sentence.
    """
    content = read_content(path)
    kind = content.get("kind")
    if kind not in KINDS:
        known = " or ".join(KINDS)
        raise ValueError(f"{path}: kind is {kind!r}{did_you_mean(str(kind), KINDS)}; it must be "
                         f"{known}")  # fmt: skip
    if path.suffix == ".json":
        return _stored(path, content)
    tables = {name: entry for name, entry in content.items() if name not in TOP}
    for name, entry in tables.items():
        if not isinstance(entry, Mapping):
            near = did_you_mean(name, [*TOP, *(key.split(".")[-1] for key in KINDS[kind].keys)])
            raise ValueError(
                f"{path.name}: key '{name}' is not known at the top{near}; there are "
                f"{', '.join(TOP)}"
            )
    values = read_values(KINDS[kind].keys, tables, path.name)
    times = content.get("immersion")
    if isinstance(times, str):
        times = [times]
    if not isinstance(times, list) or not all(isinstance(t, str) for t in times):
        raise ValueError(
            f'{path.name}: immersion is {times!r}; it must be a list of times such as ["0s", "3d"]'
        )
    for name in ("title", "out"):
        if not isinstance(content.get(name, ""), str):
            raise ValueError(f"{path.name}: {name} is {content[name]!r}; it must be a text")
    return SceneFile(
        path.stem, kind, content.get("title", ""), _times(times, "immersion"), content.get("out"),
        values,
    )  # fmt: skip


def _times(texts: list[str], what: str) -> tuple[ImmersionTime, ...]:
    times = parse_immersion_times(texts)
    if not times[-1].seconds > 0:
        raise ValueError(f"{what} is {texts[-1]}; the last must be above 0")
    return times


def to_json(scene: SceneFile, ready: Prepared) -> dict:
    """What a run stores: every value, also those that were left out, and the data that it used."""
    return {
        "kind": scene.kind,
        "scene": scene.name,
        "title": scene.title,
        "immersion": [time.label for time in scene.times],
        "values": {name: asdict(value) for name, value in ready.values.items()},
        "data": {name: asdict(value) for name, value in ready.beside.items()},
    }


def _stored(path: Path, content: Mapping) -> SceneFile:
    try:
        known = {item.name for item in fields(Value)}
        tables = []
        for name in ("values", "data"):
            entries = content[name]
            assert all(set(entry) == known for entry in entries.values())
            tables.append({key: Value(**entry) for key, entry in entries.items()})
        values, beside = tables
        _check_keys(KINDS[content["kind"]].keys, values)
        times = _times(list(content["immersion"]), "immersion")
        return SceneFile(
            str(content["scene"]), content["kind"], str(content["title"]), times, None, values,
            beside,
        )  # fmt: skip
    except (KeyError, TypeError, AttributeError, AssertionError):
        raise ValueError(f"'{path}' is no scene that a run has stored") from None


def _check_keys(keys: Mapping[str, Key], values: Mapping[str, Value]) -> None:
    """Each value once more as its key reads it, so that a hand that edits is met, too."""
    for name, value in values.items():
        table, *rest = name.split(".")
        pattern = name if name in keys else ".".join([table, "*", *rest[1:]])
        keys[pattern].read(value.value, f"scene.json: {name}")


def write_template(scene: SceneFile, out: str | None) -> str:
    """A scene file with every key of its kind; those that the scene lacks behind a #."""
    kind, out = scene.kind, out or scene.out or "runs/mine"
    lines = [
        "# A scene of localised corrosion: `perilife run FILE` computes it, `perilife plan FILE` "
        "says",
        "# how large it is and what it need not compute. A value is a text with its unit, a number"
        " in SI,",
        "# or a table { value, source, where, kind }. A line with # in front of its key is an "
        "example.",
        "",
        f"kind = {json.dumps(kind)}",
        f"title = {json.dumps(scene.title)}",
        f"immersion = {json.dumps([time.label for time in scene.times])}",
        f"out = {json.dumps(out)}",
    ]
    keys = KINDS[kind].keys
    given = Given(dict(scene.values), scene.name)
    tables: list[tuple[str, str]] = []
    for key in keys:
        table = key.rsplit(".", 1)[0]
        named = table.endswith(".*")
        names = [f"{table[:-2]}.{n}" for n in given.names(table[:-2])] if named else [table]
        tables += [(table, name) for name in names if (table, name) not in tables]
    shown = set()
    for pattern, table in tables:
        lines += ["", f"[{table}]"]
        for key, spec in keys.items():
            head, name = key.rsplit(".", 1)
            value = scene.values.get(f"{table}.{name}")
            if head == pattern and (value is not None or pattern not in shown):
                lines += _entry(name, spec, value)
        shown.add(pattern)
    return "\n".join(lines) + "\n"


def _entry(name: str, key: Key, value: Value | None) -> list[str]:
    above = textwrap.wrap(key.text, WIDTH, initial_indent="# ", subsequent_indent="# ")
    if value is None:
        return [*above, f"#{name} = {_toml(key.example)}"]
    shown = value.value
    if key.dimension == "length":
        shown = _lengths(shown)
    elif key.unit not in ("", "1"):
        shown = f"{shown!r} {key.unit}"
    parts = [f"value = {_toml(shown)}"]
    about = (("source", value.source), ("where", value.where), ("kind", value.kind))
    if value.kind == "given" and not (value.source or value.where):
        return [*above, f"{name} = {_toml(shown)}"]
    parts += [f"{word} = {json.dumps(text)}" for word, text in about if text]
    return [*above, f"{name} = {{ {', '.join(parts)} }}"]


def _lengths(value: object) -> object:
    """Lengths as one types them, where that says the same number; else with all digits in m."""
    if isinstance(value, list):
        return [_lengths(item) for item in value]
    assert isinstance(value, float)
    key = Key("length", "", "")
    units = (("um", 1e-6), ("mm", 1e-3))
    for unit, share in units if abs(value) < 1e-4 else reversed(units):
        text = f"{value / share:.6g}{unit}"
        if key.read(text, "") == value:
            return text
    return f"{value!r}m"


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
