"""A ball that dissolves into clean liquid, without a lattice: the nonlocal model in radial shells.

Units: the horizon, the flux i/(zF) of a flat front and C_solid are 1; constant kinetics, q = 0,
omega = 1.  A point at depth z below the sphere of radius R, rho = R - z, sees

    lambda = 2 (-ln z - (R^2 - rho^2) (1/z - 1) / (2 rho) + (1 - z) / (2 rho)),     0 < z < 1.

H = int lambda dt is what it has seen.  Faraday's law takes it away at H = 1 and leaves 1 - H until
then; the proportional law takes it away at H = ln(C_solid/C_sat) and leaves e^-H.  R(t) is not
R_0 - t: the first layer is drained before the surface moves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POINTS = np.polynomial.legendre.leggauss(6)
_AT_SURFACE = np.polynomial.legendre.leggauss(30)
_STEP = 2e-3
"""Largest step, of the life of a point."""


def dissolving_ball(
    radius: float, ratio: float | None, depth: float, shells: int = 800
) -> tuple[Array, Array, Array]:
    """Times, V_L and radius of a ball until its surface has moved by `depth` (all in horizons).

    Parameters
    ----------
    radius : float
        At least depth + 1.
    ratio : float or None
        C_sat/C_solid of the proportional law; None: Faraday's law.
    shells : int
        Per horizon; the error is first order and extrapolated from half as many: 1e-3 of V_L.
    """
    if not depth <= radius - 1:
        raise ValueError(f"depth: {depth} horizons; at most {radius - 1} for a ball of {radius}")
    coarse, fine = (_march(radius, ratio, depth, n) for n in (shells // 2, shells))
    time = fine[0]
    loss, place = (
        2 * f - np.interp(time, coarse[0], c) for f, c in zip(fine[1:], coarse[1:], strict=True)
    )
    return time, loss, place


def _seen(depth: Array, radius: float) -> Array:
    """lambda at these depths."""
    z = np.maximum(depth, 1e-300)
    rho = radius - z
    bent = (radius**2 - rho**2) / (2 * rho) * (1 / z - 1) - (1 - z) / (2 * rho)
    return np.where(z < 1, 2 * (-np.log(z) - bent), 0.0)


def _march(
    radius: float, ratio: float | None, depth: float, shells: int
) -> tuple[Array, Array, Array]:
    ends, least = (1.0, 0.0) if ratio is None else (-math.log(ratio), ratio)
    e = 1.0 / shells
    outer = radius - e * np.arange(math.ceil(depth * shells) + shells)
    inner = outer - e
    volume = (outer**3 - inner**3) / 3
    x, w = _POINTS
    points = inner[:, None] + e * (x + 1) / 2
    weight = points**2 * w * e / 2 / volume[:, None]
    u, v = (_AT_SURFACE[0] + 1) / 2, _AT_SURFACE[1] / 2
    seen = np.zeros(outer.size)
    rows = [(0.0, 0.0, radius)]
    whole = radius**3 / 3 * (1 - least)
    time = 0.0
    for k in range(math.ceil(depth * shells)):
        near = slice(k, k + shells + 1)
        rate = (_seen(outer[k] - points[near], outer[k]) * weight[near]).sum(axis=1)
        z = e * u**3  # graded: the skin's rate is a logarithm
        shell = 3 * e * u**2 * v * (outer[k] - z) ** 2 / volume[k]
        rate[0] = (_seen(z, outer[k]) * shell).sum()
        span = (ends - seen[k]) / rate[0]
        steps = math.ceil(span / (ends * _STEP))
        for n in range(steps):
            seen[near] += span / steps * rate
            time += span / steps
            first = k + (n == steps - 1)
            left = np.exp(-seen[first:]) - least if ratio is not None else 1 - seen[first:]
            rest = inner[-1] ** 3 / 3 * (1 - least) + float((volume[first:] * left).sum())
            rows.append((time, 1 - rest / whole, outer[first]))
    times, loss, place = np.array(rows).T
    return times, loss, place
