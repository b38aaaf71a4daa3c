"""Keys of the scene files of localised corrosion: dimension, range and meaning; what a file gives.

A value is a text with its unit ("50um"), a number in SI, or a table with `value` and where it comes
from (`source`, `where`, `kind`).  A bare value is of kind "given": the person's own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from perilife_data import did_you_mean
from perilife_data.units import UNITS, to_si
from pipeline.scenes.outcome import Value

TEXT, COUNT = "text", "whole number"
PROVENANCE = ("value", "source", "where", "kind")
"""Keys of a value that says where it comes from."""
SOURCES = ("published", "measured", "fitted", "derived", "assumed", "given")
"""Kinds of values; `given`: stands in the person's file without a source."""
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*)?")


@dataclass(frozen=True)
class Key:
    """One key.

    dimension : of perilife_data.units, or TEXT or COUNT.  text : what it is, and what is taken
    where it is left out.  above, at_least, at_most : limits, SI.  allowed : of a TEXT.  several :
    a list of such.  example : shown in a template.
    """

    dimension: str
    text: str
    example: object
    above: float = -math.inf
    at_least: float = -math.inf
    at_most: float = math.inf
    allowed: tuple[str, ...] = ()
    several: bool = False

    @property
    def unit(self) -> str:
        """The SI unit, or nothing."""
        return "" if self.dimension in (TEXT, COUNT) else next(iter(UNITS[self.dimension]))

    def read(self, entry: object, where: str) -> object:
        """An entry in SI; ValueError with one sentence that begins with `where`."""
        if self.several:
            if not isinstance(entry, list) or not entry:
                raise ValueError(f"{where} is {entry!r}; it must be a list")
            return [self._one(item, where) for item in entry]
        return self._one(entry, where)

    def _one(self, entry: object, where: str) -> object:
        if self.dimension == TEXT:
            if not isinstance(entry, str) or not entry.strip():
                raise ValueError(f"{where} is {entry!r}; it must be a text in quotes")
            if self.allowed and entry not in self.allowed:
                near = did_you_mean(entry, self.allowed)
                one = ", ".join(self.allowed)
                raise ValueError(f"{where} is '{entry}'{near}; it must be one of {one}")
            return entry
        value = self._number(entry, where)
        if self.dimension == COUNT and value != int(value):
            raise ValueError(f"{where} is {entry!r}; it must be a whole number")
        if not (value > self.above and self.at_least <= value <= self.at_most):
            raise ValueError(f"{where} is {entry!r}; it must be {self.range()}")
        return int(value) if self.dimension == COUNT else value

    def _number(self, entry: object, where: str) -> float:
        if isinstance(entry, str) and self.unit:
            match = _NUMBER.fullmatch(entry.strip())
            units = UNITS[self.dimension]
            if match is None or (match[2] or "1") not in units:
                known = ", ".join(units)
                raise ValueError(
                    f"{where} is '{entry}'; it must be a number with a unit of {self.dimension} "
                    f"({known})"
                )
            value = to_si(float(match[1]), match[2] or "1", self.dimension)
        elif isinstance(entry, int | float) and not isinstance(entry, bool):
            value = float(entry)
        else:
            raise ValueError(f"{where} is {entry!r}; it must be a number, or a text with a unit")
        if not math.isfinite(value):
            raise ValueError(f"{where} is {entry!r}; it must be finite")
        return value

    def range(self) -> str:
        """What is allowed, in words."""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        parts = []
        if self.above > -math.inf:
            parts.append(f"above {self.above:g}{unit}")
        if self.at_least > -math.inf:
            parts.append(f"at least {self.at_least:g}{unit}")
        if self.at_most < math.inf:
            parts.append(f"at most {self.at_most:g}{unit}")
        return " and ".join(parts) or "finite"


def positive(dimension: str, text: str, example: object, **limits: object) -> Key:
    """A key that is above 0."""
    return Key(dimension, text, example, above=0.0, **limits)  # type: ignore[arg-type]


@dataclass
class Given:
    """The values of a scene by their keys ("liquid.diffusivity"), what was left out added on use.

    file : how the scene is called in a refusal.
    """

    values: dict[str, Value]
    file: str
    used: set[str] = field(default_factory=set)

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def __getitem__(self, key: str) -> object:
        """The value in SI; ValueError where it is missing."""
        self.used.add(key)
        if key not in self.values:
            raise ValueError(f"{self.file}: {key} is missing")
        return self.values[key].value

    def number(self, key: str) -> float:
        """A number."""
        value = self[key]
        assert isinstance(value, int | float)
        return value

    def text(self, key: str) -> str:
        """A text."""
        return str(self[key])

    def vector(self, key: str, length: int) -> tuple[float, ...]:
        """A list of as many numbers as the scene has axes."""
        value = self[key]
        assert isinstance(value, list)
        if len(value) != length:
            raise ValueError(
                f"{self.file}: {key} has {len(value)} entries; it must have {length}, one per axis"
            )
        return tuple(value)

    def otherwise(self, key: str, value: float | str, unit: str, because: str) -> object:
        """The value of a key, or this one, which is recorded then."""
        if key not in self.values:
            self.values[key] = Value(value, unit, "", because, "assumed")
        return self[key]

    def names(self, table: str) -> list[str]:
        """Names of the tables in a table."""
        head = f"{table}."
        found = [key[len(head) :].split(".")[0] for key in self.values if key.startswith(head)]
        return list(dict.fromkeys(found))

    def left_over(self) -> None:
        """Refuse values that this scene does not look at."""
        extra = [key for key in self.values if key not in self.used]
        if extra:
            raise ValueError(
                f"{self.file}: {extra[0]} is given, but a scene with these other values has no "
                "use for it"
            )


def read_values(
    keys: Mapping[str, Key], content: Mapping[str, object], file: str
) -> dict[str, Value]:
    """The values of a file's tables.

    keys : by "table.key", or "table.*.key" where any name may stand.

    Raises ValueError for a key or table that is not known, with the nearest that is, and for what
    Key.read refuses.
    """
    tables = list(dict.fromkeys(key.split(".")[0] for key in keys))
    found: dict[str, Value] = {}
    for table, entries in content.items():
        if table not in tables:
            raise ValueError(
                f"{file}: {'table' if isinstance(entries, Mapping) else 'key'} '{table}' is not "
                f"known{did_you_mean(table, tables)}; tables are {', '.join(tables)}"
            )
        if not isinstance(entries, Mapping):
            raise ValueError(f"{file}: {table} is {entries!r}; it must be a table [{table}]")
        named = f"{table}.*." in {key[: len(table) + 3] for key in keys}
        if not named:
            _read_table(keys, table, table, entries, file, found)
            continue
        for name, inner in entries.items():
            if not isinstance(inner, Mapping):
                raise ValueError(f"{file}: {table}.{name} is {inner!r}; it must be a table")
            if not name or "." in name:
                raise ValueError(f"{file}: [{table}.'{name}']; a name must have no dot")
            _read_table(keys, f"{table}.*", f"{table}.{name}", inner, file, found)
    return found


def _read_table(keys, pattern: str, table: str, entries: Mapping, file: str, found: dict) -> None:
    known = [key[len(pattern) + 1 :] for key in keys if key.startswith(f"{pattern}.")]
    for name, entry in entries.items():
        if name not in known:
            raise ValueError(
                f"{file}: {table}.{name} is not known{did_you_mean(name, known)}; keys of "
                f"[{table}] are {', '.join(known)}"
            )
        where = f"{file}: {table}.{name}"
        found[f"{table}.{name}"] = _value(keys[f"{pattern}.{name}"], entry, where)


def _value(key: Key, entry: object, where: str) -> Value:
    """A value with its provenance."""
    about: dict[str, object] = {"value": entry}
    if isinstance(entry, Mapping):
        about = dict(entry)
        for name, text in about.items():
            if name not in PROVENANCE:
                near = did_you_mean(name, PROVENANCE)
                raise ValueError(
                    f"{where}.{name} is not known{near}; a value has {', '.join(PROVENANCE)}"
                )
            if name != "value" and not isinstance(text, str):
                raise ValueError(f"{where}.{name} is {text!r}; it must be a text in quotes")
        if "value" not in about:
            raise ValueError(f"{where}.value is missing")
    kind = str(about.get("kind", "given"))
    if kind not in SOURCES:
        near, one = did_you_mean(kind, SOURCES), ", ".join(SOURCES)
        raise ValueError(f"{where}.kind is '{kind}'{near}; it must be one of {one}")
    value = key.read(about["value"], where)
    source, place = str(about.get("source", "")), str(about.get("where", ""))
    return Value(value, key.unit, source, place, kind)  # type: ignore[arg-type]
