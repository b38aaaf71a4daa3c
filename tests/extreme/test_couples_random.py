"""A few of the random couples of random_couples.py by default, more when slow tests run."""

import pytest

from tests.extreme.random_couples import check


@pytest.mark.parametrize("seed", [1, 19, 21, 54])
def test_a_random_couple_keeps_its_bounds(seed):
    """Balanced pools, Faraday's law, contents that only fall; these once broke one of them."""
    assert check(seed) in ("marched", "used up")


@pytest.mark.slow
def test_many_random_couples():
    outcomes = [check(seed) for seed in range(60)]
    assert outcomes.count("marched") > 30 and outcomes.count("no sink") < 15
