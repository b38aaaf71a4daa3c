"""Every compiled loop over the lattice: arrays in, arrays out.

Fields are three-dimensional C-ordered float64 arrays with a ghost margin of the stencil's reach
on every side; the ghosts hold zero.  One- and two-dimensional lattices use the last one or two
axes.  The callers validate; nothing here does.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from peri.engine.compiled import CONTRACT, Array, Triple, by_size

STRETCH = 400
"""Numbers that a sum over bonds adds in one loop where rows are shorter: rows of 12 to 22 take two
thirds of the time that they take one by one; 250 to 1,600 of them differ by less than the noise."""


@njit(cache=True, fastmath=CONTRACT)
def _sum_rows(source: Array, starts: Array, first: int, last: int, target: Array) -> None:
    """target[:] = sum of the stretches of source from starts[first:last], four a sweep."""
    n = target.size
    r = first
    if last - first >= 2:
        a, b = source[starts[r] : starts[r] + n], source[starts[r + 1] : starts[r + 1] + n]
        for k in range(n):
            target[k] = a[k] + b[k]
        r += 2
    else:
        a = source[starts[r] : starts[r] + n]
        for k in range(n):
            target[k] = a[k]
        r += 1
    while last - r >= 4:
        a, b = source[starts[r] : starts[r] + n], source[starts[r + 1] : starts[r + 1] + n]
        c, d = source[starts[r + 2] : starts[r + 2] + n], source[starts[r + 3] : starts[r + 3] + n]
        for k in range(n):
            target[k] += (a[k] + b[k]) + (c[k] + d[k])
        r += 4
    while r < last:
        a = source[starts[r] : starts[r] + n]
        for k in range(n):
            target[k] += a[k]
        r += 1


@njit(cache=True, fastmath=CONTRACT)
def _combine_shells(shells: Array, weights: Array, count: int, target: Array) -> None:
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


@njit(cache=True, fastmath=CONTRACT)
def _convolve_tile(
    u: Array,
    out: Array,
    i: int,
    j0: int,
    j1: int,
    low: Array,
    high: Array,
    reach: Triple,
    source_a: Array,
    source_b: Array,
    shell_start: Array,
    weights: Array,
    shells_used: Array,
    sign_a: float,
    sign_c: float,
) -> None:
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
    # Sums of the planes i-a and i+a, shared by every row of the tile; row after row, so that
    # neighbouring rows are one stretch, which short rows are worked off in.
    planes = np.empty((ra + 1) * width * n)
    for j in range(width):
        target = planes[j * n : (j + 1) * n]
        here = u[i + ra, j0 + j, k0 : k0 + n]
        for k in range(n):
            target[k] = here[k]
    for a in range(1, ra + 1):
        for j in range(width):
            first = (a * width + j) * n
            target = planes[first : first + n]
            before = u[i + ra - a, j0 + j, k0 : k0 + n]
            after = u[i + ra + a, j0 + j, k0 : k0 + n]
            for k in range(n):
                target[k] = sign_a * before[k] + after[k]
    n_shells = shell_start.size - 1
    most = max(1, min(j1 - j0, STRETCH // n))
    shells = np.empty((n_shells, most * n))
    columns = np.empty((rc + 1, most * n))
    starts = np.empty(source_a.size, np.int64)
    j = j0
    while j < j1:
        if high[i, j] <= low[i, j]:
            j += 1
            continue
        last = j + 1
        while last < j1 and last - j < most and high[i, last] > low[i, last]:
            last += 1
        length = (last - j) * n
        for r in range(starts.size):
            starts[r] = (source_a[r] * width + (j - j0 + rb + source_b[r])) * n
        for s in range(n_shells):
            _sum_rows(planes, starts, shell_start[s], shell_start[s + 1], shells[s][:length])
        for c in range(rc + 1):
            _combine_shells(shells, weights[c], shells_used[c], columns[c][:length])
        for row in range(j, last):
            lo, hi = low[i, row], high[i, row]
            m = hi - lo
            shift = (row - j) * n + lo - k0 + rc
            target = out[i + ra, row + rb, lo + rc : hi + rc]
            middle = columns[0, shift : shift + m]
            for k in range(m):
                target[k] = middle[k]
            for c in range(1, rc + 1):
                before = columns[c, shift - c : shift - c + m]
                after = columns[c, shift + c : shift + c + m]
                for k in range(m):
                    target[k] += sign_c * before[k] + after[k]
        j = last


@by_size
def convolve(
    u: Array,
    out: Array,
    tiles: Array,
    low: Array,
    high: Array,
    reach: Triple,
    source_a: Array,
    source_b: Array,
    shell_start: Array,
    weights: Array,
    shells_used: Array,
    sign_a: float,
    sign_c: float,
) -> None:
    """out_i = sum_j w_ij u_j over the rows' ranges [low, high) of the interior.

    Factorised for kernels even or odd in each axis: planes i-a and i+a are added (subtracted)
    first, rows whose weight columns agree are added next (a shell), the shells are combined once
    per distance c along the row, and the shifted columns are added (subtracted) last: about a
    third of the additions of a plain sum over bonds, and the same sum up to round-off.
    tiles (nt, 3): plane, first and last row; weights (reach_c + 1, n_shells): weight of shell s
    at distance c; shells_used: how many shells (sorted by length) matter at distance c; sign_a,
    sign_c: 1.0 for a kernel even along the planes, along the rows, -1.0 for an odd one (across
    the rows a sign is part of the shells' weights).
    """
    for t in prange(tiles.shape[0]):
        _convolve_tile(
            u,
            out,
            tiles[t, 0],
            tiles[t, 1],
            tiles[t, 2],
            low,
            high,
            reach,
            source_a,
            source_b,
            shell_start,
            weights,
            shells_used,
            sign_a,
            sign_c,
        )


@by_size(fastmath=CONTRACT)
def convolve_at(u: Array, nodes: Array, offsets: Array, weights: Array) -> Array:
    """sum_b weights_b u[n + offsets_b] of some nodes n; u and nodes are flat."""
    out = np.empty(nodes.size)
    for i in prange(nodes.size):
        total = 0.0
        for b in range(offsets.size):
            total += weights[b] * u[nodes[i] + offsets[b]]
        out[i] = total
    return out


# --- Vector operations over the rows' ranges of padded fields -------------------------------


@by_size(fastmath=CONTRACT)
def inner_product(a: Array, b: Array) -> Array:
    """sum a b per plane (not by BLAS, whose own threads would compete with these)."""
    partial = np.zeros(a.shape[0])
    for i in prange(a.shape[0]):
        total = 0.0
        for j in range(a.shape[1]):
            ar, br = a[i, j], b[i, j]
            for k in range(a.shape[2]):
                total += ar[k] * br[k]
        partial[i] = total
    return partial


@by_size(fastmath=CONTRACT)
def next_direction(
    z: Array, p: Array, weight: Array, q: Array, beta: float, low: Array, high: Array, reach: Triple
) -> None:
    """p = z + beta p;  q = weight p."""
    ra, rb, rc = reach
    for i in prange(low.shape[0]):
        for j in range(low.shape[1]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            pr, zr = p[i + ra, j + rb, lo:hi], z[i + ra, j + rb, lo:hi]
            wr, qr = weight[i + ra, j + rb, lo:hi], q[i + ra, j + rb, lo:hi]
            for k in range(hi - lo):
                value = zr[k] + beta * pr[k]
                pr[k] = value
                qr[k] = wr[k] * value


@by_size(fastmath=CONTRACT)
def diffusion_rows(
    u: Array,
    y: Array,
    weight: Array,
    diagonal: Array,
    diffusivity: float,
    low: Array,
    high: Array,
    reach: Triple,
) -> Array:
    """y = weight (diagonal u - diffusivity y); returns u . y per plane."""
    ra, rb, rc = reach
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        total = 0.0
        for j in range(low.shape[1]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            ur, yr = u[i + ra, j + rb, lo:hi], y[i + ra, j + rb, lo:hi]
            wr, dr = weight[i + ra, j + rb, lo:hi], diagonal[i + ra, j + rb, lo:hi]
            for k in range(hi - lo):
                value = wr[k] * (dr[k] * ur[k] - diffusivity * yr[k])
                yr[k] = value
                total += value * ur[k]
        partial[i] = total
    return partial


@by_size(fastmath=CONTRACT)
def add_shift(u: Array, y: Array, shift: Array, low: Array, high: Array, reach: Triple) -> Array:
    """y += shift u; returns u . (shift u) per plane."""
    ra, rb, rc = reach
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        total = 0.0
        for j in range(low.shape[1]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            ur, yr = u[i + ra, j + rb, lo:hi], y[i + ra, j + rb, lo:hi]
            sr = shift[i + ra, j + rb, lo:hi]
            for k in range(hi - lo):
                value = sr[k] * ur[k]
                yr[k] += value
                total += value * ur[k]
        partial[i] = total
    return partial


@by_size(fastmath=CONTRACT)
def stage_residual(
    y: Array,
    old: Array,
    gain: Array,
    weight: Array,
    diagonal: Array,
    diffusivity: float,
    tau: float,
    low: Array,
    high: Array,
    reach: Triple,
) -> Array:
    """gain = weight (old / tau - diagonal y + diffusivity gain);  (weight old)^2 per plane."""
    ra, rb, rc = reach
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        squares = 0.0
        for j in range(low.shape[1]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            yr, before = y[i + ra, j + rb, lo:hi], old[i + ra, j + rb, lo:hi]
            wr, dr = weight[i + ra, j + rb, lo:hi], diagonal[i + ra, j + rb, lo:hi]
            gr = gain[i + ra, j + rb, lo:hi]
            for k in range(hi - lo):
                gr[k] = wr[k] * (before[k] / tau - dr[k] * yr[k] + diffusivity * gr[k])
                squares += (wr[k] * before[k]) ** 2
        partial[i] = squares
    return partial


@by_size(fastmath=CONTRACT)
def advance_solution(
    x: Array, r: Array, p: Array, y: Array, alpha: float, low: Array, high: Array, reach: Triple
) -> Array:
    """x += alpha p;  r -= alpha y;  returns r . r per plane."""
    ra, rb, rc = reach
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        total = 0.0
        for j in range(low.shape[1]):
            lo, hi = low[i, j] + rc, high[i, j] + rc
            xr, rr = x[i + ra, j + rb, lo:hi], r[i + ra, j + rb, lo:hi]
            pr, yr = p[i + ra, j + rb, lo:hi], y[i + ra, j + rb, lo:hi]
            for k in range(hi - lo):
                xr[k] += alpha * pr[k]
                value = rr[k] - alpha * yr[k]
                rr[k] = value
                total += value * value
        partial[i] = total
    return partial


@by_size(fastmath=CONTRACT)
def add_diagonal_and_coarse(
    r: Array,
    inverse: Array,
    coarse: Array,
    factors: Triple,
    start: Triple,
    mask: Array,
    z: Array,
    low: Array,
    high: Array,
    reach: Triple,
) -> Array:
    """z = mask (inverse r + coarse correction of the cell's aggregate);  returns r . z per plane.

    factors: cells of the fine lattice per coarse cell along each axis; coarse has one ghost and
    begins at the cell `start`.
    """
    ra, rb, rc = reach
    fa, fb, fc = factors
    sa, sb, sc = start
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        total = 0.0
        for j in range(low.shape[1]):
            if high[i, j] <= low[i, j]:
                continue
            line = coarse[(i - sa) // fa + 1, (j - sb) // fb + 1]
            for k in range(low[i, j], high[i, j]):
                kk = k + rc
                value = inverse[i + ra, j + rb, kk] * r[i + ra, j + rb, kk]
                value = mask[i + ra, j + rb, kk] * (value + line[(k - sc) // fc + 1])
                z[i + ra, j + rb, kk] = value
                total += value * r[i + ra, j + rb, kk]
        partial[i] = total
    return partial
