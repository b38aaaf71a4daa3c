"""Tests beside a march: how many fit, and the time of a run against a simulation of its queue."""

from collections.abc import Sequence

import pytest

from pipeline.planning.beside import Task, room, saved
from pipeline.record import machine

TIMES = 6


def tasks_of(alloys: int, marches: Sequence[float], test: float, at_once: int) -> list[Task]:
    """Marches (the first with the surface apart) and tests of one way of holding; s, 1e9 bytes."""
    surface = Task("corrode", "surface", "", 20.0, 1e9, 0.0)
    marching = [Task("corrode", "", "", seconds, 1e9, 0.0) for seconds in marches]
    pulls = Task("pull", "", "", test * alloys * TIMES / at_once, at_once * 1e9, 0.0, at_once)
    return [surface, *marching, pulls]


def simulated(alloys: int, marches: Sequence[float], test: float, cores: int) -> float:
    """When the last test ends: one core marches, then joins those that pull."""
    ready = [0.0] * alloys  # the intact solid
    end = 20.0
    for seconds in marches:
        end += seconds
        ready += [end] * (TIMES - 1)
    free = sorted([0.0] * (cores - 1) + [end])
    for at in sorted(ready):
        free[0] = max(free[0], at) + test
        free.sort()
    return free[-1]


@pytest.mark.parametrize(
    ("alloys", "marches", "test", "cores"),
    [(2, (5.0, 10.0), 4.0, 2), (2, (5.0, 10.0), 30.0, 2), (1, (5.0,), 10.0, 2)]
    + [(3, (5.0, 100.0, 5.0), 5.0, 4), (2, (300.0, 5.0), 1.0, 2)],
)
def test_what_is_saved_is_what_a_simulation_of_the_queue_saves(
    monkeypatch, alloys, marches, test, cores
):
    monkeypatch.setattr(machine, "processor_cores", lambda: cores)
    monkeypatch.setattr(machine, "available_memory", lambda: 1e12)
    tasks = tasks_of(alloys, marches, test, cores)
    whole = sum(task.seconds for task in tasks)
    expected = whole - saved(tasks, cores, alloys, TIMES)
    # tests are not divided, so that a core may wait for the last one
    assert expected == pytest.approx(simulated(alloys, marches, test, cores), abs=test)
    assert expected < whole


def test_tests_fit_beside_a_march_by_cores_and_by_memory(monkeypatch):
    monkeypatch.setattr(machine, "processor_cores", lambda: 4)
    monkeypatch.setattr(machine, "available_memory", lambda: 3.5e9)
    for workers, memory, fit in ((4, 1e12, 3), (2, 1e12, 1), (1, 1e12, 0), (4, 3.5e9, 2)):
        monkeypatch.setattr(machine, "available_memory", lambda memory=memory: memory)
        assert room(tasks_of(1, (5.0,), 1.0, workers), workers) == fit
