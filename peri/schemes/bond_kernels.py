"""Compiled sums over single bonds: arrays in, arrays out, one loop over receiving nodes each.

Fields as in engine.kernels: three axes with a ghost margin of the stencil's reach, ghosts zero.
Slower per bond than the factorised convolution, for what it cannot hold.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from peri.engine.compiled import CONTRACT, Array, Triple, by_size


@by_size(fastmath=CONTRACT, error_model="numpy")
def harmonic_gain(
    u: Array,
    out: Array,
    resistance: Array,
    tiles: Array,
    low: Array,
    high: Array,
    reach: Triple,
    offsets: Array,
    weights: Array,
) -> None:
    """out_i = sum_o w_o 2 / (r_i + r_{i+o}) u_{i+o} over the rows' ranges; 0 < r <= infinity."""
    ra, rb, rc = reach
    for t in prange(tiles.shape[0]):
        i = tiles[t, 0]
        for j in range(tiles[t, 1], tiles[t, 2]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            target, here = out[i + ra, j + rb, lo:hi], resistance[i + ra, j + rb, lo:hi]
            target[:] = 0.0
            for o in range(weights.size):
                ia, jb, c = i + ra + offsets[o, 0], j + rb + offsets[o, 1], offsets[o, 2]
                there, value = resistance[ia, jb, lo + c : hi + c], u[ia, jb, lo + c : hi + c]
                weight = 2.0 * weights[o]
                for k in range(hi - lo):
                    target[k] += weight * value[k] / (here[k] + there[k])


@njit(cache=True)
def fitted_share(difference: float) -> float:
    """B(-x) = x / (1 - exp(-x)) of x = `difference`; 1 at 0."""
    if difference == 0.0:
        return 1.0
    return -difference / math.expm1(-difference)


@by_size(fastmath=CONTRACT)
def exponential_gain(
    u: Array,
    out: Array,
    drift: Array,
    sign: float,
    tiles: Array,
    low: Array,
    high: Array,
    reach: Triple,
    offsets: Array,
    weights: Array,
) -> None:
    """out_i = sum_o w_o B(-sign (s_{i+o} - s_i)) u_{i+o} over the rows' ranges, s = `drift`."""
    ra, rb, rc = reach
    for t in prange(tiles.shape[0]):
        i = tiles[t, 0]
        for j in range(tiles[t, 1], tiles[t, 2]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            target, here = out[i + ra, j + rb, lo:hi], drift[i + ra, j + rb, lo:hi]
            target[:] = 0.0
            for o in range(weights.size):
                ia, jb, c = i + ra + offsets[o, 0], j + rb + offsets[o, 1], offsets[o, 2]
                there, value = drift[ia, jb, lo + c : hi + c], u[ia, jb, lo + c : hi + c]
                for k in range(hi - lo):
                    if value[k] != 0.0:
                        share = fitted_share(sign * (there[k] - here[k]))
                        target[k] += weights[o] * share * value[k]


@by_size(fastmath=CONTRACT)
def stored_gain(u: Array, out: Array, nodes: Array, shifts: Array, weights: Array) -> None:
    """out_i = sum_o weights[i, o] u_{i + shifts[o]} for the listed nodes (flat padded indices)."""
    source, target = u.ravel(), out.ravel()
    for n in prange(nodes.size):
        total = 0.0
        for o in range(shifts.size):
            total += weights[n, o] * source[nodes[n] + shifts[o]]
        target[nodes[n]] = total


_ONE = np.uint64(1)
_DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
"""Multiplied by a power of two, its highest six bits tell which power."""
_POWER = np.zeros(64, np.int64)
for _p in range(64):
    _POWER[(int(_DE_BRUIJN) << _p & 2**64 - 1) >> 58] = _p


@njit(cache=True)
def count_bits(word: int) -> int:
    """Number of bits that are set in a 64-bit word."""
    count = 0
    while word != 0:
        word &= word - _ONE
        count += 1
    return count


@njit(cache=True)
def lowest_bit(word: int) -> int:
    """Place of the lowest bit that is set in a 64-bit word other than 0."""
    alone = word & (~word + _ONE)
    return _POWER[(alone * _DE_BRUIJN) >> np.uint64(58)]


@njit(cache=True)
def partners(i: int, j: int, k: int, shape: Triple, reach: Triple, offsets: Array) -> int:
    """How many bonds of a node end within the lattice."""
    ra, rb, rc = reach
    if ra <= i < shape[0] - ra and rb <= j < shape[1] - rb and rc <= k < shape[2] - rc:
        return offsets.shape[0]
    count = 0
    for o in range(offsets.shape[0]):
        x, y, z = i + offsets[o, 0], j + offsets[o, 1], k + offsets[o, 2]
        count += 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]
    return count


@by_size(fastmath=CONTRACT)
def take_out_broken(
    u: Array,
    out: Array,
    bits: Array,
    corners: Array,
    edges: Triple,
    shape: Triple,
    reach: Triple,
    offsets: Array,
    shifts: Array,
    weights: Array,
) -> None:
    """Take the broken bonds out of the sums `out` of the listed tiles' nodes.

    bits (tiles, nodes of a tile, words): bit o of a node is its bond along offset o; corners
    (tiles, 3): first node of each tile; edges: nodes of a tile per axis; shape: of the lattice;
    shifts (bonds,): the offsets in a flattened padded array.  A node that has lost more than half
    of its bonds is summed anew over the others, so that the sum of one that has lost all is
    exactly zero.
    """
    ra, rb, rc = reach
    ea, eb, ec = edges
    source = u.ravel()
    bonds = weights.size
    for t in prange(corners.shape[0]):
        for n in range(ea * eb * ec):
            i, j = corners[t, 0] + n // (eb * ec), corners[t, 1] + n // ec % eb
            k = corners[t, 2] + n % ec
            if i >= shape[0] or j >= shape[1] or k >= shape[2]:
                continue
            count = 0
            for w in range(bits.shape[2]):
                count += count_bits(bits[t, n, w])
            if count == 0:
                continue
            anew = 2 * count > partners(i, j, k, shape, reach, offsets)
            here = ((i + ra) * u.shape[1] + j + rb) * u.shape[2] + k + rc
            total = 0.0
            for w in range(bits.shape[2]):
                word = bits[t, n, w]
                if anew:
                    word = ~word
                while word != 0:
                    o = 64 * w + lowest_bit(word)
                    if o >= bonds:
                        break
                    total += weights[o] * source[here + shifts[o]]
                    word &= word - _ONE
            if anew:
                out[i + ra, j + rb, k + rc] = total
            else:
                out[i + ra, j + rb, k + rc] -= total
