"""The page that lays several runs over each other: what differs, tables, curves, in one file."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from pipeline.compare import plots
from pipeline.compare.differences import ABSENT, differences
from pipeline.compare.runs import Line, Way, same_time, tested, times, way_of, ways
from pipeline.record.run_folder import write_text
from pipeline.record.run_results import RunResults
from pipeline.report.downloads import Download, download
from pipeline.report.templating import environment, script
from pipeline.report.wording import duration, gathered, headline, percent
from pipeline.scene.errors import strength_error
from pipeline.scene.holding import HOLDINGS


def write_comparison(lines: Sequence[Line], path: Path, seconds: float | None = None) -> Path:
    """Write the page that compares the lines, of at least two runs, and return its path.

    seconds: immersion time of the force-elongation curves; None takes the last one that most lines
    were tested at.  Raises ValueError, naming the times that there are, where no run was tested
    then, and OSError where the page cannot be written.
    """
    runs = list({line.run_label: line.run for line in lines}.items())
    compared = ways(lines)
    chosen = _chosen_time(lines, seconds)
    page = environment().get_template("compare.html.j2").render(
        title=f"Comparison of {len(runs)} runs",
        lines=[_line(line) for line in lines],
        run_labels=[label for label, _ in runs],
        notes=_notes(lines, runs, compared, chosen),
        missing=[
            f"{label}: {sentence}" for label, run in runs for sentence in gathered(run.missing)
        ],
        differences=_by_group(differences([run.scene for _, run in runs])),
        strengths=[_strength(lines, way, chosen, f"way-{n}") for n, way in enumerate(compared)],
        losses=_losses(lines),
        loss_plot=plots.volume_loss_plot(lines),
        curve_time=duration(chosen),
        downloads=[_table(lines)],
        script=script("page.js"),
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )  # fmt: skip
    write_text(path, page)
    return path


def _line(line: Line) -> dict[str, object]:
    result = line.corroded
    return {
        "swatch": plots.swatch(line.number),
        "label": line.label,
        "folder": str(line.run.folder),
        "answer": headline(result, way_of(line.run.scene.hold(result.hold)).names),
    }


def _chosen_time(lines: Sequence[Line], seconds: float | None) -> float:
    """The time of the curves: the one asked for, or the last one that most lines have."""
    had = [
        times([i.seconds for alloys in line.run.held.values() for a in alloys
               if a.name == line.alloy for i in a.immersions if i.reaction is not None])
        for line in lines
    ]  # fmt: skip
    known = times([t for one in had for t in one])

    def count(time: float) -> int:
        return sum(any(same_time(time, t) for t in one) for one in had)

    if seconds is not None:
        if not any(same_time(seconds, t) for t in known):
            raise ValueError(
                f"--time is {duration(seconds)}, after which no run was tested; they were tested "
                f"after {', '.join(duration(t) for t in known)}"
            )
        return seconds
    return max(known, key=lambda time: (count(time), time), default=0.0)


def _strength(lines: Sequence[Line], way: Way, chosen: float, name: str) -> dict[str, object]:
    """Table and drawings of one load and way of holding; chosen: time (s) of the curves."""
    held = [(line, found) for line in lines if (found := line.held(way)) is not None]
    at = times([i.seconds for _, alloy in held for i in tested(alloy) if i.seconds > 0])
    first: dict[float, float] = {}
    rows = []
    for line, alloy in held:
        left = {t: i.strength_ratio for t in at for i in tested(alloy) if same_time(i.seconds, t)}
        cells = []
        for t in at:
            value = left.get(t)
            apart = "" if value is None or t not in first else _points(value - first[t])
            cells.append((ABSENT if value is None else percent(value), apart))
        first = first or left
        hold = next(h for h in line.run.scene.holds if way_of(h) == way)
        error = strength_error(line.run.scene, hold)
        intact = next((i for i in alloy.immersions if i.seconds == 0), None)
        peak = None if intact is None else intact.tensile.get(f"peak_{way.names.reaction}")
        rows.append(
            {
                "line": _line(line),
                "intact": ABSENT if peak is None else way.names.shown(peak),
                "cells": cells,
                "error": "not measured" if error is None else f"± {percent(error, 1)}",
            }
        )
    return {
        "way": way,
        "question": HOLDINGS[way.hold].question,
        "times": [duration(t) for t in at],
        "rows": rows,
        "plot": plots.strength_plot(lines, way, name),
        "curves": plots.pull_plot(lines, way, chosen, f"{name}-curves"),
    }


def _points(difference: float) -> str:
    text = f"{100 * difference:+.0f}".replace("-", "−")
    return "±0" if text in ("+0", "−0") else text


def _losses(lines: Sequence[Line]) -> dict[str, object]:
    """Volume loss of every line after every time."""
    rows = []
    at = times([i.seconds for x in lines for i in x.corroded.immersions if i.summary])
    at = [t for t in at if t > 0]
    for line in lines:
        items = [i for i in line.corroded.immersions if i.summary]
        found = [next((i for i in items if same_time(i.seconds, t)), None) for t in at]
        cells = [percent(i.summary.volume_loss, 1) if i else ABSENT for i in found]
        rows.append({"line": _line(line), "cells": cells})
    return {"times": [duration(t) for t in at], "rows": rows}


def _by_group(found: list) -> dict[str, list]:
    groups: dict[str, list] = {}
    for difference in found:
        groups.setdefault(difference.group, []).append(difference)
    return groups


def _notes(
    lines: Sequence[Line], runs: list[tuple[str, RunResults]], compared: list[Way], chosen: float
) -> list[str]:
    """What a reader must know before comparing: other times, loads, ways of holding, ends."""
    notes = []
    labels = [tuple(t.label for t in run.scene.immersion) for _, run in runs]
    seconds = [[t.seconds for t in run.scene.immersion if t.seconds > 0] for _, run in runs]
    if any(one != seconds[0] for one in seconds):
        said = "; ".join(f"{r}: {', '.join(t)}" for (r, _), t in zip(runs, labels, strict=True))
        notes.append(
            "The immersion times are not the same, so that a dash stands where a run has no such "
            f"time ({said})."
        )
    loads = list(dict.fromkeys(way.load for way in compared))
    if len(loads) > 1:
        notes.append(
            f"The loads are not the same ({', '.join(loads)}): each stands by itself, since the "
            "strength left under one load says nothing of that under another."
        )
    have = {
        way: [label for label, run in runs if any(way_of(h) == way for h in run.scene.holds)]
        for way in compared
    }
    if any(len(found) < len(runs) for found in have.values()):
        said = "; ".join(
            f"{way.part}{'' if len(loads) == 1 else f' ({way.load})'}: {', '.join(found)}"
            for way, found in have.items()
        )
        notes.append(
            "Not every run was held in the same ways, and the strength left of one way of holding "
            f"does not answer the question of another ({said})."
        )
    ends = {label: run.scene.tensile.final_strain for label, run in runs}
    if len(set(ends.values())) > 1:
        said = ", ".join(f"{label} {percent(end)}" for label, end in ends.items())
        notes.append(
            "The tests do not end at the same strain, and a peak is the largest value up to "
            f"there ({said})."
        )
    makers = {label: _version(run) for label, run in runs}
    if len(set(makers.values())) > 1:
        said = ", ".join(f"{label} {version}" for label, version in makers.items())
        notes.append(f"The runs were made by different versions of perilife ({said}).")
    lacking = [
        line.label
        for line in lines
        if not any(
            same_time(i.seconds, chosen) and i.reaction is not None
            for alloys in line.run.held.values()
            for a in alloys
            if a.name == line.alloy
            for i in a.immersions
        )
    ]
    if lacking:
        notes.append(f"No curve after {duration(chosen)}: {', '.join(lacking)}.")
    return notes


def _version(run: RunResults) -> str:
    """Versions of perilife that did the stages of a run."""
    found = {record.versions.get("perilife", "?") for _, record in run.records}
    return " and ".join(sorted(found)) or "?"


def _table(lines: Sequence[Line]) -> Download:
    """All results as one CSV, SI units."""
    buffer = io.StringIO()
    writer: csv.DictWriter | None = None
    for line in lines:
        held = (a for alloys in line.run.held.values() for a in alloys if a.name == line.alloy)
        for item in (item for alloy in held for item in alloy.immersions if item.summary):
            row = {"run": line.run_label, **asdict(item.summary), "reaction_unit": item.names.unit}
            if writer is None:
                writer = csv.DictWriter(buffer, row, lineterminator="\n")
                writer.writeheader()
            writer.writerow({k: f"{v:.10g}" if isinstance(v, float) else v for k, v in row.items()})
    return download("comparison.csv", "all results, a row each test", buffer.getvalue())
