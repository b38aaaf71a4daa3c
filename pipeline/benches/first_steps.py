"""The first steps from Python and in a shell: how long imports, help and three lines take."""

from __future__ import annotations

import resource
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
    """Time from starting Python to its end, the best of so many."""
    results = []
    for what, arguments in STARTS.items():
        took = [_took(arguments) for _ in range(times)]
        results += _results(what, tuple(map(min, zip(*took, strict=True))), "<= 0.3")
    return results


def three_lines() -> list[Result]:
    """The README's three lines, from starting Python on, its compiled code there already."""
    _three_lines_took(COARSE)
    return _results("three lines of Python, 8 weeks", _three_lines_took({}), "<= 60")


def small_three_lines() -> list[Result]:
    """The same of a plain pin on a coarse mesh."""
    return _results("three lines of Python, coarse pin", _three_lines_took(COARSE), None)


def _results(what: str, took: tuple[float, float], target: str | None) -> list[Result]:
    seconds, processor = took
    return [
        Result(what, seconds, "s", target),
        Result(f"{what}: processor time", processor, "s", None),
    ]


def _three_lines_took(more: dict[str, object]) -> tuple[float, float]:
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        return _took(["-c", THREE_LINES.format(more=more)], place)


def _took(arguments: list[str], place: str | None = None) -> tuple[float, float]:
    """Seconds by the clock, and of the processor with all children that were waited for."""
    environment = child_environment(0, None)
    begin, before = time.perf_counter(), _children()
    subprocess.run(
        [sys.executable, *arguments], check=True, capture_output=True, cwd=place, env=environment
    )
    return time.perf_counter() - begin, _children() - before


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
