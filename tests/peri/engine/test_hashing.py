"""Hashed uniform numbers."""

import numpy as np
import pytest
from numba import njit

from peri.engine import hashing


@njit
def in_a_kernel(start, count):
    out = np.empty(count)
    for n in range(count):
        out[n] = hashing.term(start, np.uint64(n))
    return out


def test_sequence_is_splitmix64():
    """Terms against plain integers."""
    mask = 2**64 - 1

    def mixed(x: int) -> int:
        x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & mask
        x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & mask
        return x ^ (x >> 31)

    for seed in (0, 1, 1234567, 2**64 - 1):
        expected = [
            (mixed((mixed(seed) + (n + 1) * 0x9E3779B97F4A7C15) & mask) >> 11) * 2.0**-53
            for n in range(50)
        ]
        np.testing.assert_array_equal(hashing.uniform(seed, np.arange(50)), expected)
        np.testing.assert_array_equal(in_a_kernel(hashing.stream(seed), 50), expected)
    # The first output of the published generator for the state 0.
    assert mixed(0x9E3779B97F4A7C15) == 0xE220A8397B1DCDAF


def test_numbers_fill_the_unit_interval():
    u = hashing.uniform(3, np.arange(100_000))
    assert u.min() >= 0 and u.max() < 1
    counts = np.histogram(u, 100, (0, 1))[0]
    assert 0.5 < ((counts - 1000) ** 2 / 1000).sum() / 99 < 1.6  # 1 with a scatter of 0.14
    with pytest.raises(ValueError, match="seed: -1"):
        hashing.uniform(-1, np.arange(3))
