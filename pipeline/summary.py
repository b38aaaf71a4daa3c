"""The table of a run: one row per alloy and immersion time."""

import csv
import io
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from pipeline.run_folder import write_text


@dataclass(frozen=True)
class SummaryRow:
    """One alloy after one immersion time.

    volume_loss: V_L of the lattice, by mass, in [0, 1]; mean_corrosion_damage: volume mean of
    f0 over the mesh; strength_ratio: peak force over that of the same alloy at time zero;
    elongation_at_peak: nominal strain; status: how the tensile test ended.
    """

    alloy: str
    immersion_days: float
    volume_loss: float
    mean_corrosion_damage: float
    peak_force_N: float
    strength_ratio: float
    elongation_at_peak: float
    status: str


COLUMNS = tuple(f.name for f in fields(SummaryRow))


def write_summary(path: Path, rows: list[SummaryRow]) -> None:
    """Write the rows as CSV with a header line, in one step."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow([f"{v:.10g}" if isinstance(v, float) else v for v in astuple(row)])
    write_text(path, buffer.getvalue())


def read_summary(path: Path) -> list[SummaryRow]:
    """Read rows that `write_summary` wrote; ValueError when the columns are others."""
    with open(path, encoding="utf-8", newline="") as handle:
        reader = csv.DictReader(handle)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise ValueError(f"columns of '{path}' are not {', '.join(COLUMNS)}")
        return [
            SummaryRow(**{k: v if k in ("alloy", "status") else float(v) for k, v in row.items()})
            for row in reader
        ]
