"""The pieces of a plan, and tests beside a march: how many fit, and the time that they save."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.record import machine


@dataclass(frozen=True)
class Task:
    """One piece of the plan: what it is, its size in words, seconds and bytes expected.

    memory: of all processes together, `at_once` of like size.
    """

    stage: str
    what: str
    size: str
    seconds: float
    memory: float
    disk: float
    at_once: int = 1


def room(tasks: Sequence[Task], workers: int) -> int:
    """How many tests, of `workers` at a time, fit beside a march: into cores and memory."""
    march = max(task.memory for task in tasks if task.stage == "corrode")
    test = max(task.memory / task.at_once for task in tasks if task.stage == "pull")
    cores = machine.processor_cores()
    threads = max(1, cores // workers)  # of a test
    memory = max(0.0, machine.available_memory() - march) / test
    return int(min(workers, (cores - 1) // threads, memory))


def saved(tasks: Sequence[Task], workers: int, alloys: int, times: int) -> float:
    """Seconds by which a run is shorter than its tasks one after another.

    During the first march only the intact solid can be pulled, one of `times`; during the others
    what was mapped of the alloys before.
    """
    marches = [task.seconds for task in tasks if task.stage == "corrode"]
    at_once = max(task.at_once for task in tasks if task.stage == "pull")
    tests = sum(task.seconds * task.at_once for task in tasks if task.stage == "pull")
    fit, later = room(tasks, workers), sum(marches[len(marches) - alloys + 1 :])
    first = min(fit * (sum(marches) - later), tests / times)
    rest = min(fit * later, (tests - first) * (alloys - 1) / alloys)
    return (first + rest) / at_once
