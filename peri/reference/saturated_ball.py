"""A ball that saturates its liquid, without a lattice: the nonlocal model in radial shells.

Units: the horizon, the flux i/(zF) of a flat front and C_solid are 1; constant kinetics, q = 0,
omega = 1, complementarity at C_sat, proportional law.  A pair of shells exchanges

    2 pi r s int int (1/|r - s| - 1) ds dr,    |r - s| < 1,

the kernel integrated over both spheres; beyond the liquid's edge a horizon of it is held clean.
Metal and liquid of a bond exchange what concentrations and D_int = 1/3 give; a shell of liquid that
would pass C_sat takes from each of its bonds the share that holds it there.  No shell of metal may
reach C_sat by the end: surfaces that move are in moving_ball.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_KERNEL = 3 / np.pi
_INTERFACE = 1 / 3
_FIRST = 1e-5
"""First step, of the whole time; steps grow geometrically."""
_ORDER = 1.8
"""In the shells, measured from 16, 32 and 64 of them a horizon."""
_ROUNDS = 200


def saturated_ball(
    radius: float,
    edge: float,
    diffusivity: float,
    saturation: float,
    times: ArrayLike,
    shells: int = 64,
    steps: int = 200,
) -> Array:
    """V_L (nt,) of a ball in liquid up to `edge`, by backward Euler.

    Parameters
    ----------
    radius, edge : float
        Multiples of the width 1/shells and of twice that; radius >= 1, edge >= radius + 1.
    diffusivity : float
        D_liq C_solid / (flux horizon).
    saturation : float
        C_sat / C_solid.
    times : ascending, > 0.
    shells, steps : int
        Per horizon, and in all; what half as many shells and twice as many steps change is
        extrapolated.  Their error is then some 1e-3 of V_L.
    """
    if not (radius >= 1 and edge >= radius + 1):
        raise ValueError(
            f"radius, edge: {radius} and {edge} horizons; at least 1, and 1 more than the radius"
        )
    wanted = np.asarray(times, float)
    scene = (radius, edge, diffusivity, saturation, wanted)
    fine = _march(*scene, shells, steps)
    coarse = _march(*scene, shells // 2, steps)
    longer = _march(*scene, shells // 2, 2 * steps) - coarse
    return fine + (fine - coarse) / (2**_ORDER - 1) + 2 * longer


def _pairs(radius: float, edge: float, shells: int) -> tuple[Array, Array, Array]:
    """Middle radii, volumes over 4 pi, and exchanges over 4 pi of the shells, core left out."""
    width, inner = 1 / shells, radius - 1
    count = round((edge + 1 - inner) * shells)
    low = inner + width * np.arange(count)
    away = np.arange(-1, count + 1) * width

    def twice(u: Array) -> Array:
        """Second antiderivative of 1/u - 1, zero beyond 1."""
        u = np.abs(u)
        near = np.minimum(u, 1.0)
        return (
            near * np.log(np.where(near > 0, near, 1.0)) - near - near**2 / 2 - np.maximum(u - 1, 0)
        )

    by_distance = twice(away[2:]) + twice(away[:-2]) - 2 * twice(away[1:-1])
    by_distance[0] = 0.0
    index = np.arange(count)
    middle = low + width / 2
    exchange = 2 * np.pi * np.outer(middle, middle)
    exchange *= by_distance[np.abs(index[:, None] - index)]
    return middle, ((low + width) ** 3 - low**3) / 3, exchange


def _march(
    radius: float, edge: float, diffusivity: float, saturation: float, times: Array,
    shells: int, steps: int,
) -> Array:  # fmt: skip
    middle, volume, exchange = _pairs(radius, edge, shells)
    metal, free, held = middle < radius, (middle > radius) & (middle < edge), middle > edge
    solid, liquid = volume[metal], volume[free]
    bonds, to_held = exchange[np.ix_(metal, free)], exchange[np.ix_(metal, held)].sum(axis=1)
    inner = exchange[np.ix_(free, free)]
    spread = np.diag(inner.sum(axis=1) + exchange[np.ix_(free, held)].sum(axis=1)) - inner
    spread *= _KERNEL * diffusivity
    rate, reached = _KERNEL * _INTERFACE, bonds.sum(axis=0) > 0
    whole = radius**3 / 3

    left, dissolved = np.ones(solid.size), np.zeros(liquid.size)
    full, share = np.zeros(liquid.size, bool), np.ones(liquid.size)
    found, now = [], 0.0
    for time in np.union1d(np.geomspace(_FIRST * times[-1], times[-1], steps), times):
        step, now = time - now, time
        for _ in range(_ROUNDS):
            open_bonds = bonds * share
            losing = 1 / step + rate * (open_bonds.sum(axis=1) + to_held) / solid
            # The metal is eliminated: left = (before/step + rate/volume * what comes back)/losing.
            system = np.diag(liquid / step + rate * open_bonds.sum(axis=0)) + spread
            system -= rate**2 * open_bonds.T @ (open_bonds / (losing * solid)[:, None])
            right = liquid * dissolved / step + rate * open_bonds.T @ (left / step / losing)
            new = np.where(full, saturation, 0.0)
            new[~full] = np.linalg.solve(
                system[np.ix_(~full, ~full)], right[~full] - system[np.ix_(~full, full)] @ new[full]
            )
            rest = (left / step + rate / solid * (open_bonds @ new)) / losing
            needed = liquid * (new - dissolved) / step + spread @ new
            offered = rate * (bonds.T @ rest - bonds.sum(axis=0) * new)
            wanted = np.where(full, needed / np.where(full, offered, 1.0), 1.0)
            now_full = np.where(full, wanted < 1, reached & (new > saturation * (1 + 1e-10)))
            settled = np.array_equal(now_full, full)
            wanted = np.where(now_full, np.minimum(wanted, 1.0), 1.0)
            moved = np.abs((wanted - share) * offered).sum() * step
            full, share = now_full, wanted
            loss = 1 - ((solid * rest).sum() + (radius - 1) ** 3 / 3) / whole
            if settled and moved < 1e-9 * whole * max(1e-3, loss):
                break
        else:
            raise RuntimeError(f"saturated shells do not settle in {_ROUNDS} rounds at time {time}")
        left, dissolved = rest, new
        if left.min() <= saturation:
            raise ValueError(f"times: metal reaches C_sat at {time}; no surface moves here")
        if time in times:
            found.append(loss)
    return np.array(found)
