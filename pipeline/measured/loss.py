"""The metal that a later scan of the same part has lost, beside what a run computes, by place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pipeline.geometry.surface import Solid
from pipeline.geometry.voxel_mask import VoxelMask, voxel_fraction
from pipeline.geometry.voxels import metal_fraction

SLICES = 8  # along z, in the table

MOST_ELSEWHERE = 0.1
"""Largest share of the scan's metal that may lie where the intact solid has none: corrosion adds no
metal, so more means that scan and solid do not lie on each other."""


@dataclass(frozen=True)
class LossByPlace:
    """Shares of the lattice's cells that are metal (nx, ny, nz): before, and after as measured and
    as computed; depth: of each cell below the surface of the intact solid (m), 0 outside.

    origin, spacing: of the lattice, m.  width: of the boxes in which place by place is meant, m.
    """

    before: np.ndarray
    measured: np.ndarray
    computed: np.ndarray
    depth: np.ndarray
    origin: np.ndarray
    spacing: np.ndarray
    width: float

    @property
    def cell(self) -> float:
        """Volume of a cell, m^3."""
        return float(np.prod(self.spacing))

    def in_boxes(self, share: np.ndarray) -> np.ndarray:
        """Mean of a share over the box about every cell."""
        cells = np.maximum(1, 2 * np.rint(self.width / self.spacing / 2).astype(int) + 1)
        return ndimage.uniform_filter(share, cells, mode="constant")

    def difference(self) -> np.ndarray:
        """Share lost as measured, less as computed, mean over the box about every cell."""
        return self.in_boxes(self.computed - self.measured)

    def table(self) -> list[tuple[str, float, float, float]]:
        """Rows (place, metal before in m^3, share lost as measured, share lost as computed).

        The whole, then slices of equal height along z, then layers below the surface, half a box
        thick but for the last, which is all below.
        """
        there = self.before > 0.0
        places = [("whole", there)]
        levels = self.origin[2] + self.spacing[2] * np.arange(self.before.shape[2])
        used = levels[there.any(axis=(0, 1))]
        edges = np.linspace(used[0], used[-1] + 1e-9, SLICES + 1)
        for low, high in zip(edges, edges[1:], strict=False):
            name = f"z {1e3 * low:.2f} to {1e3 * high:.2f} mm"
            places.append((name, there & (levels >= low) & (levels < high)))
        half = self.width / 2
        for number in range(3):
            low, high = number * half, (number + 1) * half if number < 2 else np.inf
            name = f"depth {1e6 * low:.0f} to {1e6 * high:.0f} um"
            if number == 2:
                name = f"depth above {1e6 * low:.0f} um"
            places.append((name, there & (self.depth >= low) & (self.depth < high)))
        rows = []
        for name, place in places:
            metal = float(self.before[place].sum())
            if metal > 0.0:
                lost = [1.0 - float(a[place].sum()) / metal for a in (self.measured, self.computed)]
                rows.append((name, metal * self.cell, *lost))
        return rows

    def shift(self) -> np.ndarray:
        """By how much (3,) m the scan would have to be moved to fit the computed metal best.

        The peak of the correlation of both, between the nodes by parabolas: good to a sixth of the
        lattice's spacing.  Turning is not looked at.
        """
        shape = np.multiply(2, self.measured.shape)  # so that nothing comes round the other side
        product = np.fft.rfftn(self.computed, shape) * np.fft.rfftn(self.measured, shape).conj()
        fit = np.fft.irfftn(product, shape)
        peak = np.array(np.unravel_index(fit.argmax(), fit.shape))
        moved = np.where(peak < shape // 2, peak, peak - shape).astype(float)
        for axis, step in enumerate(np.eye(3, dtype=int)):
            low, mid, high = (fit[tuple((peak + n * step) % shape)] for n in (-1, 0, 1))
            bend = 2.0 * mid - low - high
            moved[axis] += 0.5 * (high - low) / bend if bend > 0.0 else 0.0
        return moved * self.spacing

    def disagreement(self) -> float:
        """Root mean square of `difference` where the intact solid is, weighted by its metal."""
        weight = self.in_boxes(self.before)
        return float(np.sqrt(np.average(self.difference() ** 2, weights=weight)))


def loss_by_place(
    solid: Solid, scan: VoxelMask, fields: dict, number: int, width: float, name: str
) -> LossByPlace:
    """Put scan and result on the lattice of a march.

    fields: of the corrosion stage; number: of the immersion time in them; width: of the boxes, m;
    name: of the scan, for messages.  Before and measured are shares of the cells themselves; the
    march gives what cut cells have to their neighbours, so that single cells cannot be compared
    but boxes of some cells can.  ValueError where the scan does not lie on the solid.
    """
    origin = np.asarray(fields["lattice/origin"], float)
    spacing = np.broadcast_to(np.asarray(fields["lattice/spacing"], float), 3)
    metal = fields["metal"].astype(bool)
    lattice = (origin, spacing, metal.shape)
    before = metal_fraction(solid, *lattice)[1]
    measured = voxel_fraction(scan, *lattice)
    cell = float(np.prod(spacing))
    elsewhere = float(np.maximum(measured - before, 0.0).sum()) * cell + scan.volume
    elsewhere -= float(measured.sum()) * cell
    if elsewhere > MOST_ELSEWHERE * scan.volume:
        raise ValueError(
            f"{name} has {elsewhere / scan.volume:.0%} of its metal where the intact solid has "
            f"none; it must be at most {MOST_ELSEWHERE:.0%}, so lay the scan on the solid first"
        )
    left = np.where(metal, fields["concentration"][number], 0.0) / fields["solid_concentration"]
    computed = np.where(metal, fields["capacity"], 0.0) * np.minimum(left, 1.0)
    inside = before >= 0.5
    depth = ndimage.distance_transform_edt(inside, sampling=spacing) - spacing.min() / 2
    return LossByPlace(
        before, measured, computed, np.where(inside, depth, 0.0), origin, spacing, width
    )
