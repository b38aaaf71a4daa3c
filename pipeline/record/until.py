"""When each alloy becomes too weak, held in each way: until.csv of a run folder."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields
from pathlib import Path

from pipeline.record.run_folder import write_text
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.loads import LOADS

UNTIL_FILE = "until.csv"

FOUND, NEVER, ALWAYS = "found", "not_within_the_run", "from_the_start"
OUTCOMES = (FOUND, NEVER, ALWAYS)


@dataclass(frozen=True)
class UntilRow:
    """When one alloy, held in one way, becomes weaker than what is wanted.

    wanted_ratio, wanted_peak: of the intact strength, and in N or N m; outcome: of OUTCOMES; days:
    the time found, the last one of the run where the strength is never that small, 0 where it
    always is; strength_ratio, peak_reaction, volume_loss: computed at that time, not interpolated;
    search_error_days: how far that time may lie from the one at which the strength is exactly what
    is wanted; settings_error_days: what the measured errors of lattice, mesh and increments make
    of it, None where they were not measured; tests: full runs that the search took; run: folder of
    the last of them, below the run's.
    """

    alloy: str
    hold: str
    load: str
    outcome: str
    wanted_ratio: float
    wanted_peak: float
    days: float
    strength_ratio: float
    peak_reaction: float
    volume_loss: float
    search_error_days: float | None = None
    settings_error_days: float | None = None
    tests: int = 0
    run: str = ""

    def in_words(self) -> str:
        """The answer in one sentence."""
        names, part = LOADS[self.load], HOLDINGS[self.hold].part
        wanted = f"{names.shown(self.wanted_peak)} ({_percent(self.wanted_ratio)})"
        has = f"{names.shown(self.peak_reaction)} ({_percent(self.strength_ratio)})"
        lead = f"{self.alloy}, {part}"
        if self.outcome == ALWAYS:
            return (
                f"{lead}: too weak from the start, {has} before immersion where {wanted} is asked"
            )
        if self.outcome == NEVER:
            return (
                f"{lead}: not too weak within the run, {has} are left after "
                f"{self._time(self.days)}, its last time, where {wanted} is asked"
            )
        settings = "the errors of its settings have not been measured"
        if self.settings_error_days is not None:
            settings = f"± {self._time(self.settings_error_days)} by lattice, mesh and increments"
        return (
            f"{lead}: weaker than {wanted} from {self._time(self.days)} on, "
            f"± {self._time(self.search_error_days)} by the search, {settings}; "
            f"a full run to that time: {has}"
        )

    @staticmethod
    def _time(days: float) -> str:
        return f"{days / 7:.1f} weeks" if days >= 14 else f"{days:.1f} days"


def _percent(ratio: float) -> str:
    """A ratio for a reader, whatever was asked for."""
    return f"{100 * ratio:.1f} %" if ratio == 0 or 1e-3 <= ratio < 100 else f"{100 * ratio:.3g} %"


_COLUMNS = {
    **{field.name: field.name for field in fields(UntilRow)},
    "wanted_peak": "wanted_peak_N_or_N_m",
    "peak_reaction": "peak_N_or_N_m",
}
_TEXTS = ("alloy", "hold", "load", "outcome", "run")


def write_until(path: Path, rows: list[UntilRow]) -> None:
    """Write the rows as CSV in one step; what is not known stays empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS.values())
    for row in rows:
        values = [getattr(row, name) for name in _COLUMNS]
        writer.writerow([f"{v:.10g}" if isinstance(v, float) else v for v in values])  # None: ""
    write_text(path, buffer.getvalue())


def read_until(path: Path) -> list[UntilRow]:
    """The rows that `write_until` wrote; none where there is no such file."""
    if not path.is_file():
        return []
    with open(path, encoding="utf-8", newline="") as handle:
        reader = csv.DictReader(handle)
        if list(reader.fieldnames or ()) != list(_COLUMNS.values()):
            raise ValueError(f"columns of '{path}' are not {', '.join(_COLUMNS.values())}")
        return [
            UntilRow(**{name: _cell(name, line[column]) for name, column in _COLUMNS.items()})
            for line in reader
        ]


def _cell(name: str, text: str) -> str | float | int | None:
    if name in _TEXTS:
        return text
    if name == "tests":
        return int(text)
    return float(text) if text else None
