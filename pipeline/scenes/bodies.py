"""Metals of a couple on a lattice: boxes, balls, plates with a hole, screws and files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from peri.engine.lattice import Lattice, ball
from pipeline.scenes.keys import TEXT, Given, Key, positive

if TYPE_CHECKING:
    from pipeline.geometry.surface import Solid

SHAPES = ("box", "ball", "plate", "screw", "file")
OF_THREE_AXES = ("plate", "screw", "file")
BODY_KEYS: dict[str, Key] = {
    "shape": Key(TEXT, "its shape", "box", allowed=SHAPES),
    "low": Key("length", "lowest corner of a box or plate", ["0mm", "0mm"], several=True),
    "high": Key("length", "highest corner of a box or plate", ["10mm", "5mm"], several=True),
    "centre": Key("length", "middle of a ball", ["0mm", "0mm"], several=True),
    "radius": positive("length", "of a ball, or where a plate ends about z", "1mm"),
    "hole_radius": positive("length", "of the hole along z in a plate", "1.2mm"),
    "diameter": positive("length", "of a screw (2 mm)", "2mm"),
    "length": positive("length", "of a screw (4 mm)", "4mm"),
    "pitch": positive("length", "of a screw's thread (0.4 mm)", "0.4mm"),
    "thread": Key(TEXT, "of a screw (helical)", "none", allowed=("helical", "grooves", "none")),
    "file": Key(TEXT, "STEP, BREP or STL file", "plate.step"),
    "unit": Key(TEXT, "of the numbers in a BREP or STL file (mm)", "um"),
    "at": Key("length", "where the origin of a file or a screw goes", ["0mm"] * 3, several=True),
}
"""Keys of [metals.NAME] that say where the metal is."""


def body_solid(given: Given, table: str, axes: int) -> Solid | None:
    """The solid of a screw or a file; None for other shapes.

    Raises ValueError for a shape that needs another number of axes than the lattice has, and as
    pipeline.geometry.solids does.
    """
    shape = given.text(f"{table}.shape")
    if shape in OF_THREE_AXES and axes != 3:
        raise ValueError(
            f"{given.file}: {table}.shape is '{shape}', which has three axes; the lattice has "
            f"{axes}"
        )
    if shape not in ("screw", "file"):
        return None
    from pipeline.geometry.solids import ScrewParameters, screw_solid, solid_from_file

    if shape == "screw":
        sizes = {
            name: given[f"{table}.{name}"]
            for name in ("diameter", "length", "pitch", "thread")
            if f"{table}.{name}" in given
        }
        return screw_solid(ScrewParameters(**sizes))  # type: ignore[arg-type]
    unit = given.text(f"{table}.unit") if f"{table}.unit" in given else "mm"
    return solid_from_file(Path(given.text(f"{table}.file")), unit)


def nodes_of(given: Given, table: str, lattice: Lattice, solid: Solid | None) -> np.ndarray:
    """The nodes of a metal, bool; `solid` as body_solid gives it."""
    d = lattice.dimension
    if solid is not None:
        from pipeline.geometry.voxels import check_resolution, metal_fraction

        check_resolution(solid, lattice.spacing)
        at = given.vector(f"{table}.at", 3) if f"{table}.at" in given else (0.0, 0.0, 0.0)
        origin = np.subtract(lattice.origin, at)
        return metal_fraction(solid, origin, lattice.spacing, lattice.shape)[0]
    shape = given.text(f"{table}.shape")
    if shape == "ball":
        return ball(lattice, given.vector(f"{table}.centre", d), given.number(f"{table}.radius"))
    low, high = given.vector(f"{table}.low", d), given.vector(f"{table}.high", d)
    inside = np.ones(lattice.shape, bool)
    for x, a, b in zip(lattice.coordinates(), low, high, strict=True):
        inside &= (x > a) & (x < b)
    if shape == "plate":
        x, y, _ = lattice.coordinates()
        away = np.hypot(x, y)
        inside &= away > given.number(f"{table}.hole_radius")
        if f"{table}.radius" in given:
            inside &= away < given.number(f"{table}.radius")
    return np.ascontiguousarray(inside)


def thinnest_gap(liquid: np.ndarray, spacing: tuple[float, ...]) -> float:
    """The shortest stretch of liquid between metals along an axis of the lattice, m; infinite
    without one."""
    thinnest = math.inf
    for axis, step in enumerate(spacing):
        rows = np.moveaxis(liquid, axis, -1).reshape(-1, liquid.shape[axis])
        wall = np.pad(~rows, ((0, 0), (1, 1)))
        change = np.diff(wall.astype(np.int8), axis=1)
        for row in np.flatnonzero(rows.any(axis=1) & (~rows).any(axis=1)):
            begins, ends = np.flatnonzero(change[row] < 0), np.flatnonzero(change[row] > 0)
            later = np.searchsorted(ends, begins)
            closed = later < len(ends)
            if closed.any():
                thinnest = min(thinnest, step * float((ends[later[closed]] - begins[closed]).min()))
    return thinnest
