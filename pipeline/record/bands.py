"""What the doubt of the constants makes of volume loss and strength: bands.csv of a run folder."""

import csv
import io
import sys
from dataclasses import dataclass
from pathlib import Path

from pipeline.record.run_folder import write_text

BANDS_FILE = "bands.csv"
LEVELS = (5, 50, 95)
"""Per cent of the samples that lie below each value of a band."""

_BANDED = {
    "volume_loss": "volume_loss",
    "degradation_rate": "degradation_rate_mm_per_year",
    "strength_ratio": "strength_ratio",
}
"""Field of a row with a band -> start of its columns."""

_COLUMNS = (
    "alloy",
    "hold",
    "immersion_days",
    *(f"{name}_{level}" for name in _BANDED.values() for level in LEVELS),
    "samples",
    "strength_curve_error",
)


@dataclass(frozen=True)
class BandRow:
    """One alloy after one immersion time, held in one way.

    Bands are the values below which 5, 50 and 95 % of the samples lie.  degradation_rate: (5.34)
    of Hermann 2024, mm/year; samples: of the constants; strength_curve_error: leave-one-out, of
    the strength left.
    """

    alloy: str
    hold: str
    immersion_days: float
    volume_loss: tuple[float, float, float]
    degradation_rate: tuple[float, float, float]
    strength_ratio: tuple[float, float, float]
    samples: int
    strength_curve_error: float


def write_bands(path: Path, rows: list[BandRow]) -> None:
    """Write the rows as CSV in one step."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        numbers = (row.immersion_days, *(v for name in _BANDED for v in getattr(row, name)))
        error = f"{row.strength_curve_error:.3g}"
        lead = (row.alloy, row.hold)
        writer.writerow([*lead, *(f"{v:.10g}" for v in numbers), row.samples, error])
    write_text(path, buffer.getvalue())


def read_bands(path: Path) -> list[BandRow]:
    """The rows that `write_bands` wrote; none where there is no such file."""
    if not path.is_file():
        return []
    with open(path, encoding="utf-8", newline="") as handle:
        reader = csv.DictReader(handle)
        if tuple(reader.fieldnames or ()) != _COLUMNS:
            raise ValueError(f"columns of '{path}' are not {', '.join(_COLUMNS)}")
        return [
            BandRow(
                row["alloy"],
                row["hold"],
                float(row["immersion_days"]),
                *(tuple(float(row[f"{n}_{level}"]) for level in LEVELS) for n in _BANDED.values()),
                int(row["samples"]),
                float(row["strength_curve_error"]),
            )
            for row in reader
        ]


def print_bands(rows: list[BandRow]) -> None:
    """Print the rows for a reader."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    title = f"{LEVELS[0]} to {LEVELS[-1]} % of the samples of the constants (middle)"
    table = Table(title=title)
    for name in ("alloy", "hold", "immersion [d]"):
        table.add_column(escape(name))
    for name in ("volume loss [%]", "degradation rate [mm/year]", "strength left [%]"):
        table.add_column(escape(name), justify="right")
    for row in rows:
        shown = [
            f"{low:.{digits}f} to {high:.{digits}f} ({middle:.{digits}f})"
            for digits, (low, middle, high) in (
                (1, [100 * v for v in row.volume_loss]),
                (3, row.degradation_rate),
                (1, [100 * v for v in row.strength_ratio]),
            )
        ]
        table.add_row(row.alloy, row.hold, f"{row.immersion_days:g}", *shown)
    Console(width=None if sys.stdout.isatty() else 120).print(table)
