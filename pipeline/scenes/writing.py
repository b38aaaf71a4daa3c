"""Files of a scene's run: HDF5, history, table, ParaView series, plot."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from peri.corrosion.results import write_history
from peri.engine.results import write_result
from pipeline.record.run_folder import write_text
from pipeline.record.whole_file import whole_file
from pipeline.scenes.outcome import Outcome, Panel, Prepared, Section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCHEMA_VERSION = 1
RESULT_FILE, HISTORY_FILE, SUMMARY_FILE = "result.h5", "history.csv", "summary.csv"
PLOT_FILE, SERIES_FILE = "plot.png", "fields.pvd"


def march_and_write(
    folder: Path, name: str, prepared: Prepared, times: Sequence[float], **march: Any
) -> tuple[list[Path], dict[str, object]]:
    """March a scene to its times (s) and write it: the files, and the record's numbers.

    march : as `outcome.March` takes it.  Numbers: value and unit by name, those that are finite.
    """
    outcome = prepared.march(times, **march)
    paths = write_outcome(folder, name, outcome)
    return paths, {n: [v, unit] for n, (v, unit) in outcome.summary.items() if abs(v) < np.inf}


def write_outcome(folder: Path, name: str, outcome: Outcome) -> list[Path]:
    """Write all files of a run, each whole under its name or not at all; returns them."""
    from peri.engine.results import Field

    result = folder / RESULT_FILE
    fields = {"times": Field(outcome.times, "s"), **outcome.fields}
    history = {n: Field(v, outcome.units[n]) for n, v in outcome.history.items()}
    about = {"scene": name, "wall_time": outcome.wall_time}
    write_result(result, outcome.lattice, fields, history, about, SCHEMA_VERSION)
    write_history(folder / HISTORY_FILE, dict(outcome.history), outcome.units)
    write_text(folder / SUMMARY_FILE, _table(outcome))
    draw(outcome.panels, folder / PLOT_FILE)
    series = write_series(folder, outcome)
    return [
        result, folder / HISTORY_FILE, folder / SUMMARY_FILE, folder / PLOT_FILE, *series
    ]  # fmt: skip


def _table(outcome: Outcome) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["quantity", "value", "unit"])
    for quantity, (value, unit) in outcome.summary.items():
        writer.writerow([quantity, f"{value:.9g}", unit])
    return text.getvalue()


def draw(panels: Sequence[Panel | Section], path: Path) -> None:
    """The panels side by side, two in a row; one that is left over has a row of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = (len(panels) + 1) // 2
    figure = Figure(figsize=(11.0, 3.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 2)
    for place, panel in enumerate(panels):
        row, column = divmod(place, 2)
        alone = place == len(panels) - 1 and column == 0
        axes = figure.add_subplot(grid[row, :] if alone else grid[row, column])
        axes.set_title(panel.title, fontsize=11)
        if isinstance(panel, Section):
            _draw_section(panel, axes)
            continue
        for n, curve in enumerate(panel.curves):
            style = "" if curve.dots else "--" if n >= 8 else "-"
            mark = "o" if curve.dots or len(curve.x) < 12 else ""
            axes.plot(curve.x, curve.y, style, marker=mark, ms=3, lw=1.3, label=curve.name)
        if panel.logarithmic:
            axes.set_yscale("log")
        axes.set_xlabel(panel.x)
        axes.set_ylabel(panel.y)
        axes.grid(True, linewidth=0.3)
        if len(panel.curves) > 1:
            axes.legend(fontsize=8)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _draw_section(section: Section, axes: Axes) -> None:
    """Values by colour, each node as a cell; grey where there are none."""
    x, y = section.x, section.y
    image = axes.pcolormesh(x, y, np.ma.masked_invalid(section.values.T), shading="nearest")
    axes.set_facecolor("0.75")
    axes.set_aspect("equal")
    axes.set_xlabel(section.along)
    axes.set_ylabel(section.across)
    axes.figure.colorbar(image, ax=axes, label=section.of, location="bottom")


def write_series(folder: Path, outcome: Outcome) -> list[Path]:
    """One VTK image per output time with all fields, and the series file for ParaView."""
    import pyvista

    lattice = outcome.lattice
    lead = (1,) * (3 - lattice.dimension)
    files, entries = [], []
    for n, time in enumerate(outcome.times):
        image = pyvista.ImageData(
            dimensions=lattice.shape + lead,
            spacing=lattice.spacing + (min(lattice.spacing),) * len(lead),
            origin=lattice.origin + (0.0,) * len(lead),
        )
        for name, field in outcome.fields.items():
            values = np.asarray(field.values)
            values = values if values.shape == lattice.shape else values[n]
            kind = np.uint8 if values.dtype.kind in "bu" else np.float32
            image[name] = values.astype(kind).ravel(order="F")
        path = folder / f"fields_{n:03d}.vti"
        image.save(path)
        files.append(path)
        entries.append(f'<DataSet timestep="{time:.9g}" file="{path.name}"/>')
    series = folder / SERIES_FILE
    inner = "\n".join(entries)
    write_text(
        series,
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
        f"{inner}\n</Collection>\n</VTKFile>\n",
    )
    return [*files, series]
