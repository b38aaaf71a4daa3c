"""How a run tells what it is doing: bars on a terminal, plain lines elsewhere, or nothing."""

import sys
import time
from typing import TextIO

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

    def finished(self, key: str, seconds: float) -> None:
        """`key` is done after `seconds`."""

    def reused(self, key: str) -> None:
        """`key` was complete already."""

    def note(self, text: str) -> None:
        """Something the person should know."""

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *exception: object) -> None:
        """Release the terminal."""


class LineProgress(Progress):
    """One line per event, and one every `interval` seconds of a long stage."""

    def __init__(self, stream: TextIO | None = None, interval: float = 15.0):
        self._stream = stream or sys.stderr
        self._interval = interval
        self._begin = time.monotonic()
        self._last: dict[str, float] = {}

    def _line(self, text: str) -> None:
        print(f"[{time.monotonic() - self._begin:7.1f} s] {text}", file=self._stream, flush=True)

    def started(self, key: str) -> None:
        self._last[key] = time.monotonic()
        self._line(f"{key}: started")

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        now = time.monotonic()
        if now - self._last.get(key, -self._interval) >= self._interval:
            self._last[key] = now
            self._line(f"{key}: {100 * fraction:.0f} % {text}".rstrip())

    def finished(self, key: str, seconds: float) -> None:
        self._line(f"{key}: done in {format_seconds(seconds)}")

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

    def __enter__(self) -> "TerminalProgress":
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def started(self, key: str) -> None:
        self._tasks[key] = self._bars.add_task(key, total=1.0, text="")

    def advanced(self, key: str, fraction: float, text: str = "") -> None:
        if key in self._tasks:
            self._bars.update(self._tasks[key], completed=fraction, text=text)

    def finished(self, key: str, seconds: float) -> None:
        if key in self._tasks:
            task = self._tasks.pop(key)
            self._bars.update(task, completed=1.0, text="")
            self._bars.stop_task(task)

    def reused(self, key: str) -> None:
        self._bars.console.print(f"{key}: complete, kept")

    def note(self, text: str) -> None:
        self._bars.console.print(text)


def progress_for(stream: TextIO, quiet: bool = False) -> Progress:
    """Bars when `stream` is a terminal, lines when it is not, nothing when `quiet`."""
    if quiet:
        return Progress()
    return TerminalProgress() if stream.isatty() else LineProgress(stream)
