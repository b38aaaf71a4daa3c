"""One round of the active set, and Algorithm 1's switch."""

import numpy as np

from peri.corrosion.saturation import next_active_set, published_switch


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
