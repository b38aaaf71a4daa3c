"""Uniform numbers that are a function of a seed and a counter, in no order and without a state.

splitmix64 (Steele, Lea and Flood 2014): the numbers of a seed are the terms of the sequence that
starts at the mixed seed; counter n picks term n.  Threads, blocks and resumed runs see the same.
"""

from __future__ import annotations

import numpy as np
from numba import njit

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = (np.uint64(n) for n in (27, 30, 31, 11))
_ONE = np.uint64(1)
_UNIT = 2.0**-53


@njit(inline="always")
def _mixed(x):  # type: ignore[no-untyped-def]
    x = (x ^ (x >> _S30)) * _FIRST
    x = (x ^ (x >> _S27)) * _SECOND
    return x ^ (x >> _S31)


@njit(inline="always")
def term(stream, counter):  # type: ignore[no-untyped-def]
    """For kernels: the number in [0, 1) of a counter (uint64) of the sequence from `stream`."""
    return np.float64(_mixed(stream + (counter + _ONE) * GOLDEN) >> _S11) * _UNIT


def stream(seed: int) -> np.uint64:
    """Start of a seed's sequence, 0 <= seed < 2^64: near seeds are far apart in it.

    Raises ValueError for a seed out of range.
    """
    if not 0 <= int(seed) < 2**64:
        raise ValueError(f"seed: {seed}; it must be from 0 to 2^64 - 1")
    return np.uint64(_mixed(np.uint64(seed)))


def uniform(seed: int, counter: np.ndarray) -> np.ndarray:
    """Numbers in [0, 1), one for each counter (array of whole numbers, 0 <= n < 2^64).

    Raises ValueError for a seed out of range.
    """
    with np.errstate(over="ignore"):
        x = stream(seed) + (np.asarray(counter).astype(np.uint64) + _ONE) * GOLDEN
        x = (x ^ (x >> _S30)) * _FIRST
        x = (x ^ (x >> _S27)) * _SECOND
        x = x ^ (x >> _S31)
    return (x >> _S11).astype(float) * _UNIT
