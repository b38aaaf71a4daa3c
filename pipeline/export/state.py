"""What a run holds of one alloy after one immersion time, gathered for another program (SI)."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem.constitutive.gurson import RESIDUAL_STRENGTH
from fem.quadrature import find_element
from fem.solid import Grips, Held
from pipeline.geometry.mesh import read_mesh
from pipeline.record.run_folder import RunFolder, RunFolderError
from pipeline.record.stage_hashes import corrosion_hash, geometry_hash, map_hash, pull_hash
from pipeline.scene.scene import AlloyScene, HoldScene, MaterialParameters, Scene, scene_from_json
from pipeline.scene.units import ImmersionTime
from pipeline.stages.corrosion import CORROSION_FILE
from pipeline.stages.mapping import DAMAGE_FILE, read_damage
from pipeline.stages.strength import CURVE_FILE


@dataclass(frozen=True)
class CorrodedState:
    """The mesh of a solid with its corrosion damage, how it is held, and what it is made of.

    points (n, 3) m, cells (nc, 4): of the intact solid. corrosion_damage (nc,): f0, mean of each
    cell. curve: columns of tensile.csv by name, empty where the test has not been done.
    corrosion: file of the concentrations on the lattice.
    """

    alloy: str
    time: ImmersionTime
    hold: HoldScene
    material: MaterialParameters
    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    corrosion_damage: NDArray[np.float64]
    corrosion: Path
    curve: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def strength_left(self) -> NDArray[np.float64]:
        """1 - q1 f0 of each cell (nc,): what the yield stress is multiplied by."""
        return np.maximum(0.0, 1.0 - self.material.q1 * self.corrosion_damage)

    @property
    def dead(self) -> NDArray[np.bool_]:
        """Cells (nc,) that count as gone in the tensile test."""
        return self.strength_left <= RESIDUAL_STRENGTH * (1.0 + 1e-9)

    @property
    def held(self) -> Held:
        """Where the grips hold the nodes."""
        test = self.hold.tensile
        return Held.of(self.points, Grips(test.bottom_grip, test.top_grip, test.lateral))

    def grips(self) -> NDArray[np.int8]:
        """For each point (n,): 1 held at the bottom, 2 at the top, 0 between."""
        held = self.held
        numbers = held.at_bottom(self.points) + 2 * held.at_top(self.points)
        return numbers.astype(np.int8)


def read_state(
    run: str | Path, time: str, alloy: str | None = None, hold: str | None = None
) -> CorrodedState:
    """The state that a run folder holds of an alloy after `time` (8w, 56d).

    alloy: may be left out where the run has one; hold: the first way of holding of the run where
    left out. Raises FileNotFoundError or ValueError in one sentence for a folder, alloy, time or
    way of holding that is not there, and where the damage has not been mapped or was changed.
    """
    folder = RunFolder(run)
    scene = _scene(folder)
    chosen = _alloy(scene, alloy)
    way = scene.hold(hold) if hold is not None else scene.holds[0]
    moment = scene.time(time)
    place = folder.test(chosen.name, moment.label, way.name)
    _whole(folder, folder.geometry, "geometry", geometry_hash(scene))
    march = folder.corrosion(chosen.name)
    _whole(folder, march, "corrode", corrosion_hash(scene, chosen.name))
    _whole(folder, place, "map", map_hash(scene, chosen.name, moment, way))
    mesh = read_mesh(folder.geometry / scene.mesh_folder(way))
    damage = read_damage(place / DAMAGE_FILE)
    if damage.shape[1] > 1:
        weights = find_element(way.tensile.element).weights
        damage = damage @ weights[:, None] / weights.sum()
    pulled = folder.complete(place, "pull", pull_hash(scene, chosen.name, moment, way))
    return CorrodedState(
        alloy=chosen.name,
        time=moment,
        hold=way,
        material=chosen.material,
        points=mesh.points,
        cells=mesh.cells,
        corrosion_damage=damage[:, 0],
        corrosion=march / CORROSION_FILE,
        curve=_columns(place / CURVE_FILE) if pulled else {},
    )


def read_march(
    run: str | Path, time: str, alloy: str | None = None
) -> tuple[Scene, Path, Path, ImmersionTime]:
    """Scene, folder of the geometry, corrosion file and time: what a march alone leaves.

    Arguments and errors as those of `read_state`; no damage needs to have been mapped.
    """
    folder = RunFolder(run)
    scene = _scene(folder)
    chosen, moment = _alloy(scene, alloy), scene.time(time)
    march = folder.corrosion(chosen.name)
    _whole(folder, folder.geometry, "geometry", geometry_hash(scene))
    _whole(folder, march, "corrode", corrosion_hash(scene, chosen.name))
    return scene, folder.geometry, march / CORROSION_FILE, moment


def _alloy(scene: Scene, name: str | None) -> AlloyScene:
    names = [a.name for a in scene.alloys]
    if name is None and len(names) > 1:
        raise ValueError(f"the run has several alloys; say which with --alloy: {', '.join(names)}")
    return scene.alloy(name or names[0])


def _scene(folder: RunFolder) -> Scene:
    if not folder.path.is_dir():
        raise FileNotFoundError(f"run folder '{folder.path}' does not exist")
    try:
        content = json.loads(folder.scene_file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunFolderError(
            f"'{folder.path}' holds no {folder.scene_file.name}, so it is no run folder"
        ) from None
    except (ValueError, RecursionError):
        raise RunFolderError(f"'{folder.scene_file}' is not the scene of a run") from None
    return scene_from_json(content)


def _whole(folder: RunFolder, place: Path, stage: str, inputs: str) -> None:
    if folder.complete(place, stage, inputs) is None:
        damage = folder.damage(place, stage, inputs)
        because = f", {damage}" if damage else ""
        raise RunFolderError(
            f"stage '{stage}' of '{place.relative_to(folder.path)}' is not complete in run folder "
            f"'{folder.path}'{because}; run `perilife {stage}` on it first"
        )


def _columns(path: Path) -> dict[str, NDArray[np.float64]]:
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
