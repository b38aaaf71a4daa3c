"""Which pictures a report shows: the corroded solid per alloy and time, whole and cut open.

The field is that of the damage map without its upper bound: of each eighth of a cell where
exposures gave it; where it came from the lattice's nodes, interpolated to a refinement of the mesh
(pipeline.stages.damage_map) with the map's exponent.  Without either it is the damage map itself.
"""

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.mesh import refine_tetrahedra
from pipeline.record.machine import processor_cores
from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import AlloyResult, ImmersionResult, RunResults
from pipeline.report.pictures import Cut, PictureRequest, render_pictures
from pipeline.scene.mechanics import NODES
from pipeline.stages.damage_map import map_damage, scaled_damage

logger = logging.getLogger(__name__)

MOST_TIMES = 6
"""Number of times that are shown of each alloy."""
ENOUGH_CELLS = 40_000
"""Cells from which on a mesh is not refined for pictures."""
PICTURES_FOLDER = "pictures"

VIEWS: tuple[Cut, ...] = ("whole", "half", "quarter")

PictureKey = tuple[str, str, str]
"""Alloy, label of the immersion time, how the solid is cut."""


@dataclass(frozen=True)
class PictureSet:
    """The pictures that could be made, by key, and "" or a sentence on what failed."""

    paths: dict[PictureKey, Path]
    trouble: str


def times_shown(alloy: AlloyResult) -> list[ImmersionResult]:
    """The times that pictures show: all, or six spread over them, first and last included."""
    count = len(alloy.immersions)
    if count <= MOST_TIMES:
        return list(alloy.immersions)
    picks = np.linspace(0, count - 1, MOST_TIMES).round().astype(int)
    return [alloy.immersions[n] for n in picks]


def make_pictures(run: RunResults) -> PictureSet:
    """Render the pictures of a run into its folder `pictures`; never raises for graphics."""
    folder = run.folder / PICTURES_FOLDER
    for old in folder.glob("*.png"):
        old.unlink()
    if run.points is None:
        return PictureSet({}, "")
    points, cells = run.points, run.cells
    while len(cells) < ENOUGH_CELLS:
        points, cells = refine_tetrahedra(points, cells)
    factor = run.scene.alloys[0].material.q1
    states, paths = [], {}
    for alloy in run.alloys:
        for item in times_shown(alloy):
            damage = damage_field(run, alloy.name, item, points, len(cells))
            if damage is None:
                continue
            states.append([])
            for cut in VIEWS:
                path = folder / f"{alloy.name}_{item.label}_{cut}.png"
                states[-1].append(PictureRequest(damage, path, cut))
                paths[alloy.name, item.label, cut] = path
    workers = min(processor_cores(), max(len(states), 1))
    with ThreadPoolExecutor(workers) as pool:  # each waits for a process of its own
        shares = [sum(states[first::workers], []) for first in range(workers)]
        troubles = pool.map(
            lambda share: render_pictures(points, cells, share, maximum_damage=1.0 / factor), shares
        )
        trouble = next(filter(None, troubles), "")
    return PictureSet({key: path for key, path in paths.items() if path.is_file()}, trouble)


def damage_field(
    run: RunResults, alloy: str, item: ImmersionResult, points: NDArray[np.float64], cells: int
) -> NDArray[np.float64] | None:
    """Corrosion damage at the points, or in the cells, or None where there is none to show.

    points, cells: the points and the number of cells of the run's mesh, or of a refinement of it.
    """
    if item.mapping == NODES:
        found = _between_nodes(run, alloy, item, points)
        if found is not None:
            return found
    shown = item.damage
    if item.parts is not None:
        shown = item.parts.reshape(-1, 1) if cells > len(item.parts) else item.parts
    if shown is None or item.damage is None or len(item.damage) != len(run.cells):
        return None
    return np.repeat(shown.reshape(len(shown), -1).mean(axis=1), cells // len(shown))


def _between_nodes(
    run: RunResults, alloy: str, item: ImmersionResult, points: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """The lattice's damage at the points, with the map's exponent; None without the lattice."""
    path = RunFolder(run.folder).corrosion(alloy) / "corrosion.h5"
    solid = run.scene.alloy(alloy).corrosion.solid_concentration
    try:
        with h5py.File(path) as file:
            number = np.flatnonzero(np.isclose(file["times"][:], item.seconds, rtol=1e-9))
            if number.size:
                found = map_damage(
                    points,
                    file["lattice/origin"][:],
                    file["lattice/spacing"][:],
                    file["concentration"][int(number[0])],
                    file["metal"][:].astype(bool),
                    solid,
                    maximum_damage=1.0,
                )
                return scaled_damage(found, item.map_exponent)
    except (OSError, KeyError, ValueError) as error:
        logger.info("%s is not used for pictures: %s", path, error)
    return None
