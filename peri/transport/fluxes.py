"""Bond fluxes of ions: what migration adds to the diffusion along a bond.

u = z (psi_j - psi_i), psi = F phi / (R T).  The inflow of an ion into node i from node j, over
w_ij c_j D, is

    sqra          exp(u/2) C_j - exp(-u/2) C_i              (default)
    sg            B(-u) C_j - B(u) C_i,  B(x) = x / (e^x - 1)        (Scharfetter and Gummel)
    mean          C_j - C_i + u (C_i + C_j) / 2             (dissertation 2.63, corrected)
    as_published  C_j - C_i + u (C_i + C_j)                 (2.63 as printed)

The first two keep concentrations positive and carry no flux in Boltzmann equilibrium, whatever the
step of the potential; `mean` does neither beyond |u| = 2.  `sqra`, `mean` and `as_published` are
sums of products of a function of i and one of j, so they are convolutions; `sg` goes bond by bond.
`sqra` exceeds `sg` by 2 sinh(u/2)/u: 0.4 % at |u| = 0.3, 4 % at 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit, prange

from peri.engine.operators import NonlocalSum

LARGEST_SQRA_STEP = 0.3
"""|u| of a bond up to which `sqra` is within 0.4 % of `sg`."""


def steps_of(z: float, psi: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """exp(z psi / 2) - 1 and exp(-z psi / 2) - 1, exact for a small field."""
    return np.expm1(0.5 * z * psi), np.expm1(-0.5 * z * psi)


def sqra(
    c: np.ndarray,
    steps: tuple[np.ndarray, np.ndarray],
    grown: np.ndarray,
    around: np.ndarray,
    shrunk: np.ndarray,
    degree: np.ndarray,
) -> np.ndarray:
    """a_j C_j / a_i - a_i C_i / a_j - (C_j - C_i), a = 1 + grow, 1/a = 1 + shrink, bonds summed.

    steps : grow, shrink;  grown, around, shrunk : the sums of grow C, C and shrink over the bonds
    """
    grow, shrink = steps
    return (1.0 + shrink) * grown + shrink * around - c * ((1.0 + grow) * shrunk + grow * degree)


def _mean(
    total: Callable[[np.ndarray], np.ndarray],
    c: np.ndarray,
    psi: np.ndarray,
    z: float,
    degree: np.ndarray,
) -> np.ndarray:
    return (0.5 * z) * (total(psi * c) + c * total(psi) - psi * total(c) - psi * c * degree)


def _as_published(
    total: Callable[[np.ndarray], np.ndarray],
    c: np.ndarray,
    psi: np.ndarray,
    z: float,
    degree: np.ndarray,
) -> np.ndarray:
    return 2.0 * _mean(total, c, psi, z, degree)


SEPARABLE = {"mean": _mean, "as_published": _as_published}
FLUX_FORMS = ("sqra", "sg", "mean", "as_published")


def migration(
    form: str,
    bond_sum: NonlocalSum,
    volume: np.ndarray,
    concentration: np.ndarray,
    psi: np.ndarray,
    z: float,
    degree: np.ndarray | None = None,
) -> np.ndarray:
    """Return sum_j w_ij c_j (f_ij - (C_j - C_i)) for D = 1, a padded field.

    Parameters
    ----------
    form : one of FLUX_FORMS
    bond_sum : NonlocalSum
    volume : padded relative volumes c of the liquid's cells, 0 elsewhere
    concentration, psi : padded fields, 0 where there is no liquid
    z : charge number
    degree : bond_sum(volume), where it is at hand

    Raises ValueError for an unknown form.
    """
    if form == "sg":
        out = np.zeros_like(psi)
        fields = (_with_neighbours(bond_sum, v) for v in (volume, concentration, psi))
        _sg_migration(out, bond_sum.octant, *fields, float(z))
        return out
    if form not in FLUX_FORMS:
        raise ValueError(f"flux_form: '{form}'; allowed are {', '.join(FLUX_FORMS)}")

    def total(values: np.ndarray) -> np.ndarray:
        return bond_sum(volume * values)

    if degree is None:
        degree = bond_sum(volume)
    if form == "sqra":
        steps = steps_of(z, psi)
        grown, around = total(steps[0] * concentration), total(concentration)
        result = sqra(concentration, steps, grown, around, total(steps[1]), degree)
    else:
        result = SEPARABLE[form](total, concentration, psi, z, degree)
    return np.where(volume > 0, result, 0.0)


def _with_neighbours(bond_sum: NonlocalSum, u: np.ndarray) -> np.ndarray:
    """A padded field with the neighbouring blocks' values in its ghosts, if there are any."""
    filled = bond_sum.processes.with_ghosts(u, bond_sum.window)
    return filled if bond_sum.processes.whole else filled.copy()  # the next exchange writes there


@njit(cache=True)
def _bernoulli(x: float) -> float:
    if abs(x) < 1e-4:
        return 1.0 - 0.5 * x + x * x / 12.0
    if x > 700.0:
        return 0.0
    return x / math.expm1(x)


@njit(cache=True, parallel=True)
def _sg_migration(out, octant, volume, c, psi, z):  # type: ignore[no-untyped-def]
    A, B, C = octant.shape
    ra, rb, rc = A - 1, B - 1, C - 1
    for i in prange(ra, out.shape[0] - ra):
        for j in range(rb, out.shape[1] - rb):
            for k in range(rc, out.shape[2] - rc):
                if volume[i, j, k] == 0.0:
                    continue
                total = 0.0
                here, at = c[i, j, k], psi[i, j, k]
                for a in range(-ra, A):
                    for b in range(-rb, B):
                        for d in range(-rc, C):
                            w = octant[abs(a), abs(b), abs(d)] * volume[i + a, j + b, k + d]
                            if w == 0.0:
                                continue
                            there = c[i + a, j + b, k + d]
                            u = z * (psi[i + a, j + b, k + d] - at)
                            # B(-u) = B(u) + u; minus the diffusion that is booked elsewhere
                            forward = _bernoulli(-u) - 1.0
                            back = _bernoulli(u) - 1.0
                            total += w * (forward * there - back * here)
                out[i, j, k] = total


def largest_bond_step(psi: np.ndarray, volume: np.ndarray, bond_sum: NonlocalSum) -> float:
    """Return a bound of |psi_j - psi_i| over the liquid's bonds, from neighbouring cells.

    The largest difference of neighbours along each axis times the reach, summed over the axes;
    a path along the axes inside the liquid is assumed.
    """
    bound = 0.0
    psi, volume = (_with_neighbours(bond_sum, v) for v in (psi, volume))
    for axis, r in enumerate(bond_sum.reach):
        if r:
            here, there = [slice(None)] * 3, [slice(None)] * 3
            here[axis], there[axis] = slice(0, -1), slice(1, None)
            both = (volume[tuple(here)] > 0) & (volume[tuple(there)] > 0)
            step = np.abs(psi[tuple(there)] - psi[tuple(here)])[both]
            bound += r * bond_sum.processes.largest(float(step.max(initial=0.0)))
    return bound
