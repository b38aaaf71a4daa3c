"""Reads a run folder, complete or not, into plain records for the report.

Nothing is computed here.  A part that is not there, or cannot be read, becomes a sentence in
`RunResults.missing`; it never raises and is never replaced by a guess.
"""

import csv
import json
import logging
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from pipeline.record.run_folder import RunFolder, StageRecord
from pipeline.record.summary import SummaryRow, read_summary
from pipeline.scene.loads import LOADS, LoadNames
from pipeline.scene.mechanics import NODES
from pipeline.scene.scene import HoldScene, Scene, scene_from_json

logger = logging.getLogger(__name__)

STAGES = ("geometry", "corrode", "map", "pull", "report")
"""Names of the stages in the order in which they run."""


@dataclass(frozen=True)
class ImmersionResult:
    """One alloy after one immersion time, held in one way; None where a stage has not run.

    curve: columns of tensile.csv by name; damage: (nc, nq) corrosion damage f0 at the quadrature
    points; tensile: content of tensile.json; map_numbers: what the map stage measured; mapping: the
    map; map_exponent: with which it scaled the damage (damage_map.scaled_damage); parts: (nc, 8)
    damage of each eighth of a cell, not cut off, where exposures gave it.
    """

    label: str
    seconds: float
    summary: SummaryRow | None = None
    curve: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    damage: NDArray[np.float64] | None = None
    tensile: dict = field(default_factory=dict)
    map_numbers: dict = field(default_factory=dict)
    load: str = "axial"
    map_exponent: float = 1.0
    mapping: str = NODES
    parts: NDArray[np.float64] | None = None

    @property
    def names(self) -> LoadNames:
        """What the results of the load are called."""
        return LOADS[self.load]

    @property
    def abscissa(self) -> NDArray[np.float64] | None:
        """What the curve is drawn against, (n,): elongation in per cent, or angle in degrees."""
        values = column(self.curve, self.names.abscissa)
        return None if values is None else self.names.abscissa_factor * values

    @property
    def reaction(self) -> NDArray[np.float64] | None:
        """Force [N], torque or moment [N m] of the test, (n,)."""
        return column(self.curve, self.names.reaction)

    @property
    def strength_ratio(self) -> float | None:
        """Peak over that of the intact solid; None where there is no tensile test.

        Time zero has no row in the table where it was only pulled for the sake of the ratio.
        """
        if self.summary is not None:
            ratio = self.summary.strength_ratio
            return ratio if np.isfinite(ratio) else None
        return 1.0 if self.seconds == 0 and self.reaction is not None else None


@dataclass(frozen=True)
class AlloyResult:
    """One alloy held in one way: its history (columns of history.csv by name) and its times."""

    name: str
    history: dict[str, NDArray[np.float64]]
    immersions: tuple[ImmersionResult, ...]
    corrosion_numbers: dict = field(default_factory=dict)
    hold: str = "shank"


@dataclass(frozen=True)
class RunResults:
    """Everything that a run folder holds and a report shows.

    points: (n, 3) m and cells: (nc, 4) of the mesh; alloys: in the first way of holding; held: the
    same in every way, by its name; missing: one sentence per absent part.
    """

    folder: Path
    scene: Scene
    scene_extras: dict
    geometry: dict
    points: NDArray[np.float64] | None
    cells: NDArray[np.int64] | None
    alloys: tuple[AlloyResult, ...]
    records: tuple[tuple[str, StageRecord], ...]
    missing: tuple[str, ...]
    held: dict[str, tuple[AlloyResult, ...]] = field(default_factory=dict)


def read_run(path: Path | str, fields: bool = True) -> RunResults:
    """Read the run folder at `path`.

    fields: mesh and damage, too, which only pictures need; without, they are not called missing.

    Raises FileNotFoundError where the folder or its scene.json is not there, and ValueError
    where the scene cannot be read; all else that is absent is listed in `missing`.
    """
    folder = RunFolder(path)
    if not folder.scene_file.is_file():
        raise FileNotFoundError(f"run folder '{path}' holds no scene.json; it must be one of a run")
    scene, extras = _read_scene(folder.scene_file)
    missing: list[str] = []
    points, cells = None, None
    if fields:
        points, cells = _read_mesh(folder.geometry / "mesh.h5", missing)
    summary = _read_summary(folder.summary_file, missing)
    held = {
        hold.name: tuple(
            _read_alloy(folder, scene, alloy.name, hold, summary, missing, fields)
            for alloy in scene.alloys
        )
        for hold in scene.holds
    }
    return RunResults(
        folder=folder.path,
        scene=scene,
        scene_extras=extras,
        geometry=_read_json(folder.geometry / "geometry.json"),
        points=points,
        cells=cells,
        alloys=held[scene.holds[0].name],
        records=_read_records(folder, scene),
        missing=tuple(dict.fromkeys(missing)),
        held=held,
    )


def _read_scene(path: Path) -> tuple[Scene, dict]:
    """The scene, and what else the file holds beside the fields of a scene."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"scene file '{path}' cannot be read: {error}") from None
    if isinstance(content, dict) and isinstance(content.get("scene"), dict):
        extras = {key: value for key, value in content.items() if key != "scene"}
        return scene_from_json(content["scene"]), extras
    return scene_from_json(content), {}


def _read_mesh(path: Path, missing: list[str]) -> tuple[NDArray | None, NDArray | None]:
    try:
        with h5py.File(path) as file:
            return file["points"][:].astype(float), file["cells"][:].astype(np.int64)
    except (OSError, KeyError):
        missing.append("the tetrahedral mesh (geometry/mesh.h5), and with it all pictures")
        return None, None


def _read_summary(path: Path, missing: list[str]) -> list[SummaryRow]:
    try:
        return read_summary(path)
    except (OSError, ValueError, TypeError):
        missing.append("the table of results (summary.csv)")
        return []


def _read_alloy(
    folder: RunFolder,
    scene: Scene,
    name: str,
    hold: HoldScene,
    summary: list[SummaryRow],
    missing: list[str],
    fields: bool,
) -> AlloyResult:
    names = LOADS[hold.tensile.load]
    held = f" ({hold.name})" if len(scene.holds) > 1 else ""
    history = _read_columns(folder.corrosion(name) / "history.csv")
    if not history:
        missing.append(f"the course of corrosion of {name} (corrosion/history.csv)")
    immersions = []
    for time in scene.with_intact():
        place = folder.test(name, time.label, hold.name)
        curve = _read_columns(place / "tensile.csv")
        mapped = _read_damage(place / "damage.h5") if fields else {}
        if fields and not mapped:
            missing.append(f"the damage map of {name}{held} after {time.label}")
        if column(curve, names.abscissa) is None or column(curve, names.reaction) is None:
            missing.append(f"the {names.test} of {name}{held} after {time.label}")
        rows = [
            row
            for row in summary
            if (row.alloy, row.hold) == (name, hold.name)
            and abs(row.immersion_days - time.days) < 1e-6 * (1 + time.days)
        ]
        tensile = _read_json(place / "tensile.json")
        if str(tensile.get("status", "")).startswith("stopped"):
            missing.append(f"the end of the {names.test} of {name}{held} after {time.label}")
        record = folder.read_record(place, "map")
        immersions.append(
            ImmersionResult(
                label=time.label,
                seconds=time.seconds,
                summary=rows[0] if rows else None,
                curve=curve,
                tensile=tensile,
                map_numbers=dict(record.numbers) if record else {},
                load=hold.tensile.load,
                **mapped,
            )
        )
    corrosion = folder.read_record(folder.corrosion(name), "corrode")
    numbers = dict(corrosion.numbers) if corrosion else {}
    return AlloyResult(name, history, tuple(immersions), numbers, hold.name)


def column(columns: dict[str, NDArray[np.float64]], name: str) -> NDArray[np.float64] | None:
    """The column called `name`, or `name_unit` (`force_N`), or None."""
    for key, values in columns.items():
        if key == name or key.startswith(name + "_"):
            return values
    return None


def _read_columns(path: Path) -> dict[str, NDArray[np.float64]]:
    """Numeric columns of a CSV with a header line, by name; empty when there is none."""
    try:
        with open(path, encoding="utf-8", newline="") as handle:
            lines = [line for line in handle if not line.startswith("#")]
        rows = list(csv.DictReader(lines))
        if not rows:
            return {}
        return {
            key.strip(): np.array([_number(row[key]) for row in rows])
            for key in rows[0]
            if key is not None
        }
    except (OSError, ValueError) as error:
        logger.info("%s is not used: %s", path, error)
        return {}


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def _read_damage(path: Path) -> dict:
    """What an ImmersionResult has of the map; nothing where there is no map."""
    try:
        with h5py.File(path) as file:
            return {
                "damage": file["f0"][:].astype(float),
                "map_exponent": float(file.attrs.get("exponent", 1.0)),
                "mapping": str(file.attrs.get("mapping", NODES)),
                "parts": file["parts"][:].astype(float) if "parts" in file else None,
            }
    except (OSError, KeyError):
        return {}


def _read_json(path: Path) -> dict:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _read_records(folder: RunFolder, scene: Scene) -> tuple[tuple[str, StageRecord], ...]:
    """Every stage record with the place it belongs to, in the order of the stages."""
    places = [("", folder.geometry)]
    for alloy in scene.alloys:
        places.append((alloy.name, folder.corrosion(alloy.name)))
        places += [
            (
                f"{alloy.name} {time.label} {hold.name}",
                folder.test(alloy.name, time.label, hold.name),
            )
            for hold in scene.holds
            for time in scene.with_intact()
        ]
    found = []
    for stage in STAGES:
        for place, path in places:
            record = folder.read_record(path, stage)
            if record is not None:
                found.append((place, record))
    return tuple(found)
