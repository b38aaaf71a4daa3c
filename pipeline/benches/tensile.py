"""Benchmarks of the tensile stage: material, assembly, one quick pull, the published size."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from pipeline.benches.assembly import assembly
from pipeline.benches.result import Result

POINTS = 200_000
PUBLISHED_SIZES = (38.3e-6, 25.5e-6)
"""Edge lengths of about 773,000 cells (m)."""

RANKS = 2


def tensile() -> list[Result]:
    """Constitutive update on both threads, assembly, one quick pull and linear costs, 8 weeks."""
    return [*constitutive_update(), *assembly(), *quick_pull(), *two_levels()]


def small_tensile() -> list[Result]:
    """The constitutive update on fewer points, the assembly on fewer cells."""
    return [*constitutive_update(20_000), *assembly(750)]


def constitutive_update(count: int = POINTS) -> list[Result]:
    """Plastic points per second with stress, state and consistent tangent, f = 0 and 0.05."""
    return [*_updates(count, 0.0, None), *_updates(count, 0.05, ">= 1e6")]


def _updates(count: int, damage: float, target: str | None) -> list[Result]:
    from fem.constitutive import Material, fit_voce
    from fem.constitutive.material import identity_plastic, update_points
    from pipeline.record.machine import processor_cores

    threads = processor_cores()
    material = Material(43e9, 0.3, fit_voce(130e6, 220e6, 0.19))
    random = np.random.default_rng(0)
    # 1 % of strain in every direction: three times the strain at yield
    gradients = np.eye(3).ravel() + 0.01 * random.standard_normal((count, 9))
    old = (identity_plastic((count,)), np.zeros(count), np.full(count, damage))
    law = (material.parameters(), material.hardening.kind, material.hardening.parameters())
    new = (
        np.empty((count, 6)), np.empty((count, 6, 6)), np.empty((count, 6)), np.empty(count),
        np.empty(count),
    )  # fmt: skip
    failed = np.zeros(threads, int)

    def update(part: int) -> None:
        cut = slice(part * count // threads, (part + 1) * count // threads)
        inputs = (array[cut] for array in (gradients, *old))
        outputs = (array[cut] for array in new)
        failed[part] = update_points(*inputs, *law, *outputs)

    update(0)  # compiles
    best, processor = np.inf, np.inf
    for _ in range(3):
        workers = [threading.Thread(target=update, args=(part,)) for part in range(threads)]
        begun, begun_processor = time.perf_counter(), time.process_time()
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        best = min(best, time.perf_counter() - begun)
        processor = min(processor, time.process_time() - begun_processor)
    plastic = int((new[3] > 0.0).sum())
    where = f"f = {damage:g}"
    return [
        Result(f"{where}: points per second, {threads} threads", plastic / best, "1/s", target),
        Result(f"{where}: points per processor second", plastic / processor, "1/s"),
        Result(f"{where}: share of the points that yield", plastic / count, "1"),
        Result(f"{where}: points without a result", float(failed.sum()), "1", "0"),
    ]


def quick_pull(alloy: str = "Mg-5Gd", immersion: str = "8w") -> list[Result]:
    """The reference screw of the quick preset after 8 weeks, on one thread."""
    from pipeline.scene.resolution import resolution
    from pipeline.studies.workshop import Pull, Workshop

    preset = resolution("quick")
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        shop = Workshop(Path(place))
        shop.corrode(alloy, ["0w", immersion])
        pull = Pull(
            "", "", alloy, immersion, preset.element, preset.mesh_size, preset.mesh_size_fine,
            preset.increment,
        )  # fmt: skip
        row = shop.pull([pull], 1, lambda row: None)[0]
    passed = not row.status.startswith("stopped")
    rest = row.seconds - row.assembly_seconds - row.setup_seconds - row.solve_seconds
    return [
        Result("quick pull: cells", row.cells, "1"),
        Result("quick pull: unknowns", row.unknowns, "1"),
        Result("quick pull: processor time", row.processor_seconds, "s", "<= 30"),
        Result("quick pull: time on one thread", row.seconds, "s"),
        Result("quick pull: of that material and assembly", row.assembly_seconds, "s"),
        Result("quick pull: of that set-up of the preconditioner", row.setup_seconds, "s"),
        Result("quick pull: of that linear solutions", row.solve_seconds, "s"),
        Result("quick pull: of that the rest", rest, "s"),
        Result("quick pull: most Newton iterations of an increment", row.iterations, "1", "<= 12"),
        Result("quick pull: reached its stop criterion", float(passed), "1", "1"),
        Result("quick pull: peak force", row.peak_force, "N"),
    ]


def two_levels() -> list[Result]:
    """Linear solutions of 19,231 ten-node cells after 8 weeks, to 1 % strain on one rank."""
    found = published_pull((0.2e-3, 0.12e-3), 0.01, "P2", 1)
    return [
        Result("two-level multigrid: unknowns", found["unknowns"], "1"),
        *linear_costs("two-level multigrid", found),
    ]


def published_tensile() -> list[Result]:
    """The published size after 8 weeks on two ranks to 10 % strain, split by what it costs."""
    found = published_pull(PUBLISHED_SIZES)
    iterations = max(found["iterations"], 1.0)
    solutions = found["linear_iterations"] / iterations
    # the kernel does both at once; at most, since points that do not yield cost less
    material = found["assemblies"] * found["cells"] / RANKS / _plastic_points_per_second()
    per = "per Newton iteration"
    return [
        Result("cells", found["cells"], "1", "about 773,000"),
        Result("unknowns", found["unknowns"], "1", "about 412,000"),
        Result("generation of the mesh", found["mesh"], "s"),
        Result("whole test to 10 % strain", found["seconds"], "s", "<= 1200"),
        Result("of that set-up of the test", found["setup"], "s"),
        Result("memory of both ranks, at most", found["memory"], "bytes", "<= 8e9"),
        Result("strain reached", found["strain"], "1", "0.1"),
        Result("peak force", found["peak_force"], "N"),
        Result("increments", found["increments"], "1"),
        Result("Newton iterations, predictions included", iterations, "1"),
        Result("most Newton iterations of an increment", found["most_iterations"], "1", "<= 12"),
        Result(f"time {per}", found["loop"] / iterations, "s"),
        Result(f"material and assembly {per}", found["assembly"] / iterations, "s"),
        Result(f"of that material {per}, at most", material / iterations, "s"),
        Result(f"set-up of the preconditioner {per}", found["preconditioner"] / iterations, "s"),
        Result(f"linear solutions {per}", found["solve"] / iterations, "s"),
        Result(f"linear iterations {per}", solutions, "1"),
        *linear_costs("GAMG", found),
    ]


def small_published() -> list[Result]:
    """The same on 19,000 cells to 1 % strain."""
    found = published_pull((0.2e-3, 0.12e-3), 0.01)
    return [Result(name, value, "") for name, value in found.items()]


def published_pull(
    sizes: tuple[float, float], strain: float = 0.1, element: str = "P1", ranks: int = RANKS
) -> dict[str, float]:
    """Pull the screw after 8 weeks on the quick lattice; the tensile stage itself."""
    from pipeline.life_cycle import StagedRun
    from pipeline.record.progress import Progress
    from pipeline.scene.resolve import resolve_scene
    from pipeline.stages.strength import read_result

    scene = resolve_scene(
        ["Mg-5Gd"], ["8w"], "quick", mesh_size=sizes[0], mesh_size_fine=sizes[1],
        tensile={"element": element, "increment": 0.005, "final_strain": strain, "peak_drop": 1.0},
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        cycle = StagedRun(scene, Path(place), ranks=ranks, workers=1, progress=Progress())
        begun = time.perf_counter()
        cycle.geometry()
        meshed = time.perf_counter() - begun
        cycle.corrode("Mg-5Gd")
        moment, hold = scene.immersion[0], scene.holds[0]
        cycle.map("Mg-5Gd", moment, hold)
        cycle.pull([("Mg-5Gd", moment, hold)])
        folder = cycle.folder.test("Mg-5Gd", moment.label, hold.name)
        result = read_result(folder)
        table = np.genfromtxt(folder / "tensile.csv", delimiter=",", names=True)
    cost = result["cost"]
    return {
        "cells": result["cells"],
        "unknowns": cost["unknowns"],
        "mesh": meshed,
        "setup": cost["setup_seconds"],
        "seconds": cost["seconds"],
        "loop": cost["seconds"] - cost["setup_seconds"],
        "assembly": cost["assembly_seconds"],
        "assemblies": cost["assemblies"],
        "preconditioner": cost["preconditioner_seconds"],
        "setups": cost["preconditioner_setups"],
        "solve": cost["solve_seconds"],
        "linear_iterations": cost["linear_iterations"],
        # the prediction of an increment costs what an iteration does
        "iterations": cost["linear_solves"],
        "most_iterations": float(table["iterations"].max()),
        "increments": result["increments"],
        "strain": float(table["elongation"][-1]),
        "peak_force": result["peak_force"],
        # rank 0 has the whole mesh besides its share, so that the other one needs less
        "memory": ranks * result["memory_bytes"],
    }


def linear_costs(method: str, found: dict[str, float]) -> list[Result]:
    """What a linear iteration and a set-up of the preconditioner cost, and how many it is worth."""
    iteration = found["solve"] / max(found["linear_iterations"], 1.0)
    setup = found["preconditioner"] / max(found["setups"], 1.0)
    return [
        Result(f"{method}: linear iteration", iteration, "s"),
        Result(f"{method}: set-up of the preconditioner", setup, "s"),
        Result(f"{method}: set-up in linear iterations", setup / iteration, "1"),
    ]


def _plastic_points_per_second() -> float:
    """On one thread, with f = 0.05."""
    found = {result.quantity: result.value for result in _updates(POINTS, 0.05, None)}
    return found["f = 0.05: points per processor second"]
