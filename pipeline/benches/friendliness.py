"""What a newcomer meets: how long each thing takes that is to be quick, and how true it is.

A row is a function that returns `Result`s and an entry in ROWS; `perilife bench friendliness` runs
them all, one after the other.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pipeline.benches.empty_environment import empty_environment, small_empty_environment
from pipeline.benches.first_steps import small_three_lines, starts, three_lines
from pipeline.benches.images import image_to_solid
from pipeline.benches.result import Result
from pipeline.scene.scene import DomainSettings, ScrewGeometry
from pipeline.scene.screw import ScrewParameters

COARSE_PIN = {
    "geometry": ScrewGeometry(ScrewParameters(thread="none")),
    "spacing": 250e-6,
    "horizon": 250e-6,
    "domain": DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
    "mesh_size": 0.6e-3,
}
"""A scene of seconds."""


@dataclass(frozen=True)
class Row:
    """One thing that is measured; small: the same in seconds, to see that it works."""

    measure: Callable[[], list[Result]]
    small: Callable[[], list[Result]]


def friendliness() -> list[Result]:
    """Every row at full size."""
    return [result for row in ROWS.values() for result in row.measure()]


def small_friendliness() -> list[Result]:
    """Every row's small version."""
    return [result for row in ROWS.values() for result in row.small()]


def exported_screw() -> list[Result]:
    """The intact quick screw, exported and pulled by CalculiX: its peak force beside ours."""
    return _peak_beside_calculix({})


def small_exported_screw() -> list[Result]:
    """The same of a plain pin on a coarse mesh, to 2 % elongation."""
    return _peak_beside_calculix(
        {**COARSE_PIN, "tensile": {"final_strain": 0.02, "increment": 0.01}}
    )


def _peak_beside_calculix(changes: dict) -> list[Result]:
    """Largest force by the deck of `perilife export` in ccx over that of our own tensile test."""
    from pipeline.export.inp import write_inp
    from pipeline.export.state import read_state
    from pipeline.life_cycle import run_life_cycle
    from pipeline.scene.resolve import resolve_scene

    if shutil.which("ccx") is None:
        raise ValueError("ccx is not installed; the Debian package calculix-ccx has it")
    scene = resolve_scene(["Mg-5Gd"], ["0w"], "quick", **changes)
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        run = Path(place) / "run"
        rows = run_life_cycle(scene, run)
        write_inp(read_state(run, "0w"), Path(place) / "screw.inp")
        done = subprocess.run(["ccx", "screw"], cwd=place, capture_output=True, text=True)
        if "Job finished" not in done.stdout:
            raise RuntimeError(f"ccx did not finish: {done.stdout[-300:]}")
        lines = (Path(place) / "screw.dat").read_text().splitlines()
    forces = [float(line.split()[2]) for line in lines if len(line.split()) == 3]
    ratio = max(forces) / rows[0].peak_reaction - 1.0
    return [Result("peak of the exported intact screw in CalculiX, less ours", 100 * ratio, "%",
                   "-1 to 1")]  # fmt: skip


def compared_runs() -> list[Result]:
    """`perilife compare` of ten runs of two alloys after six times, its start included."""
    return _seconds_to_compare(10, ["Mg-5Gd", "Mg-10Gd"], ["0w", "1w", "2w", "4w", "8w", "24w"])


def small_compared_runs() -> list[Result]:
    """The same of three runs of one alloy after two times."""
    return _seconds_to_compare(3, ["Mg-5Gd"], ["0w", "8w"])


def _seconds_to_compare(count: int, alloys: list[str], immersion: list[str]) -> list[Result]:
    """Compares one coarse run with copies of itself whose scenes say another rate change."""
    from pipeline.life_cycle import run_life_cycle
    from pipeline.scene.resolve import resolve_scene

    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        runs = [Path(place) / f"run-{n}" for n in range(count)]
        run_life_cycle(resolve_scene(alloys, immersion, "quick", **COARSE_PIN), runs[0])
        for n, run in enumerate(runs[1:], start=1):
            shutil.copytree(runs[0], run)
            scene = json.loads((run / "scene.json").read_text())
            scene["corrosion"]["rate_change"] -= 0.01 * n
            (run / "scene.json").write_text(json.dumps(scene))
        page = Path(place) / "page.html"
        begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "pipeline.cli", "compare", *map(str, runs), "--out", str(page)],
            check=True,
            capture_output=True,
        )
        seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        size = page.stat().st_size / 1e6
    what = f"compare {count} runs of {len(alloys)} alloys after {len(immersion)} times"
    return [
        Result(what, seconds, "s", "<= 5" if count == 10 else None),
        Result(f"{what}: processor time", busy, "s", None),
        Result(f"{what}: its page", size, "MB", None),
    ]


ROWS: dict[str, Row] = {
    "starts": Row(starts, partial(starts, 1)),
    "three-lines": Row(three_lines, small_three_lines),
    "exported-screw": Row(exported_screw, small_exported_screw),
    "compared-runs": Row(compared_runs, small_compared_runs),
    "image-to-solid": Row(image_to_solid, partial(image_to_solid, 96)),
    "empty-environment": Row(empty_environment, small_empty_environment),
}
"""What `perilife bench friendliness` measures."""
