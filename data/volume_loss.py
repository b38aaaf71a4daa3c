"""Reads a person's own volume-loss measurements from a CSV file.

The first row that is neither empty nor a comment (#) names the columns, each with its unit in
square brackets:

    immersion time [w], volume loss [%], standard deviation [%]
    1, 3.1, 0.4
    8, 13.9, 1.2

The standard deviation may be left out. Times are 0 or later and do not fall; one time may occur
more than once (several samples). A volume loss lies between 0 and 1 (100 %).
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .units import UNITS, to_si

COLUMNS = {
    "immersion time": "time",
    "volume loss": "dimensionless",
    "standard deviation": "dimensionless",
}
"""Name of each column and the dimension of its unit."""

NEEDED = ("immersion time", "volume loss")


@dataclass(frozen=True)
class VolumeLossData:
    """Measured volume loss: times (n,) in s, volume_loss (n,) and standard_deviation (n,) or None,
    both as fractions of the initial volume (5.1)."""

    times: np.ndarray
    volume_loss: np.ndarray
    standard_deviation: np.ndarray | None
    path: Path


def read_volume_loss_csv(path: str | Path) -> VolumeLossData:
    """Read immersion times and volume losses, with standard deviations where the file has them.

    Raises FileNotFoundError, and ValueError for a missing, unknown or doubled column, a missing
    or wrong unit, a cell that is no number, a row of the wrong length, a time that is negative or
    falls, a volume loss outside 0 to 1, a negative standard deviation, or a file without rows.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not a text file in UTF-8") from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(lines) < 2:
        raise ValueError(
            f"{path}: has no measurements; it needs a row of column names and a row of numbers"
        )
    delimiter = ";" if ";" in lines[0][1] else ","
    rows = [
        (number, [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))])
        for number, line in lines
    ]
    columns = [_column(cell, path) for cell in rows[0][1]]
    names = [name for name, _ in columns]
    for name in NEEDED:
        if name not in names:
            raise ValueError(f"{path}: column '{name} [unit]' is missing")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{path}: column '{name}' is given twice; it must be unique")
    values = np.array([_numbers(cells, columns, path, number) for number, cells in rows[1:]])
    data = dict(zip(names, values.T, strict=True))
    times, losses = data["immersion time"], data["volume loss"]
    deviations = data.get("standard deviation")
    for (number, cells), earlier, time in zip(rows[1:], [0.0, *times[:-1]], times, strict=True):
        where, cell = f"{path}, line {number}", cells[names.index("immersion time")]
        if time < 0:
            raise ValueError(f"{where}: immersion time is {cell}; it must be at least 0")
        if time < earlier:
            raise ValueError(f"{where}: immersion time is {cell}, below the row before")
    for name, unit in columns:
        if COLUMNS[name] == "dimensionless":
            _check_fraction(data[name], name, unit, rows[1:], path)
    return VolumeLossData(times, losses, deviations, path)


def _column(cell: str, path: Path) -> tuple[str, str]:
    name, bracket, rest = cell.partition("[")
    name = " ".join(name.split()).lower()
    if name not in COLUMNS:
        raise ValueError(f"{path}: column '{cell}' is unknown; known are {', '.join(COLUMNS)}")
    known = UNITS[COLUMNS[name]]
    unit = rest.rstrip("] ").strip()
    if not bracket or unit not in known:
        problem = f"has the unit '{unit}'" if bracket else "has no unit"
        raise ValueError(
            f"{path}: column '{name}' {problem}; write '{name} [unit]' with one of "
            f"{', '.join(known)}"
        )
    return name, unit


def _numbers(
    cells: list[str], columns: list[tuple[str, str]], path: Path, number: int
) -> list[float]:
    if len(cells) != len(columns):
        raise ValueError(
            f"{path}, line {number}: has {len(cells)} cells; the header names {len(columns)} "
            "columns (decimals are written with a point)"
        )
    values = []
    for cell, (name, unit) in zip(cells, columns, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(
                f"{path}, line {number}: {name} is '{cell}'; it must be a finite number "
                "with a decimal point"
            )
        values.append(to_si(value, unit, COLUMNS[name]))
    return values


def _check_fraction(values: np.ndarray, name: str, unit: str, rows: list, path: Path) -> None:
    outside = np.flatnonzero((values < 0.0) | (values > 1.0))
    if outside.size:
        first = int(outside[0])
        raise ValueError(
            f"{path}, line {rows[first][0]}: {name} is "
            + (
                f"{values[first]:g}; it must be between 0 and 1, or given in [%]"
                if unit == "1"
                else f"{100 * values[first]:g} %; it must be between 0 and 100 %"
            )
        )
