"""Bonds between the shares of metal and liquid of cells that a moving surface cuts.

Where cells hold shares f_i of metal and c_j of liquid, cell i loses sum_j k_ij f_i c_j.
Averaged over the places of a lattice against a plane of normal n this is, per area,

    S(n) = sum_xi k(xi) < max(n . (xi + x - x'), 0) >,     x, x' anywhere in the two cells,

so the weights act like their trilinear interpolant.  The weights k are those nearest to the
stencil's (least squares, each bond weighed by its share in a front's flux, k >= 0, one of a cell
with itself added) with

    S(n) = the continuum's strength S for every n (measured: -0.2 to +0.1 % at two spacings per
           horizon, +-0.1 % from three on)

and with what they carry how deep.  From three spacings per horizon on that is, along each axis a,

    sum k over the layer of a cell = 0,
    sum k over layers from the n-th on = S / h_a (T_(n-1) - T_n), on each side (FlatFront.layers).

By the first the flux of a front along an axis is the same wherever it lies in its layer, whose
cells all hold the same share; the weight of a cell with itself is negative for it.  By the second
each layer carries on the average over the places what it does in truth.  Where it is cut, that is
convex or concave in its share, which a cell makes up for by drawing from the next along the axes,

    c_a sum_n f_i f_n (f_n - f_i),

which they lose (share_flux.py).  Two spacings are too few for that: bodies that shrink lose
several per cent by the weights' fourth moment, which the layers leave no freedom for.  There no
weight is negative, and for the layers' sums stands

    sum_xi k (xi_a^2 + h_a^2/6) = 4 z_a S,

z_a being how deep the flux of a flat front lies if each layer of cells spreads its own evenly; the
mean depth of what a travelling front has drained is right only with it.  Between two and three both
are mixed (`fineness`).  Curvature, edges, walls and fronts that meet are then those of the nonlocal
model on cells, wherever the surface is.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from peri.engine.influence import Stencil, closed_strength
from peri.engine.surface.flat_front import FlatFront

_STIFF = 1e3
"""Weight of the conditions against that of nearness."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShareBonds:
    """What binds the shares of cells that a moving surface cuts.

    weights : k, at the origin, too.  drawing : c of the next cells along each axis.  handed : share
    of what is forgotten of the first surface's flux that goes to metal around (volumes.py).
    """

    weights: Stencil
    drawing: Stencil
    handed: float


def fineness(spacing: Sequence[float], horizon: float) -> float:
    """0 at two spacings per horizon and below, 1 from three on."""
    return float(np.clip(horizon / max(spacing) - 2.0, 0.0, 1.0))


def share_bonds(stencil: Stencil, front: FlatFront, by_layers: bool = True) -> ShareBonds:
    """The bonds of a lattice, 1/m^2.

    Parameters
    ----------
    stencil : Stencil
        Of diffusion, 3D, one horizon.
    front : FlatFront
        Of the same horizon, kernel exponent and influence.
    by_layers : bool
        Without it the weights are those of two spacings per horizon, however fine the lattice.
    """
    fine = fineness(stencil.spacing, front.horizon) if by_layers else 0.0
    fit = _Fit(stencil, front)
    weights, drawing = np.zeros((2, *stencil.octant.shape))
    if fine < 1:
        weights += (1 - fine) * fit.by_depth()
    if fine > 0:
        weights += fine * fit.by_layers()
        for axis, next_cell in enumerate(np.eye(3, dtype=int)):
            drawing[tuple(next_cell)] = fine * fit.drawing(axis)
    return ShareBonds(
        Stencil(weights, stencil.spacing), Stencil(drawing, stencil.spacing), handed=fine
    )


class _Fit:
    """Weights of a stencil's bonds by least squares under conditions."""

    def __init__(self, stencil: Stencil, front: FlatFront) -> None:
        self.front, self.spacing = front, np.array(stencil.spacing)
        self.shape, spacing = stencil.octant.shape, self.spacing
        offsets = np.argwhere(stencil.octant > 0)
        self.offsets = np.vstack([np.zeros((1, 3), int), offsets])
        nearest = max(float(stencil.octant[tuple(axis)]) for axis in np.eye(3, dtype=int))
        base = np.append(nearest, stencil.octant[tuple(offsets.T)])
        cubic = bool(np.ptp(spacing) <= 1e-9 * spacing.max())
        kinds = np.sort(self.offsets, axis=1) if cubic else self.offsets
        _, first, group = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        self._group, self._base = group.ravel(), base[first]
        self.strength = closed_strength(front.horizon, front.kernel_exponent, front.influence)
        self.axes = range(1 if cubic else 3)
        away, normals = self.offsets * spacing, _normals(cubic)
        self._fronts = np.array([self._sums(_flux(n, away, spacing)) for n in normals])
        self._fronts /= self.strength * np.sqrt(len(normals))
        length = np.linalg.norm(away, axis=1)
        length[0] = spacing.min()
        near = self._sums(length) * self._base
        self._near = np.sqrt(near / near.sum())

    def _sums(self, values: Array) -> Array:
        """Sums over the bonds (all octants) of each group of equal weight."""
        count = 2.0 ** (self.offsets > 0).sum(axis=1)
        return np.bincount(self._group, values * count, self._base.size).astype(float)

    def by_depth(self) -> Array:
        """Octant of weights, none negative, whose second moments are those of the depth."""
        rows = []
        for a in self.axes:
            h = self.spacing[a]
            moment = (self.offsets[:, a] * h) ** 2 + h**2 / 6
            rows.append(self._sums(moment) / (4 * self.front.mean_depth(h) * self.strength))
        return self._nearest(rows, np.ones(len(rows)))

    def by_layers(self) -> Array:
        """Octant of weights whose layers carry what they should, that of a cell of either sign."""
        rows, wanted = [], []
        for a in self.axes:
            h, away = self.spacing[a], self.offsets[:, a]
            tails, _ = self.front.layers(h, int(away.max()))
            layers = [away == 0] + [away >= n for n in range(1, int(away.max()) + 1)]
            rows += [0.5 * h / self.strength * self._sums(layer.astype(float)) for layer in layers]
            wanted += [0.0, *-np.diff(tails)]
        return self._nearest(rows, np.array(wanted), signed=True)

    def drawing(self, axis: int) -> float:
        """c of the next cell along an axis, 1/m^2."""
        h = self.spacing[axis]
        most = self.front.layers(h, int(self.offsets[:, axis].max()))[1]
        return most * self.strength / h

    def _nearest(self, rows: list[Array], wanted: Array, signed: bool = False) -> Array:
        """Octant of the weights nearest to the stencil's; signed: the first has either sign."""
        fronts = self._fronts
        conditions = np.vstack([fronts, *rows]) * self._base
        wanted = np.append(np.full(len(fronts), 1 / np.sqrt(len(fronts))), wanted)
        matrix = np.vstack([_STIFF * conditions, np.diag(self._near)])
        goal = np.append(_STIFF * wanted, self._near)
        factor, _ = nnls(np.hstack([matrix, -matrix[:, :signed]]), goal)
        factor[0] -= factor[self._base.size :].sum()
        octant = np.zeros(self.shape)
        octant[tuple(self.offsets.T)] = (factor[: self._base.size] * self._base)[self._group]
        return octant


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
