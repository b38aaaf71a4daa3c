"""Bond weights between the shares of metal and liquid of cells that a moving surface cuts.

Where cells hold shares f_i of metal and c_j of liquid, cell i loses sum_j k_ij f_i c_j.
Averaged over the places of a lattice against a plane of normal n this is, per area,

    S(n) = sum_xi k(xi) < max(n . (xi + x - x'), 0) >,     x, x' anywhere in the two cells,

so the weights act like their trilinear interpolant.  The weights k are those nearest to the
stencil's (least squares, each bond weighed by its share in a front's flux, k >= 0, one of a cell
with itself added) with

    S(n) = the continuum's strength for every n (measured: -0.2 to +0.1 % at two spacings per
           horizon, +-0.1 % from three on),
    sum_xi k (xi_a^2 + h_a^2/6) = 4 z_a S along each axis a,

z_a being how deep the flux of a flat front lies if each layer of cells spreads its own evenly; the
mean depth of what a travelling front has drained is right only with it.  Curvature, edges, walls
and fronts that meet are then those of the nonlocal model on cells, wherever the surface is.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from peri.engine.influence import Stencil, closed_strength
from peri.engine.surface.flat_front import FlatFront

_STIFF = 1e3
"""Weight of the conditions against that of nearness."""

Array = NDArray[np.float64]


def share_stencil(stencil: Stencil, front: FlatFront) -> Stencil:
    """The weights k of a lattice, 1/m^2, on the bonds of its stencil and at the origin.

    Parameters
    ----------
    stencil : Stencil
        Of diffusion, 3D, one horizon.
    front : FlatFront
        Of the same horizon, kernel exponent and influence.
    """
    spacing = np.array(stencil.spacing)
    offsets = np.argwhere(stencil.octant > 0)
    offsets = np.vstack([np.zeros((1, 3), int), offsets])
    nearest = max(float(stencil.octant[tuple(axis)]) for axis in np.eye(3, dtype=int))
    base = np.append(nearest, stencil.octant[tuple(offsets[1:].T)])
    cubic = bool(np.ptp(spacing) <= 1e-9 * spacing.max())
    kinds = np.sort(offsets, axis=1) if cubic else offsets
    _, first, group = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
    group, base = group.ravel(), base[first]
    count = (offsets > 0).sum(axis=1)
    strength = closed_strength(front.horizon, front.kernel_exponent, front.influence)

    def by_group(values: Array) -> Array:
        """Sums over the bonds (all octants) of each group of equal weight."""
        sums = np.bincount(group, weights=values * 2.0**count, minlength=first.size)
        return sums.astype(float)

    normals = _normals(cubic)
    rows = np.array([by_group(_flux(n, offsets * spacing, spacing)) for n in normals])
    rows = rows / strength / np.sqrt(len(normals))
    wanted = np.full(len(normals), 1 / np.sqrt(len(normals)))
    for a in range(1 if cubic else 3):
        moment = (offsets[:, a] * spacing[a]) ** 2 + spacing[a] ** 2 / 6
        target = 4 * front.mean_depth(spacing[a]) * strength
        rows = np.vstack([rows, by_group(moment) / target])
        wanted = np.append(wanted, 1.0)
    length = np.linalg.norm(offsets * spacing, axis=1)
    length[0] = spacing.min()
    near = by_group(length) * base
    near = np.sqrt(near / near.sum())
    matrix = np.vstack([_STIFF * rows * base, np.diag(near)])
    factor, _ = nnls(matrix, np.append(_STIFF * wanted, near))
    octant = np.zeros(stencil.octant.shape)
    octant[tuple(offsets.T)] = (factor * base)[group]
    return Stencil(octant, stencil.spacing)


def _normals(cubic: bool) -> Array:
    """Directions over an octant, or over the part of it that a cube's symmetries leave."""
    steps = np.linspace(0.0, 1.0, 7)
    if cubic:
        n = np.array([(1.0, a, a * b) for a in steps for b in steps])
    else:
        n = np.array([
            (np.cos(p) * np.cos(t), np.sin(p) * np.cos(t), np.sin(t))
            for p in 0.5 * np.pi * steps for t in 0.5 * np.pi * steps
        ])  # fmt: skip
    n /= np.linalg.norm(n, axis=1)[:, None]
    return np.unique(np.round(n, 12), axis=0)


def _flux(normal: Array, bonds: Array, spacing: Array) -> Array:
    """< max(n . (xi + x - x'), 0) > of bonds (n, 3), averaged over their mirror images."""
    out = np.zeros(len(bonds))
    away, weight = _differences()
    spread = away @ (normal * spacing)
    for signs in itertools.product((1.0, -1.0), repeat=2):  # the opposite bond is the same
        along = np.abs(bonds @ (normal * np.array([1.0, *signs])))
        near = along < float(np.abs(normal) @ spacing)
        out[~near] += along[~near]
        out[near] += np.abs(along[near, None] + spread) @ weight
    return out / 8


def _differences() -> tuple[Array, Array]:
    """Points and weights of x - x' for two points anywhere in a unit cube: density prod 1 - |t|."""
    x, w = np.polynomial.legendre.leggauss(6)
    t = np.concatenate([(x - 1) / 2, (x + 1) / 2])
    v = np.concatenate([w, w]) / 2 * (1 - np.abs(t))
    points = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, (v[:, None, None] * v[:, None] * v).ravel()
