"""Logarithmic (Hencky) strain: spectral decomposition and the tangent of an isotropic law.

Everything here is a kernel on numbers, not arrays, so that it stays in registers: a 3x3 tensor is
nine numbers row by row, a symmetric one six, 00, 11, 22, 01, 02, 12. Neither the decomposition nor
the tangent distinguishes equal stretches, so no case loses digits.
"""

from __future__ import annotations

import numpy as np

from fem.constitutive.compiled import kernel

_SWEEPS = 30
_CUBIC_STEPS = 3
_NEAR = 0.1  # share of the mean eigenvalue below which Jacobi's method takes over


@kernel
def decompose(symmetric: tuple) -> tuple:
    """Eigenvalues (l1, l2, l3) and eigenvectors (three tuples) of a positive definite tensor.

    Scherzinger and Dohrmann (2008): the eigenvalue that is farthest from the others, in closed
    form, and its vector from the largest column of the adjugate; the other two from a rotation in
    the plane normal to it. Orthonormal and exact to a few round-offs of the largest eigenvalue;
    where the smallest is much below that, Jacobi's method keeps its digits.
    """
    s00, s11, s22, s01, s02, s12 = symmetric
    mean = (s00 + s11 + s22) / 3.0
    d00, d11, d22 = s00 - mean, s11 - mean, s22 - mean  # exact but for the round-off of the mean
    rest = (d00 + d11 + d22) / 3.0
    d00, d11, d22 = d00 - rest, d11 - rest, d22 - rest
    second = 0.5 * (d00 * d00 + d11 * d11 + d22 * d22) + s01 * s01 + s02 * s02 + s12 * s12
    if second <= 1e-40 * mean * mean:
        return (s00, s11, s22), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    third = (
        d00 * (d11 * d22 - s12 * s12)
        - s01 * (s01 * d22 - s12 * s02)
        + s02 * (s01 * s12 - d11 * s02)
    )
    radius = np.sqrt(second / 3.0)
    # the root 2 radius y of the characteristic equation, 4 y^3 - 3 y = cosine, sqrt(3)/2 <= y <= 1
    cosine = min(abs(third) / (2.0 * radius * radius * radius), 1.0)
    y = 0.8660254037844386 + cosine * (0.1666666666666667 - 0.0326920704511053 * cosine)
    for _ in range(_CUBIC_STEPS):
        y -= ((4.0 * y * y - 3.0) * y - cosine) / (12.0 * y * y - 3.0)
    far = np.copysign(2.0 * radius * y, third)
    # adjugate of d - far 1: a positive multiple of n n^T
    e00, e11, e22 = d00 - far, d11 - far, d22 - far
    c00, c11, c22 = e11 * e22 - s12 * s12, e00 * e22 - s02 * s02, e00 * e11 - s01 * s01
    c01, c02, c12 = s02 * s12 - s01 * e22, s01 * s12 - s02 * e11, s01 * s02 - s12 * e00
    if c00 >= c11 and c00 >= c22:
        x, y, z = c00, c01, c02
    elif c11 >= c22:
        x, y, z = c01, c11, c12
    else:
        x, y, z = c02, c12, c22
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    x, y, z = x * scale, y * scale, z * scale
    # two vectors normal to it (Duff et al. 2017), then Jacobi's rotation between them
    sign = np.copysign(1.0, z)
    slope = -1.0 / (sign + z)
    both = x * y * slope
    px, py, pz = 1.0 + sign * x * x * slope, sign * both, -sign * x
    qx, qy, qz = both, sign + y * y * slope, -y
    tx, ty, tz = (
        d00 * px + s01 * py + s02 * pz,
        s01 * px + d11 * py + s12 * pz,
        s02 * px + s12 * py + d22 * pz,
    )
    pp, pq = px * tx + py * ty + pz * tz, qx * tx + qy * ty + qz * tz
    qq = -far - pp
    half = 0.5 * (qq - pp)
    reach = abs(half) + np.sqrt(half * half + pq * pq)
    tangent = np.copysign(1.0, half) * pq / reach if reach > 0.0 else 0.0
    c = 1.0 / np.sqrt(1.0 + tangent * tangent)
    s = c * tangent
    turned = tangent * pq
    values = (mean + (rest + far), mean + (rest + pp - turned), mean + (rest + qq + turned))
    if not min(values[0], values[1], values[2]) > _NEAR * mean:
        return _decompose_by_rotations(symmetric)
    return (
        values,
        (x, y, z),
        (c * px - s * qx, c * py - s * qy, c * pz - s * qz),
        (s * px + c * qx, s * py + c * qy, s * pz + c * qz),
    )


@kernel
def _decompose_by_rotations(symmetric: tuple) -> tuple:
    """As `decompose`, by Jacobi's method, which keeps the digits of small eigenvalues."""
    matrix, vectors = np.empty((3, 3)), np.eye(3)
    for i in range(3):
        matrix[i, i] = symmetric[i]
    matrix[0, 1] = matrix[1, 0] = symmetric[3]
    matrix[0, 2] = matrix[2, 0] = symmetric[4]
    matrix[1, 2] = matrix[2, 1] = symmetric[5]
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
    return (
        (matrix[0, 0], matrix[1, 1], matrix[2, 2]),
        (vectors[0, 0], vectors[1, 0], vectors[2, 0]),
        (vectors[0, 1], vectors[1, 1], vectors[2, 1]),
        (vectors[0, 2], vectors[1, 2], vectors[2, 2]),
    )


@kernel
def shear_factor(difference: float) -> float:
    """x coth x, for x the difference of two logarithmic strains, also when it is nothing.

    It is (ln a - ln b) / 2 (a + b) / (a - b) of the squared stretches a, b with x = ln(a / b) / 2.
    """
    square = difference * difference
    if square < 0.01:  # the next term is 2e-18
        series = 1.0 / 4725.0 - square * 2.0 / 93555.0
        series = 1.0 / 45.0 - square * (2.0 / 945.0 - square * series)
        return 1.0 + square * (1.0 / 3.0 - square * series)
    return difference / np.tanh(difference)


@kernel
def invert(matrix: tuple) -> tuple:
    """Determinant and inverse (nine numbers; not finite when the determinant is 0)."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = matrix
    c00 = m11 * m22 - m12 * m21
    c01 = m12 * m20 - m10 * m22
    c02 = m10 * m21 - m11 * m20
    determinant = m00 * c00 + m01 * c01 + m02 * c02
    scale = 1.0 / determinant
    return determinant, (
        c00 * scale, (m02 * m21 - m01 * m22) * scale, (m01 * m12 - m02 * m11) * scale,
        c01 * scale, (m00 * m22 - m02 * m20) * scale, (m02 * m10 - m00 * m12) * scale,
        c02 * scale, (m01 * m20 - m00 * m21) * scale, (m00 * m11 - m01 * m10) * scale,
    )  # fmt: skip


@kernel
def push_forward(gradient: tuple, symmetric: tuple) -> tuple:
    """G S G^T of a symmetric S."""
    g00, g01, g02, g10, g11, g12, g20, g21, g22 = gradient
    s00, s11, s22, s01, s02, s12 = symmetric
    x0, x1, x2 = (
        g00 * s00 + g01 * s01 + g02 * s02,
        g00 * s01 + g01 * s11 + g02 * s12,
        g00 * s02 + g01 * s12 + g02 * s22,
    )
    y0, y1, y2 = (
        g10 * s00 + g11 * s01 + g12 * s02,
        g10 * s01 + g11 * s11 + g12 * s12,
        g10 * s02 + g11 * s12 + g12 * s22,
    )
    z0, z1, z2 = (
        g20 * s00 + g21 * s01 + g22 * s02,
        g20 * s01 + g21 * s11 + g22 * s12,
        g20 * s02 + g21 * s12 + g22 * s22,
    )
    return (
        x0 * g00 + x1 * g01 + x2 * g02,
        y0 * g10 + y1 * g11 + y2 * g12,
        z0 * g20 + z1 * g21 + z2 * g22,
        x0 * g10 + x1 * g11 + x2 * g12,
        x0 * g20 + x1 * g21 + x2 * g22,
        y0 * g20 + y1 * g21 + y2 * g22,
    )


@kernel
def from_principal(values: tuple, a: tuple, b: tuple, c: tuple) -> tuple:
    """The symmetric tensor with these principal values and unit vectors."""
    u, v, w = values
    u0, u1, u2 = u * a[0], u * a[1], u * a[2]
    v0, v1, v2 = v * b[0], v * b[1], v * b[2]
    w0, w1, w2 = w * c[0], w * c[1], w * c[2]
    return (
        u0 * a[0] + v0 * b[0] + w0 * c[0],
        u1 * a[1] + v1 * b[1] + w1 * c[1],
        u2 * a[2] + v2 * b[2] + w2 * c[2],
        u0 * a[1] + v0 * b[1] + w0 * c[1],
        u0 * a[2] + v0 * b[2] + w0 * c[2],
        u1 * a[2] + v1 * b[2] + w1 * c[2],
    )


@kernel
def spatial_tangent(
    principal: np.ndarray, moduli: np.ndarray, a: tuple, b: tuple, c: tuple, dyads: np.ndarray,
    tangent: np.ndarray,
) -> None:  # fmt: skip
    """Fill C (6, 6) of the corotational stress rate, d(tau) = C : d + w tau - tau w.

    With dF F^-1 = d + w, symmetric and skew; d counts its shears twice, so that C is symmetric
    where D is. principal: D_AB = d tau_A / d eps_B (3, 3); moduli (3,): d tau_AB / d d_AB of the
    pairs 01, 02, 12 of the principal vectors a, b, c, which is (tau_A - tau_B) / (eps_A - eps_B)
    times `shear_factor`, for d tau_AB = (tau_A - tau_B) (b_A + b_B) / (b_A - b_B) d_AB. `dyads`
    (9, 6) is scratch.
    """
    for k in range(3):
        plain, first, second = a, a, b
        if k == 1:
            plain, second = b, c
        elif k == 2:
            plain, first, second = c, b, c
        dyads[k, 0], dyads[k, 1], dyads[k, 2] = plain[0] ** 2, plain[1] ** 2, plain[2] ** 2
        dyads[k, 3], dyads[k, 4] = plain[0] * plain[1], plain[0] * plain[2]
        dyads[k, 5] = plain[1] * plain[2]
        dyads[3 + k, 0] = 2.0 * first[0] * second[0]
        dyads[3 + k, 1] = 2.0 * first[1] * second[1]
        dyads[3 + k, 2] = 2.0 * first[2] * second[2]
        dyads[3 + k, 3] = first[0] * second[1] + first[1] * second[0]
        dyads[3 + k, 4] = first[0] * second[2] + first[2] * second[0]
        dyads[3 + k, 5] = first[1] * second[2] + first[2] * second[1]
    for k in range(3):
        for j in range(6):
            dyads[6 + k, j] = (
                principal[k, 0] * dyads[0, j]
                + principal[k, 1] * dyads[1, j]
                + principal[k, 2] * dyads[2, j]
            )
    x, y, z = 0.5 * moduli[0], 0.5 * moduli[1], 0.5 * moduli[2]
    for i in range(6):
        u, v, w = x * dyads[3, i], y * dyads[4, i], z * dyads[5, i]
        for j in range(6):
            tangent[i, j] = (
                dyads[0, i] * dyads[6, j] + dyads[1, i] * dyads[7, j] + dyads[2, i] * dyads[8, j]
                + u * dyads[3, j] + v * dyads[4, j] + w * dyads[5, j]
            )  # fmt: skip
