"""How a run tells what it is doing: bars on a terminal, plain lines elsewhere, or nothing.

To a person, and, as JSON lines, to a program.
"""

import json
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from pipeline.record.run_folder import utc_now
from pipeline.scene.units import format_seconds


class Progress:
    """Silent observer of a run, and the interface of the others.

    `key` names one piece of work (`corrode Mg-5Gd`); started and finished (or reused) are
    called once for it, advanced any number of times with a fraction in [0, 1].
    """

    def started(self, key: str) -> None:
        """Work on `key` begins."""

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        """`fraction` of `key` is done."""

    def finished(self, key: str, seconds: float, found: str = "") -> None:
        """`key` is done after `seconds`; found: what came out, in a few words."""

    def reused(self, key: str) -> None:
        """`key` was complete already."""

    def note(self, text: str) -> None:
        """Something the person should know."""

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *exception: object) -> None:
        """Release the terminal."""


def time_left(passed: float, fraction: float) -> str:
    """How long a piece of work will take that has done `fraction` in `passed` seconds, in words.

    Nothing in the first second, before a tenth is done (a pull begins with small increments, and
    most end long before the whole elongation), and where nothing is left to do.
    """
    if passed < 1.0 or not 0.1 <= fraction < 1.0:
        return ""
    return f"about {format_seconds(passed * (1.0 - fraction) / fraction)} left"


class LineProgress(Progress):
    """One line per event, and one every `interval` seconds of a long stage."""

    def __init__(self, stream: TextIO | None = None, interval: float = 15.0):
        self._stream = stream or sys.stderr
        self._interval = interval
        self._begin = time.monotonic()
        self._last: dict[str, float] = {}
        self._started: dict[str, float] = {}

    def _line(self, text: str) -> None:
        # in one piece: pulls are told from a thread of their own
        self._stream.write(f"[{time.monotonic() - self._begin:7.1f} s] {text}\n")
        self._stream.flush()

    def started(self, key: str) -> None:
        self._started[key] = self._last[key] = time.monotonic()
        self._line(f"{key}: started")

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        now = time.monotonic()
        if now - self._last.get(key, -self._interval) >= self._interval:
            self._last[key] = now
            left = time_left(now - self._started.get(key, now), fraction)
            said = ", ".join(filter(None, (f"{100 * fraction:.0f} %", left)))
            self._line(f"{key}: {said} {text}".rstrip())

    def finished(self, key: str, seconds: float, found: str = "") -> None:
        said = f"{key}: done in {format_seconds(seconds)}"
        self._line(f"{said}: {found}" if found else said)

    def reused(self, key: str) -> None:
        self._line(f"{key}: complete, kept")

    def note(self, text: str) -> None:
        self._line(text)


class TerminalProgress(Progress):
    """One bar per piece of work, drawn with rich; used only when stderr is a terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[text]}"),
            console=Console(stderr=True),
        )
        self._tasks: dict[str, int] = {}
        self._started: dict[str, float] = {}

    def __enter__(self) -> "TerminalProgress":
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def started(self, key: str) -> None:
        self._started[key] = time.monotonic()
        self._tasks[key] = self._bars.add_task(key, total=1.0, text="")

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        if key in self._tasks:
            left = time_left(time.monotonic() - self._started[key], fraction)
            said = ", ".join(filter(None, (left, text)))
            self._bars.update(self._tasks[key], completed=fraction, text=said)

    def finished(self, key: str, seconds: float, found: str = "") -> None:
        if key in self._tasks:
            task = self._tasks.pop(key)
            self._bars.update(task, completed=1.0, text=found)
            self._bars.stop_task(task)

    def reused(self, key: str) -> None:
        self._bars.console.print(f"{key}: complete, kept")

    def note(self, text: str) -> None:
        self._bars.console.print(text)


class LogProgress(Progress):
    """One JSON object a line and event, added to a file: `at` (UTC), `event`, and what it is of.

    `what`: the piece of work; `fraction` of it that is done, at most one such line a second and
    piece; `seconds` that it took; `text`, of a piece that is done what came out.
    """

    def __init__(self, path: Path | str, interval: float = 1.0):
        self._file = open(path, "a", encoding="utf-8")
        self._interval = interval
        self._last: dict[str, float] = {}

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def _line(self, event: str, **values: object) -> None:
        entry = {"at": utc_now(), "event": event, **values}
        self._file.write(json.dumps(entry, ensure_ascii=False) + "\n")  # in one piece, as above
        self._file.flush()

    def started(self, key: str) -> None:
        self._line("started", what=key)

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        now = time.monotonic()
        if now - self._last.get(key, -self._interval) >= self._interval:
            self._last[key] = now
            self._line("advanced", what=key, fraction=round(fraction, 4), text=text)

    def finished(self, key: str, seconds: float, found: str = "") -> None:
        self._line("finished", what=key, seconds=round(seconds, 3), text=found)

    def reused(self, key: str) -> None:
        self._line("reused", what=key)

    def note(self, text: str) -> None:
        self._line("note", text=text)


class SeveralProgresses(Progress):
    """Hands everything on to others."""

    def __init__(self, others: Sequence[Progress]):
        self._others = others
        self._open = ExitStack()

    def __enter__(self) -> "SeveralProgresses":
        for other in self._others:
            self._open.enter_context(other)
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def started(self, key: str) -> None:
        for other in self._others:
            other.started(key)

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        for other in self._others:
            other.advanced(key, fraction, text)

    def finished(self, key: str, seconds: float, found: str = "") -> None:
        for other in self._others:
            other.finished(key, seconds, found)

    def reused(self, key: str) -> None:
        for other in self._others:
            other.reused(key)

    def note(self, text: str) -> None:
        for other in self._others:
            other.note(text)


def progress_for(stream: TextIO, quiet: bool = False, log: str | None = None) -> Progress:
    """Bars when `stream` is a terminal, lines when it is not, nothing when `quiet`.

    log: a file that gets JSON lines, too; OSError where it cannot be written.
    """
    if quiet:
        shown = Progress()
    else:
        shown = TerminalProgress() if stream.isatty() else LineProgress(stream)
    return shown if log is None else SeveralProgresses([shown, LogProgress(log)])
