"""From nothing but a Python to a corroded screw: wheel, empty environment, installation, stages."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pipeline.benches.result import Result

CHECKOUT = Path(__file__).resolve().parents[2]


def empty_environment(python: str = "") -> list[Result]:
    """Seconds until the quick screw of Mg-5Gd is corroded, in an environment without dolfinx.

    python: to make the environment with; the one below this one's where left out.
    """
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        begun, before = time.perf_counter(), _children()
        command = _installed(Path(place), python, alone=False)
        installed = time.perf_counter() - begun
        run = str(Path(place) / "run")
        _do(command, "geometry", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", run, "--quiet")
        _do(command, "corrode", "--out", run, "--quiet")
        seconds = time.perf_counter() - begun
        processor = _children() - before
    what = "wheel in an empty environment to corrode"
    return [
        Result(what, seconds, "s", "<= 180"),
        Result(f"{what}: of that, installation with its downloads", installed, "s", None),
        Result(f"{what}: processor time", processor, "s", None),
    ]


def small_empty_environment() -> list[Result]:
    """The wheel without what it depends on, to its version alone."""
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        begun = time.perf_counter()
        command = _installed(Path(place), "", alone=True)
        code = "import importlib.metadata as m, perilife; print(m.version('perilife'))"
        _do(command.with_name("python"), "-c", code)
        seconds = time.perf_counter() - begun
    return [Result("wheel alone in an empty environment", seconds, "s", None)]


def _installed(place: Path, python: str, alone: bool) -> Path:
    """Build the wheel, install it into a new environment; the command `perilife` there."""
    source = copied_sources(place / "source")
    base = python or getattr(sys, "_base_executable", sys.executable)
    _do(base, "-m", "venv", str(place / "venv"))
    pip = [place / "venv/bin/python", "-m", "pip", "--quiet", "--disable-pip-version-check"]
    _do(*pip, "wheel", "--no-deps", "-w", str(place), str(source))
    (wheel,) = place.glob("*.whl")
    _do(*pip, "install", *["--no-deps"] * alone, str(wheel))
    return place / "venv/bin/perilife"


def copied_sources(place: Path) -> Path:
    """A copy of what the wheel is built from, so that building leaves nothing in the checkout."""
    if not (CHECKOUT / "pyproject.toml").exists():
        raise ValueError("the wheel is built from a checkout, and this perilife is installed")
    for folder in ("data", "fem", "peri", "perilife", "pipeline"):
        shutil.copytree(
            CHECKOUT / folder, place / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / name, place)
    return place


def _do(*command: str | Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, command)), env=environment, cwd="/", capture_output=True, text=True
    )
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
        raise RuntimeError(f"{Path(command[0]).name} {command[1]} failed: {said}")


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
