"""What the doubt of the constants makes of volume loss and strength: bands.csv of a run folder."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

from pipeline.record.run_folder import write_text

BANDS_FILE = "bands.csv"
LEVELS = (5, 50, 95)
"""Per cent of the samples that lie below each value of a band."""

_COLUMNS = (
    "alloy",
    "immersion_days",
    *(f"volume_loss_{level}" for level in LEVELS),
    *(f"strength_ratio_{level}" for level in LEVELS),
    "samples",
    "strength_curve_error",
)


@dataclass(frozen=True)
class BandRow:
    """One alloy after one immersion time: values below which 5, 50 and 95 % of the samples lie.

    samples: of the constants; strength_curve_error: leave-one-out, of the strength ratio.
    """

    alloy: str
    immersion_days: float
    volume_loss: tuple[float, float, float]
    strength_ratio: tuple[float, float, float]
    samples: int
    strength_curve_error: float


def write_bands(path: Path, rows: list[BandRow]) -> None:
    """Write the rows as CSV in one step."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for row in rows:
        numbers = (row.immersion_days, *row.volume_loss, *row.strength_ratio)
        error = f"{row.strength_curve_error:.3g}"
        writer.writerow([row.alloy, *(f"{v:.10g}" for v in numbers), row.samples, error])
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
                float(row["immersion_days"]),
                tuple(float(row[f"volume_loss_{level}"]) for level in LEVELS),
                tuple(float(row[f"strength_ratio_{level}"]) for level in LEVELS),
                int(row["samples"]),
                float(row["strength_curve_error"]),
            )
            for row in reader
        ]
