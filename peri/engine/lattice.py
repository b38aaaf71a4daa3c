"""Uniform lattices, node sets on them, and the families of a horizon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Lattice:
    """A uniform lattice of nodes in one, two or three dimensions.

    Node (i, j, k) lies at origin + spacing * (i, j, k) and owns the cell of size `spacing`
    centred on it.

    Parameters
    ----------
    origin : tuple of float
        Position of the first node, m.
    spacing : tuple of float
        Distance of neighbouring nodes along each axis, m; may differ per axis.
    shape : tuple of int
        Number of nodes along each axis.

    Raises
    ------
    ValueError
        If the three do not have the same length (1 to 3), or are not finite and positive.
    """

    origin: tuple[float, ...]
    spacing: tuple[float, ...]
    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", tuple(float(v) for v in self.origin))
        object.__setattr__(self, "spacing", tuple(float(v) for v in self.spacing))
        object.__setattr__(self, "shape", tuple(int(v) for v in self.shape))
        if not 1 <= len(self.shape) <= 3 or not len(self.origin) == len(self.spacing) == len(
            self.shape
        ):
            raise ValueError(
                f"lattice: origin {self.origin}, spacing {self.spacing} and shape {self.shape} "
                "must have one entry per axis, for 1 to 3 axes"
            )
        if not all(np.isfinite(h) and h > 0 for h in self.spacing):
            raise ValueError(f"spacing: {self.spacing} m; every entry must be finite and positive")
        if not all(n >= 1 for n in self.shape):
            raise ValueError(f"shape: {self.shape}; every axis needs at least one node")
        if not all(np.isfinite(x) for x in self.origin):
            raise ValueError(f"origin: {self.origin} m; every entry must be finite")

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def cell_volume(self) -> float:
        """Volume (area, length) of one cell, m^dimension."""
        return float(np.prod(self.spacing))

    def axis(self, a: int) -> np.ndarray:
        """Node positions along axis a, m, shape (shape[a],)."""
        return self.origin[a] + self.spacing[a] * np.arange(self.shape[a])

    def coordinates(self) -> list[np.ndarray]:
        """Node positions per axis as arrays that broadcast to `shape`, m."""
        return list(np.meshgrid(*map(self.axis, range(self.dimension)), indexing="ij", sparse=True))


def box_lattice(
    lower: Sequence[float], upper: Sequence[float], spacing: float | Sequence[float]
) -> Lattice:
    """The lattice whose cells cover the box [lower, upper], symmetrically about its middle.

    A box that is a whole number of cells wide is covered exactly, so that plane faces on its
    sides fall between nodes.

    Parameters
    ----------
    lower, upper : sequence of float
        Corners of the box, m.
    spacing : float or sequence of float
        Node distance, m.
    """
    low, high = np.atleast_1d(np.asarray(lower, float)), np.atleast_1d(np.asarray(upper, float))
    step = np.broadcast_to(np.asarray(spacing, float), low.shape)
    if not np.all(step > 0):
        raise ValueError(f"spacing: {step.tolist()} m; every entry must be positive")
    if not np.all(high > low):
        raise ValueError(f"upper: {high.tolist()} m must exceed lower {low.tolist()} m")
    count = np.maximum(1, np.ceil((high - low) / step - 1e-9).astype(int))
    origin = 0.5 * (low + high) - 0.5 * (count - 1) * step
    return Lattice(tuple(origin), tuple(step), tuple(count))


def ball(lattice: Lattice, centre: Sequence[float], radius: float) -> np.ndarray:
    """Nodes within `radius` (m) of `centre` (m); bool of the lattice's shape."""
    squared = sum((x - c) ** 2 for x, c in zip(lattice.coordinates(), centre, strict=True))
    return np.ascontiguousarray(np.broadcast_to(squared <= radius**2 * (1 + 1e-12), lattice.shape))


def cylinder(
    lattice: Lattice, centre: Sequence[float], radius: float, height: float, axis: int = 2
) -> np.ndarray:
    """Nodes in the cylinder about `centre` (m) with `radius` and `height` (m) along `axis`."""
    coordinates = lattice.coordinates()
    squared = sum(
        (x - c) ** 2 for a, (x, c) in enumerate(zip(coordinates, centre, strict=True)) if a != axis
    )
    inside = (squared <= radius**2 * (1 + 1e-12)) & (
        np.abs(coordinates[axis] - centre[axis]) <= 0.5 * height * (1 + 1e-12)
    )
    return np.ascontiguousarray(np.broadcast_to(inside, lattice.shape))


@dataclass(frozen=True)
class Family:
    """The bonds of one octant of a neighbourhood; the others follow by reflection.

    offsets (n, d): non-negative index offsets, without the node itself; bond_length (n,), m;
    volume_correction (n,): beta of Eq. 3.2 of the dissertation; direction_horizon (n,): the
    horizon along each bond, m; multiplicity (n,): number of reflected copies.
    """

    offsets: np.ndarray
    bond: np.ndarray
    bond_length: np.ndarray
    volume_correction: np.ndarray
    direction_horizon: np.ndarray
    multiplicity: np.ndarray


def family(lattice: Lattice, horizon: float | Sequence[float]) -> Family:
    """The family of a node: bonds shorter than the horizon plus half a cell.

    The horizon is a sphere (one number) or an ellipsoid (one semi-axis per lattice axis), the
    latter with the horizon of a bond's own direction as in Jafarzadeh et al. 2022, Eq. 15.
    Dissertation 3.1: |xi| < delta + dx/2, with the volume correction of Eq. 3.2,
    beta = clip((delta + h - |xi|) / (2 h), 0, 1), h half the cell's width along the bond.

    Raises
    ------
    ValueError
        If a semi-axis is shorter than the spacing along it (no bonds in that direction).
    """
    d = lattice.dimension
    semi_axes = np.broadcast_to(np.asarray(horizon, float), (d,))
    spacing = np.asarray(lattice.spacing)
    if not np.all(np.isfinite(semi_axes)) or np.any(semi_axes < spacing * (1 - 1e-9)):
        raise ValueError(
            f"horizon: {semi_axes.tolist()} m must be at least the spacing {spacing.tolist()} m"
        )
    reach = np.floor(semi_axes / spacing + 0.5 - 1e-9).astype(int)
    grids = np.meshgrid(*[np.arange(r + 1) for r in reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)[1:]
    bond = offsets * spacing
    length = np.linalg.norm(bond, axis=1)
    direction = bond / length[:, None]
    along = 1.0 / np.linalg.norm(direction / semi_axes, axis=1)
    half = 0.5 * np.linalg.norm(direction * spacing, axis=1)
    # On a uniform lattice Eq. 3.2 uses dx whatever the direction, and `half` is dx/2 exactly.
    correction = np.clip((along + half - length) / (2 * half), 0.0, 1.0)
    keep = correction > 1e-12
    multiplicity = np.prod(np.where(offsets > 0, 2, 1), axis=1)
    return Family(
        offsets[keep],
        bond[keep],
        length[keep],
        correction[keep],
        along[keep],
        multiplicity[keep],
    )
