"""Where the error of the strength left comes from: one factor refined at a time.

The strength left (peak force over that of the intact screw) of one alloy after one immersion time,
with the quick preset on a lattice of half the horizon and with each factor refined alone: lattice,
time step, mapping (one f per cell or per quadrature point, samples of a cell for them), mesh,
element, increment.  A factor's error is the change to its finest level, with what is left of that
level by the order of the factor added; the errors of the factors add up, which bounds the sum where
they do not cancel.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.scene.resolution import resolution
from pipeline.studies.workshop import Pull, Row, Workshop, kept_folder, write_page

FILE = "life_cycle.md"
TITLE = "Where the error of the strength left comes from"
WANTED_ERRORS = (0.10, 0.03, 0.01)
LATTICES = (100e-6, 200e-6 / 3, 50e-6)
RATE_CHANGES = (0.4, 0.1)
GROWTHS = (("cell", 1), ("point", 1), ("point", 2))
INCREMENT_SHARES = (1.0, 0.5, 0.25)  # of the preset's
MESHES = (
    ("P1-Fbar", 0.2e-3, 0.12e-3), ("P2", 0.3e-3, 0.2e-3),
    ("P2-Fbar", 0.4e-3, 0.3e-3), ("P2-Fbar", 0.3e-3, 0.2e-3), ("P2-Fbar", 0.2e-3, 0.12e-3),
    ("P2-Fbar", 0.16e-3, 0.1e-3),
)  # fmt: skip
ORDERS = {
    "lattice": (2.0, LATTICES[-2] / LATTICES[-1]),  # with rate classes (study corrosion)
    "time step": (2.0, RATE_CHANGES[-2] / RATE_CHANGES[-1]),
    "increment": (1.0, INCREMENT_SHARES[-2] / INCREMENT_SHARES[-1]),
}
"""Order of a factor and how much finer its last level is than the one before."""

FACTORS = ("lattice", "time step", "mapping", "mesh and element", "increment")


@dataclass(frozen=True)
class Level:
    """One value of one factor, all others as in the base.

    ratio: strength left; error: of this level, relative; seconds: processor time that the factor
    decides, of the march (the surface aside) or of the pulls, of time step and mapping over the
    base's; map_seconds: of the base's map onto a mesh.
    """

    factor: str
    choice: str
    ratio: float
    error: float
    seconds: float
    status: str
    map_seconds: float = 0.0


@dataclass(frozen=True)
class Combination:
    """A level of every factor, with the sum of the errors and the processor time of the run."""

    levels: tuple[Level, ...]
    error: float
    seconds: float


def factor_levels(
    factor: str,
    entries: Sequence[tuple[str, float, float, str]],
    order: float | None,
    refined: float = 2.0,
) -> list[Level]:
    """Levels of a factor from (choice, ratio, seconds, status), coarse to fine.

    order: of the factor; refined: the step of the last level but one over that of the finest.  What
    is left of the finest level is then its last change / (refined^order - 1).  None: the last
    change itself.
    """
    finest = entries[-1][1]
    rest = 0.0
    if len(entries) > 1:
        change = abs(entries[-1][1] - entries[-2][1])
        rest = change if order is None else change / (refined**order - 1.0)
    return [
        Level(factor, choice, ratio, (abs(ratio - finest) + rest) / finest, seconds, status)
        for choice, ratio, seconds, status in entries
    ]


def combinations(levels: Sequence[Level]) -> list[Combination]:
    """Every choice of one level per factor; the cost is that of its corrosion, map and pulls.

    Pulls cost what those of their mesh cost, scaled by what the increment costs over the base's.
    """
    groups = [[e for e in levels if e.factor == factor] for factor in FACTORS]
    base = next(e for e in levels if e.factor == "increment")
    found = []
    for chosen in itertools.product(*groups):
        if any(level.status.startswith("stopped") for level in chosen):
            continue
        by = {level.factor: level for level in chosen}
        corrosion = by["lattice"].seconds * by["time step"].seconds
        mesh = by["mesh and element"]
        cost = corrosion + mesh.map_seconds * by["mapping"].seconds
        cost += mesh.seconds * by["increment"].seconds / base.seconds
        found.append(Combination(chosen, sum(e.error for e in chosen), cost))
    return found


def cheapest(found: Sequence[Combination], wanted: float) -> tuple[Combination, bool]:
    """The cheapest combination within an error, or the surest one and False."""
    good = [c for c in found if c.error <= wanted]
    if good:
        return min(good, key=lambda c: (c.seconds, c.error)), True
    return min(found, key=lambda c: (c.error, c.seconds)), False


def study_life_cycle(
    alloy: str, immersion: str, tell: Callable[[str], None] = lambda line: None, workers: int = 2,
    keep: Path | None = None,
) -> list[Level]:  # fmt: skip
    """Run the study for one alloy and time; `tell` hears one line per pull.

    keep: a folder in which fields, meshes and what each pull found stay, so that an interrupted
    study goes on.
    """
    preset = resolution("quick")
    mesh = (preset.element, preset.mesh_size, preset.mesh_size_fine)
    base = Pull("", "", alloy, "0w", *mesh, preset.increment)
    with kept_folder(keep) as place:
        shop = Workshop(place)
        shop.corrode(alloy, [immersion])  # compiles
        seconds = {
            name: shop.corrode(alloy, [immersion], name, spacing, change)
            for name, spacing, change in _marches()
        }
        for spacing, cost in shop.setup_seconds.items():
            tell(f"surface on {1e6 * spacing:.0f} um: {cost:.1f} s")
        variants = _variants(base)
        pulls = {
            (factor, choice, label): replace(pull, immersion=label, curve=factor, choice=choice)
            for factor, choice, pull in variants
            for label in ("0w", immersion)
        }
        once = list({_content(p): p for p in pulls.values()}.values())
        rows = shop.pull(once, workers, lambda row: tell(_line(row)))
    found = {_content(p): row for p, row in zip(once, rows, strict=True)}
    entries: dict[str, list[tuple[str, float, float, str]]] = {factor: [] for factor in FACTORS}
    first = _march_name(LATTICES[0], RATE_CHANGES[0])
    mapped = _map_seconds(rows)
    for factor, choice, _ in variants:
        intact, corroded = (found[_content(pulls[factor, choice, t])] for t in ("0w", immersion))
        cost = intact.processor_seconds + corroded.processor_seconds
        if factor == "lattice":
            cost = seconds[corroded.field]
        if factor == "time step":
            cost = seconds[corroded.field] / seconds[first]
        if factor == "mapping":
            cost = mapped[_mapped_by(corroded)] / mapped[_mapped_by(base)]
        ratio = corroded.peak_force / intact.peak_force
        entries[factor].append((choice, ratio, cost, corroded.status))
    levels: list[Level] = []
    for factor in FACTORS:
        if factor == "mesh and element":
            onto = [mapped[size, fine, base.samples] for _, size, fine in MESHES]
            made = zip(_mesh_levels(entries[factor]), onto, strict=True)
            levels += [replace(level, map_seconds=cost) for level, cost in made]
        else:
            levels += factor_levels(factor, entries[factor], *ORDERS.get(factor, (None,)))
    return levels


def _mapped_by(pull: Pull) -> tuple[float, float, int]:
    return pull.mesh_size, pull.mesh_size_fine, pull.samples


def _map_seconds(rows: Sequence[Row]) -> dict[tuple[float, float, int], float]:
    """Of the map by mesh and samples: the longest, of which the others found a part ready."""
    longest: dict[tuple[float, float, int], float] = {}
    for row in rows:
        place = _mapped_by(row)
        longest[place] = max(row.mapping_seconds, longest.get(place, 0.0))
    return longest


def _mesh_levels(entries: Sequence[tuple[str, float, float, str]]) -> list[Level]:
    """Each mesh against the finest, whose rest is its change from the mesh before it."""
    second = [e for e in entries if e[0].startswith(MESHES[-1][0])]
    return [factor_levels("mesh and element", [entry, *second[-2:]], None)[0] for entry in entries]


def _marches() -> list[tuple[str, float, float]]:
    found = [(_march_name(s, RATE_CHANGES[0]), s, RATE_CHANGES[0]) for s in LATTICES]
    found += [(_march_name(LATTICES[0], c), LATTICES[0], c) for c in RATE_CHANGES[1:]]
    return found


def _march_name(spacing: float, change: float) -> str:
    return f"{1e6 * spacing:.0f}-{change:g}"


def _variants(base: Pull) -> list[tuple[str, str, Pull]]:
    """(factor, choice, pull), each factor from coarse to fine."""
    base = replace(base, field=_march_name(LATTICES[0], RATE_CHANGES[0]))
    found = [
        (
            "lattice", f"{1e6 * s:.0f} um", replace(base, field=_march_name(s, RATE_CHANGES[0])),
        )
        for s in LATTICES
    ]  # fmt: skip
    found += [
        ("time step", f"rate change {c:g}", replace(base, field=_march_name(LATTICES[0], c)))
        for c in RATE_CHANGES
    ]
    found += [
        (
            "mapping", f"one f per {damage}, {4 * 8**n} samples",
            replace(base, damage=damage, samples=n),
        )
        for damage, n in GROWTHS
    ]  # fmt: skip
    for element, size, fine in MESHES:
        pull = replace(base, element=element, mesh_size=size, mesh_size_fine=fine)
        found.append(("mesh and element", f"{element} {1e3 * size:g}/{1e3 * fine:g} mm", pull))
    for share in INCREMENT_SHARES:
        size = share * base.increment
        found.append(("increment", f"{100 * size:g} %", replace(base, increment=size)))
    return found


def _content(pull: Pull) -> tuple:
    """What decides the result of a pull; the intact screw is the same for every march."""
    intact = pull.immersion == "0w"
    plain = replace(pull, field=_march_name(LATTICES[0], RATE_CHANGES[0])) if intact else pull
    plain = replace(plain, samples=Pull.samples, damage=Pull.damage) if intact else plain
    return (plain.immersion, *plain.setting())


def _line(row: Row) -> str:
    return (
        f"{row.immersion}, {row.curve} {row.choice}: {row.peak_force:.1f} N, "
        f"{row.processor_seconds:.1f} s, {row.status}"
    )


def tables(levels: Sequence[Level], title: str) -> list[str]:
    """The levels and the cheapest combinations as Markdown."""
    lines = [
        f"{title}: strength left, one factor changed at a time",
        "",
        "| factor | level | strength left | error | processor time |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for e in levels:
        relative = e.factor in ("time step", "mapping")
        cost = f"x {e.seconds:.1f}" if relative else f"{e.seconds:.1f} s"
        if e.map_seconds:
            cost += f" + map {e.map_seconds:.1f} s"
        early = " (stopped early)" if e.status.startswith("stopped") else ""
        lines.append(
            f"| {e.factor} | {e.choice} | {100 * e.ratio:.1f} %{early} | {100 * e.error:.1f} % "
            f"| {cost} |"
        )
    lines.append("")
    found = combinations(levels)
    for wanted in WANTED_ERRORS:
        chosen, reached = cheapest(found, wanted)
        words = ", ".join(f"{e.factor} {e.choice}" for e in chosen.levels)
        start = "" if reached else "not reached; the surest is "
        lines.append(
            f"- cheapest within {100 * wanted:g} %: {start}{words}: error {100 * chosen.error:.1f} "
            f"%, {chosen.seconds:.0f} s of processor time"
        )
    return lines


def print_study(alloy: str, immersion: str, out: Path | None = None) -> None:
    """Run the study, print its tables and, with a folder, write them there."""
    keep = None if out is None else out / "pulls"
    levels = study_life_cycle(alloy, immersion, lambda line: print(line, flush=True), keep=keep)
    lines = tables(levels, f"{alloy}, {immersion}")
    print("\n" + "\n".join(lines))
    if out is not None:
        command = f"perilife study life-cycle --alloy {alloy} --immersion {immersion} --out {out}"
        print(write_page(TITLE, lines, out / FILE, command))
