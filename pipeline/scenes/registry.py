"""Kinds of scenes of localised corrosion, and the scenes that are shipped, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from perilife_data import did_you_mean
from pipeline.scene.command.scene_file import LOCALISED
from pipeline.scenes import couples, crevices, implants, sections
from pipeline.scenes.keys import Given, Key
from pipeline.scenes.outcome import Prepared

SHIPPED = Path(__file__).parent / "shipped"


@dataclass(frozen=True)
class Kind:
    """What a file of a kind may say, and the scene it makes.

    keys : by "table.key".  prepare : from the values of a file to what can be run.  example : the
    shipped scene that `perilife init` shows.
    """

    keys: Mapping[str, Key]
    prepare: Callable[[Given], Prepared]
    example: str


KINDS: dict[str, Kind] = {
    "pit": Kind(sections.PIT_KEYS, sections.pit, "pit-304"),
    "crevice": Kind(crevices.KEYS, crevices.prepare, "crevice-625"),
    "galvanic": Kind(couples.KEYS, couples.prepare, "galvanic-ae44-steel"),
    "intergranular": Kind(sections.GRAIN_KEYS, sections.grains, "intergranular"),
    "couple": Kind(implants.KEYS, implants.prepare, "screw-in-titanium-plate"),
}
assert tuple(KINDS) == LOCALISED


@cache
def shipped() -> dict[str, Path]:
    """The shipped scene files by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def path_of(name: str) -> Path:
    """The file of a shipped scene; ValueError that names the known ones."""
    if name not in shipped():
        if Path(name).is_file():
            raise ValueError(f"scene is the file '{name}', which `perilife run {name}` computes")
        near, known = did_you_mean(name, shipped()), ", ".join(shipped())
        raise ValueError(f"scene '{name}' is not known{near}; it must be one of {known}")
    return shipped()[name]
