"""Plates on a lattice, layer by layer: what varies along one direction of the lattice only.

Cells (i, j, k) of a plate of normal (a, b, 0) lie as deep as n = a i + b j says; the bonds between
two layers n are the sums of the lattice's.  The discrete problem is that of the plate on the whole
lattice, to round-off, for the cost of one column of cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.scene import CorrosionScene, nearest_of
from peri.engine.influence import (
    Stencil,
    closed_constant,
    closed_strength,
    diffusion_stencil,
)
from peri.engine.lattice import Lattice
from peri.engine.surface.flat_front import FlatFront
from peri.engine.surface.rate_classes import CLASSES, CellExposure, RateClasses, gauss_rule
from peri.engine.surface.share_weights import ShareBonds, share_bonds

_SLICES = 1000
"""Of a cell, each with its volume and mean exposure."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LayeredScene(CorrosionScene):
    """A scene with rate classes whose lattice (n, 1, 1) is that of the layers.

    normal : (a, b), integers without a common divisor, of the layers in the cubic lattice.  The
    lattice's spacing is that of the cells; the layers lie spacing / |normal| apart.
    """

    normal: tuple[int, int] = (1, 0)

    def __post_init__(self) -> None:
        shape, spacing = self.lattice.shape, self.lattice.spacing
        if len(shape) != 3 or shape[1:] != (1, 1) or len(set(spacing)) > 1:
            raise ValueError(f"lattice: shape {shape}, spacing {spacing} m; layers have (n, 1, 1)")
        if gcd(*self.normal) != 1:
            raise ValueError(f"normal: {self.normal}; two integers without a common divisor")
        super().__post_init__()

    def _make_stencil(self) -> Stencil:
        return self._summed(self._full())

    def cut_cell_bonds(self, front: FlatFront) -> ShareBonds:
        """See CorrosionScene.cut_cell_bonds."""
        full = share_bonds(self._full(), front, self.dissolution.by_layers)
        weights, drawing = self._summed(full.weights), self._summed(full.drawing)
        return ShareBonds(weights, drawing, full.handed)

    def nearest_stencil(self) -> Stencil:
        """See CorrosionScene.nearest_stencil."""
        return self._summed(nearest_of(self._full()))

    def _full(self) -> Stencil:
        size = 2 * int(np.ceil(self.horizon / self.lattice.spacing[0])) + 3
        whole = Lattice((0.0,) * 3, self.lattice.spacing, (size,) * 3)
        return diffusion_stencil(
            whole, self.horizon, self.kernel_exponent, self.influence, self.calibration
        )

    def _summed(self, bonds: Stencil) -> Stencil:
        """Sums over the bonds of each layer; those within a layer are of a cell with itself."""
        weights = bonds.dense()
        where = np.argwhere(weights != 0)
        along = (where - np.array(bonds.reach))[:, :2] @ np.array(self.normal)
        most = int(np.abs(self.normal) @ np.array(bonds.reach[:2])) + 1
        sums = np.bincount(np.abs(along), weights[tuple(where.T)], most).astype(float)
        sums[1:] *= 0.5
        return Stencil(sums.reshape(-1, 1, 1), bonds.spacing)


def plate_layers(
    depth: Array, thickness: float, spacing: float, horizon: float, normal: tuple[int, int],
    classes: int = CLASSES,
) -> CellExposure:  # fmt: skip
    """Classes, shares and liquid exposures of the layers of a plate (q = 0, omega = 1).

    Parameters
    ----------
    depth : (n,)
        Of the layers' middles below one face of the plate, m; negative in the liquid.
    thickness : float
        m, at least two horizons.
    """
    if thickness < 2 * horizon:
        raise ValueError(f"thickness: {thickness} m; below two horizons a point sees both faces")
    edges, share = _slices(normal)
    upper, lower = (depth[:, None] + edge * spacing for edge in (edges[:-1], edges[1:]))
    far = upper + lower > thickness
    upper, lower = np.where(far, thickness - lower, upper), np.where(far, thickness - upper, lower)
    front = FlatFront(horizon, 0.0, "constant")
    metal, seen = _of_side(upper, lower, share, front)
    open_share, clear = _of_side(-lower, -upper, share, front)
    fraction = metal.sum(axis=1)
    weights, nodes = gauss_rule(metal, seen, classes)
    cell, there = np.nonzero(weights > 0)
    whole = open_share.sum(axis=1)
    liquid = np.divide(
        (open_share * clear).sum(axis=1), whole, out=np.zeros(depth.size), where=whole > 0
    )
    shape = (depth.size, 1, 1)
    held = RateClasses(cell, weights[cell, there], nodes[cell, there], fraction.reshape(shape))
    return CellExposure(held, liquid.reshape(shape))


def _of_side(upper: Array, lower: Array, share: Array, front: FlatFront) -> tuple[Array, Array]:
    """Volumes and mean exposures of slices (from `upper` to `lower` deep) on one side of a face."""
    first, last = np.maximum(upper, 0.0), np.maximum(lower, 0.0)
    kernel = (front.horizon, front.kernel_exponent, front.influence)
    whole = closed_strength(*kernel) / float(closed_constant(3, *kernel))
    carried = front.carried(last / front.horizon) - front.carried(first / front.horizon)
    thick = last - first
    seen = np.divide(whole * carried, thick, out=np.zeros_like(thick), where=thick > 0)
    return share * thick / (lower - upper), seen


def _slices(normal: tuple[int, int]) -> tuple[Array, Array]:
    """Slices of a cubic cell across a normal: edges from its middle (in spacings) and volumes."""
    a, b = (abs(v) / float(np.hypot(*normal)) for v in normal)
    half = 0.5 * (a + b)
    edges = np.linspace(-half, half, _SLICES + 1)
    # the width of the cell's square there: whole in the middle, linear towards two corners
    x = np.minimum(half - np.abs(edges), min(a, b))
    before = np.where(edges < 0, edges, -edges) + half
    ramp = min(a, b)
    area = np.where(before < ramp, 0.5 * x**2 / max(ramp, 1e-300), before - 0.5 * ramp)
    total = float(half - 0.5 * ramp)
    below = np.where(edges < 0, area, 2 * total - area) / (2 * total)
    return edges, np.diff(below)
