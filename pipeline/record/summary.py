"""The table of a run: one row per alloy, way of holding and immersion time."""

import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from pipeline.record.run_folder import write_text
from pipeline.scene.loads import LOADS


@dataclass(frozen=True)
class SummaryRow:
    """One alloy after one immersion time, held in one way.

    hold: name of the way of holding (pipeline.scene.holding); volume_loss: V_L of the
    lattice, by mass, in [0, 1]; mean_corrosion_damage: volume mean of f0 over the mesh;
    peak_reaction: largest force (N), torque or moment (N m), as `load` says; strength_ratio: that
    over the one of the same alloy, held alike, at time zero; strain_at_peak: nominal; status: how
    the test ended; degradation_rate: (5.34) of Hermann 2024, mm/year, None at time zero.
    """

    alloy: str
    hold: str
    immersion_days: float
    volume_loss: float
    mean_corrosion_damage: float
    peak_reaction: float
    strength_ratio: float
    strain_at_peak: float
    status: str
    load: str = "axial"
    degradation_rate: float | None = None


def columns(load: str) -> dict[str, str]:
    """Column of summary.csv by field of a row; those of the peak are named by the load."""
    names = LOADS[load]
    same = ("alloy", "hold", "immersion_days", "volume_loss", "mean_corrosion_damage")
    return {
        **{name: name for name in same},
        "peak_reaction": names.peak,
        "strength_ratio": "strength_ratio",
        "strain_at_peak": names.strain_at_peak,
        "status": "status",
        "degradation_rate": "degradation_rate_mm_per_year",
    }


def write_summary(path: Path, rows: list[SummaryRow]) -> None:
    """Write the rows, all of one load, as CSV with a header line, in one step."""
    named = columns(rows[0].load if rows else "axial")
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(named.values())
    for row in rows:
        values = [getattr(row, field) for field in named]
        writer.writerow([f"{v:.10g}" if isinstance(v, float) else v for v in values])  # None: ""
    write_text(path, buffer.getvalue())


def read_summary(path: Path) -> list[SummaryRow]:
    """Read rows that `write_summary` wrote; ValueError when the columns are others."""
    with open(path, encoding="utf-8", newline="") as handle:
        reader = csv.DictReader(handle)
        found = tuple(reader.fieldnames or ())
        load = next((load for load in LOADS if tuple(columns(load).values()) == found), None)
        if load is None:
            expected = ", ".join(columns("axial").values())
            raise ValueError(f"columns of '{path}' are not {expected}")
        return [
            SummaryRow(
                **{field: _cell(field, row[name]) for field, name in columns(load).items()},
                load=load,
            )
            for row in reader
        ]


def shown(rows: Sequence[SummaryRow]) -> tuple[list[str], list[list[str]]]:
    """Titles and cells of the rows, all of one load, for a reader; 80 columns hold them."""
    names = LOADS[rows[0].load]
    titles = [
        "alloy",
        "hold",
        "time [d]",
        "volume loss [%]",
        f"peak {names.reaction} [{names.shown_unit}]",
        "strength left [%]",
        "strain at peak [%]",
        "status",
    ]
    return titles, [
        [
            row.alloy,
            row.hold,
            f"{row.immersion_days:g}",
            f"{100 * row.volume_loss:.2f}",
            f"{names.shown_factor * row.peak_reaction:.1f}",
            f"{100 * row.strength_ratio:.1f}",
            f"{100 * row.strain_at_peak:.2f}",
            row.status,
        ]
        for row in rows
    ]


def print_summary(rows: Sequence[SummaryRow], stream: TextIO | None = None) -> None:
    """Print the rows, all of one load, for a reader; on stdout where no stream is given."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    stream = stream or sys.stdout
    table = Table(
        box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title=f"Residual {LOADS[rows[0].load].strength}"
    )
    titles, cells = shown(rows)
    for title in titles:
        words = title in ("alloy", "hold", "status")
        longest = max(map(len, title.split()))  # what rich would cut in a narrow terminal
        side = "left" if words else "right"
        table.add_column(escape(title), justify=side, min_width=longest, no_wrap=words)
    for row in cells:
        table.add_row(*row)
    Console(file=stream, width=None if stream.isatty() else 120).print(table)


def _cell(field: str, text: str) -> str | float | None:
    if field in ("alloy", "hold", "status"):
        return text
    return None if field == "degradation_rate" and not text else float(text)
