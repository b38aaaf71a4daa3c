"""Benchmarks: a registry of named measurements, each giving quantities with value and target.

A newcomer adds one by writing a function that returns `Result`s and naming it in BENCHMARKS.
"""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from perilife_data import did_you_mean
from pipeline.benches import calibration as bench_calibration
from pipeline.benches import campaign as bench_campaign
from pipeline.benches import corrosion as bench_corrosion
from pipeline.benches import cut_cells as bench_cut_cells
from pipeline.benches import friendliness as bench_friendliness
from pipeline.benches import galvanic as bench_galvanic
from pipeline.benches import ions as bench_ions
from pipeline.benches import localised as bench_localised
from pipeline.benches import operators as bench_operators
from pipeline.benches import ranks as bench_ranks
from pipeline.benches import tensile as bench_tensile
from pipeline.benches.result import Result
from pipeline.record import machine
from pipeline.record.progress import Progress

ALLOYS = ["Mg-5Gd", "Mg-10Gd"]
TIMES = ["0w", "1w", "2w", "4w", "8w", "24w"]


@dataclass(frozen=True)
class Benchmark:
    """A named measurement; small: the same in seconds, to see that it works."""

    description: str
    measure: Callable[[], list[Result]]
    small: Callable[[], list[Result]]


def run_benchmark(name: str, small: bool = False) -> dict[str, object]:
    """Run one benchmark; returns {"name", "small", "machine", "load", "results"}.

    small: its version of a few seconds.  load: of the machine before
    it began, in busy cores; times mean little above a few tenths.

    Raises ValueError that names the known ones.
    """
    if name not in BENCHMARKS:
        known = ", ".join(BENCHMARKS)
        near = did_you_mean(name, BENCHMARKS)
        raise ValueError(f"benchmark '{name}' is not known{near}; it must be one of {known}")
    benchmark = BENCHMARKS[name]
    load = os.getloadavg()[0]
    results = benchmark.small() if small else benchmark.measure()
    return {
        "name": name,
        "small": small,
        "load": load,
        "machine": machine.describe_machine(),
        "results": [asdict(result) for result in results],
    }


def print_result(result: dict) -> None:
    """Print the object of `run_benchmark` as a table."""
    from rich.console import Console
    from rich.table import Table

    machine_used = result["machine"]
    title = f"{result['name']} on {machine_used['processor']}, {machine_used['cores']} cores"
    table = Table(title=title)
    for column in ("quantity", "value", "unit", "target"):
        table.add_column(column, justify="right" if column == "value" else "left")
    for row in result["results"]:
        table.add_row(row["quantity"], f"{row['value']:.5g}", row["unit"], row["target"] or "")
    Console().print(table)


def quick_stages(alloys: Sequence[str] = ALLOYS, **changes: object) -> list[Result]:
    """The stages of the quick run of both alloys, 0 to 24 weeks, in a temporary folder.

    changes: of the scene (pipeline.scene.resolve).
    """
    from pipeline.life_cycle import StagedRun, run_life_cycle
    from pipeline.scene.resolve import resolve_scene

    scene = resolve_scene(list(alloys), TIMES, "quick", **changes)
    hold = scene.holds[0]
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        clock = _StageClock()
        rows = run_life_cycle(scene, Path(place), progress=clock)
        cycle = StagedRun(scene, Path(place))
        results = [
            Result(f"{stage} time", seconds, "s", None) for stage, seconds in clock.stages.items()
        ]
        results.append(Result("whole run time", clock.total(), "s", "<= 300"))
        differences = [
            abs(cycle.map(alloy, moment, hold).numbers["relative_difference"])
            for alloy in alloys
            for moment in scene.immersion
        ]
    at = {(row.alloy, row.immersion_days): row for row in rows if row.hold == hold.name}
    for alloy in alloys:
        results += [
            Result(f"{alloy} intact peak force", at[alloy, 0.0].peak_reaction, "N", "300 to 700"),
            Result(f"{alloy} volume loss after 8 weeks", at[alloy, 56.0].volume_loss, "1"),
            Result(f"{alloy} strength left after 8 weeks", at[alloy, 56.0].strength_ratio, "1"),
            Result(f"{alloy} strength left after 24 weeks", at[alloy, 168.0].strength_ratio, "1"),
        ]
    results.append(Result("lost mass, mesh to lattice, largest difference", max(differences), "1"))
    return results


def small_quick_stages() -> list[Result]:
    """The same of one alloy, a plain pin on a coarse lattice and mesh."""
    from pipeline.scene.scene import DomainSettings, ScrewGeometry
    from pipeline.scene.screw import ScrewParameters

    return quick_stages(
        ALLOYS[:1],
        geometry=ScrewGeometry(ScrewParameters(thread="none")),
        spacing=250e-6,
        horizon=250e-6,
        domain=DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
        mesh_size=0.6e-3,
        tensile={"element": "P1", "final_strain": 0.05},
    )


class _StageClock(Progress):
    """Observer that adds up the wall time of each stage; pulls that run side by side count once."""

    def __init__(self) -> None:
        self._begin = self._last = time.perf_counter()
        self.stages: dict[str, float] = {}

    def finished(self, key: str, seconds: float) -> None:
        now = time.perf_counter()
        stage = key if key.startswith("corrode") else key.split()[0]
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._last
        self._last = now

    def total(self) -> float:
        """Seconds from the making of the clock to the end of the last stage."""
        return self._last - self._begin


BENCHMARKS: dict[str, Benchmark] = {
    "quick-stages": Benchmark(
        "the stages of the quick run: both alloys, 0 to 24 weeks", quick_stages, small_quick_stages
    ),
    "stencil": Benchmark(
        "bond sums per second, direct and by FFT",
        bench_corrosion.stencil,
        bench_corrosion.small_stencil,
    ),
    "implicit": Benchmark(
        "CG iterations and time per unknown",
        bench_corrosion.implicit,
        bench_corrosion.small_implicit,
    ),
    "operators": Benchmark(
        "every kind of bond: product, iterations, solution",
        bench_operators.operators,
        bench_operators.small_operators,
    ),
    "screw": Benchmark(
        "the published full screw run, 2.14e6 nodes, 56 days (15 minutes)",
        bench_corrosion.screw,
        bench_corrosion.small_screw,
    ),
    "cut-cells": Benchmark(
        "rate classes: bodies at rest and dissolved, cost on the screw (8 minutes)",
        bench_cut_cells.cut_cells,
        bench_cut_cells.small_cut_cells,
    ),
    "campaign": Benchmark(
        "forty samples of one geometry, V_L and strength; what Dask adds to a task (5 min)",
        bench_campaign.campaign,
        bench_campaign.small_campaign,
    ),
    "calibration": Benchmark(
        "fits, posteriors, marches and bands of the screw (10 minutes)",
        bench_calibration.calibration,
        bench_calibration.small_calibration,
    ),
    "pitting-step": Benchmark(
        "explicit and implicit pitting on 128 x 128 x 64 nodes",
        bench_corrosion.pitting_step,
        bench_corrosion.small_pitting,
    ),
    "pitting": Benchmark(
        "what local rates cost a pit of 1e6 nodes, and a lacy cover in 3D to 83 s",
        bench_localised.pitting,
        bench_localised.small_pitting,
    ),
    "bond-damage": Benchmark(
        "stochastic damage of the bonds of 1e6 nodes, m = 4",
        bench_localised.bond_damage,
        bench_localised.small_bond_damage,
    ),
    "crevice": Benchmark(
        "the film equation of a crevice of alloy 625, 72 h",
        bench_localised.crevice,
        bench_localised.small_crevice,
    ),
    "galvanic": Benchmark(
        "the potential from 1e4 to 2e6 nodes, AE44 beside steel for 3 days (1 minute)",
        bench_galvanic.galvanic,
        bench_galvanic.small_galvanic,
    ),
    "tensile": Benchmark(
        "constitutive update, assembly, one quick pull of the screw after 8 weeks (a minute)",
        bench_tensile.tensile,
        bench_tensile.small_tensile,
    ),
    "tensile-published": Benchmark(
        "773,000 cells on two ranks to 10 % strain after 8 weeks (5 minutes)",
        bench_tensile.published_tensile,
        bench_tensile.small_published,
    ),
    "nnpp": Benchmark(
        "ions, pH and minerals around metal: seconds per step, eight weeks (3 minutes)",
        bench_ions.nnpp,
        bench_ions.small_nnpp,
    ),
    "nnpp-steps": Benchmark(
        "the steps of 'nnpp' alone: without minerals and potential, with minerals, with both "
        "(2 minutes)",
        bench_ions.nnpp_steps,
        bench_ions.small_nnpp_steps,
    ),
    "nnpp-saline": Benchmark(
        "ions of 1 M NaCl in the published domain, 26 days (10 minutes)",
        bench_ions.saline,
        bench_ions.small_saline,
    ),
    "nnpp-published": Benchmark(
        "the published lattice of 20 um, 4.4e6 nodes: memory and three steps (10 minutes)",
        bench_ions.published,
        bench_ions.small_published,
    ),
    "friendliness": Benchmark(
        "what a newcomer meets: times, memory, and other programs' answers (4 minutes)",
        bench_friendliness.friendliness,
        bench_friendliness.small_friendliness,
    ),
    "ranks": Benchmark(
        "marches of a metal, with ions, of a couple: in one process, on 1 and 2 MPI ranks (2 min)",
        bench_ranks.ranks,
        bench_ranks.small_ranks,
    ),
    "scaling": Benchmark(
        "cost and memory from 1e4 to 1e7 nodes, threads 1 and 2, ranks 1, 2 and 4",
        bench_corrosion.scaling,
        bench_corrosion.small_scaling,
    ),
}
