"""Uniaxial tension of the porous material by an ordinary differential equation, independent of fem.

Written with the stresses themselves as unknowns of a root search and the plastic
multiplier as time; shares no formula in code with the return mapping.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


def uniaxial_curve(young, poisson, hardening, q1, f0, multiplier_end, points=400):
    """Engineering strain, force per initial area [Pa], f and plastic strain along the curve."""

    def stress(f, strain):
        flow = hardening(strain)
        phi = lambda s: (s / flow) ** 2 + 2 * q1 * f * np.cosh(s / (2 * flow)) - 1 - (q1 * f) ** 2  # noqa: E731
        return brentq(phi, 0.0, 1.1 * flow, xtol=1e-3, rtol=1e-14), flow

    def rate(_, y):
        _, _, f, strain = y
        s, flow = stress(f, strain)
        volume = q1 * f * np.sinh(s / (2 * flow)) / flow
        axial, lateral = 2 * s / flow**2 + volume, -s / flow**2 + volume
        return [
            axial,
            lateral,
            (1 - f) * (axial + 2 * lateral),
            np.sqrt(2 / 3 * (axial**2 + 2 * lateral**2)),
        ]

    grid = np.linspace(0, multiplier_end, points)
    y = solve_ivp(rate, (0, multiplier_end), [0, 0, f0, 0], t_eval=grid, rtol=1e-10, atol=1e-14).y
    engineering, nominal = [], []
    for axial, lateral, f, strain in y.T:
        s, _ = stress(f, strain)
        # tau = J s with ln J = plastic volume + (1 - 2 nu) tau / E
        plastic_volume = axial + 2 * lateral
        tau = brentq(
            lambda t, s=s, v=plastic_volume: t - s * np.exp(v + (1 - 2 * poisson) * t / young),
            0, 3 * s, xtol=1e-3, rtol=1e-14,
        )  # fmt: skip
        engineering.append(np.expm1(axial + tau / young))
        nominal.append(s * np.exp(2 * (lateral - poisson * tau / young)))
    return np.array(engineering), np.array(nominal), y[2], y[3]
