"""The curves of the report, drawn with matplotlib as SVG that follows the page's colours.

Figures are built without pyplot, so nothing of matplotlib's global state changes.  Colours are
placeholders that become CSS variables in the SVG text: one drawing serves light, dark and paper.
"""

import io
import re
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from perilife_data import VolumeLossData
from pipeline.record.bands import BandRow
from pipeline.record.run_results import AlloyResult, column
from pipeline.scene.loads import LOADS, LoadNames
from pipeline.scene.units import SECONDS_PER

ALLOY_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8f6f00", "#56b4e9")
"""Okabe and Ito's colours (one darkened), distinguishable without colour vision; for paper."""
MARKERS = ("o", "s", "^", "D", "v", "P")
LINE_STYLES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.2, 1, 1.2)))
TIME_RAMP = 8
"""Number of steps of the colour ramp for immersion times; the CSS names them --t0 to --t7."""

_INK, _FAINT = "#a1b1c0", "#a1b1c1"
_SERIES = tuple(f"#a1b2c{n:x}" for n in range(len(ALLOY_COLOURS)))
_RAMP = tuple(f"#a1b3c{n:x}" for n in range(TIME_RAMP))
_CSS = {
    _INK: "var(--ink)",
    _FAINT: "var(--line)",
    **{colour: f"var(--s{n})" for n, colour in enumerate(_SERIES)},
    **{colour: f"var(--t{n})" for n, colour in enumerate(_RAMP)},
}
_SIZE = (4.6, 3.3)
_MOST_MARKS = 60
"""Values of one curve that can be read off under the pointer."""

Marks = list[tuple[float, float, str]]
"""Values of a drawing to be read off: place on either axis, and the words."""


def time_axis(longest: float) -> tuple[float, str]:
    """Seconds per unit and name of the unit in which times up to `longest` (s) read best."""
    for name, unit, least in (("weeks", "w", 2.0), ("days", "d", 2.0), ("hours", "h", 2.0)):
        if longest >= least * SECONDS_PER[unit]:
            return SECONDS_PER[unit], name
    return 1.0, "seconds"


def volume_loss_plot(
    alloys: Sequence[AlloyResult],
    measured: Mapping[str, VolumeLossData],
    bands: Sequence[BandRow] = (),
) -> str:
    """Volume loss against immersion time as SVG; `measured`: a person's own points by alloy.

    bands: 5 to 95 % of the samples of the constants, as bars at their times.
    """
    figure, axes = _figure()
    longest = max(
        [a.immersions[-1].seconds for a in alloys if a.immersions]
        + [float(data.times.max()) for data in measured.values()]
        + [1.0]
    )
    second, unit = time_axis(longest)
    marks: Marks = []
    for n, alloy in enumerate(alloys):
        style = _style(n)
        time, loss = column(alloy.history, "time"), column(alloy.history, "volume_loss")
        known = [i for i in alloy.immersions if i.summary is not None]
        if time is not None and loss is not None:
            times, losses = _smooth(time, loss)
            axes.plot(times / second, 100 * losses, lw=1.8, label=alloy.name, **_line(style))
            marks += [
                (
                    t / second,
                    100 * v,
                    f"{alloy.name}, {t / second:.3g} {unit}: {100 * v:.2f} % lost",
                )
                for t, v in zip(*_few(time, loss), strict=True)
            ]
        elif known:
            axes.plot([], [], lw=1.8, label=alloy.name, **style)
        if known:
            axes.plot(
                [i.seconds / second for i in known],
                [100 * i.summary.volume_loss for i in known],
                ls="none",
                ms=5,
                **_marker(style),
            )
        own = [b for b in bands if b.alloy == alloy.name]
        axes.vlines(  # not joined: the loss between the times is no straight line
            [86400.0 * b.immersion_days / second for b in own],
            [100 * b.volume_loss[0] for b in own],
            [100 * b.volume_loss[2] for b in own],
            color=style["color"],
            alpha=0.3,
            lw=7,
        )
        if alloy.name in measured:
            data = measured[alloy.name]
            spread = data.standard_deviation
            axes.errorbar(
                data.times / second,
                100 * data.volume_loss,
                yerr=None if spread is None else 100 * spread,
                ls="none",
                marker=style["marker"],
                mfc="none",
                mew=1.4,
                ms=7,
                capsize=2.5,
                elinewidth=1.0,
                color=style["color"],
                label=f"{alloy.name}, measured",
            )
    _time_ticks(axes, unit)
    axes.set_ylabel("Volume loss (%)")
    _finish(axes, zero=True)
    title = "Volume loss in per cent against immersion time"
    return _svg(figure, "volume-loss", title, marks)


def _shade(axes: Axes, rows: Sequence[BandRow], second: float, style: dict) -> None:
    """Shade the band of the strength of one alloy from time zero on."""
    if not rows:
        return
    times = [0.0, *(86400.0 * row.immersion_days / second for row in rows)]
    low, high = ([100.0, *(100 * row.strength_ratio[end] for row in rows)] for end in (0, 2))
    axes.fill_between(times, low, high, color=style["color"], alpha=0.18, lw=0)


def strength_plot(
    alloys: Sequence[AlloyResult],
    names: LoadNames = LOADS["axial"],
    bands: Sequence[BandRow] = (),
    hold: str = "shank",
    error: float | None = None,
) -> str:
    """Peak over that of the intact solid against immersion time, all alloys held alike, as SVG.

    bands: 5 to 95 % of the samples of the constants, shaded; error: of the strength left, relative,
    as measured of mesh and increments, shaded more strongly, None where it was not.
    """
    figure, axes = _figure()
    longest = max((i.seconds for a in alloys for i in a.immersions), default=1.0)
    for n, alloy in enumerate(alloys):
        rows = [band for band in bands if band.alloy == alloy.name]
        _shade(axes, rows, time_axis(longest)[0], _style(n))
    second, unit = time_axis(longest)
    marks: Marks = []
    for n, alloy in enumerate(alloys):
        known = [i for i in alloy.immersions if i.strength_ratio is not None]
        times = [i.seconds / second for i in known]
        if error is not None and known:
            low, high = (
                [100 * i.strength_ratio * (1 + side * error * (i.seconds > 0)) for i in known]
                for side in (-1, 1)
            )
            axes.fill_between(times, low, high, color=_style(n)["color"], alpha=0.28, lw=0)
        for time, item in zip(times, known, strict=True):
            peak = ""
            if item.reaction is not None and len(item.reaction):
                peak = f", {names.shown(float(np.nanmax(item.reaction)))}"
            value = 100 * item.strength_ratio
            text = f"{alloy.name}, {time:.3g} {unit}: {value:.1f} % left{peak}"
            marks.append((time, value, text))
    draw_strength(axes, alloys, colours=_SERIES, names=names)
    _finish(axes, zero=True)
    title = f"{_capital(names.strength)} left in per cent against immersion time"
    return _svg(figure, f"strength-{hold}", title, marks)


def draw_strength(
    axes: Axes,
    alloys: Sequence[AlloyResult],
    colours: Sequence[str],
    names: LoadNames,
    way: tuple[int, str] | None = None,
) -> None:
    """Draw strength left (%) against immersion time into `axes`; severed solids get a cross.

    way: number and name of a way of holding where one drawing shows several: each has a line style
    of its own, and `name_lines` writes its name beside its lines.
    """
    longest = max((i.seconds for a in alloys for i in a.immersions), default=1.0)
    second, unit = time_axis(longest)
    severed = []
    for n, alloy in enumerate(alloys):
        style = _style(n, colours)
        known = [i for i in alloy.immersions if i.strength_ratio is not None]
        if not known:
            continue
        times = [i.seconds / second for i in known]
        ratios = [100 * i.strength_ratio for i in known]
        label = alloy.name
        if way is not None:
            style["ls"] = LINE_STYLES[way[0] % len(LINE_STYLES)]
            label = alloy.name if way[0] == 0 else None
        axes.plot(times, ratios, lw=1.8, ms=5.5, label=label, clip_on=False, zorder=3, **style)
        severed += [(t, r) for t, r in zip(times, ratios, strict=True) if r == 0.0]
    if severed:
        said = "severed" in axes.get_legend_handles_labels()[1]  # of another way of holding
        axes.plot(
            *zip(*severed, strict=True),
            ls="none",
            marker="x",
            ms=10,
            mew=2,
            color=axes.xaxis.label.get_color(),
            label=None if said else "severed",
            clip_on=False,
            zorder=4,
        )
    _time_ticks(axes, unit)
    axes.set_ylabel(f"{_capital(names.strength)} left (%)")
    axes.set_ylim(0, max(105.0, axes.get_ylim()[1]))


def name_lines(
    axes: Axes, lines: Sequence[tuple[float, str, str]], apart: float, size: float = 8.5
) -> None:
    """Write the names of lines beside their right ends, beyond the axes, none over another.

    lines: value at the end, name and colour; apart: least distance of two names, in values.
    """
    ordered = sorted(lines)
    places = [value for value, _, _ in ordered]
    for _ in range(200):  # push neighbours apart by halves until all are far enough
        for n in range(len(places) - 1):
            lacking = apart - (places[n + 1] - places[n])
            if lacking > 0:
                places[n] -= 0.5 * lacking
                places[n + 1] += 0.5 * lacking
        places = [max(place, axes.get_ylim()[0]) for place in places]
    right = axes.get_xlim()[1]
    for place, (value, name, colour) in zip(places, ordered, strict=True):
        axes.annotate(
            name,
            (right, value),
            xytext=(1.03, place),
            textcoords=axes.get_yaxis_transform(),
            va="center",
            color=colour,
            fontsize=size,
            annotation_clip=False,
        )


def load_plot(alloy: AlloyResult, name: str, most: float, names: LoadNames = LOADS["axial"]) -> str:
    """Force-elongation (torque-angle, moment-angle) curves of one alloy by immersion time, as SVG.

    most: upper end of the force axis (SI), so that the alloys' plots share one scale.
    """
    figure, axes = _figure()
    marks: Marks = []
    tested = [i for i in alloy.immersions if i.reaction is not None and i.abscissa is not None]
    for n, item in enumerate(tested):
        shade = _RAMP[round(n * (TIME_RAMP - 1) / max(1, len(tested) - 1))]
        along, force = item.abscissa, names.shown_factor * item.reaction
        if len(force) == 0 or not np.any(force > 0):
            axes.plot([], [], color=shade, lw=1.8, label=f"{item.label}: carries nothing")
            continue
        axes.plot(along, force, color=shade, lw=1.8, label=item.label)
        peak = int(np.nanargmax(force))
        axes.plot(along[peak], force[peak], "o", ms=4, color=shade)
        marks += [
            (x, y, f"{item.label}: {y:.3g} {names.shown_unit} at {x:.3g} {names.abscissa_unit}")
            for x, y in zip(*_few(along, force, peak), strict=True)
        ]
    axes.set_xlabel(names.abscissa_title)
    axes.set_ylabel(f"{_capital(names.reaction)} ({names.shown_unit})")
    axes.set_ylim(0, 1.05 * names.shown_factor * (most or 1.0))
    axes.set_xlim(left=0)
    _finish(axes, zero=False)
    title = f"{_capital(names.reaction)} against {names.abscissa} of {alloy.name}"
    return _svg(figure, f"curves-{name}", title, marks)


def ph_plot(alloy: str, name: str, rows: Sequence[Mapping], medium: float) -> str:
    """Mean pH against the distance from the metal, one curve per immersion time, as SVG.

    rows: per time `time` (s), `profile_um` and `profile_ph`; medium: its pH, dotted.
    """
    figure, axes = _figure()
    for n, row in enumerate(rows):
        shade = _RAMP[round(n * (TIME_RAMP - 1) / max(1, len(rows) - 1))]
        second, unit = time_axis(max(row["time"], 1.0))
        label = f"{row['time'] / second:.3g} {unit}" if row["time"] else "start"
        axes.plot(row["profile_um"], row["profile_ph"], color=shade, lw=1.8, label=label)
    axes.axhline(medium, color=_INK, lw=1.0, ls=":")
    axes.set_xlabel("Distance from the metal (µm)")
    axes.set_ylabel("pH")
    axes.set_xlim(left=0)
    _finish(axes, zero=False)
    return _svg(figure, f"ph-{name}", f"pH against the distance from the metal, {alloy}")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _smooth(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve through all steps of a march that neither overshoots nor shows their corners."""
    time, first = np.unique(time, return_index=True)
    if len(time) < 3:
        return time, values[first]
    fine = np.unique(np.concatenate([time, np.linspace(time[0], time[-1], 200)]))
    return fine, PchipInterpolator(time, values[first])(fine)


def _time_ticks(axes: Axes, unit: str) -> None:
    """Label the time axis, with ticks where people expect them: every 4 weeks, every 7 days."""
    axes.set_xlabel(f"Immersion time ({unit})")
    axes.set_xlim(left=0)
    steps = {"weeks": (1, 2, 4, 8, 12, 26, 52), "days": (1, 2, 7, 14), "hours": (1, 2, 6, 12, 24)}
    fitting = [s for s in steps.get(unit, ()) if 3 <= axes.get_xlim()[1] / s <= 9]
    if fitting:
        axes.xaxis.set_major_locator(MultipleLocator(fitting[0]))


def _figure() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.add_subplot()
    for item in (axes.xaxis, axes.yaxis):
        item.label.set_color(_INK)
        item.label.set_fontsize(9)
    axes.tick_params(colors=_INK, labelsize=8.5, width=0.7, length=3)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(_INK)
        spine.set_linewidth(0.7)
    axes.grid(color=_FAINT, lw=0.6)
    axes.set_axisbelow(True)
    axes.patch.set_alpha(0.0)
    figure.patch.set_alpha(0.0)
    return figure, axes


def _style(n: int, colours: Sequence[str] = _SERIES) -> dict:
    return {
        "color": colours[n % len(colours)],
        "marker": MARKERS[n % len(MARKERS)],
        "ls": LINE_STYLES[n % len(LINE_STYLES)],
    }


def _line(style: dict) -> dict:
    return {"color": style["color"], "ls": style["ls"]}


def _marker(style: dict) -> dict:
    return {"color": style["color"], "marker": style["marker"]}


def _few(
    x: NDArray[np.float64], y: NDArray[np.float64], keep: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """At most so many points of a curve that each can be pointed at, number `keep` among them."""
    picks = np.linspace(0, len(x) - 1, min(len(x), _MOST_MARKS)).round().astype(int)
    picks = np.unique(np.append(picks, keep))
    picks = picks[np.isfinite(x[picks]) & np.isfinite(y[picks])]
    return x[picks], y[picks]


def _finish(axes: Axes, *, zero: bool) -> None:
    """Limits, and the legend above the axes, its entries in the order of drawing row by row."""
    if zero:
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    columns = min(len(labels), 6 if max(map(len, labels)) <= 3 else 3)
    axes.figure.legend(
        _by_rows(handles, columns),
        _by_rows(labels, columns),
        loc="outside upper left",
        ncols=columns,
        columnspacing=1.2,
        fontsize=8.5,
        frameon=False,
        labelcolor=_INK,
        handlelength=1.8,
    )


def _by_rows(entries: Sequence, columns: int) -> list:
    """The entries in the order in which matplotlib, column by column, fills rows with them."""
    return [entry for first in range(columns) for entry in entries[first::columns]]


def _svg(figure: Figure, name: str, label: str, marks: Marks = ()) -> str:
    """The figure as an SVG element for an HTML page: CSS colours, page font, unique ids.

    marks: values of the first axes, as circles with a title that the page's script shows.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", text, flags=re.DOTALL)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    text = re.sub(r"font-family: [^;\"]*; ?", "", text)
    for colour, variable in _CSS.items():
        text = text.replace(colour, variable)
    width, height = (72 * figure.get_size_inches()).round(2)
    head = (
        f'<svg class="plot" role="img" aria-label="{label}" viewBox="0 0 {width} {height}" '
        'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    )
    body = text[text.index(">") + 1 : text.rindex("</svg>")]
    to_figure = figure.axes[0].transData - figure.transFigure
    circles = [
        f'<circle class="value" cx="{width * x:.1f}" cy="{height * (1 - y):.1f}" r="3.5">'
        f"<title>{escape(words)}</title></circle>"
        for (x, y), words in ((to_figure.transform(mark[:2]), mark[2]) for mark in marks)
    ]
    return head + body + "".join(circles) + "</svg>"
