"""The first steps from Python and in a shell: how long imports, help and three lines take."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time

from pipeline.benches.result import Result
from pipeline.record.machine import child_environment

STARTS = {
    "import pipeline, peri": ["-c", "import pipeline, peri"],
    "from pipeline import LifeCycle": ["-c", "from pipeline import LifeCycle"],
    "perilife --help": ["-m", "pipeline.cli", "--help"],
}
"""What is started, and the arguments of Python that do it."""

THREE_LINES = """
from pipeline import LifeCycle
result = LifeCycle("Mg-5Gd", "8w", **{more}).run()
assert 0 < result.strength_left < 1
"""

COARSE = dict(
    thread="none", spacing="250um", horizon="250um", mesh_size="0.6mm", radial_margin="0.5mm",
    axial_margin="0.5mm", element="P1", final_strain=0.02,
)  # fmt: skip
"""Keywords of a plain pin, which is computed in seconds."""


def starts(times: int = 5) -> list[Result]:
    """Wall time from starting Python to its end, the best of so many."""
    return [
        Result(what, min(_seconds(arguments) for _ in range(times)), "s", "<= 0.3")
        for what, arguments in STARTS.items()
    ]


def three_lines() -> list[Result]:
    """The README's three lines, from starting Python on, its compiled code there already."""
    _seconds_of_three_lines(COARSE)
    return [Result("three lines of Python, 8 weeks", _seconds_of_three_lines({}), "s", "<= 60")]


def small_three_lines() -> list[Result]:
    """The same of a plain pin on a coarse mesh."""
    return [Result("three lines of Python, coarse pin", _seconds_of_three_lines(COARSE), "s", None)]


def _seconds_of_three_lines(more: dict[str, object]) -> float:
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        return _seconds(["-c", THREE_LINES.format(more=more)], place)


def _seconds(arguments: list[str], place: str | None = None) -> float:
    environment = child_environment(0, None)
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], check=True, capture_output=True, cwd=place, env=environment
    )
    return time.perf_counter() - begin
