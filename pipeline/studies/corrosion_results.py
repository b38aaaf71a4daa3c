"""What the study of the corrosion stage shows: orders, cheapest settings, presets, table, plot."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pipeline.record.run_folder import write_text
from pipeline.record.whole_file import whole_file
from pipeline.scene.units import format_seconds
from pipeline.studies.cases import CLASSES, TIMES
from pipeline.studies.corrosion import (
    COMMON,
    LATTICE_CURVES,
    RATE_CHANGES,
    STEP_CURVES,
    Row,
    Study,
)

WANTED_ERRORS = (0.10, 0.03, 0.015, 0.01, 0.003)
PRESET_ERRORS = {"quick": 0.01, "standard": 0.007, "fine": 0.0045}
"""The error of V_L that each preset is to stay below; on delta/2, which would do for 1.3 %, V_L of
Mg-10Gd depends by 3 % on where the lattice lies."""

COLOURS = ("#4477aa", "#ee6677", "#228833", "#aa3377")
MARKERS = ("o", "s", "^", "D")


def observed_orders(rows: Iterable[Row]) -> list[tuple[str, str, float, float]]:
    """(alloy, curve, order, smallest error): slope of log error over log step or spacing."""
    rows = list(rows)
    found = []
    for alloy, curve in {(r.alloy, r.curve): None for r in rows}:
        chosen = [r for r in rows if (r.alloy, r.curve) == (alloy, curve)]
        if curve in LATTICE_CURVES:
            points = [(1.0 / r.horizon_ratio, r.lattice_error) for r in chosen]
        else:
            points = [(r.step or r.rate_change, r.time_error) for r in chosen]
        points = [(h, e) for h, e in points if e > 1e-9]
        if len(points) >= 3:
            h, e = np.log(np.array(points)).T
            found.append((alloy, curve, float(np.polyfit(h, e, 1)[0]), float(np.exp(e.min()))))
    return found


def cheapest(rows: Iterable[Row]) -> list[tuple[str, float, Row | None]]:
    """(alloy, wanted error, run with the fewest seconds of set-up and march within it, or None)."""
    rows = list(rows)
    out = []
    for alloy in {r.alloy: None for r in rows}:
        for wanted in WANTED_ERRORS:
            good = [r for r in rows if r.alloy == alloy and r.error <= wanted]
            out.append((alloy, wanted, min(good, key=_seconds, default=None)))
    return out


def _seconds(row: Row) -> float:
    """Of the processor, set-up of the surface and march."""
    return row.setup_seconds + row.processor_seconds


@dataclass(frozen=True)
class Setting:
    """Lattice with rate classes and control of the steps, with errors and seconds of each alloy.

    time_error, lattice_error, seconds: by alloy; seconds are of the processor, those of the march;
    setup: seconds of the surface, once for all alloys.
    """

    horizon_ratio: int
    rate_change: float
    time_error: dict[str, float]
    lattice_error: dict[str, float]
    seconds: dict[str, float]
    setup: float

    @property
    def all_seconds(self) -> float:
        """Set-up and the marches of all alloys."""
        return self.setup + sum(self.seconds.values())

    @property
    def error(self) -> float:
        """The larger error of the alloys."""
        return max(self.time_error[a] + self.lattice_error[a] for a in self.time_error)


def settings(rows: Sequence[Row]) -> list[Setting]:
    """Every pair of a lattice and a control target that was measured for all alloys.

    A pair that was not run itself has the time error of its target on the coarsest lattice and
    the cost of its lattice, in proportion to the steps where the liquid is computed.
    """
    alloys = list({r.alloy: None for r in rows})
    steps = {(r.alloy, r.rate_change): r for r in rows if r.curve == STEP_CURVES[2]}
    lattices = {(r.alloy, r.horizon_ratio): r for r in rows if r.curve in LATTICE_CURVES[:2]}
    common = COMMON.rate_change

    def seconds(alloy: str, m: int, change: float) -> float:
        lattice = lattices[alloy, m]
        if lattice.liquid == "left out":
            return lattice.processor_seconds
        return lattice.processor_seconds * steps[alloy, change].steps / steps[alloy, common].steps

    found = []
    for m in sorted({m for _, m in lattices}):
        for change in RATE_CHANGES:
            if all((a, m) in lattices and (a, change) in steps for a in alloys):
                found.append(
                    Setting(
                        m,
                        change,
                        {a: steps[a, change].time_error for a in alloys},
                        {a: lattices[a, m].lattice_error for a in alloys},
                        {a: seconds(a, m, change) for a in alloys},
                        max(lattices[a, m].setup_seconds for a in alloys),
                    )
                )
    return found


def errors_by_nodes(rows: Iterable[Row], ratio: int) -> dict[str, float]:
    """The lattice's error with one rate per node by alloy, of those where it was measured."""
    return {
        r.alloy: r.lattice_error
        for r in rows
        if r.classes == 0 and r.horizon_ratio == ratio and r.curve in LATTICE_CURVES
    }


def cheapest_setting(found: Sequence[Setting], wanted: float) -> tuple[Setting, bool]:
    """The cheapest setting within an error for all alloys, and whether there is one.

    Where none is, the cheapest within a tenth of the smallest error.
    """
    least = min(s.error for s in found)
    reached = least <= wanted
    limit = wanted if reached else 1.1 * least
    good = [s for s in found if s.error <= limit]
    # A lattice costs more than any control of the steps does; seconds of short runs are noise.
    return min(good, key=lambda s: (s.horizon_ratio, -s.rate_change)), reached


def cost_of_half_the_error(study: Study, chosen: Setting) -> tuple[float, bool]:
    """Processor time of half the error over that of `chosen`, and whether it was measured.

    Beyond the measured lattices: seconds ~ m^a and lattice error ~ m^-p, both fitted.
    """
    found = settings(study.rows)
    half, measured = cheapest_setting(found, 0.5 * chosen.error)
    if measured:
        return half.all_seconds / chosen.all_seconds, True
    common = [s for s in found if s.rate_change == COMMON.rate_change]
    ratios = np.log([s.horizon_ratio for s in common])
    power = np.polyfit(ratios, np.log([s.all_seconds for s in common]), 1)[0]
    return float(2.0 ** (power / fine_order(study.rows))), False


def fine_order(rows: Sequence[Row]) -> float:
    """Order of the lattice error with rate classes, of the alloy that errs most."""
    curves: dict[str, list[tuple[int, float]]] = {}
    for r in rows:
        if r.curve in LATTICE_CURVES[:2]:
            curves.setdefault(r.alloy, []).append((r.horizon_ratio, r.lattice_error))
    m, e = np.log(np.array(max(curves.values(), key=lambda curve: max(e for _, e in curve)))).T
    return float(-np.polyfit(m, e, 1)[0])


def presets_text(study: Study, command: str) -> str:
    """The presets as TOML; scene.resolution reads the copy in pipeline/scene/presets.toml."""
    found = settings(study.rows)
    lines = [
        "# Lattice and time steps of the presets, with their measured errors of the volume loss",
        "# (largest relative error after 7, 28 and 56 days, that of steps of marches to one of",
        "# them or to 168 days alone, too; reference screw, Table 5.1).",
        f"# Written by: {command}",
        "# then copied to pipeline/scene/presets.toml. A preset is the cheapest setting within its",
        "# wanted error for all alloys, or the best one measured where none reaches it. Set-up of",
        "# the surface, once for a solid and a lattice, and marches in seconds of the processor.",
        "",
        f"command = {command!r}".replace("'", '"'),
    ]
    for name, wanted in PRESET_ERRORS.items():
        chosen, reached = cheapest_setting(found, wanted)
        cost, measured = cost_of_half_the_error(study, chosen)
        lines += [
            "",
            f"[{name}]",
            f"wanted_error = {wanted:g}",
            f"reached = {str(reached).lower()}",
            f"horizon = {study.horizon:.6g}  # m",
            f"horizon_ratio = {chosen.horizon_ratio}",
            f"rate_change = {chosen.rate_change:g}",
            f"classes = {CLASSES}",
            f"error = {chosen.error:.2g}",
            f"setup_seconds = {chosen.setup:.2g}",
            f"half_error_cost = {cost:.2g}  # times the processor time",
            f"half_error_measured = {str(measured).lower()}  # false: extrapolated",
        ]
        for alloy in chosen.time_error:
            lines += [
                f"[{name}.measured.{alloy}]",
                f"time_error = {chosen.time_error[alloy]:.2g}",
                f"lattice_error = {chosen.lattice_error[alloy]:.2g}",
                f"processor_seconds = {chosen.seconds[alloy]:.2g}",
            ]
        nodes = errors_by_nodes(study.rows, chosen.horizon_ratio)
        if set(nodes) == set(chosen.time_error):
            lines += [f"[{name}.lattice_error_by_nodes]  # one rate per node, --classes 0"]
            lines += [f"{alloy} = {error:.2g}" for alloy, error in nodes.items()]
    return "\n".join(lines) + "\n"


def summary_lines(study: Study) -> list[str]:
    """The study in words, one fact per line."""
    lines = []
    for alloy, curve, order, least in observed_orders(study.rows):
        of = "spacing" if curve in LATTICE_CURVES else "step"
        lines.append(
            f"{alloy}, {curve}: observed order {order:.2f} in the {of}, "
            f"smallest error {100 * least:.2g} %"
        )
    for alloy, wanted, row in cheapest(study.rows):
        if row is None:
            best = min((r for r in study.rows if r.alloy == alloy), key=lambda r: r.error)
            text = f"not reached; best: {_in_words(best)}"
        else:
            text = _in_words(row)
        lines.append(f"{alloy}, cheapest within {100 * wanted:g} %: {text}")
    for alloy, losses, doubt in study.limits:
        found = ", ".join(f"{100 * loss:.3f}" for loss in losses)
        lines.append(f"{alloy} without a lattice: {found} %, sure to {100 * doubt:.2f} % of it")
    for alloy, horizon, loss in study.horizons:
        lines.append(
            f"{alloy}, horizon {1e6 * horizon:.0f} um: volume loss {100 * loss:.2f} % after 56 days"
        )
    for alloy, limit, cost in study.explicit:
        steps = TIMES[-1] / limit
        lines.append(
            f"{alloy}, forward Euler: stable up to {limit:.2g} s, so {steps:.1e} steps and "
            f"{format_seconds(steps * cost)} of processor time for 56 days; not run"
        )
    return lines


def tables(rows: Sequence[Row]) -> list[str]:
    """Lattices, and control targets of the steps, as the tables of pipeline/MEASURED.md."""
    lines = [
        "| alloy | rates, liquid | spacing | positions | error of V_L | range | own estimate "
        "| set-up | march |",
        "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for r in rows:
        if r.curve in LATTICE_CURVES:
            own = "" if r.own is None else f"{100 * r.own:.2f} %"
            lines.append(
                f"| {r.alloy} | {r.curve} | {r.choice} | {r.positions} | "
                f"{100 * r.lattice_error:.2f} % | {100 * r.spread:.2f} % | {own} | "
                f"{r.setup_seconds:.1f} s | {r.processor_seconds:.1f} s |"
            )
    lines += ["", "| alloy | steps | choice | number | error of V_L | march |"]
    lines += ["| --- | --- | ---: | ---: | ---: | ---: |"]
    for r in rows:
        if r.curve in STEP_CURVES:
            lines.append(
                f"| {r.alloy} | {r.curve} | {r.choice} | {r.steps} | {100 * r.time_error:.2f} % | "
                f"{r.processor_seconds:.1f} s |"
            )
    return lines


def _in_words(row: Row) -> str:
    """A setting, its cost and its error."""
    control = ""
    if row.liquid != "left out":
        control = f", {row.scheme}, "
        control += f"{row.step / 3600:.0f} h" if row.step else f"{row.rate_change or ''}"
    rates = f"{row.classes} rate classes" if row.classes else "one rate per node"
    return (
        f"spacing δ/{row.horizon_ratio}, {rates}, liquid {row.liquid}{control}: "
        f"{format_seconds(_seconds(row))} (error {100 * row.error:.2g} %)"
    )


def write_study(study: Study, folder: Path, command: str) -> list[Path]:
    """Write corrosion.csv, corrosion.txt, corrosion.png and presets.toml into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    table, words = folder / "corrosion.csv", folder / "corrosion.txt"
    write_rows(study.rows, table)
    write_text(words, "\n".join(summary_lines(study)) + "\n")
    picture, presets = folder / "corrosion.png", folder / "presets.toml"
    draw(study.rows, picture)
    write_text(presets, presets_text(study, command))
    return [table, words, picture, presets]


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """The rows as CSV, SI, with their total error as the last column."""
    with (
        whole_file(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, [*asdict(rows[0]), "error"])
        writer.writeheader()
        for row in rows:
            writer.writerow({**asdict(row), "error": row.error})


def read_rows(path: Path) -> list[Row]:
    """The rows of a CSV that `write_rows` wrote."""
    texts = {"alloy", "curve", "choice", "liquid", "scheme"}
    counts = {"horizon_ratio", "nodes", "steps", "classes", "positions"}
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for entry in csv.DictReader(file):
            del entry["error"]
            rows.append(
                Row(
                    **{
                        k: v
                        if k in texts
                        else None
                        if v == ""
                        else int(v)
                        if k in counts
                        else float(v)
                        for k, v in entry.items()
                    }
                )
            )
    return rows


def draw(rows: Sequence[Row], path: Path) -> None:
    """The work-precision plot: above what the lattice costs and buys, below the time steps."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    alloys = list({r.alloy: None for r in rows})
    figure = Figure(figsize=(5.6 * len(alloys), 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(alloys), squeeze=False, sharey="row")
    for column, alloy in enumerate(alloys):
        mine = [r for r in rows if r.alloy == alloy]
        ratio = mine[0].horizon_ratio
        above, below = panels[0][column], panels[1][column]
        _curves(above, mine, LATTICE_CURVES, lambda r: r.error)
        _curves(below, mine, STEP_CURVES, lambda r: r.time_error)
        for wanted in WANTED_ERRORS:
            above.axhline(100 * wanted, color="0.75", linewidth=0.8, zorder=0)
            above.text(
                0.995, 100 * wanted, f"{100 * wanted:g} %", color="0.45", fontsize=8, ha="right",
                va="bottom", transform=above.get_yaxis_transform(),
            )  # fmt: skip
        above.set_ylim(0.1, 40)
        below.set_ylim(2e-3, 100)
        above.set_title(f"{alloy}: lattice and what is left out", fontsize=11)
        below.set_title(f"{alloy}: time steps, on a lattice of δ/{ratio}", fontsize=11)
        below.set_xlabel("processor time of surface and 56 days / s")
    panels[0][0].set_ylabel("error of the volume loss / %\n(lattice and time together)")
    panels[1][0].set_ylabel("error of the volume loss / %\n(time alone)")
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _curves(axes, rows, names, error_of) -> None:
    for name, colour, marker in zip(names, COLOURS, MARKERS, strict=False):
        chosen = [r for r in rows if r.curve == name]
        if not chosen:
            continue
        seconds = [_seconds(r) for r in chosen]
        errors = [100 * max(error_of(r), 1e-9) for r in chosen]
        axes.loglog(seconds, errors, marker=marker, color=colour, label=name, markersize=5)
        for row, x, y in zip(chosen, seconds, errors, strict=True):
            axes.annotate(
                row.choice, (x, y), fontsize=8, color=colour, xytext=(4, 4),
                textcoords="offset points",
            )  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter("")
    axes.grid(True, which="major", linewidth=0.3)
    axes.legend(fontsize=8, loc="upper right")
    axes.margins(x=0.12)
