"""The solid to be turned in the page: mesh and damage of every time, packed for its script.

`templates/viewer.js` draws it with WebGL.  The script is this project's own: three sets of
triangles and one shader need no library, so there is none to pin, to license or to load.
"""

import base64
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline.geometry.mesh import refine_tetrahedra
from pipeline.record.run_results import AlloyResult, ImmersionResult, RunResults
from pipeline.report import picture_set
from pipeline.report.pictures import DAMAGE_COLOURS, GONE, damage_at_points
from pipeline.report.wording import caption

MOST_VALUES = 900_000
"""Damage values (points times states) in a page, one byte each before packing; more of them resolve
the damage better and make the page larger (600,000 take 0.3 MB of it)."""
MOST_POINTS = 60_000
"""Points of the mesh in a page; more of them keep a large mesh as it is and slow the turning."""
MOST_TIMES = 12
"""Times that the slider of a page stops at."""
MOST_DAMAGE = 255
"""A damage of 1 as it is stored; whole numbers from 0."""


@dataclass(frozen=True)
class SolidView:
    """What the page's script draws.

    about: numbers and words for the script, fit for JSON; packed: base64 of the deflated points
    (float32, mm), cells (uint32) and damage (uint8, one state after another), little-endian;
    refined: how often the cells' edges are halved before the damage is drawn; simplified: whether
    the mesh has fewer points than that of the run.
    """

    about: dict[str, object]
    packed: str
    refined: int
    simplified: bool


def solid_view(run: RunResults) -> SolidView | None:
    """The view of a run; None where it has no mesh or no damage to show."""
    if run.points is None or run.cells is None:
        return None
    times = {alloy.name: _spread(alloy) for alloy in run.alloys}
    count = max(1, sum(len(items) for items in times.values()))
    most = min(MOST_POINTS, MOST_VALUES // count)
    points, cells = simplified(run.points, run.cells, most)
    simpler = len(points) < len(run.points)
    coarse, refined = (points, cells), 0
    # a refinement gives 5 to 7 times the points
    while not simpler and len(cells) < picture_set.ENOUGH_CELLS and 7 * len(points) < most:
        points, cells = refine_tetrahedra(points, cells)
        refined += 1
    states, fields = [], []
    for number, alloy in enumerate(run.alloys):
        for item in times[alloy.name]:
            damage = _at_points(run, alloy, item, points, cells)
            if damage is None:
                continue
            states.append({"alloy": number, "seconds": item.seconds, "caption": caption(item)})
            fields.append(np.round(MOST_DAMAGE * np.clip(damage, 0.0, 1.0)).astype(np.uint8))
    if not states:
        return None
    about = {
        "alloys": [alloy.name for alloy in run.alloys],
        "states": states,
        "points": len(coarse[0]),
        "cells": len(coarse[1]),
        "refined": refined,
        "most": MOST_DAMAGE,
        "gone": 1.0 / run.scene.alloys[0].material.q1,
        "colours": DAMAGE_COLOURS,
    }
    content = b"".join(
        [
            (1e3 * coarse[0]).astype("<f4").tobytes(),
            coarse[1].astype("<u4").tobytes(),
            *(field.tobytes() for field in fields),
        ]
    )
    packed = base64.b64encode(zlib.compress(content, 9)).decode()
    return SolidView(about, packed, refined, simpler)


def _spread(alloy: AlloyResult) -> list[ImmersionResult]:
    """All times of an alloy, or as many spread over them as the slider may have."""
    count = len(alloy.immersions)
    picks = np.linspace(0, count - 1, min(count, MOST_TIMES)).round().astype(int)
    return [alloy.immersions[n] for n in picks]


def _at_points(
    run: RunResults,
    alloy: AlloyResult,
    item: ImmersionResult,
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
) -> NDArray[np.float64] | None:
    """Corrosion damage (n,) at the points; None where the run does not hold it for this mesh.

    A mesh with fewer points than that of the run has the damage that those have there.
    """
    if len(points) < len(run.points):
        known = _at_points(run, alloy, item, run.points, run.cells)
        return None if known is None else known[cKDTree(run.points).query(points)[1]]
    damage = picture_set.damage_field(run, alloy.name, item, points, len(cells))
    if damage is None or len(damage) == len(points):
        return damage
    if len(damage) != len(cells):
        return None
    return damage_at_points(points, cells, damage) / GONE


def simplified(
    points: NDArray[np.float64], cells: NDArray[np.int64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The mesh with at most `most` points: those of a box become one, flat cells go.

    The boxes are cubes that grow until there are few enough.  A box keeps one of its own points,
    one of the surface where it has any, so that the shape changes by less than a box.  Cells may
    overlap afterwards; a face is on the surface where an odd number of cells has it.

    Parameters
    ----------
    points : (n, 3) m.
    cells : (nc, 4) four-node tetrahedra.
    most : points that are allowed, > 0.
    """
    if len(points) <= most:
        return points, cells
    faces = np.sort(cells[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    n = len(points)
    _, first, count = np.unique(
        (faces[:, 0] * n + faces[:, 1]) * n + faces[:, 2], return_index=True, return_counts=True
    )
    inside = np.ones(n, dtype=bool)
    inside[faces[first[count == 1]]] = False
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    size = float((extent.prod() / most) ** (1 / 3))
    while True:
        box = np.floor((points - low) / size).astype(np.int64)
        number = np.ravel_multi_index(box.T, box.max(axis=0) + 1)
        off_centre = np.linalg.norm((points - low) / size - box - 0.5, axis=1)
        order = np.lexsort((off_centre, inside, number))
        boxes, place = np.unique(number[order], return_index=True)
        if len(boxes) <= most:
            break
        size *= 1.1
    fewer = np.searchsorted(boxes, number)[cells]
    ordered = np.sort(fewer, axis=1)
    kept = fewer[(np.diff(ordered, axis=1) > 0).all(axis=1)]
    return points[order[place]], kept
