"""Grains, grain boundaries and particles of a metal as fields on a lattice.

A polycrystal is the Voronoi tessellation of one point in each cell of a grid whose cells have the
grains' mean size; points and all other random numbers are hashed from the seed and the cell
(engine.hashing).  The structure is therefore a function of place: a box of the lattice, a finer
lattice and every process see the same one, and nothing ends at the lattice's edge.  Grains of one
point a cell differ less in size than those of points thrown at random.  Sizes per axis make
elongated grains (the L, LT and ST directions of rolled metal): the tessellation is that of space
scaled by them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from peri.engine import hashing
from peri.engine.lattice import Lattice

GRAIN, BOUNDARY, PARTICLE = 0, 1, 2
"""Phases of a microstructure."""

_FARTHEST = 2**18
"""Cells from the origin that are told apart."""
_PER_CELL = 16
"""Numbers hashed from a cell."""
_GRAIN_POINT, _GRAIN_FACTOR, _PARTICLE_POINT = 0, 3, 4
"""First of the numbers for each purpose."""


@dataclass(frozen=True)
class Microstructure:
    """Fields of a lattice's shape.

    phase : int8, GRAIN, BOUNDARY or PARTICLE.
    grain : int64, number of the grain that a node is in or nearest to, 0 to grains - 1.
    draw : (grains,) one number in [0, 1) for each grain, e.g. for its orientation.
    """

    phase: np.ndarray
    grain: np.ndarray
    draw: np.ndarray

    def values(
        self,
        grain: float,
        boundary: float | None = None,
        particle: float | None = None,
        orientation: tuple[float, float] = (1.0, 1.0),
    ) -> np.ndarray:
        """One number for each node by its phase: rate, C_solid, conductivity.

        orientation : lowest and highest factor of a grain, drawn evenly between them.

        Raises
        ------
        ValueError
            For numbers or factors that are not finite and positive, or a phase without a number.
        """
        given = {"grain": grain, "boundary": boundary, "particle": particle}
        out = np.zeros(self.phase.shape)
        for phase, (name, value) in enumerate(given.items()):
            here = self.phase == phase
            if value is None:
                if here.any():
                    raise ValueError(f"{name}: missing, but {int(here.sum())} nodes are of it")
                continue
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
            out[here] = value
        low, high = orientation
        if not (0 < low <= high and math.isfinite(high)):
            raise ValueError(
                f"orientation: {orientation}; the factors must be positive, the lowest first"
            )
        grains = self.phase == GRAIN
        out[grains] *= (low + (high - low) * self.draw)[self.grain[grains]]
        return out


def polycrystal(
    lattice: Lattice,
    grain_size: float | Sequence[float],
    boundary_width: float = 0.0,
    seed: int = 0,
) -> Microstructure:
    """Grains and, where they have a width, the boundaries between them.

    A node is of the boundary where its distance to the nearest face between two grains is at most
    half the width, exact for each face's plane (also of elongated grains).

    Parameters
    ----------
    lattice : Lattice
    grain_size : float or one per axis
        Mean size, m; at least two spacings.
    boundary_width : float
        m; 0 for none, else at least two spacings, so that the lattice can carry it, and below
        the smallest grain size.
    seed : int
        0 to 2^64 - 1.

    Raises
    ------
    ValueError
        For sizes, widths or a seed out of range, or a lattice farther than 2^18 cells from 0.
    """
    size = _sizes(lattice, grain_size)
    coarsest = max(lattice.spacing)
    if boundary_width and not 2 * coarsest * (1 - 1e-9) <= boundary_width < size.min():
        raise ValueError(
            f"boundary_width: {boundary_width} m; it must be 0, or at least two spacings of "
            f"{coarsest} m and below the grain size of {size.min()} m"
        )
    number, point = _points(lattice, size, seed, _GRAIN_POINT, margin=3)
    place = _places(lattice) / size
    # Faces meet at a node's grain and at points hardly farther away; 8 and 16 hold them all.
    near = min(4 * 2 ** (lattice.dimension - 1), len(point))
    distance, index = cKDTree(point).query(place, k=near)
    distance, index = (np.reshape(v, (len(place), near)) for v in (distance, index))
    own, grain = np.unique(index[:, 0], return_inverse=True)
    phase = np.zeros(lattice.shape, np.int8)
    if boundary_width:
        away = np.full(len(place), np.inf)
        for k in range(1, near):
            gap = 0.5 * (distance[:, k] ** 2 - distance[:, 0] ** 2)
            steepness = np.linalg.norm((point[index[:, k]] - point[index[:, 0]]) / size, axis=1)
            away = np.minimum(away, gap / steepness)
        phase[(away <= 0.5 * boundary_width * (1 + 1e-9)).reshape(lattice.shape)] = BOUNDARY
    draw = hashing.uniform(seed, number[own] * _PER_CELL + _GRAIN_FACTOR)
    return Microstructure(phase, grain.reshape(lattice.shape).astype(np.int64), draw)


def with_particles(
    lattice: Lattice,
    structure: Microstructure,
    radius: float | Sequence[float],
    fraction: float,
    seed: int = 0,
) -> Microstructure:
    """The structure with balls or ellipsoids of a second phase in it.

    One particle lies at a hashed place within each cell of a grid, wholly within it, so particles
    never touch; the cells' size gives the fraction.

    Parameters
    ----------
    radius : float or one per axis
        Semi-axes, m; at least one spacing.
    fraction : float
        Of the volume, above 0 and at most half of what fills the cells (0.5, 0.39, 0.26 in 1, 2,
        3 dimensions), so that places stay random.

    Raises
    ------
    ValueError
        For values out of range.
    """
    d = lattice.dimension
    semi = np.broadcast_to(np.asarray(radius, float), (d,))
    if not (np.isfinite(semi).all() and np.all(semi >= np.asarray(lattice.spacing) * (1 - 1e-9))):
        raise ValueError(
            f"radius: {semi.tolist()} m; every semi-axis must be at least the spacing "
            f"{list(lattice.spacing)} m"
        )
    full = math.pi ** (d / 2) / math.gamma(d / 2 + 1) / 2**d
    if not 0 < fraction <= 0.5 * full:
        raise ValueError(f"fraction: {fraction}; it must be above 0 and at most {0.5 * full:.3g}")
    size = 2 * semi * (full / fraction) ** (1 / d)
    _, point = _points(lattice, size, seed, _PARTICLE_POINT, margin=1, kept=2 * semi / size)
    # Each particle fills a small box of the lattice.
    phase = structure.phase.copy()
    axes = [lattice.axis(a) for a in range(d)]
    for centre in point * size:
        window = tuple(
            slice(*np.searchsorted(axis, (c - r, c + r)))
            for axis, c, r in zip(axes, centre, semi, strict=True)
        )
        if all(w.stop > w.start for w in window):
            parts = [axes[a][window[a]] for a in range(d)]
            grids = np.meshgrid(*parts, indexing="ij", sparse=True)
            inside = sum(((x - c) / r) ** 2 for x, c, r in zip(grids, centre, semi, strict=True))
            phase[window][np.broadcast_to(inside <= 1.0, phase[window].shape)] = PARTICLE
    return Microstructure(phase, structure.grain, structure.draw)


def _sizes(lattice: Lattice, grain_size: float | Sequence[float]) -> np.ndarray:
    size = np.broadcast_to(np.asarray(grain_size, float), (lattice.dimension,))
    if not (np.isfinite(size).all() and np.all(size >= 2 * np.asarray(lattice.spacing))):
        raise ValueError(
            f"grain_size: {size.tolist()} m; every axis needs at least two spacings, "
            f"{list(lattice.spacing)} m"
        )
    return size


def _places(lattice: Lattice) -> np.ndarray:
    """(nodes, d), m."""
    grids = np.meshgrid(*[lattice.axis(a) for a in range(lattice.dimension)], indexing="ij")
    return np.stack([g.ravel() for g in grids], axis=1)


def _points(
    lattice: Lattice,
    size: np.ndarray,
    seed: int,
    first: int,
    margin: int,
    kept: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the cells on and around the lattice, and a point in each, in cells.

    kept : share of each edge that the point keeps to the cell's faces, both sides together.
    """
    ends = [(lattice.axis(a)[0], lattice.axis(a)[-1]) for a in range(lattice.dimension)]
    ranges = [
        range(math.floor(low / s) - margin, math.floor(high / s) + margin + 1)
        for (low, high), s in zip(ends, size, strict=True)
    ]
    if any(r[0] < -_FARTHEST or r[-1] >= _FARTHEST for r in ranges):
        raise ValueError("lattice: it lies farther than 2^18 grains or particles from 0")
    cells = np.array(list(itertools.product(*ranges)), np.int64)
    number = np.zeros(len(cells), np.int64)
    for column in cells.T:
        number = number * (2 * _FARTHEST) + column + _FARTHEST
    drawn = np.stack(
        [hashing.uniform(seed, number * _PER_CELL + first + a) for a in range(len(ends))], axis=1
    )
    return number, cells + 0.5 * np.asarray(kept) + drawn * (1.0 - np.asarray(kept))
