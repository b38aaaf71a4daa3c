"""Benchmark of marches on MPI ranks: processor time, and the memory of each rank."""

from __future__ import annotations

from pipeline.benches.case import in_own_process
from pipeline.benches.result import Result

BALL, IONS, COUPLE = 100e-6, 90e-6, 100e-6
"""Spacings: 268,000 nodes about a cylinder, 50,000 with ions, 30,000 of a couple."""


def ranks(
    ball: float = BALL, ions: float = IONS, couple: float = COUPLE, steps: int = 4
) -> list[Result]:
    """Marches of a metal, with ions and of a couple in one process, on one rank and on two.

    Each in processes of their own with one thread; memory is what the march adds to a process that
    has marched a small scene.
    """
    results = []
    for model, case, spacing in (
        ("bi-material", "ball_march", ball),
        ("ions", "ion_march", ions),
        ("couple", "couple_march", couple),
    ):
        alone = 0.0
        for number in (0, 1, 2):
            found = in_own_process(
                case, ranks=number, threads=1, spacing=spacing, steps=steps, petsc=number > 0
            )
            alone = alone or found["volume_loss"]
            where = f"{number} rank{'s' * (number > 1)}" if number else "one process"
            name = f"{model}, {found['nodes']:,} nodes, {where}"
            first, *others = found["rank_field_bytes"]
            results += [
                Result(f"{name}: processor time of all", found["processor_seconds"], "s"),
                Result(f"{name}: time by the clock", found["seconds"], "s"),
                Result(f"{name}: memory of the first", first / found["nodes"], "B/node"),
            ]
            if others:
                more = max(others) / found["nodes"]
                results.append(Result(f"{name}: memory of another", more, "B/node"))
            if number:
                off = abs(found["volume_loss"] / alone - 1)
                results.append(
                    Result(f"{name}: volume loss beside one process", off, "1", "<= 1e-8")
                )
    return results


def small_ranks() -> list[Result]:
    """The same with 34,000, 6,000 and 7,500 nodes."""
    return ranks(200e-6, 180e-6, 200e-6, 1)
