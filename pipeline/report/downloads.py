"""Tables of a run as files in the page itself: results, curves, courses of the corrosion."""

import base64
import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import RunResults


@dataclass(frozen=True)
class Download:
    """A file in the page: its name, what it holds in words, and its content as a data address."""

    name: str
    text: str
    address: str


def downloads(run: RunResults) -> list[Download]:
    """The tables that the run folder holds; those of several tests joined into one file."""
    found = []
    summary = RunFolder(run.folder).summary_file
    if summary.is_file():
        content = summary.read_text(encoding="utf-8")
        found.append(download("summary.csv", "the results, a row each test", content))
    curves = [
        ((alloy.name, alloy.hold, item.label), item.curve)
        for alloys in run.held.values()
        for alloy in alloys
        for item in alloy.immersions
        if item.curve
    ]
    if curves:
        content = _joined(("alloy", "hold", "immersion"), curves)
        found.append(download("curves.csv", "the curves, a row each increment of a test", content))
    history = [((alloy.name,), alloy.history) for alloy in run.alloys if alloy.history]
    if history:
        content = _joined(("alloy",), history)
        found.append(download("history.csv", "the corrosion, a row each time step", content))
    return found


def _joined(
    first: tuple[str, ...],
    tables: Iterable[tuple[tuple[str, ...], Mapping[str, NDArray[np.float64]]]],
) -> str:
    """One CSV of several tables, each row with what it belongs to; absent columns stay empty."""
    tables = list(tables)
    names = list(dict.fromkeys(name for _, columns in tables for name in columns))
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*first, *names])
    for owner, columns in tables:
        writer.writerows([*owner, *row] for row in _rows(columns, names))
    return buffer.getvalue()


def _rows(columns: Mapping[str, NDArray[np.float64]], names: list[str]) -> Iterator[list[str]]:
    """The rows as text; nothing where there is no number."""
    count = len(next(iter(columns.values())))
    blank = np.full(count, np.nan)
    for values in zip(*(columns.get(name, blank) for name in names), strict=True):
        yield ["" if np.isnan(value) else f"{value:.8g}" for value in values]


def download(name: str, text: str, content: str) -> Download:
    """A CSV as a file in the page."""
    packed = base64.b64encode(content.encode()).decode()
    return Download(name, text, f"data:text/csv;charset=utf-8;base64,{packed}")
