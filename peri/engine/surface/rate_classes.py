"""Rate classes of a cell: a few volumes of metal that see different amounts of liquid.

The rate of a metal point grows like ln(delta / depth) towards the surface, and its spread within
a surface cell does not shrink with the cell; one rate a cell is therefore first order for ever.
The metal of a cell is sampled (volumes v_q, exposures Lambda_q) and the samples are replaced by
their P-point Gauss rule: P classes that keep volume, mean rate and the moments up to 2P - 1.

Sampling.  Cells near the surface are halved until their parts are small (`finest`) or lie well
away from it.  Each part takes one exposure, at a point of its metal, and the profile of a flat
front beside it: Lambda(x) = Lambda(x_0) + F(z) - F(z_0), z the depth, so that what is sampled is
the curvature's share only and the logarithm is integrated, not sampled.  The volume of a part
by depth is that of a cube cut by a plane; per cell it is scaled to the exact share of metal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from peri.engine.lattice import Lattice
from peri.engine.surface.exposure import FAR, exposure
from peri.engine.surface.triangles import Array, Surface, signed_distance

CLASSES = 3
"""Default P: 0.002 % of V_L from all samples at delta/2 on the reference screw (P = 2: 0.14 %)."""
_APART = 0.6
"""Parts whose middle is this many of their diagonals from the surface are not halved."""
_DEEP = 2.0
"""Parts away from the surface are at most this many times the finest size."""
_SLICES = 12
"""Slices of a part by depth, their edges graded by the square towards the surface."""
_GRADE = 2.0


@dataclass(frozen=True)
class RateClasses:
    """The metal of a lattice in classes, cell by cell.

    cell : (n,) flat index of the cell that a class belongs to, ascending.
    volume : (n,) volumes relative to a cell's, > 0.
    exposure : (n,) Lambda of each class, 1/m^(2q), >= 0.
    fraction : lattice array, the metal share of each cell; the classes of a cell sum to it.
    """

    cell: NDArray[np.int64]
    volume: NDArray[np.float64]
    exposure: NDArray[np.float64]
    fraction: NDArray[np.float64]


@dataclass(frozen=True)
class CellExposure:
    """What a corrosion scene knows of its surface.

    metal : classes of the metal.  liquid : lattice array, mean exposure of each cell's liquid.
    inside, held : lattice arrays, the shares of each cell that lie in the domain and that are
    held at zero concentration (within the horizon of its edge); by nodes where left out.
    """

    metal: RateClasses
    liquid: NDArray[np.float64]
    inside: NDArray[np.float64] | None = None
    held: NDArray[np.float64] | None = None


def cell_exposure(
    lattice: Lattice,
    surface: Surface,
    horizon: float,
    fraction: NDArray[np.float64],
    classes: int = CLASSES,
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    finest: float | None = None,
) -> CellExposure:
    """Both sides of a surface on a lattice; arguments and errors of `rate_classes`."""
    kernel = (kernel_exponent, influence, finest)
    return CellExposure(
        rate_classes(lattice, surface, horizon, fraction, classes, *kernel),
        liquid_exposure(lattice, surface, horizon, fraction, *kernel),
    )


@dataclass(frozen=True)
class Samples:
    """Sampled metal (or liquid) of cells: rows of the arrays are cells, unused entries have v = 0.

    cell : (n,) flat index.  volume, exposure : (n, k); volumes relative to a cell's.
    """

    cell: NDArray[np.int64]
    volume: NDArray[np.float64]
    exposure: NDArray[np.float64]


def gauss_rule(
    volume: NDArray[np.float64], value: NDArray[np.float64], points: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The Gauss rules of discrete measures, row by row (Lanczos, Golub and Welsch 1969).

    Parameters
    ----------
    volume, value : (n, k) arrays
        Weights >= 0 of a row's values.
    points : int
        P >= 1.

    Returns
    -------
    weights, nodes : (n, P); weights sum to those of the row and are 0 where a row has fewer than
    P distinct values; the nodes lie within the range of the row's values.

    Raises
    ------
    ValueError
        For fewer than one point, or negative weights.
    """
    if points < 1:
        raise ValueError(f"points: {points}; a rule needs at least one")
    if volume.shape != value.shape or (volume < 0).any():
        raise ValueError("volume: it must have the values' shape and no negative entry")
    return _gauss_rows(np.ascontiguousarray(volume), np.ascontiguousarray(value), points)


@njit(cache=True, parallel=True)
def _gauss_rows(volume: Array, value: Array, points: int) -> tuple[Array, Array]:
    n, k = volume.shape
    weights, nodes = np.zeros((n, points)), np.zeros((n, points))
    for i in prange(n):
        total, low, high = 0.0, np.inf, -np.inf
        for q in range(k):
            if volume[i, q] > 0.0:
                total += volume[i, q]
                low, high = min(low, value[i, q]), max(high, value[i, q])
        if total <= 0.0:
            continue
        mean = 0.0
        for q in range(k):
            mean += volume[i, q] / total * value[i, q]
        scale = high - low
        if points == 1 or not scale > 1e-12 * max(abs(high), abs(low)):
            weights[i, 0], nodes[i, 0] = total, mean
            nodes[i, 1:] = mean
            continue
        # Values relative to their mean and range, so that round-off is of the spread.
        diagonal, beside = np.zeros(points), np.zeros(points)
        before, now = np.zeros(k), np.ones(k)
        last, size = 0.0, points
        for j in range(points):
            a = 0.0
            for q in range(k):
                a += volume[i, q] / total * now[q] ** 2 * (value[i, q] - mean) / scale
            diagonal[j] = a
            if j == points - 1:
                break
            norm = 0.0
            for q in range(k):
                after = ((value[i, q] - mean) / scale - a) * now[q] - last * before[q]
                before[q], now[q] = now[q], after
                norm += volume[i, q] / total * after**2
            norm = np.sqrt(norm)
            if norm < 1e-7:
                size = j + 1
                break
            beside[j] = last = norm
            for q in range(k):
                now[q] /= norm
        matrix = np.zeros((size, size))
        for j in range(size):
            matrix[j, j] = diagonal[j]
            if j + 1 < size:
                matrix[j, j + 1] = matrix[j + 1, j] = beside[j]
        eigenvalues, vectors = np.linalg.eigh(matrix)
        for j in range(size):
            weights[i, j] = total * vectors[0, j] ** 2
            nodes[i, j] = min(max(mean + scale * eigenvalues[j], low), high)
        nodes[i, size:] = mean
    return weights, nodes


def rate_classes(
    lattice: Lattice,
    surface: Surface,
    horizon: float,
    fraction: NDArray[np.float64],
    classes: int = CLASSES,
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    finest: float | None = None,
) -> RateClasses:
    """The rate classes of a solid's metal on a lattice.

    Cells within the horizon of the surface get P classes, deeper ones one of exposure 0.

    Parameters
    ----------
    lattice : Lattice
        Three-dimensional.
    surface : Surface
        Of the solid.
    horizon : float
        m, one number.
    fraction : lattice array
        Metal share of each cell, 0..1; the volumes are scaled to it.
    classes : int
        P.
    kernel_exponent : float
        q < 1/2; from there on a front has no finite flux.
    influence : {"constant", "linear"}
    finest : float, optional
        Largest size of the parts that the surface cuts, in horizons; default: half the spacing,
        but no less than a sixteenth.  For a ball of two horizons that has lost 8 and 29 % it errs
        by 0.08 and 0.30 % at 1/4, 0.02 and 0.08 % at 1/8, 0.01 and 0.02 % at 1/16.  Walls want
        parts no thicker than the wall: the mean exposure of a plate of a tenth of the horizon
        errs by 6.2 % at 1/4, 0.2 % at 1/16.

    Raises
    ------
    ValueError
        One sentence naming argument, value and what is allowed.
    """
    if classes < 1:
        raise ValueError(f"classes: {classes}; a cell needs at least one")
    if not kernel_exponent < 0.5:
        raise ValueError(
            f"kernel_exponent: {kernel_exponent}; rate classes need one below 1/2, from which on "
            "the flux of a front is infinite"
        )
    if fraction.shape != lattice.shape or not (fraction.min() >= 0 and fraction.max() <= 1):
        raise ValueError(f"fraction: it must be {lattice.shape} with values from 0 to 1")
    samples = sample_metal(lattice, surface, horizon, fraction, kernel_exponent, influence, finest)
    volume, rate = gauss_rule(samples.volume, samples.exposure, classes)
    cell = np.repeat(samples.cell, classes)
    deep = np.setdiff1d(np.flatnonzero(fraction), samples.cell, assume_unique=True)
    cell = np.concatenate([cell, deep])
    volume = np.concatenate([volume.ravel(), fraction.ravel()[deep]])
    rate = np.concatenate([rate.ravel(), np.zeros(deep.size)])
    order = np.argsort(cell, kind="stable")
    order = order[volume[order] > 0]
    return RateClasses(cell[order], volume[order], rate[order], fraction)


def liquid_exposure(
    lattice: Lattice,
    surface: Surface,
    horizon: float,
    fraction: NDArray[np.float64],
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    finest: float | None = None,
) -> NDArray[np.float64]:
    """Mean exposure of each cell's liquid share to the metal, 1/m^(2q); see rate_classes."""
    samples = sample_metal(
        lattice, surface, horizon, 1.0 - fraction, kernel_exponent, influence, finest, liquid=True
    )
    out = np.zeros(fraction.size)
    _, mean = gauss_rule(samples.volume, samples.exposure, 1)
    out[samples.cell] = mean[:, 0]
    return out.reshape(fraction.shape)


def default_finest(lattice: Lattice, horizon: float) -> float:
    """Size of the finest parts where none is given, in horizons; see rate_classes."""
    return max(0.5 * max(lattice.spacing) / horizon, 1.0 / 16.0)


# --- sampling ---------------------------------------------------------------------------------


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
) -> Samples:
    """Samples of the metal in every cell that holds some within the horizon of the surface.

    liquid : sample the liquid instead, its exposure to the metal; `fraction` is then its share.
    """
    if lattice.dimension != 3 or surface.dimension != 3:
        raise ValueError(
            f"lattice: {lattice.dimension} dimensions; rate classes need 3, scenes given by nodes "
            "have one rate per node"
        )
    if np.ndim(horizon) != 0:
        raise ValueError(f"horizon: {horizon} m; rate classes need one number, no ellipsoid")
    cells = np.flatnonzero(fraction)
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
    owner, depth, inward, size, centre = parts
    points, around = _around(centre, depth, size, side)
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
    wide = (smooth & (size.max(axis=1) > 1.01 * finest * horizon) & (around.min(axis=1) > 0))[held]
    base, slope = np.zeros(owner.size), np.zeros(owner.size)
    base[~wide] = _excess(reference[~wide], at_reference[~wide], side, kernel)
    four = _excess(points[held][wide].reshape(-1, 3), around[held][wide].ravel(), side, kernel)
    base[wide], slope[wide], at_reference[wide] = _line(around[held][wide], four.reshape(-1, 4))
    excess = base[:, None] + slope[:, None] * (z - np.nan_to_num(at_reference)[:, None])
    rate = np.maximum(excess + flat_profile(z, *kernel), 0.0)
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
        """signed_distance of points whose distance is at most about `bound` (n,), NaN beyond."""
        depth, inward = np.full(len(points), np.nan), np.zeros((len(points), 3))
        reach = self.reach / 2 ** np.arange(5)[::-1]
        band = np.searchsorted(reach[:-1], bound * (1 + 1e-9))
        for b in np.unique(band):
            here = np.flatnonzero(band == b)
            depth[here], inward[here] = signed_distance(points[here], self.surface, reach[b])
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
    """Halve the cells that the surface cuts or nearly touches; lists of all parts."""
    done: list[list[NDArray[Any]]] = [[] for _ in range(5)]
    size = spacing.copy()
    while True:
        diagonal = float(np.linalg.norm(size))
        largest = float(size.max()) * (1 - 1e-9)
        cut = np.abs(depth) < _APART * diagonal
        split = (largest > _DEEP * finest) | (cut & (largest > finest))
        keep = ~split & (depth > -0.5 * diagonal)
        for store, values in zip(
            done,
            (owner[keep], depth[keep], inward[keep], np.tile(size, (keep.sum(), 1)), centre[keep]),
            strict=True,
        ):
            store.append(values)
        if not split.any():
            return tuple(np.concatenate(store) for store in done)
        corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        centre = (centre[split][:, None] + 0.25 * size * corners).reshape(-1, 3)
        owner = np.repeat(owner[split], 8)
        size = 0.5 * size
        depth, inward = side.depth(centre, np.repeat(np.abs(depth[split]), 8) + 0.25 * diagonal)
        inside = depth > -0.5 * float(np.linalg.norm(size))
        centre, owner, depth, inward = (a[inside] for a in (centre, owner, depth, inward))


def _around(centre: Array, depth: Array, size: Array, side: _Side) -> tuple[Array, Array]:
    """Four points of each part that have the box's second moments, and their depths."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(12.0)
    points = centre[:, None] + corners * size[:, None]
    away = np.abs(depth) + 0.5 * np.linalg.norm(size, axis=1)
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
    out[good] = side.sign * exposure(points[good], side.surface, *kernel, far=FAR)
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
    """Rows of samples by cell, scaled to the cells' shares of metal."""
    order = np.argsort(owner, kind="stable")
    owner, v, rate = owner[order], v[order], rate[order]
    count = np.bincount(owner, minlength=cells.size)
    k = v.shape[1]
    volume, value = (np.zeros((cells.size, max(1, int(count.max(initial=1))) * k)) for _ in "ab")
    place = np.arange(owner.size) - (np.cumsum(count) - count)[owner]
    column = place[:, None] * k + np.arange(k)
    volume[owner[:, None], column] = v
    value[owner[:, None], column] = rate
    found = volume.sum(axis=1)
    volume *= np.divide(share, found, out=np.zeros_like(found), where=found > 0)[:, None]
    return Samples(cells, volume, value)
