"""Sizes of increments, without a solid."""

import numpy as np
import pytest

from fem.march import March

LIMITS = {"smallest": 1e-6, "largest": 5e-3}


def march(size):
    return March(np.zeros((1, 3)), size)


@pytest.mark.parametrize(
    ("iterations", "lag", "factor"),
    [
        (2, 0.0, 1.5),  # easy, and nothing lags
        (6, 0.0, 1.0),
        (9, 0.0, 0.7),
        (2, 4.0, 0.5),  # of second order: half of the size has a quarter of the lag
        (2, 0.64, 1.25),
        (2, 1e9, 0.25),
        (2, np.inf, 0.25),
        (9, 0.25, 0.7),
    ],
)
def test_next_size(iterations, lag, factor):
    here = march(1e-3)
    here.choose_size(iterations, lag, **LIMITS)
    assert here.size == pytest.approx(factor * 1e-3, rel=1e-12)


def test_sizes_keep_to_their_limits():
    here = march(4e-3)
    here.choose_size(2, 0.0, **LIMITS)
    assert here.size == LIMITS["largest"]
    small = march(2e-6)
    small.choose_size(2, 1e9, **LIMITS)
    assert small.size == LIMITS["smallest"]
    assert not small.shorten(1e9, LIMITS["smallest"])


def test_an_increment_is_shortened_a_few_times_only():
    here = march(1e-3)
    sizes = []
    while here.shorten(16.0, 1e-6):
        sizes.append(here.size)
    assert sizes == pytest.approx([2.5e-4, 6.25e-5, 1.5625e-5])
    here.choose_size(2, 1.0, **LIMITS)  # an accepted one may again
    assert here.shorten(4.0, 1e-6) and here.size == pytest.approx(0.5 * 1.5625e-5)


def test_back_to_a_size_that_a_jump_has_cut():
    here = march(1e-3)
    here.halve(1 / 64)
    here.choose_size(6, 0.0, **LIMITS)  # not easy, and after a failure
    sizes = [here.size]
    for _ in range(6):
        here.choose_size(2, 0.0, **LIMITS)
        sizes.append(here.size)
    factors = np.array(sizes[1:]) / sizes[:-1]
    assert factors == pytest.approx(
        [3, 3, 3, 3, 1.5, 1.5]
    )  # the last threefold one from 0.42 of that size
    assert sizes[4] == pytest.approx(81 / 64 * 1e-3)


def test_the_size_that_failed_before_cells_were_torn():
    here = march(1e-3)
    here.previous = np.zeros((1, 3))
    here.halve()
    assert here.previous is not None
    here.halve()
    assert here.previous is None and here.failures == 2 and here.size == 0.25e-3
    here.undo_halvings()
    assert here.size == 1e-3 and here.failures == 0 and here.halvings == 2
