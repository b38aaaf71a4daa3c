"""What a newcomer meets: how long each thing takes that is to be quick, and how true it is.

A row is a function that returns `Result`s and an entry in ROWS; `perilife bench friendliness` runs
them all, one after the other.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.benches.result import Result


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
    from pipeline.scene.scene import DomainSettings, ScrewGeometry
    from pipeline.scene.screw import ScrewParameters

    return _peak_beside_calculix(
        {
            "geometry": ScrewGeometry(ScrewParameters(thread="none")),
            "spacing": 250e-6,
            "horizon": 250e-6,
            "domain": DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
            "mesh_size": 0.6e-3,
            "tensile": {"final_strain": 0.02, "increment": 0.01},
        }
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


ROWS: dict[str, Row] = {
    "exported-screw": Row(exported_screw, small_exported_screw),
}
"""What `perilife bench friendliness` measures."""
