"""Compiled loops of the multigrid for the local operator: arrays in, arrays out.

Level arrays carry one ghost cell on each side.
"""

from __future__ import annotations

from numba import prange

from peri.engine.compiled import CONTRACT, Array, Triple, by_size


@by_size
def aggregate(fine: Array, first: Triple, extent: Triple, factors: Triple, coarse: Array) -> None:
    """coarse cell = sum of its factors[0] x factors[1] x factors[2] fine cells.

    first : index of the first fine cell, of `extent` along each axis.
    """
    ma, mb, mc = first
    fa, fb, fc = factors
    na, nb, nc = extent
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


@by_size
def first_step(x: Array, b: Array, inverse: Array, d: Array, scale: float) -> None:
    """x = d = scale inverse b: local_step and add_to from x = 0."""
    for i in prange(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            xr, br, dr, vr = x[i, j], b[i, j], d[i, j], inverse[i, j]
            for k in range(1, x.shape[2] - 1):
                dr[k] = scale * (br[k] * vr[k])
                xr[k] = dr[k]


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
