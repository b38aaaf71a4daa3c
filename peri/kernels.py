"""Every compiled loop over the lattice: arrays in, arrays out.

Fields are three-dimensional C-ordered float64 arrays with a ghost margin of the stencil's reach
on every side; the ghosts hold zero.  One- and two-dimensional lattices use the last one or two
axes.  The callers validate; nothing here does.
"""

import numpy as np
from numba import njit, prange

# Contraction lets a*b+c become one fused operation; NaN and infinity keep their meaning.
_CONTRACT = {"contract"}


@njit(cache=True, fastmath=_CONTRACT)
def _sum_rows(source, rows, first, last, target):
    """target[:] = sum of source[rows[first:last]], four rows a sweep."""
    n = target.size
    r = first
    if last - first >= 2:
        a, b = source[rows[r]], source[rows[r + 1]]
        for k in range(n):
            target[k] = a[k] + b[k]
        r += 2
    else:
        a = source[rows[r]]
        for k in range(n):
            target[k] = a[k]
        r += 1
    while last - r >= 4:
        a, b, c, d = source[rows[r]], source[rows[r + 1]], source[rows[r + 2]], source[rows[r + 3]]
        for k in range(n):
            target[k] += (a[k] + b[k]) + (c[k] + d[k])
        r += 4
    while r < last:
        a = source[rows[r]]
        for k in range(n):
            target[k] += a[k]
        r += 1


@njit(cache=True, fastmath=_CONTRACT)
def _combine_shells(shells, weights, count, target):
    """target[:] = sum over shells s < count of weights[s] * shells[s], four shells a sweep."""
    n = target.size
    s = 0
    if count >= 4:
        a, b, c, d = shells[0], shells[1], shells[2], shells[3]
        wa, wb, wc, wd = weights[0], weights[1], weights[2], weights[3]
        for k in range(n):
            target[k] = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        s = 4
    else:
        a = shells[0]
        wa = weights[0]
        for k in range(n):
            target[k] = wa * a[k]
        s = 1
    while count - s >= 4:
        a, b, c, d = shells[s], shells[s + 1], shells[s + 2], shells[s + 3]
        wa, wb, wc, wd = weights[s], weights[s + 1], weights[s + 2], weights[s + 3]
        for k in range(n):
            target[k] += (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        s += 4
    while s < count:
        a = shells[s]
        wa = weights[s]
        for k in range(n):
            target[k] += wa * a[k]
        s += 1


@njit(cache=True, fastmath=_CONTRACT)
def _convolve_tile(u, out, i, j0, j1, low, high, reach, source_a, source_b, shell_start, weights,
                   shells_used):
    """The stencil sum of the rows j0 <= j < j1 of plane i; see `convolve`."""
    ra, rb, rc = reach
    k0, k1 = high[i, j0], low[i, j0]
    for j in range(j0, j1):
        if high[i, j] > low[i, j]:
            k0, k1 = min(k0, low[i, j]), max(k1, high[i, j])
    if k1 <= k0:
        return
    n = k1 - k0 + 2 * rc
    width = j1 - j0 + 2 * rb
    # Sums of the planes i-a and i+a, shared by every row of the tile.
    planes = np.empty(((ra + 1) * width, n))
    for j in range(width):
        target = planes[j]
        here = u[i + ra, j0 + j, k0 : k0 + n]
        for k in range(n):
            target[k] = here[k]
    for a in range(1, ra + 1):
        for j in range(width):
            target = planes[a * width + j]
            before = u[i + ra - a, j0 + j, k0 : k0 + n]
            after = u[i + ra + a, j0 + j, k0 : k0 + n]
            for k in range(n):
                target[k] = before[k] + after[k]
    n_shells = shell_start.size - 1
    shells = np.empty((n_shells, n))
    columns = np.empty((rc + 1, n))
    rows = np.empty(source_a.size, np.int64)
    for j in range(j0, j1):
        lo, hi = low[i, j], high[i, j]
        if hi <= lo:
            continue
        for r in range(rows.size):
            rows[r] = source_a[r] * width + (j - j0 + rb + source_b[r])
        for s in range(n_shells):
            _sum_rows(planes, rows, shell_start[s], shell_start[s + 1], shells[s])
        for c in range(rc + 1):
            _combine_shells(shells, weights[c], shells_used[c], columns[c])
        m = hi - lo
        shift = lo - k0 + rc
        target = out[i + ra, j + rb, lo + rc : hi + rc]
        first = columns[0, shift : shift + m]
        for k in range(m):
            target[k] = first[k]
        for c in range(1, rc + 1):
            before = columns[c, shift - c : shift - c + m]
            after = columns[c, shift + c : shift + c + m]
            for k in range(m):
                target[k] += before[k] + after[k]


@njit(cache=True, parallel=True)
def convolve(u, out, tiles, low, high, reach, source_a, source_b, shell_start, weights,
             shells_used):
    """out_i = sum_j w_ij u_j over the rows' ranges [low, high) of the interior.

    Factorised for kernels even in every axis: planes i-a and i+a are added first, rows whose
    weight columns agree are added next (a shell), the shells are combined once per distance c
    along the row, and the shifted columns are added last: about a third of the additions of a
    plain sum over bonds, and the same sum up to round-off.  tiles (nt, 3): plane, first and last
    row; weights (reach_c + 1, n_shells): weight of shell s at distance c; shells_used: how many
    shells (sorted by length) matter at distance c.
    """
    for t in prange(tiles.shape[0]):
        _convolve_tile(u, out, tiles[t, 0], tiles[t, 1], tiles[t, 2], low, high, reach, source_a,
                       source_b, shell_start, weights, shells_used)
