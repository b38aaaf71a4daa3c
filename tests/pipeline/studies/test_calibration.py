"""The searches on functions whose least value is known, and the study's tables."""

import numpy as np
import pytest

from pipeline.studies.calibration import Kriging, Search, kriging_lines, search_lines
from pipeline.studies.optimisers import cma_es, swarm


def valley(place):
    """Rosenbrock's function, least 0 at (0.7, 0.49 + 0.2)."""
    x, y = place[0], place[1] - 0.2
    return float((0.7 - x) ** 2 + 100 * (y - x**2) ** 2)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cma_es_follows_a_curved_valley(seed):
    found = cma_es(valley, 2, 1500, seed)
    assert valley(found) < 1e-12 and np.abs(found - [0.7, 0.69]).max() < 1e-5


def test_cma_es_finds_a_wall_and_spends_no_more_than_allowed():
    count = 0

    def slope(place):
        nonlocal count
        count += 1
        assert place.min() >= 0 and place.max() <= 1
        return float(place.sum())

    assert cma_es(slope, 3, 700, 0) == pytest.approx(np.zeros(3), abs=1e-3)
    assert 100 < count <= 700


@pytest.mark.parametrize("seed", [0, 1])
def test_a_swarm_finds_the_least_of_many_dents(seed):
    def dents(place):
        away = 8 * (place - [0.3, 0.8])
        return float(np.sum(away**2 - np.cos(2 * np.pi * away)) + 2)

    found = swarm(dents, 2, 20, 150, seed)
    assert found == pytest.approx([0.3, 0.8], abs=1e-4)


def test_a_table_says_when_a_search_arrives():
    slow = Search("swarm", "linear", 0, np.array([5.0, 3.0, 3.0]), 1.0)
    fast = Search("gradient", "logarithmic", 0, np.array([4.0, 1.001, 1.0]), 0.1)
    assert (fast.arrived(1.0), slow.arrived(1.0)) == (2, None)
    lines = search_lines([fast, slow])
    assert "| 3 | 2 | 0.10 |" in lines[-2] and "| 3 | not | 1.00 |" in lines[-1]
    assert "| raw | 30 | 1.1 | 0.36 | 0.4 |" in kriging_lines([Kriging("raw", 30, 1.1, 0.36, 0.4)])
