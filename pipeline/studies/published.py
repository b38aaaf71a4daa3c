"""The published tensile outcome beside what is computed when the end faces are pulled.

The source (Hermann 2024, 5.4) prints no table and its figures are not at hand: what is known is its
text.  Each statement of the text is held against the course of the strength left by several
readings of the set-up that the text does not decide between.  A statement counts as reproduced if
every reading shows it, as not reproduced if none does, else as not decidable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.scene.published import UNDECIDED
from pipeline.scene.resolve import DEFAULT_PARAMETER_SET, resolve_scene
from pipeline.scene.scene import DomainSettings
from pipeline.stages.damage_map import net_section
from pipeline.studies.workshop import (
    AS_PRINTED,
    LIMIT_SECONDS,
    Pull,
    Row,
    Workshop,
    kept_folder,
    write_page,
)

SLOW, FAST = "Mg-10Gd", "Mg-5Gd"
"""The two alloys: Mg-5Gd loses more volume in the same time."""

WEEKS = ("1w", "2w", "4w", "8w", "24w")
SHORT = ("1w", "8w", "24w")
LENGTH_FACTOR = 1.1275
"""Factor on l of Eq. 5.14, published for the run on the finest lattice (Table 5.2)."""

FILE = "published.md"
TITLE = "The published tensile outcome beside what pulled end faces give"
INCREMENT = 0.005
LAYER = 50e-6
"""Edge length at the pulled faces: half of the quick lattice's spacing."""

BULK = (0.3e-3, 0.2e-3)
PUBLISHED_EDGE = 47e-6
"""773,005 cells in 9.25 mm^3: the edge of a regular tetrahedron of that volume, rounded (m)."""

WHOLE = "P1, 47 um everywhere"
LONG_LIMIT = 3600.0
"""Processor time (s) after which a pull on the whole fine mesh is given up."""

Course = Mapping[str, Mapping[str, float]]
"""Strength left by alloy and immersion time."""

Strains = Mapping[str, Mapping[str, float]]
"""Strain at the peak by alloy and immersion time, time zero included."""


@dataclass(frozen=True)
class Statement:
    """A sentence of the source and whether a course shows it; None where the course cannot say."""

    text: str
    shown: Callable[[Course, Strains], bool | None]


def _known(course: Course, times: Sequence[str]) -> list[str]:
    return [t for t in times if all(t in course[alloy] for alloy in (FAST, SLOW))]


def _alike_at_first(course: Course, strains: Strains) -> bool | None:
    times = _known(course, ("1w", "2w"))
    if not times:
        return None
    return all(abs(course[FAST][t] - course[SLOW][t]) <= 0.08 for t in times)


def _ahead_in_spite_of_more_loss(course: Course, strains: Strains) -> bool | None:
    times = _known(course, ("1w", "2w", "4w", "8w"))
    ahead = any(course[FAST][t] > course[SLOW][t] for t in times)
    return True if ahead else False if len(times) == 4 else None


def _order_reverses(course: Course, strains: Strains) -> bool | None:
    ahead = _ahead_in_spite_of_more_loss(course, strains)
    if not ahead or not _known(course, ("24w",)):
        return ahead if not ahead else None
    return course[FAST]["24w"] < course[SLOW]["24w"]


def _left_after_24_weeks(alloy: str, low: float, high: float) -> Callable:
    def shown(course: Course, strains: Strains) -> bool | None:
        left = course[alloy].get("24w")
        return None if left is None else low <= left <= high

    return shown


def _less_ductile(course: Course, strains: Strains) -> bool | None:
    cases = [(a, t) for a, by_time in strains.items() for t in by_time if t != "0w"]
    if not cases or any("0w" not in strains[a] for a, _ in cases):
        return None
    return all(strains[a][t] < strains[a]["0w"] for a, t in cases)


def _first_week_as_ductile(course: Course, strains: Strains) -> bool | None:
    known = strains.get(FAST, {})
    return None if not {"0w", "1w"} <= set(known) else known["1w"] >= known["0w"]


STATEMENTS = (
    Statement("alike in the first weeks (within 8 points after 1 and 2 weeks)", _alike_at_first),
    Statement(
        f"{FAST} at first a little ahead in spite of more volume loss (at any of 1 to 8 weeks)",
        _ahead_in_spite_of_more_loss,
    ),
    Statement("the order reverses between 8 and 24 weeks", _order_reverses),
    Statement(
        f"{FAST} near 0 after 24 weeks (at most 10 %)", _left_after_24_weeks(FAST, 0.0, 0.10)
    ),
    Statement(
        f"{SLOW} about 20 % after 24 weeks (13 to 25 %)", _left_after_24_weeks(SLOW, 0.13, 0.25)
    ),
    Statement("every degraded screw less ductile (strain at the peak)", _less_ductile),
    Statement(f"but {FAST} after 1 week, as ductile as before", _first_week_as_ductile),
)


@dataclass(frozen=True)
class Reading:
    """One way to read the set-up: its course, strains at the peak, and how it was found."""

    name: str
    course: Course
    strains: Strains
    intact: Mapping[str, float]

    def verdicts(self) -> list[bool | None]:
        """Whether each statement is shown; None where this reading cannot say."""
        return [statement.shown(self.course, self.strains) for statement in STATEMENTS]


def verdict(shown: Sequence[bool | None]) -> str:
    """The word for a statement from what all readings say of it."""
    known = [value for value in shown if value is not None]
    if known and all(known):
        return "reproduced"
    return "not decidable" if any(known) or not known else "not reproduced"


def corrosion_readings(alloy: str) -> dict[str, dict[str, object]]:
    """Changes of the scene for each reading of the corrosion, by name; "" is the default."""
    scale = resolve_scene([alloy], ["0w"], "quick").alloys[0].corrosion.volume_loss_scale
    longer = f"volume_loss:length={LENGTH_FACTOR * scale:.10g}"
    plain = dict(AS_PRINTED)
    return {
        "": plain,
        "longer l": {**plain, "corrosion": {**AS_PRINTED["corrosion"], "kinetics": longer}},
        "0.5 mm of liquid above": {**plain, "domain": DomainSettings(axial_margin=0.5e-3)},
    }


def weakest_layers(path: Path) -> tuple[float, float]:
    """Share of the outermost metal layer that still carries, at the bottom and at the top.

    path: a field of the workshop.  No mesh and no test is needed for this.
    """
    with np.load(path) as field:
        spacing, metal, solid = field["spacing"], field["metal"], float(field["solid"])
        now, intact = (
            net_section(c, metal, field["capacity"], spacing, solid)
            for c in (field["concentration"], np.where(metal, solid, 0.0))
        )
    layers = np.flatnonzero(intact > 0.5 * np.median(intact[intact > 0]))
    return tuple(float(now[n] / intact[n]) for n in (layers[0], layers[-1]))


def plan_pulls(long: bool) -> dict[str, list[Pull]]:
    """The pulls of each reading by its name."""

    def pulls(name: str, element: str, times: Sequence[str], field: str = "", **sizes) -> list:
        mesh = {"mesh_size": BULK[0], "mesh_size_fine": BULK[1], "ends": LAYER, **sizes}
        return [
            Pull(
                name, "", alloy, t, element, increment=INCREMENT, grip=0.0,
                field="" if t == "0w" else field, **mesh,  # the intact screw is the same for all
            )
            for alloy in (FAST, SLOW)
            for t in ("0w", *times)
        ]  # fmt: skip

    found = {
        "P1": pulls("P1", "P1", WEEKS),
        "P1, longer l": pulls("P1, longer l", "P1", SHORT, "longer l"),
        "P1, 0.5 mm of liquid above": pulls(
            "P1, 0.5 mm of liquid above", "P1", SHORT, "0.5 mm of liquid above"
        ),
        "P2": pulls("P2", "P2", SHORT),
    }
    if long:
        whole = {"mesh_size": PUBLISHED_EDGE, "mesh_size_fine": PUBLISHED_EDGE, "ends": None}
        # The intact screw's force has one smooth peak, beyond which only factorisations get.
        found[WHOLE] = [
            replace(pull, peak_drop=0.01) if pull.immersion == "0w" else pull
            for pull in pulls(WHOLE, "P1", ("1w", "24w"), **whole)
        ]
    return found


def reading(name: str, rows: Sequence[Row]) -> Reading:
    """The course of one reading from its pulls; a test that was given up is left out."""
    ended = [row for row in rows if np.isfinite(row.peak_force) and row.peak_force >= 0]
    intact = {row.alloy: row.peak_force for row in ended if row.immersion == "0w"}
    course: dict[str, dict[str, float]] = {FAST: {}, SLOW: {}}
    strains: dict[str, dict[str, float]] = {FAST: {}, SLOW: {}}
    for row in ended:
        strains[row.alloy][row.immersion] = row.strain_at_peak
        if row.immersion != "0w" and row.alloy in intact:
            course[row.alloy][row.immersion] = row.peak_force / intact[row.alloy]
    return Reading(name, course, strains, intact)


def study_published(
    tell: Callable[[str], None] = lambda line: None,
    long: bool = False,
    workers: int = 2,
    keep: Path | None = None,
) -> tuple[list[Reading], list[Reading]]:
    """Readings by tests, and the same by the weakest lattice layer alone, without any mesh.

    keep: a folder in which fields, meshes and what each pull found stay, so that an interrupted
    study goes on.
    """
    by_layer: list[Reading] = []
    tests: list[Reading] = []
    with kept_folder(keep) as place:
        shop = Workshop(place)
        courses: dict[str, dict[str, dict[str, float]]] = {}
        for alloy in (FAST, SLOW):
            for name, changes in corrosion_readings(alloy).items():
                shop.corrode(alloy, ["0w", *WEEKS], name, **changes)
                courses.setdefault(name, {})[alloy] = {
                    t: weakest_layers(shop.field(name, alloy, t))[1] for t in WEEKS
                }
        for name, course in courses.items():
            layer = f"weakest layer{', ' if name else ''}{name}"
            by_layer.append(Reading(layer, course, {}, {}))
        for name, pulls in plan_pulls(long).items():
            limit = LONG_LIMIT if name == WHOLE else LIMIT_SECONDS
            rows = shop.pull(pulls, workers, lambda row: tell(_line(row)), limit)
            tests.append(reading(name, rows))
    return tests, by_layer


def _line(row: Row) -> str:
    return (
        f"{row.curve}, {row.alloy} {row.immersion}, {row.cells:,} cells: {row.peak_force:.1f} N at "
        f"{100 * row.strain_at_peak:.2f} %, {row.processor_seconds:.1f} s, {row.status}"
    )


def tables(tests: Sequence[Reading], by_layer: Sequence[Reading]) -> list[str]:
    """The courses, and each statement with its verdict, as Markdown."""
    head = " | ".join(WEEKS)
    lines = [
        f"Strength left in %, end faces pulled, Table {DEFAULT_PARAMETER_SET[6:]}; weakest layer: "
        "share of the outermost lattice layer at the slot's end that carries, no mesh",
        "",
        f"| reading | alloy | {head} |",
        "| --- | --- |" + " ---: |" * len(WEEKS),
    ]
    for entry in (*tests, *by_layer):
        for alloy in (FAST, SLOW):
            values = [entry.course[alloy].get(t) for t in WEEKS]
            shown = " | ".join("" if v is None else f"{100 * v:.1f}" for v in values)
            lines.append(f"| {entry.name} | {alloy} | {shown} |")
    lines += ["", "| published statement | verdict | shown by | not shown by |"]
    lines.append("| --- | --- | --- | --- |")
    by_reading = [(entry.name, entry.verdicts()) for entry in (*tests, *by_layer)]
    for number, statement in enumerate(STATEMENTS):
        shown = {name: values[number] for name, values in by_reading}
        yes, no = (
            "; ".join(n for n, v in shown.items() if v is wanted) for wanted in (True, False)
        )
        word = verdict(list(shown.values()))
        lines.append(f"| {statement.text} | **{word}** | {yes or '–'} | {no or '–'} |")
    lines += ["", f"Not said in the text: {'; '.join(UNDECIDED)}."]
    return lines


def print_published(long: bool = False, out: Path | None = None) -> None:
    """Run the study, print its tables and, with a folder, write them there."""
    keep = None if out is None else out / "pulls"
    found = study_published(lambda line: print(line, flush=True), long, keep=keep)
    lines = tables(*found)
    print("\n" + "\n".join(lines))
    if out is not None:
        command = f"perilife study published{' --long' * long} --out {out}"
        print(write_page(TITLE, lines, out / FILE, command))
