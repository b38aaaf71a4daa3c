"""One round of the active set, and Algorithm 1's switch."""

import math

import numpy as np

from peri.corrosion.interface.saturation import Stall, next_active_set, published_switch


def test_one_round_of_the_active_set():
    #         stays, released, joins, free, at the limit, sees no metal
    active = np.array([True, True, False, False, False, True])
    value = np.array([1.0, 1.0, 1.1, 0.9, 1.0, 1.0])
    needed = np.array([0.3, 2.0, 0.0, 0.0, 0.0, 0.1])
    available = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    new, theta = next_active_set(active, value, needed, available, 1.0)
    np.testing.assert_array_equal(new, [True, False, True, False, False, False])
    np.testing.assert_array_equal(theta, [0.3, 1.0, 1.0, 1.0, 1.0, 1.0])


def test_published_switch_is_off_where_saturated_liquid_is_seen():
    metal = np.array([True, True, False])
    on = published_switch(np.array([0.0, 0.2, 0.0]), metal)
    np.testing.assert_array_equal(on, [True, False, False])


def rounds_until_stall(rounds):
    stall = Stall()
    return next((n for n, r in enumerate(rounds, 1) if stall.after(*r)), math.inf)


def test_rounds_that_get_nowhere_are_given_up():
    # of the second stage of a march of Mg-10Gd: 33 nodes join and leave in turn
    idle = [(657, 1.4e-5), (80, 1.7e-6), (37, 1.3e-8), (33, 3.8e-9)] + 56 * [(33, 3.6e-9)]
    assert rounds_until_stall(idle) == 8
    # slow ones that do get on: fewer changes, or less in dispute, or a set that stays
    assert rounds_until_stall([(60 - n, 1.0) for n in range(50)]) == math.inf
    assert rounds_until_stall([(5, 0.8**n) for n in range(50)]) == math.inf
    assert rounds_until_stall(50 * [(0, 1e-12)]) == math.inf
