"""A drawing of a run's results for a notebook or a file: strength left, and the curves."""

from __future__ import annotations

import io
from collections.abc import Collection

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pipeline.record.run_results import RunResults
from pipeline.report.drawing import ALLOY_COLOURS, LINE_STYLES
from pipeline.report.plots import draw_strength
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.loads import LOADS


class ShownFigure(Figure):
    """A Figure that a notebook shows although pyplot did not make it."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        FigureCanvasAgg(self).print_png(buffer)
        return buffer.getvalue()


def plot_results(run: RunResults, alloys: Collection[str], holds: Collection[str]) -> ShownFigure:
    """Strength left against immersion time beside the curves of all tests of `alloys`, `holds`.

    Colour says the alloy, line style the way of holding; the curves fade from intact to the last
    time.
    """
    load = LOADS[run.scene.tensile.load]
    figure = ShownFigure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for n, hold in enumerate(holds):
        held = [alloy for alloy in run.held[hold] if alloy.name in alloys]
        way = (n, HOLDINGS[hold].part) if len(holds) > 1 else None
        draw_strength(left, held, ALLOY_COLOURS, load, way=way)
        for alloy, colour in zip(held, ALLOY_COLOURS, strict=False):
            tested = [i for i in alloy.immersions if i.reaction is not None]
            shades = np.linspace(1.0, 0.35, len(tested))
            for item, shade in zip(tested, shades, strict=True):
                force = load.shown_factor * item.reaction
                style = LINE_STYLES[n % len(LINE_STYLES)]
                right.plot(item.abscissa, force, color=colour, alpha=shade, ls=style, lw=1.6)
                if len(force):
                    end = (item.abscissa[-1], force[-1])
                    right.annotate(
                        item.label, end, (4, 0), textcoords="offset points", va="center", fontsize=8
                    )
    right.set_xlabel(load.abscissa_title)
    right.set_ylabel(f"{load.reaction.capitalize()} ({load.shown_unit})")
    for axes in (left, right):
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.grid(color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    if len(holds) > 1:
        for n, hold in enumerate(holds):
            left.plot([], [], color="#555555", ls=LINE_STYLES[n], label=HOLDINGS[hold].part)
    left.legend(frameon=False, fontsize=8)
    return figure
