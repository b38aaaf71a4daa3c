"""How the curves of a page are drawn: colours, axes, legend, and SVG that follows the page.

Figures are built without pyplot, so nothing of matplotlib's global state changes.  Colours are
placeholders that become CSS variables in the SVG text: one drawing serves light, dark and paper.
"""

import io
import math
import re
from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from pipeline.scene.units import SECONDS_PER

ALLOY_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8f6f00", "#56b4e9")
"""Okabe and Ito's colours (one darkened), distinguishable without colour vision; for paper."""
MARKERS = ("o", "s", "^", "D", "v", "P")
LINE_STYLES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.2, 1, 1.2)))
MOST_LINES = len(ALLOY_COLOURS) * len(LINE_STYLES)
"""Lines that differ in colour and marker or in line style."""

TIME_RAMP = 8
"""Number of steps of the colour ramp for immersion times; the CSS names them --t0 to --t7."""

INK, FAINT = "#a1b1c0", "#a1b1c1"
SERIES = tuple(f"#a1b2c{n:x}" for n in range(len(ALLOY_COLOURS)))
RAMP = tuple(f"#a1b3c{n:x}" for n in range(TIME_RAMP))
_CSS = {
    INK: "var(--ink)",
    FAINT: "var(--line)",
    **{colour: f"var(--s{n})" for n, colour in enumerate(SERIES)},
    **{colour: f"var(--t{n})" for n, colour in enumerate(RAMP)},
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


def capital(text: str) -> str:
    """The text with a capital first."""
    return text[:1].upper() + text[1:]


def smooth(
    time: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve through all steps of a march that neither overshoots nor shows their corners."""
    time, first = np.unique(time, return_index=True)
    if len(time) < 3:
        return time, values[first]
    fine = np.unique(np.concatenate([time, np.linspace(time[0], time[-1], 200)]))
    return fine, PchipInterpolator(time, values[first])(fine)


def time_ticks(axes: Axes, unit: str) -> None:
    """Label the time axis, with ticks where people expect them: every 4 weeks, every 7 days."""
    axes.set_xlabel(f"Immersion time ({unit})")
    axes.set_xlim(left=0)
    steps = {"weeks": (1, 2, 4, 8, 12, 26, 52), "days": (1, 2, 7, 14), "hours": (1, 2, 6, 12, 24)}
    fitting = [s for s in steps.get(unit, ()) if 3 <= axes.get_xlim()[1] / s <= 9]
    if fitting:
        axes.xaxis.set_major_locator(MultipleLocator(fitting[0]))


def new_figure() -> tuple[Figure, Axes]:
    """A figure of the size of all, and its axes, for text in the colours of the page."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.add_subplot()
    for item in (axes.xaxis, axes.yaxis):
        item.label.set_color(INK)
        item.label.set_fontsize(9)
    axes.tick_params(colors=INK, labelsize=8.5, width=0.7, length=3)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)
        spine.set_linewidth(0.7)
    axes.grid(color=FAINT, lw=0.6)
    axes.set_axisbelow(True)
    axes.patch.set_alpha(0.0)
    figure.patch.set_alpha(0.0)
    return figure, axes


def style_of(n: int, colours: Sequence[str] = SERIES) -> dict:
    """Colour, marker and line style of line number n; MOST_LINES of them can be told apart."""
    turn = n // math.lcm(len(colours), len(LINE_STYLES))  # then colour and style meet again
    return {
        "color": colours[n % len(colours)],
        "marker": MARKERS[n % len(MARKERS)],
        "ls": LINE_STYLES[(n + turn) % len(LINE_STYLES)],
    }


def line_of(style: dict) -> dict:
    """The part of a style that a line has."""
    return {"color": style["color"], "ls": style["ls"]}


def marker_of(style: dict) -> dict:
    """The part of a style that a marker has."""
    return {"color": style["color"], "marker": style["marker"]}


def few(
    x: NDArray[np.float64], y: NDArray[np.float64], keep: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """At most so many points of a curve that each can be pointed at, number `keep` among them."""
    picks = np.linspace(0, len(x) - 1, min(len(x), _MOST_MARKS)).round().astype(int)
    picks = np.unique(np.append(picks, keep))
    picks = picks[np.isfinite(x[picks]) & np.isfinite(y[picks])]
    return x[picks], y[picks]


def finish(axes: Axes, *, zero: bool) -> None:
    """Limits, and the legend above the axes, its entries in the order of drawing row by row."""
    if zero:
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    columns = min(len(labels), 6 if max(map(len, labels)) <= 3 else 3)
    axes.figure.legend(
        by_rows(handles, columns),
        by_rows(labels, columns),
        loc="outside upper left",
        ncols=columns,
        columnspacing=1.2,
        fontsize=8.5,
        frameon=False,
        labelcolor=INK,
        handlelength=1.8,
    )


def by_rows(entries: Sequence, columns: int) -> list:
    """The entries in the order in which matplotlib, column by column, fills rows with them."""
    return [entry for first in range(columns) for entry in entries[first::columns]]


def svg_of(figure: Figure, name: str, label: str, marks: Marks = ()) -> str:
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
