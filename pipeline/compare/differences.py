"""In which numbers and choices the scenes of several runs differ, by name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from pipeline.report.provenance import shown, title_of
from pipeline.scene.scene import Scene, ScrewGeometry

ABSENT = "–"
"""What stands where a run has no such part: another alloy, another kind of solid."""

_NAMES_OF_THE_USER = ("alloys", "parameter_set", "measured_volume_loss", "solid", "hardening")
"""Texts whose underscores belong to a name."""


@dataclass(frozen=True)
class Difference:
    """A field that is not alike in all runs that have it: its value in each, for a reader."""

    group: str
    name: str
    values: tuple[str, ...]


def differences(scenes: Sequence[Scene]) -> list[Difference]:
    """What differs between the scenes, in the order of a scene.

    A part that only some runs have (an alloy, a way of holding, the measures of a screw) is named
    by what lists such parts; its fields count only where two runs that have the part differ.
    """
    listed = [dict(_entries(scene)) for scene in scenes]
    found = []
    for key in dict.fromkeys(key for entries in listed for key in entries):
        given = [entries[key] for entries in listed if key in entries]
        if all(value == given[0] for value in given):
            continue
        values = _told_apart(key[1], [entries.get(key, ABSENT) for entries in listed])
        found.append(Difference(key[0], title_of(key[1]), values))
    return found


def _entries(scene: Scene) -> Iterator[tuple[tuple[str, str], object]]:
    """Group and field of everything that a scene says, with its value."""
    run = "Run"
    yield (run, "alloys"), ", ".join(alloy.name for alloy in scene.alloys)
    yield (run, "immersion"), ", ".join(time.label for time in scene.immersion)
    yield (run, "ways_of_holding"), ", ".join(hold.name for hold in scene.holds)
    yield (run, "model"), "bi-material" if scene.ions is None else "nnpp"
    yield (run, "resolution"), scene.resolution
    yield (run, "parameter_set"), scene.parameter_set
    measured = (f"{alloy}: {path}" for alloy, path in scene.measured_volume_loss.items())
    yield (run, "measured_volume_loss"), ", ".join(measured) or "none"
    solid = scene.geometry
    if isinstance(solid, ScrewGeometry):
        yield ("Geometry", "solid"), "a screw by its measures"
        yield from _fields("Geometry", solid.parameters)
    else:  # from a file or an image; the same content may lie elsewhere
        yield ("Geometry", "solid"), Path(solid.path).name
        yield ("Geometry", "content"), f"SHA-256 {solid.sha256[:12]}"
        for key, value in _fields("Geometry", solid):
            if key[1] not in ("path", "sha256", "kind"):
                yield key, value
    yield from _fields("Lattice", scene.lattice)
    yield from _fields("Liquid domain", scene.domain)
    yield from _fields("Corrosion solver", scene.corrosion)
    for hold in scene.holds:
        yield from _fields(f"Mesh ({hold.name})", hold.mesh)
        yield from _fields(f"Test ({hold.name})", hold.tensile)
    for alloy in scene.alloys:
        yield from _fields(alloy.name, alloy.corrosion)
        yield from _fields(alloy.name, alloy.material)
        yield (alloy.name, "hardening"), alloy.hardening or "the alloy's own"
    if scene.ions is not None:
        for item in fields(scene.ions):
            yield from _leaves("Ions", item.name, getattr(scene.ions, item.name))


def _fields(group: str, part: object) -> Iterator[tuple[tuple[str, str], object]]:
    for item in fields(part):
        yield (group, item.name), getattr(part, item.name)


def _leaves(group: str, name: str, value: object) -> Iterator[tuple[tuple[str, str], object]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(group, f"{name}: {key}", inner)
    else:
        yield (group, name), value


def _told_apart(name: str, values: Sequence[object]) -> tuple[str, ...]:
    """The values for a reader; in full where rounding would make two of them one."""
    brief = [_text(name, value) for value in values]
    distinct = {repr(value) for value in values}
    if len(set(brief)) == len(distinct):
        return tuple(brief)
    return tuple(ABSENT if value is ABSENT else repr(value) for value in values)


def _text(name: str, value: object) -> str:
    if value is ABSENT:
        return ABSENT
    if value is None:
        return "none"
    if name in _NAMES_OF_THE_USER:
        return str(value)
    if isinstance(value, list):
        value = tuple(value)
    return " ".join(filter(None, shown(name, value)))
