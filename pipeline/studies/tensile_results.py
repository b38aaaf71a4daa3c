"""What the study of the tensile stage shows: tables, orders, cheapest settings, presets, plot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.record.run_folder import write_text
from pipeline.record.whole_file import whole_file
from pipeline.studies.tensile import (
    DAMAGE_CURVE,
    GRIP_CURVE,
    INCREMENT_CURVE,
    MESH_CURVES,
    REFERENCE,
    SCATTER_CURVE,
    TOLERANCE_CURVE,
    Errors,
    Setting,
    Study,
    cheapest,
    edge,
    error_parts,
    settings,
)
from pipeline.studies.workshop import Row, weeks, write_rows

WANTED_ERRORS = (0.10, 0.03, 0.01)
PRESETS = {"quick": (0.02, 30.0), "standard": (0.0145, 400.0), "fine": (0.0135, np.inf)}
"""Wanted error of strength left and peak force, and processor seconds that one test may take.

A test of quick is to last 30 s, fourteen of standard an hour on two cores.  3, 2 and 1 % were
wanted first; the limit itself is not known to better than 0.7 % (pipeline/MEASURED.md).
"""

COLOURS = ("#4477aa", "#ee6677", "#228833", "#222222", "#aa7700", "#882288")
PLOT_MARKERS = ("o", "s", "^", "P", "v", "D")


def tables(study: Study) -> list[str]:
    """The study as Markdown, a table for each question."""
    lines: list[str] = []
    for alloy in study.alloys:
        errors = Errors(study, alloy)
        lines += [f"## {alloy}", "", *_force_table(errors), "", *_order_lines(errors), ""]
        for curve, title in (
            (SCATTER_CURVE, "Meshes of about the size of quick"),
            (INCREMENT_CURVE, "Largest strain increment"),
            (TOLERANCE_CURVE, "Tolerance of the residual"),
            (DAMAGE_CURVE, "How f grows"),
            (GRIP_CURVE, "Length held at either end"),
        ):
            if not any(r.curve == curve for r in errors.rows):
                continue
            lines += [
                f"{title}: peak force / N, in brackets the strength left / %",
                "",
                *_choice_table(errors, curve),
                "",
            ]
    return [*lines, "## Settings", "", *_settings_table(study), "", *cheapest_lines(study)]


def _line(entries: Sequence[str]) -> str:
    return "| " + " | ".join(entries) + " |"


def _force_table(errors: Errors) -> list[str]:
    times = errors.times
    lines = [
        "Peak force / N (processor seconds); in brackets the strength left / %",
        "",
        _line(["element", "edges / mm", "cells", "unknowns", *times]),
        _line(["---", *["---:"] * (3 + len(times))]),
    ]
    for curve in MESH_CURVES:
        rows = [r for r in errors.rows if r.curve == curve]
        for size, fine in sorted({(r.mesh_size, r.mesh_size_fine) for r in rows}, reverse=True):
            mine = {r.immersion: r for r in rows if (r.mesh_size, r.mesh_size_fine) == (size, fine)}
            first = next(iter(mine.values()))
            lines.append(
                _line(
                    [
                        curve,
                        f"{1e3 * size:g}, {1e3 * fine:g}",
                        f"{first.cells:,}",
                        f"{first.unknowns:,}",
                        *(_cell(errors, mine.get(t)) for t in times),
                    ]
                )  # fmt: skip
            )
    limits = [
        f"{errors.force[t][0]:.0f} ± {errors.force[t][1]:.0f} "
        f"[{100 * errors.ratio[t][0]:.1f} ± {100 * errors.ratio[t][1]:.1f}]"
        for t in times
    ]
    return [*lines, _line([f"{REFERENCE}, limit", "0", "", "", *limits])]


def _cell(errors: Errors, row: Row | None) -> str:
    if row is None:
        return ""
    if row.status.startswith("stopped"):
        return row.status
    return (
        f"{row.peak_force:.0f} ({row.processor_seconds:.0f} s) [{100 * errors.ratio_of(row):.1f}]"
    )


def observed_order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log error over log size, NaN from fewer than two errors above round-off."""
    points = [(h, e) for h, e in zip(sizes, errors, strict=True) if e > 1e-9]
    if len(points) < 2:
        return float("nan")
    h, e = np.log(np.array(points)).T
    return float(np.polyfit(h, e, 1)[0])


def _order_lines(errors: Errors) -> list[str]:
    lines = []
    for curve in MESH_CURVES:
        orders = []
        for t in errors.times:
            rows = errors.curve(curve, t)
            order = observed_order([edge(r) for r in rows], [errors.force_error(r) for r in rows])
            orders.append(f"{order:.1f} ({t})")
        lines.append(f"{curve}: observed order of the peak force in the edge: {', '.join(orders)}")
    known = errors.increment_errors()
    finite = sorted(known)[1:]
    if len(finite) >= 2:
        order = observed_order(finite, [known[x] for x in finite])
        lines.append(f"increment: observed order of the strength left {order:.1f}")
    spread = {t: errors.scatter(t) for t in errors.times if weeks(t) > 0.0}
    if np.isfinite(list(spread.values())).any():
        words = ", ".join(f"{100 * value:.2f} % ({t})" for t, value in spread.items())
        lines.append(f"scatter of the strength left over meshes of about one size: {words}")
    most = max(r.iterations for r in errors.rows)
    stopped = [r for r in errors.rows if r.status.startswith("stopped")]
    lines.append(
        f"{len(errors.rows)} tests, {len(stopped)} stopped early, at most {most} Newton iterations"
    )
    return [f"- {line}" for line in lines]


def _choice_table(errors: Errors, curve: str) -> list[str]:
    rows = [r for r in errors.rows if r.curve == curve]
    head = ["", *errors.times, "processor time"]
    lines = [_line(head), _line(["---", *["---:"] * (len(head) - 1)])]
    for choice in dict.fromkeys(r.choice for r in rows):
        mine = {r.immersion: r for r in rows if r.choice == choice}
        texts = []
        for t in errors.times:
            row = mine.get(t)
            if row is None:
                texts.append("")
                continue
            early = " (stopped)" if row.status.startswith("stopped") else ""
            ratio = errors.ratio_of(row)
            known = f" [{100 * ratio:.1f}]" if np.isfinite(ratio) else ""
            texts.append(f"{row.peak_force:.1f}{known}{early}")
        total = sum(r.processor_seconds for r in mine.values())
        lines.append(_line([choice, *texts, f"{total:.0f} s"]))
    return lines


def _settings_table(study: Study) -> list[str]:
    lines = [
        "Error of the strength left (mesh, with the uncertainty of the limit, plus increment) and "
        "of the peak force (mesh plus increment), processor time of the longest test and of all:",
        "",
        _line(["element", "edges / mm", "increment", "ratio", "force", "longest", "all"]),
        _line(["---", *["---:"] * 6]),
    ]
    for s in sorted(settings(study), key=lambda s: s.seconds):
        lines.append(
            _line(
                [
                    s.element,
                    f"{1e3 * s.mesh_size:g}, {1e3 * s.mesh_size_fine:g}",
                    f"{100 * s.increment:g} %",
                    f"{100 * s.error:.1f} %",
                    f"{100 * (s.force_error + s.increment_error):.1f} %",
                    f"{s.seconds:.0f} s",
                    f"{s.total_seconds:.0f} s",
                ]
            )  # fmt: skip
        )
    return lines


def in_words(s: Setting) -> str:
    """A setting with its error and cost in a line."""
    return (
        f"{s.element}, {1e3 * s.mesh_size:g}/{1e3 * s.mesh_size_fine:g} mm, increments of "
        f"{100 * s.increment:g} %: error {100 * s.error:.1f} % of the strength left, "
        f"{100 * (s.force_error + s.increment_error):.1f} % of the peak force, {s.seconds:.0f} s a "
        "test"
    )


def cheapest_lines(study: Study) -> list[str]:
    """The cheapest setting within 10, 3 and 1 % of strength left and peak force."""
    found = settings(study)
    lines = []
    for wanted in WANTED_ERRORS:
        chosen, reached = cheapest(found, wanted) if found else (None, False)
        text = "not reached by any" if chosen is None else in_words(chosen)
        if chosen is not None and not reached:
            text = f"not reached; the best is {text}"
        lines.append(f"- cheapest within {100 * wanted:g} %: {text}")
    return lines


def presets_text(study: Study, command: str) -> str:
    """The presets as TOML; scene.resolution reads the copy in scene/presets_tensile.toml."""
    found = [s for s in settings(study) if s.element == REFERENCE]
    if not found:
        raise RuntimeError(
            "no mesh has all its tests and a reference for each; there is nothing to choose from"
        )
    lines = [
        "# Mesh, element and increment of the presets, with their measured error of the strength",
        "# left (largest relative error over the immersion times; reference screw).",
        f"# Written by: {command}",
        "# then copied to scene/presets_tensile.toml. A preset is the cheapest mesh of",
        f"# {REFERENCE} cells within its wanted error, of strength left and peak force, whose",
        "# longest test stays below most_seconds, or the best of those.",
        "",
        f'command = "{command}"',
        f"alloys = {list(study.alloys)}".replace("'", '"'),
        f"immersion = {list(study.immersion)}".replace("'", '"'),
    ]
    for name, (wanted, most) in PRESETS.items():
        s, reached = cheapest(found, wanted, most)
        lines += [
            "",
            f"[{name}]",
            f"wanted_error = {wanted:g}",
            f"most_seconds = {most:g}  # processor time of one test",
            f"reached = {str(reached).lower()}",
            f'element = "{s.element}"',
            f"mesh_size = {s.mesh_size:.6g}  # m",
            f"mesh_size_fine = {s.mesh_size_fine:.6g}  # m",
            f"increment = {s.increment:g}",
            f"error = {s.error:.2g}  # of the strength left, mesh and increment",
            f"mesh_error = {s.mesh_error:.2g}",
            f"increment_error = {s.increment_error:.2g}",
            f"force_error = {s.force_error:.2g}  # of the peak force, mesh",
            f"processor_seconds = {s.seconds:.2g}  # of the longest test",
        ]
        for alloy, (mesh, increment) in error_parts(study, s).items():
            lines += [
                "",
                f"[{name}.measured.{alloy}]",
                f"mesh_error = {mesh:.2g}",
                f"increment_error = {increment:.2g}",
            ]
    return "\n".join(lines) + "\n"


def write_study(study: Study, folder: Path, command: str) -> list[Path]:
    """Write tensile.csv, tensile.md, tensile.png and presets_tensile.toml into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    table, words = folder / "tensile.csv", folder / "tensile.md"
    picture, presets = folder / "tensile.png", folder / "presets_tensile.toml"
    write_rows(study.rows, table)
    write_text(words, "\n".join(tables(study)) + "\n")
    draw(study, picture)
    write_text(presets, presets_text(study, command))
    return [table, words, picture, presets]


def draw(study: Study, path: Path) -> None:
    """The work-precision plot: error of the peak force over processor time, a panel per time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    times = study.immersion
    figure = Figure(figsize=(4.4 * len(times), 4.2 * len(study.alloys)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(study.alloys), len(times), squeeze=False, sharey=True)
    for row_of_panels, alloy in zip(panels, study.alloys, strict=True):
        errors = Errors(study, alloy)
        for axes, t in zip(row_of_panels, times, strict=True):
            curves = (*MESH_CURVES, INCREMENT_CURVE, TOLERANCE_CURVE)
            for name, colour, marker in zip(curves, COLOURS, PLOT_MARKERS, strict=True):
                rows = errors.curve(name, t)
                if not rows:
                    continue
                seconds = [r.processor_seconds for r in rows]
                values = [100 * max(errors.force_error(r), 1e-5) for r in rows]
                style = "-" if name in MESH_CURVES else ":"
                axes.loglog(
                    seconds, values, style, marker=marker, color=colour, label=name, markersize=5
                )
                for r, x, y in zip(rows, seconds, values, strict=True):
                    if name in MESH_CURVES:
                        axes.annotate(
                            r.choice, (x, y), fontsize=7, color=colour, xytext=(4, 4),
                            textcoords="offset points",
                        )  # fmt: skip
            limit, uncertainty = errors.force[t]
            if uncertainty > 1e-4 * limit:
                axes.axhspan(1e-3, 100 * uncertainty / limit, color="0.92", zorder=0)
            axes.set_title(f"{alloy}, {t}: {limit:.0f} N", fontsize=11)
            axes.set_xlabel("processor time of a test / s")
            axes.set_ylim(0.05, 100)
            axes.grid(True, which="major", linewidth=0.3)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter(lambda value, _: f"{value:g}")
                axis.set_minor_formatter("")
        row_of_panels[0].set_ylabel("error of the peak force / %\n(grey: not known better)")
    panels[0][0].legend(fontsize=8, loc="lower left")
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
