"""A few of the random couples and pits by default, more when slow tests run."""

import pytest

from tests.extreme.random_couples import check, check_ions
from tests.extreme.random_pits import check_pit


@pytest.mark.parametrize("seed", [1, 19, 21, 54, 345, 369, 467, 512])
def test_a_random_couple_keeps_its_bounds(seed):
    """Balanced pools, Faraday's law, contents that only fall; these once broke one of them."""
    assert check(seed) in ("marched", "used up")


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 12, 597, 600, 602])
def test_a_random_couple_with_ions_keeps_its_bounds(seed):
    """Metal, ions, salt and what is renewed add up; nothing is negative or above saturation.

    The last three once broke one of them.
    """
    assert check_ions(seed) in ("marched", "used up", "no sink")


@pytest.mark.parametrize("seed", [4, 31, 40, 52])
def test_a_random_pit_keeps_its_bounds(seed):
    """C_sat/C_solid from 1e-6 on, pits through a plate, islands; the last once lost 1.5 %."""
    assert check_pit(seed).startswith("pit")


@pytest.mark.slow
def test_many_random_pits():
    outcomes = [check_pit(seed) for seed in range(250)]  # 40 s of processor time
    assert outcomes.count("pit through") > 100 and outcomes.count("pit with islands") > 20


@pytest.mark.slow
def test_many_random_couples():
    outcomes = [check(seed) for seed in range(60)]
    assert outcomes.count("marched") > 30 and outcomes.count("no sink") < 15
