"""Every compiled loop over the lattice: arrays in, arrays out.

Fields are three-dimensional C-ordered float64 arrays with a ghost margin of the stencil's reach
on every side; the ghosts hold zero.  One- and two-dimensional lattices use the last one or two
axes.  The callers validate; nothing here does.
"""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, prange

Array = np.ndarray
Triple = tuple[int, ...]

# Below this many elements the threads' start costs more than they save.
_THREADED_FROM = 150_000


def by_size(
    function: Callable | None = None,
    *,
    fastmath: bool | set[str] = False,
    error_model: str = "python",
) -> Callable:
    """Compile a loop twice, serial and threaded, and choose by the size of its first array.

    error_model "numpy": a division by zero gives infinity, and loops with divisions vectorise.
    """
    if function is None:
        return lambda f: by_size(f, fastmath=fastmath, error_model=error_model)
    options: dict[str, Any] = {"cache": True, "fastmath": fastmath, "error_model": error_model}
    serial = njit(**options)(_named(function, "serial"))
    threaded = njit(parallel=True, **options)(function)

    @functools.wraps(function)
    def choose(first: Array, *rest: Any) -> Any:
        return (threaded if first.size >= _THREADED_FROM else serial)(first, *rest)

    return choose


def _named(function: Callable, suffix: str) -> types.FunctionType:
    """A copy under a name of its own: Numba's cache tells functions apart by name and line only."""
    copy = types.FunctionType(function.__code__, function.__globals__, function.__name__)
    copy.__module__ = function.__module__
    copy.__qualname__ = f"{function.__qualname__}_{suffix}"
    return copy


# Contraction lets a*b+c become one fused operation; NaN and infinity keep their meaning.
CONTRACT = {"contract"}


@njit(cache=True, fastmath=CONTRACT)
def _sum_rows(source: Array, rows: Array, first: int, last: int, target: Array) -> None:
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
                target[k] = sign_a * before[k] + after[k]
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
                target[k] += sign_c * before[k] + after[k]


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
    mask: Array,
    z: Array,
    low: Array,
    high: Array,
    reach: Triple,
) -> Array:
    """z = mask (inverse r + coarse correction of the cell's aggregate);  returns r . z per plane.

    factors: cells of the fine lattice per coarse cell along each axis; coarse has one ghost.
    """
    ra, rb, rc = reach
    fa, fb, fc = factors
    partial = np.zeros(low.shape[0])
    for i in prange(low.shape[0]):
        total = 0.0
        for j in range(low.shape[1]):
            line = coarse[i // fa + 1, j // fb + 1]
            for k in range(low[i, j], high[i, j]):
                kk = k + rc
                value = inverse[i + ra, j + rb, kk] * r[i + ra, j + rb, kk]
                value = mask[i + ra, j + rb, kk] * (value + line[k // fc + 1])
                z[i + ra, j + rb, kk] = value
                total += value * r[i + ra, j + rb, kk]
        partial[i] = total
    return partial


# --- Multigrid for the local operator; level arrays carry one ghost cell on each side --------


@by_size
def aggregate(fine: Array, margin: Triple, factors: Triple, coarse: Array) -> None:
    """coarse cell = sum of its factors[0] x factors[1] x factors[2] fine cells."""
    ma, mb, mc = margin
    fa, fb, fc = factors
    na, nb, nc = fine.shape[0] - 2 * ma, fine.shape[1] - 2 * mb, fine.shape[2] - 2 * mc
    for ci in prange(coarse.shape[0] - 2):
        for cj in range(coarse.shape[1] - 2):
            row = coarse[ci + 1, cj + 1]
            row[:] = 0.0
            for i in range(ci * fa, min(na, ci * fa + fa)):
                for j in range(cj * fb, min(nb, cj * fb + fb)):
                    source = fine[i + ma, j + mb]
                    for k in range(nc):
                        row[k // fc + 1] += source[k + mc]


@by_size
def prolong_add(coarse: Array, factors: Triple, margin: Triple, fine: Array) -> None:
    """fine += the value of the coarse cell that each cell belongs to."""
    ma, mb, mc = margin
    fa, fb, fc = factors
    for i in prange(fine.shape[0] - 2 * ma):
        for j in range(fine.shape[1] - 2 * mb):
            line, row = coarse[i // fa + 1, j // fb + 1], fine[i + ma, j + mb]
            for k in range(fine.shape[2] - 2 * mc):
                row[k + mc] += line[k // fc + 1]


@by_size(fastmath=CONTRACT)
def local_step(
    x: Array,
    b: Array,
    ta: Array,
    tb: Array,
    tc: Array,
    inverse: Array,
    d: Array,
    previous: float,
    scale: float,
) -> None:
    """d = previous d + scale inverse (b - A x), A the seven-point operator of conductances t.

    t*[i]: conductance between a cell and its successor along the axis; inverse: 1 / diagonal of
    A (0 in empty cells).
    """
    for i in prange(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            xr, br, dr, vr = x[i, j], b[i, j], d[i, j], inverse[i, j]
            xa, xb, ya, yb = x[i - 1, j], x[i + 1, j], x[i, j - 1], x[i, j + 1]
            t1, t2, t3, t4 = ta[i - 1, j], ta[i, j], tb[i, j - 1], tb[i, j]
            t5 = tc[i, j]
            for k in range(1, x.shape[2] - 1):
                near = (
                    t1[k] * xa[k]
                    + t2[k] * xb[k]
                    + t3[k] * ya[k]
                    + t4[k] * yb[k]
                    + t5[k - 1] * xr[k - 1]
                    + t5[k] * xr[k + 1]
                )
                dr[k] = previous * dr[k] + scale * ((br[k] + near) * vr[k] - (vr[k] > 0) * xr[k])


@by_size(fastmath=CONTRACT)
def local_residual(
    x: Array, b: Array, ta: Array, tb: Array, tc: Array, diagonal: Array, r: Array
) -> None:
    """r = b - A x for the seven-point operator."""
    for i in prange(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            xr, br, rr, dr = x[i, j], b[i, j], r[i, j], diagonal[i, j]
            xa, xb, ya, yb = x[i - 1, j], x[i + 1, j], x[i, j - 1], x[i, j + 1]
            t1, t2, t3, t4 = ta[i - 1, j], ta[i, j], tb[i, j - 1], tb[i, j]
            t5 = tc[i, j]
            for k in range(1, x.shape[2] - 1):
                near = (
                    t1[k] * xa[k]
                    + t2[k] * xb[k]
                    + t3[k] * ya[k]
                    + t4[k] * yb[k]
                    + t5[k - 1] * xr[k - 1]
                    + t5[k] * xr[k + 1]
                )
                rr[k] = br[k] + near - dr[k] * xr[k]


@by_size(fastmath=CONTRACT)
def local_product(x: Array, ta: Array, tb: Array, tc: Array, diagonal: Array, y: Array) -> None:
    """y = A x for the seven-point operator; y has no ghosts."""
    for i in prange(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            xr, yr, dr = x[i, j], y[i - 1, j - 1], diagonal[i, j]
            xa, xb, ya, yb = x[i - 1, j], x[i + 1, j], x[i, j - 1], x[i, j + 1]
            t1, t2, t3, t4 = ta[i - 1, j], ta[i, j], tb[i, j - 1], tb[i, j]
            t5 = tc[i, j]
            for k in range(1, x.shape[2] - 1):
                near = (
                    t1[k] * xa[k]
                    + t2[k] * xb[k]
                    + t3[k] * ya[k]
                    + t4[k] * yb[k]
                    + t5[k - 1] * xr[k - 1]
                    + t5[k] * xr[k + 1]
                )
                yr[k - 1] = dr[k] * xr[k] - near


@by_size
def add_to(x: Array, d: Array) -> None:
    """x += d."""
    for i in prange(x.shape[0]):
        for j in range(x.shape[1]):
            xr, dr = x[i, j], d[i, j]
            for k in range(x.shape[2]):
                xr[k] += dr[k]
