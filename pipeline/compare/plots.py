"""The curves of several runs over each other, as SVG without legend: the page has one key."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from pipeline.compare.runs import Line, Way, same_time, tested
from pipeline.record.run_results import column
from pipeline.report.drawing import (
    SERIES,
    Marks,
    capital,
    few,
    finish,
    line_of,
    marker_of,
    new_figure,
    smooth,
    style_of,
    svg_of,
    time_axis,
    time_ticks,
)

_SHAPES = {
    "o": '<circle cx="18" cy="6" r="3.4"/>',
    "s": '<rect x="15" y="3" width="6" height="6"/>',
    "^": '<path d="M18 2l4 7.4h-8z"/>',
    "D": '<path d="M18 1.6l4.4 4.4-4.4 4.4-4.4-4.4z"/>',
    "v": '<path d="M18 10l4-7.4h-8z"/>',
    "P": '<path d="M16.5 2h3v2.5H22v3h-2.5V10h-3V7.5H14v-3h2.5z"/>',
}
"""Markers of matplotlib as shapes in a box of 36 x 12."""


def swatch(number: int) -> Markup:
    """Line and marker of a line of this number, for the key."""
    style = style_of(number)
    dashes = "" if style["ls"] == "-" else " ".join(f"{1.8 * d:g}" for d in style["ls"][1])
    colour = f"var(--s{SERIES.index(style['color'])})"
    return Markup(
        '<svg class="swatch" viewBox="0 0 36 12" width="36" height="12" aria-hidden="true">'
        f'<path d="M0 6h36" stroke="{colour}" stroke-width="1.8" stroke-dasharray="{dashes}"/>'
        f'<g fill="{colour}">{_SHAPES[style["marker"]]}</g></svg>'
    )


def strength_plot(lines: Sequence[Line], way: Way, name: str) -> Markup:
    """Strength left (%) against immersion time of the lines that were tested this way."""
    figure, axes = new_figure()
    held = [(line, found) for line in lines if (found := line.held(way)) is not None]
    second, unit = time_axis(max((i.seconds for _, a in held for i in tested(a)), default=1.0))
    marks: Marks = []
    for line, result in held:
        known = list(tested(result))
        at = [i.seconds / second for i in known]
        left = [100 * i.strength_ratio for i in known]
        axes.plot(at, left, lw=1.8, ms=5.5, clip_on=False, zorder=3, **style_of(line.number))
        for time, value, item in zip(at, left, known, strict=True):
            peak = f", {way.names.shown(item.summary.peak_reaction)}" if item.summary else ""
            marks.append((time, value, f"{line.label}, {time:.3g} {unit}: {value:.1f} %{peak}"))
    time_ticks(axes, unit)
    axes.set_ylabel(f"{capital(way.names.strength)} left (%)")
    axes.set_ylim(0, max(105.0, axes.get_ylim()[1]))
    finish(axes, zero=True)
    title = f"{capital(way.names.strength)} left of {way.part} against immersion time"
    return Markup(svg_of(figure, name, title, marks))


def volume_loss_plot(lines: Sequence[Line]) -> Markup:
    """Volume loss (%) against immersion time; markers at the times that were tested."""
    figure, axes = new_figure()
    ends = [i.seconds for line in lines for i in line.corroded.immersions]
    second, unit = time_axis(max(ends, default=1.0))
    marks: Marks = []
    for line in lines:
        style, alloy = style_of(line.number), line.corroded
        time, loss = column(alloy.history, "time"), column(alloy.history, "volume_loss")
        if time is not None and loss is not None:
            through, losses = smooth(time, loss)
            axes.plot(through / second, 100 * losses, lw=1.8, **line_of(style))
            marks += [
                (t / second, 100 * v, f"{line.label}, {t / second:.3g} {unit}: {100 * v:.2f} %")
                for t, v in zip(*few(time, loss), strict=True)
            ]
        known = [i for i in alloy.immersions if i.summary is not None]
        at = [i.seconds / second for i in known]
        axes.plot(at, [100 * i.summary.volume_loss for i in known], ls="none", ms=5,
                  **marker_of(style))  # fmt: skip
    time_ticks(axes, unit)
    axes.set_ylabel("Volume loss (%)")
    finish(axes, zero=True)
    title = "Volume loss in per cent against immersion time"
    return Markup(svg_of(figure, "compared-loss", title, marks))


def pull_plot(lines: Sequence[Line], way: Way, seconds: float, name: str) -> Markup | None:
    """Force-elongation (torque-angle, moment-angle) curves after one time; a dot at each peak.

    None where no line was tested this way after this time.
    """
    figure, axes = new_figure()
    names = way.names
    marks: Marks = []
    drawn = 0
    for line in lines:
        result = line.held(way)
        items = () if result is None else result.immersions
        item = next((i for i in items if same_time(i.seconds, seconds)), None)
        if item is None or item.reaction is None or item.abscissa is None:
            continue
        drawn += 1
        style = style_of(line.number)
        along, force = item.abscissa, names.shown_factor * item.reaction
        if not np.any(force > 0):
            marks.append((0.0, 0.0, f"{line.label}: carries nothing"))
            continue
        axes.plot(along, force, lw=1.8, **line_of(style))
        peak = int(np.nanargmax(force))
        axes.plot(along[peak], force[peak], ms=5, **marker_of(style))
        marks += [
            (x, y, f"{line.label}: {y:.3g} {names.shown_unit} at {x:.3g} {names.abscissa_unit}")
            for x, y in zip(*few(along, force, peak), strict=True)
        ]
    if not drawn:
        return None
    axes.set_xlabel(names.abscissa_title)
    axes.set_ylabel(f"{capital(names.reaction)} ({names.shown_unit})")
    finish(axes, zero=True)
    title = f"{capital(names.reaction)} against {names.abscissa}, {way.part}"
    return Markup(svg_of(figure, name, title, marks))
