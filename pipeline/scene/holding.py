"""The ways of holding a solid in the mechanical test, and the question that each answers.

How a corroded solid is held decides which part of it is tested, and with it the strength left.
"""

from dataclasses import dataclass

from pipeline.scene.image import ImageFile
from pipeline.scene.scene import Geometry, SceneError, ScrewGeometry
from pipeline.scene.units import format_length

GIVEN = "own"
"""Name of a way of holding whose depths were given one by one."""

SHORTEST_GRIP = 1e-6
"""The shortest grip (m) that holds more than an end face; far below any cell's edge."""

SLOT_HORIZONS = 1.5
"""Depth of the top grip where the slotted section is tested, in horizons: below the crust of the
end face, which is one horizon deep."""


@dataclass(frozen=True)
class Holding:
    """A way of holding for a reader.

    part: what is tested, as the subject of a sentence; grips: what the grips hold; question: what
    the strength left answers.
    """

    part: str
    grips: str
    question: str


HOLDINGS: dict[str, Holding] = {
    "shank": Holding(
        "the shank",
        "both ends, below what corrodes there",
        "How strong is the body between two ends that are held as deep as they corrode?",
    ),
    "slot": Holding(
        "the slotted section",
        "the bottom below what corrodes there, the slotted top below the crust of its end face",
        "How strong is the end with the slot, where least metal is?",
    ),
    "faces": Holding(
        "the layer at the end faces",
        "the end faces alone, as published",
        "How firmly does the outermost corroded layer still sit on the end?",
    ),
    GIVEN: Holding(
        "the part between the grips",
        "the ends, as deep as given",
        "How strong is what lies between grips of these depths?",
    ),
}


ALL = ("shank", "slot", "faces")
"""The ways that `--hold all` asks for, where the solid has a slot."""


def crust_depth(geometry: Geometry, horizon: float) -> float:
    """How deep an end corrodes while its outermost metal is still there (m).

    The depth of the slot and, below it, a horizon.  No slot is known of a solid from a file.
    """
    return (geometry.parameters.slot_depth if has_slot(geometry) else 0.0) + horizon


def has_slot(geometry: Geometry) -> bool:
    """Whether the solid is known to have a slot."""
    return isinstance(geometry, ScrewGeometry) and geometry.parameters.has_slot


def grip_depths(name: str, geometry: Geometry, horizon: float) -> tuple[float, float]:
    """Lengths (m) that the bottom and the top grip of a way of holding hold.

    Raises SceneError for an unknown name, for the slotted section of a solid without slot, and for
    the end faces of a solid from an image.
    """
    deep = crust_depth(geometry, horizon)
    if name == "shank":
        return deep, deep
    if name == "faces":
        check_ends((0.0, 0.0), geometry)
        return 0.0, 0.0
    if name != "slot":
        raise SceneError(f"hold is '{name}'; it must be one of {', '.join(ALL)}, all")
    top = SLOT_HORIZONS * horizon
    if not has_slot(geometry):
        others = "shank" if isinstance(geometry, ImageFile) else "shank or faces"
        raise SceneError(f"hold is 'slot' and the solid has no slot; it must be {others}")
    if top >= geometry.parameters.slot_depth:
        raise SceneError(
            f"hold is 'slot' and the slot is {1e3 * geometry.parameters.slot_depth:g} mm deep; it "
            f"must be deeper than the top grip, {SLOT_HORIZONS:g} horizons, {1e3 * top:g} mm"
        )
    return deep, top


def check_ends(depths: tuple[float, float], geometry: Geometry) -> None:
    """Refuse to hold an end face that is not plane, as those of a solid from an image are not.

    And grips shorter than any cell, which hold an end face and are not treated as such.
    """
    for name, depth in zip(("bottom", "top"), depths, strict=True):
        if 0.0 < depth < SHORTEST_GRIP:
            raise SceneError(
                f"{name} grip is {format_length(depth)}; it must be 0mm (the end face) or at least "
                f"{format_length(SHORTEST_GRIP)}"
            )
    if 0.0 in depths and isinstance(geometry, ImageFile):
        raise SceneError(
            "an end face is to be held and the solid is from an image, whose ends are round at the "
            "rim and rough; it must be held deeper (--hold shank, or both grips above 0)"
        )


def named(depths: tuple[float, float], geometry: Geometry, horizon: float) -> str:
    """The name of the way of holding with these depths (m), GIVEN where it has none."""
    for name in ALL:
        if name == "slot" and not has_slot(geometry):
            continue
        try:
            known = grip_depths(name, geometry, horizon)
        except SceneError:
            continue
        if all(abs(a - b) < 1e-9 for a, b in zip(known, depths, strict=True)):
            return name
    return GIVEN


def asked_for(names: list[str], geometry: Geometry, horizon: float) -> list[str]:
    """The names with `all` spelt out: every way that the solid allows."""
    if "all" not in names:
        return list(names)
    if len(names) > 1:
        raise SceneError(f"hold is {' '.join(names)}; all must stand alone")
    possible = []
    for name in ALL:
        try:
            grip_depths(name, geometry, horizon)
        except SceneError:
            continue
        possible.append(name)
    return possible
