"""The dissolution rate of a front: what the lattice, its orientation and the law make of it.

Closed forms and exact discrete sums; no march.  A flat front between solid and clean liquid
sends D_int C_solid S into the liquid, S the front strength of the stencil; `CorrosionScene`
derives D_int from the flux wanted, so S is exact along the lattice's axes by construction.
"""

from __future__ import annotations

import math

import numpy as np

from peri.engine.influence import Stencil


def directional_strength(stencil: Stencil, normal) -> float:
    """Front strength of a flat front with the given normal, 1/m, averaged over its position.

    S(n) = sum_xi w(xi) max(xi . n, 0): each bond crosses a plane in proportion to its length
    along the normal.  Along a lattice axis this is Stencil.front_strength.
    """
    normal = np.asarray(normal, float)
    normal = normal / np.linalg.norm(normal)
    dense = stencil.dense()
    axes = [h * np.arange(-r, r + 1) for h, r in zip(stencil.spacing, stencil.reach, strict=True)]
    along = sum(
        x.reshape([-1 if a == b else 1 for b in range(len(axes))]) * n
        for a, (x, n) in enumerate(zip(axes, normal, strict=True))
    )
    return float((dense * np.maximum(along, 0.0)).sum())


def sphere_strength(stencil: Stencil, radius: float, spacing: float) -> float:
    """Front strength of a metal sphere on the lattice, per area 4 pi R^2, 1/m.

    The sphere is classified node by node about a centre off the lattice; cells count fully.
    """
    reach = max(stencil.reach)
    n = int(math.ceil(radius / spacing)) + reach + 1
    x = spacing * (np.arange(-n, n + 1) + 0.31)
    squared = x[:, None, None] ** 2 + x[None, :, None] ** 2 + x[None, None, :] ** 2
    metal = squared <= radius**2
    from peri.engine.operators import NonlocalSum

    operator = NonlocalSum(stencil, metal.shape)
    liquid_seen = operator.crop(operator(operator.pad(~metal)))
    # Nodes beyond the box are liquid as well; the box is wide enough for every metal node.
    exchanged = float(liquid_seen[metal].sum()) * spacing**3
    return exchanged / (4.0 * math.pi * radius**2)


def sphere_curvature_factor(horizon: float, radius: float) -> float:
    """Continuous front strength of a sphere over that of a plane, for q = 0, omega = 1, in 3D.

    The overlap of a ball with its copy shifted by r loses pi R^2 r - pi r^3 / 12, so the factor
    is 1 - <r^3> / (12 R^2 <r>) with the kernel's weights: 1 - delta^2 / (36 R^2).
    """
    return 1.0 - horizon**2 / (36.0 * radius**2)


def flat_front_profile(depth, horizon: float):
    """Loss per flux at a depth below a flat front, 1/m (Zhao et al. 2021, Eqs 18-20, in 2D).

    f(z) = 2 / delta^2 (delta acos(z/delta) - z ln(delta/z + tan acos(z/delta))), which
    integrates to 1 over 0 < z < delta.

    Parameters
    ----------
    depth : array
        z, m, > 0.
    """
    ratio = np.clip(np.asarray(depth, float) / horizon, 1e-300, 1.0)
    angle = np.arccos(ratio)
    return 2.0 / horizon * (angle - ratio * np.log(1.0 / ratio + np.tan(angle)))


def flat_front_quadrature_error(ratio: int) -> float:
    """Relative error of the flux when the profile is summed over nodes (Zhao et al. 2021, Table 2).

    ratio : m = delta / dx; nodes at depths (k + 1/2) dx.
    """
    depth = (np.arange(ratio) + 0.5) / ratio
    return float(flat_front_profile(depth, 1.0).sum() / ratio - 1.0)


def front_speed_ratio(stencil: Stencil, concentration_ratio: float, layers: int = 200) -> float:
    """Speed of a travelling flat front over flux / C_solid, by exact event-driven decay.

    Metal layers lose lambda_k C with lambda_k the bond sum to the liquid layers, and turn liquid
    at C_sat; between two changes every layer decays exponentially, so nothing is discretised in
    time.  In the steady state a layer has to decay by C_solid/C_sat while it sees the whole
    profile of lambda, whose sum is the front strength: the ratio is 1 / ln(C_solid/C_sat) for
    every lattice, horizon and dimension.

    Parameters
    ----------
    concentration_ratio : float
        C_solid / C_sat, > 1.
    """
    dense = stencil.dense()
    column = dense.sum(axis=tuple(range(1, stencil.dimension)))
    reach = stencil.reach[0]
    column = column[reach:]
    tail = np.array([column[k:].sum() for k in range(1, reach + 1)])  # seen from depth k
    need = np.full(layers + reach, math.log(concentration_ratio))
    front, time, mark = 0, 0.0, 0.0
    while front < layers:
        rate = tail[:reach]
        left = need[front : front + reach]
        step = np.min(left / rate)
        need[front : front + reach] = left - rate * step
        time += step
        while front < layers and need[front] <= 1e-12:
            front += 1
        if front <= layers // 2:
            mark, marked = time, front
    h = stencil.spacing[0]
    speed = h * (front - marked) / (time - mark)
    return speed / stencil.front_strength(0)
