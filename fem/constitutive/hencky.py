"""Logarithmic (Hencky) strain: spectral decomposition and the tangent of an isotropic law.

Everything here is a kernel on 3x3 arrays. The decomposition is Jacobi's: its eigenvectors are
orthonormal to round-off whether or not stretches coincide, and the divided difference of the
logarithm is evaluated by series near equal stretches, so no case distinction loses digits.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_SWEEPS = 30


@njit(cache=True, nogil=True)
def eigen_symmetric(matrix: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> None:
    """Fill `values` (3,) and `vectors` (3,3; columns) of `matrix`, which is overwritten."""
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        off = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        scale = matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2
        if off <= 1e-31 * scale:
            break
        for pair in range(3):
            p = 0 if pair < 2 else 1
            q = 1 if pair == 0 else 2
            r = 3 - p - q
            apq = matrix[p, q]
            if apq == 0.0:
                continue
            theta = (matrix[q, q] - matrix[p, p]) / (2.0 * apq)
            t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
            if theta < 0.0:
                t = -t
            c = 1.0 / np.sqrt(t * t + 1.0)
            s = t * c
            matrix[p, p] -= t * apq
            matrix[q, q] += t * apq
            matrix[p, q] = matrix[q, p] = 0.0
            arp, arq = matrix[r, p], matrix[r, q]
            matrix[r, p] = matrix[p, r] = c * arp - s * arq
            matrix[r, q] = matrix[q, r] = s * arp + c * arq
            for k in range(3):
                vp, vq = vectors[k, p], vectors[k, q]
                vectors[k, p] = c * vp - s * vq
                vectors[k, q] = s * vp + c * vq
    for i in range(3):
        values[i] = matrix[i, i]


@njit(cache=True, nogil=True)
def log_divided_difference(first: float, second: float) -> float:
    """(ln first - ln second) / (first - second) for positive numbers, also when they are equal."""
    ratio = (first - second) / second
    if abs(ratio) < 1e-3:
        series = 1.0 / 6.0 - ratio / 7.0
        for denominator in (5.0, 4.0, 3.0, 2.0, 1.0):
            series = 1.0 / denominator - ratio * series
        return series / second
    return np.log1p(ratio) / (first - second)


@njit(cache=True, nogil=True)
def invert(matrix: np.ndarray, inverse: np.ndarray) -> float:
    """Fill the inverse of a 3x3 matrix; return its determinant (0 leaves the inverse)."""
    c00 = matrix[1, 1] * matrix[2, 2] - matrix[1, 2] * matrix[2, 1]
    c01 = matrix[1, 2] * matrix[2, 0] - matrix[1, 0] * matrix[2, 2]
    c02 = matrix[1, 0] * matrix[2, 1] - matrix[1, 1] * matrix[2, 0]
    determinant = matrix[0, 0] * c00 + matrix[0, 1] * c01 + matrix[0, 2] * c02
    if determinant == 0.0:
        return 0.0
    scale = 1.0 / determinant
    inverse[0, 0] = c00 * scale
    inverse[1, 0] = c01 * scale
    inverse[2, 0] = c02 * scale
    inverse[0, 1] = (matrix[0, 2] * matrix[2, 1] - matrix[0, 1] * matrix[2, 2]) * scale
    inverse[1, 1] = (matrix[0, 0] * matrix[2, 2] - matrix[0, 2] * matrix[2, 0]) * scale
    inverse[2, 1] = (matrix[0, 1] * matrix[2, 0] - matrix[0, 0] * matrix[2, 1]) * scale
    inverse[0, 2] = (matrix[0, 1] * matrix[1, 2] - matrix[0, 2] * matrix[1, 1]) * scale
    inverse[1, 2] = (matrix[0, 2] * matrix[1, 0] - matrix[0, 0] * matrix[1, 2]) * scale
    inverse[2, 2] = (matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]) * scale
    return determinant


@njit(cache=True, nogil=True)
def push_forward(gradient: np.ndarray, symmetric: tuple, result: np.ndarray) -> None:
    """result = gradient symmetric gradient^T; `symmetric` holds 00, 11, 22, 01, 02, 12."""
    s00, s11, s22, s01, s02, s12 = symmetric
    for i in range(3):
        g0, g1, g2 = gradient[i, 0], gradient[i, 1], gradient[i, 2]
        t0 = g0 * s00 + g1 * s01 + g2 * s02
        t1 = g0 * s01 + g1 * s11 + g2 * s12
        t2 = g0 * s02 + g1 * s12 + g2 * s22
        for j in range(i + 1):
            value = t0 * gradient[j, 0] + t1 * gradient[j, 1] + t2 * gradient[j, 2]
            result[i, j] = result[j, i] = value


@njit(cache=True, nogil=True)
def from_principal(vectors: np.ndarray, first: float, second: float, third: float) -> tuple:
    """Components 00, 11, 22, 01, 02, 12 of the tensor with these principal values."""
    a0, a1, a2 = vectors[0, 0], vectors[1, 0], vectors[2, 0]
    b0, b1, b2 = vectors[0, 1], vectors[1, 1], vectors[2, 1]
    c0, c1, c2 = vectors[0, 2], vectors[1, 2], vectors[2, 2]
    return (
        first * a0 * a0 + second * b0 * b0 + third * c0 * c0,
        first * a1 * a1 + second * b1 * b1 + third * c1 * c1,
        first * a2 * a2 + second * b2 * b2 + third * c2 * c2,
        first * a0 * a1 + second * b0 * b1 + third * c0 * c1,
        first * a0 * a2 + second * b0 * b2 + third * c0 * c2,
        first * a1 * a2 + second * b1 * b2 + third * c1 * c2,
    )


@njit(cache=True, nogil=True)
def spatial_tangent(
    principal: np.ndarray,
    stretches: np.ndarray,
    vectors: np.ndarray,
    shear_ratio: float,
    tangent: np.ndarray,
    dyad: np.ndarray,
    product: np.ndarray,
) -> None:
    """Fill c of d(tau) = c : l, with l = dF F^-1, as (9, 9), row 3 i + j, column 3 k + l.

    principal: D_AB = d tau_A / d eps_B (3, 3); stretches: squared trial stretches b_A (3,);
    shear_ratio: (tau_A - tau_B) / (eps_A - eps_B), the same for every pair in an isotropic law
    with radial return. With theta = (tau_A - tau_B) / (b_A - b_B), d tau_AB = theta (b_B l_AB +
    b_A l_BA) for A /= B. `dyad` (9, 9; row 3 A + B holds n_A (x) n_B) and
    `product` (9, 9) are scratch.
    """
    for a in range(3):
        for b in range(3):
            row = 3 * a + b
            for i in range(3):
                for j in range(3):
                    dyad[row, 3 * i + j] = vectors[i, a] * vectors[j, b]
    for a in range(3):
        for j in range(9):
            product[4 * a, j] = (
                principal[a, 0] * dyad[0, j]
                + principal[a, 1] * dyad[4, j]
                + principal[a, 2] * dyad[8, j]
            )
        for b in range(a):
            theta = 0.5 * shear_ratio * log_divided_difference(stretches[a], stretches[b])
            first, second = theta * stretches[b], theta * stretches[a]
            for j in range(9):
                value = first * dyad[3 * a + b, j] + second * dyad[3 * b + a, j]
                product[3 * a + b, j] = product[3 * b + a, j] = value
    for i in range(9):
        for j in range(9):
            tangent[i, j] = dyad[0, i] * product[0, j]
        for row in range(1, 9):
            factor = dyad[row, i]
            for j in range(9):
                tangent[i, j] += factor * product[row, j]
