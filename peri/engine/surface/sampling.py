"""Samples of the metal (or the liquid) in the cells of a lattice: volumes and exposures.

Cells near the surface are halved until their parts are small (`finest`) or lie well away from it,
at edges and in thin walls down to a quarter of that.  Each part takes one exposure, at a point of
its metal, and the profile of a flat front beside it: Lambda(x) = Lambda(x_0) + F(z) - F(z_0), z the
depth, so that what is sampled is the curvature's share only and the logarithm is integrated, not
sampled.  The volume of a part by depth is that of a cube cut by a plane; per cell it is scaled to
the exact share of metal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from peri.engine.lattice import Lattice
from peri.engine.surface.exposure import exposure
from peri.engine.surface.triangles import Array, Surface, signed_distance

_APART = 0.6
"""Parts whose middle is this many of their diagonals from the surface are not halved."""
_DEEP = 2.0
"""Parts away from the surface are at most this many times the finest size."""
_BENT = 0.1
"""A part is bent, and halved, where depths in it differ from a plane's by that much of its size."""
_BENT_FINER = 4.0
"""Bent parts are halved down to this share of the finest size."""
_FAR = 1.5
"""As `far` of exposures: 0.002 % of V_L on the reference screw, two thirds of the time."""
_SLICES = 12
"""Slices of a part by depth, their edges graded by the square towards the surface."""
_GRADE = 2.0


@dataclass(frozen=True)
class Samples:
    """Sampled metal (or liquid) of cells, one cell after the other; unused entries have v = 0.

    cell : (n,) flat index.  start : (n + 1,) where a cell's samples begin, each has some.
    volume, exposure : of the samples; volumes relative to a cell's.
    """

    cell: NDArray[np.int64]
    start: NDArray[np.int64]
    volume: NDArray[np.float64]
    exposure: NDArray[np.float64]

    def of(self, rows: NDArray[np.int64]) -> Samples:
        """The samples of some of the cells."""
        count = np.diff(self.start)[rows]
        start = np.append(0, np.cumsum(count))
        picked = np.arange(start[-1]) + np.repeat(self.start[rows] - start[:-1], count)
        return Samples(self.cell[rows], start, self.volume[picked], self.exposure[picked])


def default_finest(lattice: Lattice, horizon: float) -> float:
    """Size of the finest parts where none is given, in horizons; see rate_classes."""
    return max(0.5 * max(lattice.spacing) / horizon, 1.0 / 16.0)


def flat_profile(
    depth: NDArray[np.float64], horizon: float, kernel_exponent: float, influence: str
) -> NDArray[np.float64]:
    """Exposure F(z) below a flat front in 3D, 1/m^(2q), and 0 beyond the horizon."""
    x = np.clip(depth / horizon, 1e-12, 1.0)
    p = -2.0 * kernel_exponent

    def power_mean(p: float) -> NDArray[np.float64]:
        return -np.log(x) if abs(p) < 1e-13 else -np.expm1(p * np.log(x)) / p

    # 2 pi int_x^1 omega s^(p-1) (1 - x/s) ds
    value = power_mean(p) - x * power_mean(p - 1.0)
    if influence == "linear":
        value -= power_mean(p + 1.0) - x * power_mean(p)
    return 2.0 * np.pi * value * horizon ** (-2.0 * kernel_exponent)


def sample_metal(
    lattice: Lattice,
    surface: Surface,
    horizon: float,
    fraction: NDArray[np.float64],
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    finest: float | None = None,
    liquid: bool = False,
    cells: NDArray[np.int64] | None = None,
) -> Samples:
    """Samples of the metal in every cell that holds some within the horizon of the surface.

    liquid : sample the liquid instead, its exposure to the metal; `fraction` is then its share.
    cells : flat indices of the cells to look at, all where left out.
    """
    if lattice.dimension != 3 or surface.dimension != 3:
        raise ValueError(
            f"lattice: {lattice.dimension} dimensions; rate classes need 3, scenes given by nodes "
            "have one rate per node"
        )
    if np.ndim(horizon) != 0:
        raise ValueError(f"horizon: {horizon} m; rate classes need one number, no ellipsoid")
    cells = np.flatnonzero(fraction) if cells is None else cells
    spacing = np.array(lattice.spacing)
    if finest is None:
        finest = default_finest(lattice, horizon)
    centre = np.array(lattice.origin) + spacing * np.stack(
        np.unravel_index(cells, lattice.shape), axis=1
    )
    half_diagonal = 0.5 * float(np.linalg.norm(spacing))
    side = _Side(surface, -1.0 if liquid else 1.0, horizon + half_diagonal)
    depth, inward = side.depth(centre, np.full(cells.size, side.reach))
    near = np.isfinite(depth)
    cells, centre, depth, inward = cells[near], centre[near], depth[near], inward[near]
    parts = _refine(np.arange(cells.size), centre, depth, inward, spacing, side, finest * horizon)
    owner, depth, inward, size, centre, points, around = parts
    mean = around.mean(axis=1)  # differs from the middle's depth by the surface's curvature
    smooth = np.isfinite(mean)
    v, z, middle = _slices(
        np.where(smooth, mean, depth), inward, size, size.prod(axis=1) / spacing.prod()
    )
    held = v.sum(axis=1) > 0
    owner, v, z = owner[held], v[held], z[held]
    # One reference in the metal, on the normal through the part's middle; four in a wide part.
    reference = (centre + (middle - depth)[:, None] * inward)[held]
    at_reference, _ = side.depth(reference, 1.1 * middle[held] + 0.1 * size[held].max(axis=1))
    kernel = (horizon, kernel_exponent, influence)
    whole = size.max(axis=1) > 1.01 * finest * horizon
    wide = (smooth & whole & (around.min(axis=1) > 0))[held]
    base, slope = np.zeros(owner.size), np.zeros(owner.size)
    base[~wide] = _excess(reference[~wide], at_reference[~wide], side, kernel)
    four = _excess(points[held][wide].reshape(-1, 3), around[held][wide].ravel(), side, kernel)
    base[wide], slope[wide], at_reference[wide] = _line(around[held][wide], four.reshape(-1, 4))
    excess = base[:, None] + slope[:, None] * (z - np.nan_to_num(at_reference)[:, None])
    rate = excess + flat_profile(z, *kernel)
    mean = np.maximum((v * rate).sum(axis=1), 0.0)
    rate = np.where(z < horizon, np.maximum(rate, 0.0), 0.0)
    found = (v * rate).sum(axis=1)  # a line below zero beyond the horizon would add to the mean
    rate *= np.divide(mean, found, out=np.zeros_like(found), where=found > 0)[:, None]
    # A sliver that no part holds counts as a layer of its volume.
    share = fraction.ravel()[cells]
    missed = np.setdiff1d(np.arange(cells.size), owner)
    layer = 0.5 * share[missed] * float(spacing.min())
    sliver = np.zeros((missed.size, v.shape[1])), np.zeros((missed.size, v.shape[1]))
    sliver[0][:, 0], sliver[1][:, 0] = share[missed], flat_profile(layer, *kernel)
    owner, v = np.concatenate([owner, missed]), np.vstack([v, sliver[0]])
    return _gather(cells, owner, v, np.vstack([rate, sliver[1]]), share)


class _Side:
    """The metal's side of a surface (sign 1) or the liquid's (-1)."""

    def __init__(self, surface: Surface, sign: float, reach: float) -> None:
        self.surface, self.sign, self.reach = surface, sign, reach

    def depth(self, points: Array, bound: Array) -> tuple[Array, Array]:
        """signed_distance of points whose distance is at most `bound` (n,), NaN beyond."""
        depth, inward = signed_distance(points, self.surface, bound * (1 + 1e-6))
        return self.sign * depth, self.sign * inward


def _refine(
    owner: NDArray[np.int64],
    centre: Array,
    depth: Array,
    inward: Array,
    spacing: Array,
    side: _Side,
    finest: float,
) -> tuple[NDArray[Any], ...]:
    """Halve the cells that the surface cuts or nearly touches; lists of all parts.

    Of each part its cell, depth, direction inward, size, middle, four points and their depths.
    """
    done: list[list[NDArray[Any]]] = [[] for _ in range(7)]
    size = spacing.copy()
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    while True:
        diagonal = float(np.linalg.norm(size))
        largest = float(size.max()) * (1 - 1e-9)
        cut = np.abs(depth) < _APART * diagonal
        split = (largest > _DEEP * finest) | (cut & (largest > finest))
        keep = np.flatnonzero(~split & (depth > -0.5 * diagonal))
        points, around = _around(centre[keep], depth[keep], size, side)
        if largest > finest / _BENT_FINER:
            bent = _is_bent(centre[keep], points, around, depth[keep], inward[keep], size, side)
            bent &= cut[keep]
            split[keep[bent]] = True
            keep, points, around = keep[~bent], points[~bent], around[~bent]
        found = (
            owner[keep], depth[keep], inward[keep], np.tile(size, (keep.size, 1)), centre[keep],
            points, around,
        )  # fmt: skip
        for store, values in zip(done, found, strict=True):
            store.append(values)
        if not split.any():
            return tuple(np.concatenate(store) for store in done)
        centre = (centre[split][:, None] + 0.25 * size * corners).reshape(-1, 3)
        owner = np.repeat(owner[split], 8)
        size = 0.5 * size
        depth, inward = side.depth(centre, np.repeat(np.abs(depth[split]), 8) + 0.25 * diagonal)
        inside = depth > -0.5 * float(np.linalg.norm(size))
        centre, owner, depth, inward = (a[inside] for a in (centre, owner, depth, inward))


def _is_bent(
    centre: Array, points: Array, around: Array, depth: Array, inward: Array, size: Array,
    side: _Side,
) -> Array:  # fmt: skip
    """Where depths are not those below one plane: at edges, and where a wall is thin.

    Looked at: the four points of a part, and the point that lies the part's size below the surface.
    """
    plane = depth[:, None] + np.einsum("nka,na->nk", points - centre[:, None], inward)
    width = float(size.max())
    below = centre + (width - depth)[:, None] * inward
    there, _ = side.depth(below, np.full(len(below), width))
    off = np.maximum(np.abs(around - plane).max(axis=1), np.abs(there - width))
    return off > _BENT * width


def _around(centre: Array, depth: Array, size: Array, side: _Side) -> tuple[Array, Array]:
    """Four points of each part that have the box's second moments, and their depths."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(12.0)
    points = centre[:, None] + corners * size
    away = np.abs(depth) + 0.5 * float(np.linalg.norm(size))
    around, _ = side.depth(points.reshape(-1, 3), np.repeat(away, 4))
    return points, around.reshape(-1, 4)


def _line(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Mean of y, slope of y over x by least squares, and mean of x, row by row."""
    middle, mean = x.mean(axis=1), y.mean(axis=1)
    off = x - middle[:, None]
    spread = (off**2).sum(axis=1)
    slope = np.divide((off * y).sum(axis=1), spread, out=np.zeros_like(mean), where=spread > 0)
    return mean, slope, middle


def _excess(points: Array, depth: Array, side: _Side, kernel: tuple[float, float, str]) -> Array:
    """Exposure of points beyond that of a flat front at their depth; 0 off the metal."""
    good = depth > 1e-9 * kernel[0]
    out = np.zeros(len(points))
    out[good] = side.sign * exposure(points[good], side.surface, *kernel, far=_FAR)
    out[good] -= flat_profile(depth[good], *kernel)
    return out


def _slices(depth: Array, inward: Array, size: Array, volume: Array) -> tuple[Array, Array, Array]:
    """Each part's metal in slices, volume and depth (n, k), and its mean depth (n,)."""
    width = np.abs(inward) * size
    half = 0.5 * width.sum(axis=1)
    top, bottom = np.maximum(depth - half, 0.0), np.maximum(depth + half, 0.0)
    steps = (np.arange(_SLICES + 1) / _SLICES) ** _GRADE
    edges = top[:, None] + (bottom - top)[:, None] * steps
    below, integral = _cut_share(edges - depth[:, None], width)
    share = np.maximum(np.diff(below, axis=1), 0.0)
    v = share * volume[:, None]
    # The depth used for a slice has the mean of ln z over it, its volume taken as uniform, moved
    # by what the volume's true mean depth differs from the slice's middle.
    low, high = edges[:, :-1], edges[:, 1:]
    moment = np.diff(edges * below - integral, axis=1)
    mean = np.divide(moment, share, out=0.5 * (low + high), where=share > 1e-9)
    off = np.clip(mean, low, high) - 0.5 * (low + high)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_low = np.where(low > 0, low * np.log(np.maximum(low, 1e-300)), 0.0)
        z = np.exp((high * np.log(high) - log_low) / (high - low) - 1.0)
    z = np.where(high - low > 1e-6 * high, z, 0.5 * (low + high)) + off
    total = v.sum(axis=1)
    middle = (v * z).sum(axis=1) / np.maximum(total, 1e-300)
    return v, z, middle


def _cut_share(level: Array, width: Array) -> tuple[Array, Array]:
    """Share of a box of unit volume below a plane, and the integral of that share over the level.

    level : (n, k) distance of the planes from the box's middle along a normal; width : (n, 3)
    extent of the box along the normal by its axes.
    """
    m = np.maximum(width, 1e-4 * width.max(axis=1, keepdims=True))[:, None, :]
    total = m.sum(axis=2)
    a = np.clip(level + 0.5 * total, 0.0, total)
    product = m.prod(axis=2)
    share, integral = np.zeros_like(a), np.zeros_like(a)
    corners = [(1.0, 0.0 * total), (-1.0, total)]
    corners += [(-1.0, m[..., i]) for i in range(3)]
    corners += [(1.0, total - m[..., i]) for i in range(3)]
    for sign, corner in corners:
        above = np.maximum(a - corner, 0.0)
        share += sign * above**3 / (6 * product)
        integral += sign * above**4 / (24 * product)
    return np.clip(share, 0.0, 1.0), integral


def _gather(
    cells: NDArray[np.int64], owner: NDArray[np.int64], v: Array, rate: Array, share: Array
) -> Samples:
    """Samples by cell, scaled to the cells' shares of metal."""
    order = np.argsort(owner, kind="stable")
    count = np.bincount(owner, minlength=cells.size) * v.shape[1]
    start = np.append(0, np.cumsum(count))
    volume, value = v[order].ravel(), rate[order].ravel()
    found = np.add.reduceat(volume, start[:-1]) if volume.size else np.zeros(0)
    scale = np.divide(share, found, out=np.zeros_like(found), where=found > 0)
    return Samples(cells, start, volume * np.repeat(scale, count), value)
