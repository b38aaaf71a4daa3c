"""Rate classes of a run: the solid's surface on the lattice, and shares of the liquid's domain.

What the surface gives is kept beside the geometry, by the hash of all it depends on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peri.engine.lattice import Lattice
from peri.engine.march.checkpoints import fingerprint
from peri.engine.surface.rate_classes import (
    CellExposure,
    RateClasses,
    Rates,
    SamplingCheck,
    cell_exposure,
)
from peri.engine.surface.sampling import default_finest
from peri.engine.surface.triangles import Surface
from pipeline.geometry.surface import Solid
from pipeline.record.whole_file import write_arrays

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]
_FORMAT = 3
"""Raised with every change of what is kept, or of how it is sampled."""
_CHECKED = ("classes", "samples", "finer", "coarser")
_SAMPLES = 16
"""Samples per axis of a cell that the domain's edge cuts: its volume to 1e-4."""


def solid_exposure(
    solid: Solid,
    lattice: Lattice,
    horizon: float,
    fraction: Array,
    classes: int,
    kernel_exponent: float,
    influence: str,
    folder: Path | None = None,
) -> CellExposure:
    """The rate classes of a solid on a lattice, read from `folder` where they are kept already.

    fraction: metal share of each cell.  classes: P per cell.  Raises ValueError as
    `rate_classes` does.
    """
    surface = Surface(solid.points, solid.triangles)
    mark = fingerprint(
        surface.vertices, surface.facets, lattice.origin, lattice.spacing, lattice.shape,
        float(horizon), fraction, classes, float(kernel_exponent), influence,
        default_finest(lattice, horizon), _FORMAT,
    )  # fmt: skip
    kept = None if folder is None else folder / f"exposure-{mark[:16]}.npz"
    if kept is not None and kept.exists():
        with np.load(kept) as stored:
            metal = RateClasses(stored["cell"], stored["volume"], stored["exposure"], fraction)
            check = SamplingCheck(*(Rates(*stored[name]) for name in _CHECKED))
            return CellExposure(metal, stored["liquid"], check=check)
    found = cell_exposure(
        lattice, surface, horizon, fraction, classes,
        kernel_exponent=kernel_exponent, influence=influence,
    )  # fmt: skip
    if kept is not None:
        checked = {name: _rows(getattr(found.check, name)) for name in _CHECKED}
        arrays = {name: getattr(found.metal, name) for name in ("cell", "volume", "exposure")}
        write_arrays(kept, {**arrays, "liquid": found.liquid, **checked})
    return found


def _rows(rates: Rates) -> Array:
    return np.stack([rates.volume, rates.exposure])


def share_of_ball(lattice: Lattice, centre: tuple[float, ...], radius: float) -> Array:
    """Share of each cell that lies in a ball (m)."""
    return _share(lattice, lambda x, y, z: np.sqrt(x**2 + y**2 + z**2) - radius, centre, (0, 1, 2))


def share_of_cylinder(
    lattice: Lattice, centre: tuple[float, ...], radius: float, height: float
) -> Array:
    """Share of each cell that lies in a cylinder along z (m)."""
    flat = _share(lattice, lambda x, y, z: np.hypot(x, y) - radius, centre, (0, 1))
    z, step = lattice.axis(2) - centre[2], lattice.spacing[2]
    low, high = np.maximum(z - step / 2, -height / 2), np.minimum(z + step / 2, height / 2)
    return flat * np.clip((high - low) / step, 0.0, 1.0)


def _share(
    lattice: Lattice, distance: Callable, centre: tuple[float, ...], axes: tuple[int, ...]
) -> Array:
    """Share of each cell where a distance (to a surface, negative inside) is negative."""
    offset = [x - c for x, c in zip(lattice.coordinates(), centre, strict=True)]
    middle = np.broadcast_to(distance(*offset), lattice.shape)
    out = (middle < 0).astype(float)
    reach = 0.5 * float(np.linalg.norm([lattice.spacing[a] for a in axes]))
    if len(axes) == 2:  # alike in every layer
        middle, offset = middle[:, :, :1], [offset[0], offset[1], np.zeros((1, 1, 1))]
    cut = np.argwhere(np.abs(middle) < reach * (1 + 1e-9))
    sub = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    samples = np.stack(np.meshgrid(*[sub] * len(axes), indexing="ij"), axis=-1)
    samples = samples.reshape(-1, len(axes))
    for index in cut:
        point = [np.full(len(samples), offset[a].ravel()[index[a]]) for a in range(3)]
        for n, a in enumerate(axes):
            point[a] = point[a] + samples[:, n] * lattice.spacing[a]
        # A ramp over one sample keeps the share smooth in the cell's position.
        width = reach / _SAMPLES
        share = np.clip(0.5 - distance(*point) / (2 * width), 0.0, 1.0).mean()
        where = tuple(index) if len(axes) == 3 else (index[0], index[1], slice(None))
        out[where] = share
    return out
