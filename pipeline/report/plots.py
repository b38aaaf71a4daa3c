"""The curves of the report, as SVG (drawing.py)."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from perilife_data import VolumeLossData
from pipeline.record.bands import BandRow
from pipeline.record.run_results import AlloyResult, column
from pipeline.report.drawing import (
    INK,
    LINE_STYLES,
    RAMP,
    SERIES,
    TIME_RAMP,
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
from pipeline.scene.loads import LOADS, LoadNames


def volume_loss_plot(
    alloys: Sequence[AlloyResult],
    measured: Mapping[str, VolumeLossData],
    bands: Sequence[BandRow] = (),
) -> str:
    """Volume loss against immersion time as SVG; `measured`: a person's own points by alloy.

    bands: 5 to 95 % of the samples of the constants, as bars at their times.
    """
    figure, axes = new_figure()
    longest = max(
        [a.immersions[-1].seconds for a in alloys if a.immersions]
        + [float(data.times.max()) for data in measured.values()]
        + [1.0]
    )
    second, unit = time_axis(longest)
    marks: Marks = []
    for n, alloy in enumerate(alloys):
        style = style_of(n)
        time, loss = column(alloy.history, "time"), column(alloy.history, "volume_loss")
        known = [i for i in alloy.immersions if i.summary is not None]
        if time is not None and loss is not None:
            times, losses = smooth(time, loss)
            axes.plot(times / second, 100 * losses, lw=1.8, label=alloy.name, **line_of(style))
            marks += [
                (
                    t / second,
                    100 * v,
                    f"{alloy.name}, {t / second:.3g} {unit}: {100 * v:.2f} % lost",
                )
                for t, v in zip(*few(time, loss), strict=True)
            ]
        elif known:
            axes.plot([], [], lw=1.8, label=alloy.name, **style)
        if known:
            axes.plot(
                [i.seconds / second for i in known],
                [100 * i.summary.volume_loss for i in known],
                ls="none",
                ms=5,
                **marker_of(style),
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
    time_ticks(axes, unit)
    axes.set_ylabel("Volume loss (%)")
    finish(axes, zero=True)
    title = "Volume loss in per cent against immersion time"
    return svg_of(figure, "volume-loss", title, marks)


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
    figure, axes = new_figure()
    longest = max((i.seconds for a in alloys for i in a.immersions), default=1.0)
    for n, alloy in enumerate(alloys):
        rows = [band for band in bands if band.alloy == alloy.name]
        _shade(axes, rows, time_axis(longest)[0], style_of(n))
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
            axes.fill_between(times, low, high, color=style_of(n)["color"], alpha=0.28, lw=0)
        for time, item in zip(times, known, strict=True):
            peak = ""
            if item.reaction is not None and len(item.reaction):
                peak = f", {names.shown(float(np.nanmax(item.reaction)))}"
            value = 100 * item.strength_ratio
            text = f"{alloy.name}, {time:.3g} {unit}: {value:.1f} % left{peak}"
            marks.append((time, value, text))
    draw_strength(axes, alloys, colours=SERIES, names=names)
    finish(axes, zero=True)
    title = f"{capital(names.strength)} left in per cent against immersion time"
    return svg_of(figure, f"strength-{hold}", title, marks)


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
        style = style_of(n, colours)
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
    time_ticks(axes, unit)
    axes.set_ylabel(f"{capital(names.strength)} left (%)")
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
    figure, axes = new_figure()
    marks: Marks = []
    tested = [i for i in alloy.immersions if i.reaction is not None and i.abscissa is not None]
    for n, item in enumerate(tested):
        shade = RAMP[round(n * (TIME_RAMP - 1) / max(1, len(tested) - 1))]
        along, force = item.abscissa, names.shown_factor * item.reaction
        if len(force) == 0 or not np.any(force > 0):
            axes.plot([], [], color=shade, lw=1.8, label=f"{item.label}: carries nothing")
            continue
        axes.plot(along, force, color=shade, lw=1.8, label=item.label)
        peak = int(np.nanargmax(force))
        axes.plot(along[peak], force[peak], "o", ms=4, color=shade)
        marks += [
            (x, y, f"{item.label}: {y:.3g} {names.shown_unit} at {x:.3g} {names.abscissa_unit}")
            for x, y in zip(*few(along, force, peak), strict=True)
        ]
    axes.set_xlabel(names.abscissa_title)
    axes.set_ylabel(f"{capital(names.reaction)} ({names.shown_unit})")
    axes.set_ylim(0, 1.05 * names.shown_factor * (most or 1.0))
    axes.set_xlim(left=0)
    finish(axes, zero=False)
    title = f"{capital(names.reaction)} against {names.abscissa} of {alloy.name}"
    return svg_of(figure, f"curves-{name}", title, marks)


def ph_plot(alloy: str, name: str, rows: Sequence[Mapping], medium: float) -> str:
    """Mean pH against the distance from the metal, one curve per immersion time, as SVG.

    rows: per time `time` (s), `profile_um` and `profile_ph`; medium: its pH, dotted.
    """
    figure, axes = new_figure()
    for n, row in enumerate(rows):
        shade = RAMP[round(n * (TIME_RAMP - 1) / max(1, len(rows) - 1))]
        second, unit = time_axis(max(row["time"], 1.0))
        label = f"{row['time'] / second:.3g} {unit}" if row["time"] else "start"
        axes.plot(row["profile_um"], row["profile_ph"], color=shade, lw=1.8, label=label)
    axes.axhline(medium, color=INK, lw=1.0, ls=":")
    axes.set_xlabel("Distance from the metal (µm)")
    axes.set_ylabel("pH")
    axes.set_xlim(left=0)
    finish(axes, zero=False)
    return svg_of(figure, f"ph-{name}", f"pH against the distance from the metal, {alloy}")
