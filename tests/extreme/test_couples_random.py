"""A few of the random couples and pits by default, 1,000 when slow tests run."""

from collections import Counter

import pytest

from tests.extreme.random_couples import check, check_ions
from tests.extreme.random_pits import check_pit


@pytest.mark.parametrize("seed", [1, 19, 21, 54, 345, 369, 467, 512])
def test_a_random_couple_keeps_its_bounds(seed):
    """Balanced pools, Faraday's law, contents that only fall; these once broke one of them."""
    assert check(seed) in ("marched", "used up")


@pytest.mark.parametrize("seed", [1, 2, 597, 600, 602])
def test_a_random_couple_with_ions_keeps_its_bounds(seed):
    """Metal, ions, salt and what is renewed add up; nothing is negative or above saturation.

    The last three once broke one of them.
    """
    assert check_ions(seed) in ("marched", "used up", "no sink")


@pytest.mark.parametrize("seed", [31, 40, 46, 52, 169])
def test_a_random_pit_keeps_its_bounds(seed):
    """C_sat/C_solid from 1e-6 on, pits through a plate, islands; the last three once broke one."""
    assert check_pit(seed).startswith("pit")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("one", "first", "count"),
    [
        *((check, first, 100) for first in range(0, 400, 100)),
        *((check_ions, first, 30) for first in range(0, 300, 30)),
        *((check_pit, first, 150) for first in range(0, 300, 150)),
    ],
)
def test_a_thousand_random_scenes(one, first, count):
    """The bounds of random_couples; 30 to 90 s of processor time each."""
    outcomes = Counter(one(seed) for seed in range(first, first + count))
    few, most = count // 10, count // 2
    if one is check_pit:
        assert outcomes["pit through"] > most and outcomes["pit with islands"] > few
    else:
        assert outcomes["marched"] > most and outcomes["no sink"] < few
