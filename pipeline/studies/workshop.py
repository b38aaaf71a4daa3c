"""Tensile tests for the studies: one screw, many settings, each pull timed on one processor.

Solid, corrosion fields and meshes are made once and kept in a folder; the pulls run in processes of
their own, one thread each, and what they return is a row of a table.
"""

from __future__ import annotations

import csv
import hashlib
import json
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from pipeline.record.children import end_with_parent
from pipeline.record.machine import child_environment
from pipeline.record.run_folder import write_json, write_text
from pipeline.record.stage_hashes import STAGE_REVISION
from pipeline.record.whole_file import whole_file
from pipeline.scene.mapping import mapping_of
from pipeline.scene.mechanics import EXPOSURES
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import Scene
from pipeline.scene.units import parse_immersion_times

LIMIT_SECONDS = 600.0
"""Processor time after which a pull is given up."""


@dataclass(frozen=True)
class Pull:
    """One tensile test of the reference screw: what is pulled, and how (SI).

    curve, choice: line of the plot and point on it; field: name of the corrosion field, empty for
    that of the quick lattice; samples: how often the edges of a cell are halved for the means of f0
    in it (pipeline.stages.mapping; 1 in a run); grip: length held at either end, 0: the end faces,
    None: the shank, as in a run (scene.holding); ends: edge length at both end faces, None: as
    elsewhere; peak_drop: fall of the force below its peak, relative, that ends the test, None: as
    in a run.
    """

    curve: str
    choice: str
    alloy: str
    immersion: str
    element: str
    mesh_size: float
    mesh_size_fine: float
    increment: float
    tolerance: float = 1e-5
    damage: str = "point"
    damage_length: float = 0.0
    field: str = ""
    samples: int = 1
    grip: float | None = None
    ends: float | None = None
    peak_drop: float | None = None

    def setting(self) -> tuple:
        """Everything but what is pulled."""
        return tuple(
            getattr(self, field.name)
            for field in fields(Pull)
            if field.name not in ("curve", "choice", "immersion")
        )


@dataclass(frozen=True)
class Row(Pull):
    """A pull with its outcome and cost.

    strain_at_peak: at the largest force; iterations: most of one increment; processor_seconds: of
    the whole pull; seconds: of the clock, and of these material and assembly, set-up of the
    preconditioner, linear solutions; mapping_seconds: of the processor, of the map, what its points
    see included where that was not kept yet.
    """

    cells: int = 0
    unknowns: int = 0
    peak_force: float = float("nan")
    strain_at_peak: float = float("nan")
    increments: int = 0
    iterations: int = 0
    processor_seconds: float = 0.0
    seconds: float = 0.0
    assembly_seconds: float = 0.0
    setup_seconds: float = 0.0
    solve_seconds: float = 0.0
    mapping_seconds: float = 0.0
    status: str = ""


AS_PRINTED: Mapping[str, object] = {
    "spacing": 100e-6,
    "corrosion": {"classes": 0, "rate_change": 0.4},
}
"""Changes of a scene for fields on the lattice of the published constants, one rate per node: what
published statements, and meshes among each other, are compared on."""


class Workshop:
    """Solid, fields and meshes of the reference screw in a folder, each made when first asked for.

    The screw is gripped as in a run unless a pull says otherwise.  Fields, meshes and what a pull
    found stay in the folder and are taken from there; those of another code must be deleted by
    whoever changes it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._solid: object = None
        self.corrosion_seconds: dict[tuple[str, str], float] = {}
        self.setup_seconds: dict[float, float] = {}
        """Of metal and surface by spacing (m), where they were not read from the folder."""

    def scene(self, alloy: str, immersion: Sequence[str], **changes: object) -> Scene:
        """The scene of a quick run, with changes."""
        return resolve_scene([alloy], list(immersion), "quick", **changes)

    def solid(self, scene: Scene) -> object:
        """The screw, built once."""
        if self._solid is None:
            from pipeline.stages.geometry import build_solid

            self._solid = build_solid(scene)
        return self._solid

    def corrode(
        self, alloy: str, immersion: Sequence[str], name: str = "",
        spacing: float | None = None, rate_change: float | None = None, **changes: object,
    ) -> float:  # fmt: skip
        """March an alloy and store its fields as `name`; returns the march's processor seconds.

        changes: of the scene (scene.resolve.resolve_scene), the rate change aside.
        """
        from peri.engine.march.marching import TimeStepping
        from peri.omissions.planning import corrode_lean
        from pipeline.stages.by_nodes import by_nodes
        from pipeline.stages.corrosion import (
            corrosion_scene,
            domain_lattice,
            exposure_of,
            liquid_domain,
            metal_of,
        )
        from pipeline.stages.doses import doses, kernel_of
        from pipeline.stages.geometry import write_surface

        if rate_change is not None:
            changes["corrosion"] = {**changes.get("corrosion", {}), "rate_change": rate_change}
        scene = self.scene(alloy, immersion, spacing=spacing, **changes)
        done = self.folder / f"march-{name}-{alloy}.json"
        mark = hashlib.sha256(repr((STAGE_REVISION["corrode"], scene)).encode()).hexdigest()
        if done.exists() and (kept := json.loads(done.read_text()))["scene"] == mark:
            self.corrosion_seconds[alloy, name] = kept["seconds"]
            self._set_up(scene.lattice.spacing, kept["setup_seconds"])
            return kept["seconds"]
        solid = self.solid(scene)
        begun = time.process_time()
        region = liquid_domain(scene, solid.points)
        lattice, domain = domain_lattice(scene, region)
        metal, fraction = metal_of(scene, lattice, solid)
        exposed = exposure_of(scene, lattice, region, solid, fraction, self.folder)
        march = corrosion_scene(scene, alloy, lattice, domain, metal, fraction, exposed)
        setup = self._set_up(scene.lattice.spacing, time.process_time() - begun)
        begun = time.process_time()
        times = scene.with_intact()
        result, _ = corrode_lean(
            march,
            [moment.seconds for moment in times],
            TimeStepping(scene.corrosion.scheme, rate_change=scene.corrosion.rate_change),
            tolerance=scene.corrosion.tolerance,
        )
        seconds = time.process_time() - begun
        by_exposures = mapping_of(scene, scene.tensile) == EXPOSURES
        dose = doses(result.scene, result.concentration) if by_exposures else None
        more: dict[str, object] = {}
        if dose is not None:
            write_surface(self.folder, solid)
            names = ("horizon", "kernel_exponent", "influence")
            more = dict(zip(names, kernel_of(scene), strict=True))
        if exposed is not None:
            result = by_nodes(result, metal)
        march = result.scene
        fields = zip(times, result.concentration, result.volume_loss, strict=True)
        for number, (moment, concentration, loss) in enumerate(fields):
            if dose is not None:
                more["dose"] = dose[number]
            np.savez(
                _field_path(self.folder, name, alloy, moment.label),
                origin=lattice.origin, spacing=lattice.spacing, concentration=concentration,
                metal=metal, solid=march.solid_concentration, capacity=march.capacity(),
                volume_loss=loss, **more,
            )  # fmt: skip
        self.corrosion_seconds[alloy, name] = seconds
        write_json(done, {"scene": mark, "seconds": seconds, "setup_seconds": setup})
        return seconds

    def _set_up(self, spacing: float, seconds: float) -> float:
        """The most that metal and surface took on a lattice: later marches read the surface."""
        most = self.setup_seconds[spacing] = max(seconds, self.setup_seconds.get(spacing, 0.0))
        return most

    def field(self, name: str, alloy: str, immersion: str) -> Path:
        """File of a corrosion field that `corrode` stored."""
        return _field_path(self.folder, name, alloy, immersion)

    def mesh(self, size: float, fine: float, ends: float | None = None) -> Path:
        """File of the mesh of these sizes."""
        path = _mesh_path(self.folder, size, fine, ends)
        if not path.exists():
            from pipeline.geometry.solids import tetrahedral_mesh

            solid = self.solid(self.scene("Mg-5Gd", ["0w"]))
            mesh = tetrahedral_mesh(solid, size, fine, (ends, ends))
            np.savez(path, points=mesh.points, cells=mesh.cells)
        return path

    def pull(
        self, pulls: Iterable[Pull], workers: int, done: Callable[[Row], None],
        limit: float = LIMIT_SECONDS,
    ) -> list[Row]:  # fmt: skip
        """Run pulls, `workers` at a time; `done` hears each row; the order is that of the pulls.

        A pull that the folder has is not done again, unless it was given up at a lower limit.
        """
        pulls = list(pulls)
        rows: dict[int, Row] = {}
        for number, pull in enumerate(pulls):
            kept = self._kept(pull, limit)
            if kept is not None:
                rows[number] = kept
                done(kept)
        left = {n: pull for n, pull in enumerate(pulls) if n not in rows}
        if not left:
            return [rows[n] for n in range(len(pulls))]
        for sizes in {(p.mesh_size, p.mesh_size_fine, p.ends): None for p in left.values()}:
            self.mesh(*sizes)
        before = dict(os.environ)  # what is spawned inherits it
        os.environ.update(child_environment(ranks=1, threads=1))
        try:
            with ProcessPoolExecutor(
                workers, multiprocessing.get_context("spawn"), _warm_up
            ) as pool:
                waiting = {
                    pool.submit(pull_once, self.folder, pull, limit): n for n, pull in left.items()
                }
                for future in as_completed(waiting):
                    row = rows[waiting[future]] = future.result()
                    write_rows([row], self._row_path(row))
                    done(row)
        finally:
            os.environ.clear()
            os.environ.update(before)
        return [rows[n] for n in range(len(pulls))]

    def _row_path(self, pull: Pull) -> Path:
        said = {f.name: getattr(pull, f.name) for f in fields(Pull)[2:]}
        plain = {f.name: f.default for f in fields(Pull)}
        changed = {name: said[name] for name in said if said[name] != plain[name]}
        what = json.dumps([*(STAGE_REVISION[s] for s in ("corrode", "map", "pull")), changed])
        return self.folder / f"pull-{hashlib.sha256(what.encode()).hexdigest()[:16]}.csv"

    def _kept(self, pull: Pull, limit: float) -> Row | None:
        """What the folder has of a pull, on the curve asked for."""
        path = self._row_path(pull)
        if not path.exists():
            return None
        row = read_rows(path)[0]
        if np.isnan(row.peak_force) and row.processor_seconds < 0.99 * limit:
            return None
        return replace(row, curve=pull.curve, choice=pull.choice)


@contextmanager
def kept_folder(keep: Path | None) -> Iterator[Path]:
    """A workshop's folder: this one, made where it is missing, or one that goes with the study."""
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        yield keep
        return
    with tempfile.TemporaryDirectory(prefix="perilife-study-") as place:
        yield Path(place)


def _field_path(folder: Path, name: str, alloy: str, immersion: str) -> Path:
    return folder / f"field-{name}-{alloy}-{immersion}.npz"


def _mesh_path(folder: Path, size: float, fine: float, ends: float | None) -> Path:
    refined = "" if ends is None else f"-{1e6 * ends:.0f}"
    return folder / f"mesh-{1e6 * size:.0f}-{1e6 * fine:.0f}{refined}.npz"


def _warm_up() -> None:
    """Load compiled kernels before anything is timed."""
    from fem.constitutive import Material, fit_voce
    from fem.strength import TensileSettings, tensile_test

    end_with_parent()
    # what a terminal sends to the whole group is dealt with by the parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    triangle = [[0, 0], [1, 0], [0, 1]]
    points = np.array([[*xy, z] for z in (0, 1) for xy in triangle], float) * 1e-3  # a prism
    cells = np.array([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])
    material = Material(43e9, 0.3, fit_voce(130e6, 220e6, 0.19))
    for element in ("P1-Fbar", "P2", "P2-Fbar"):
        settings = TensileSettings(element, maximum_strain=0.01, threads=1)
        result = tensile_test(points, cells, 0.0, material, settings)
        if result.status != "completed":  # then nothing was compiled
            raise RuntimeError(f"the prism that loads the kernels is {result.status}")


class _Overdue(Exception):
    """The pull has used up its processor time."""


def _overdue(number: int, frame: object) -> None:
    raise _Overdue


def pull_once(folder: Path, pull: Pull, limit: float = LIMIT_SECONDS) -> Row:
    """Do one pull in this process, on one thread."""
    from fem.strength import tensile_test
    from pipeline.stages.strength import material_of, settings_of

    scene = resolve_scene([pull.alloy], ["0w"], "quick")
    values, test = scene.alloy(pull.alloy).material, scene.tensile
    test = replace(
        test, element=pull.element, increment=pull.increment, damage=pull.damage,
        damage_length=pull.damage_length, peak_drop=pull.peak_drop or test.peak_drop,
    )  # fmt: skip
    if pull.grip is not None:
        test = replace(test, bottom_grip=pull.grip, top_grip=pull.grip)
    with np.load(_mesh_path(folder, pull.mesh_size, pull.mesh_size_fine, pull.ends)) as mesh:
        points, cells = mesh["points"], mesh["cells"]
    with np.load(_field_path(folder, pull.field, pull.alloy, pull.immersion)) as field:
        begun = time.process_time()
        damage = mapped_damage(points, cells, pull, field, 1.0 / values.q1, folder)
        mapping_seconds = time.process_time() - begun
    settings = replace(settings_of(test), tolerance=pull.tolerance, threads=1)
    begun = time.process_time()
    signal.signal(signal.SIGPROF, _overdue)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        result = tensile_test(points, cells, damage, material_of(values), settings)
    except _Overdue:
        seconds = time.process_time() - begun
        return Row(
            **asdict(pull), cells=len(cells), processor_seconds=seconds,
            mapping_seconds=mapping_seconds,
            status=f"stopped: not done within {limit:.0f} s",
        )  # fmt: skip
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    history, cost = result.history, result.cost
    return Row(
        **asdict(pull),
        cells=len(cells),
        unknowns=int(cost.get("unknowns", 0)),
        peak_force=result.peak_force,
        strain_at_peak=result.elongation_at_peak / result.length,
        increments=len(result.force) - 1,
        iterations=int(history["iterations"].max()) if history else 0,
        processor_seconds=time.process_time() - begun,
        seconds=cost.get("seconds", 0.0),
        assembly_seconds=cost.get("assembly_seconds", 0.0),
        setup_seconds=cost.get("preconditioner_seconds", 0.0),
        solve_seconds=cost.get("solve_seconds", 0.0),
        mapping_seconds=mapping_seconds,
        status=result.status,
    )


def mapped_damage(points, cells, pull: Pull, field, maximum: float, folder: Path) -> np.ndarray:
    """f0 of a pull: (nc, nq) of the quadrature points, or (nc, 1) of each cell.

    By exposures where the field has doses, as in a run.  folder: where the surface is, and where
    what the points see is kept.
    """
    from pipeline.stages.geometry import read_surface
    from pipeline.stages.mapping import Lost, Seen, map_lost, points_of

    seen = None
    if "dose" in field:
        kernel = (field["horizon"].item(), field["kernel_exponent"].item(), str(field["influence"]))
        seen = Seen(read_surface(folder), kernel, field["dose"])
    lost = Lost(
        field["origin"], field["spacing"], field["concentration"], field["metal"],
        field["capacity"], field["solid"], seen,
    )  # fmt: skip
    mapped = map_lost(points, cells, lost, pull.samples, folder)
    return mapped.at_points(maximum, points_of(pull.element, pull.damage))


def weeks(label: str) -> float:
    """Immersion time as typed, in weeks."""
    return parse_immersion_times([label])[0].seconds / (7 * 86400.0)


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """The rows as CSV, SI."""
    with (
        whole_file(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def read_rows(path: Path) -> list[Row]:
    """The rows of a CSV that `write_rows` wrote."""
    kinds = {"int": int, "float": float, "str": str}
    rows = []
    with path.open(newline="", encoding="utf-8") as file:
        for entry in csv.DictReader(file):
            values: dict[str, object] = {}
            for field in fields(Row):
                text = entry.get(field.name, "")
                kind, _, empty = str(field.type).partition(" | ")
                if empty:
                    values[field.name] = kinds[kind](text) if text else None
                else:
                    values[field.name] = kinds[kind](text)
            rows.append(Row(**values))
    return rows


def write_page(title: str, lines: Sequence[str], path: Path, command: str) -> Path:
    """Tables of a study as a Markdown file that names the command that made it, in one step."""
    text = "\n".join([f"# {title}", "", f"Written by `{command}`.", "", *lines, ""])
    write_text(path, text)
    return path
