"""Tensile tests for the studies: one screw, many settings, each pull timed on one processor.

Solid, corrosion fields and meshes are made once and kept in a folder; the pulls run in processes of
their own, one thread each, and what they return is a row of a table.
"""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from pipeline.record.children import end_with_parent
from pipeline.record.machine import child_environment
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import Scene
from pipeline.scene.units import parse_immersion_times

LIMIT_SECONDS = 600.0
"""Processor time after which a pull is given up."""


@dataclass(frozen=True)
class Pull:
    """One tensile test of the reference screw: what is pulled, and how (SI).

    curve, choice: line of the plot and point on it; field: name of the corrosion field, empty for
    that of the quick lattice; samples: how often the edges of a cell are halved for the mean of f0
    over it (fem.quadrature.sampling_points; 1 in a run), None: f0 at the quadrature points; grip:
    length held at either end, 0: the end faces, None: the shank, as in a run (scene.holding);
    ends: edge length at both end faces, None: as elsewhere.
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
    damage: str = "cell"
    damage_length: float = 0.0
    field: str = ""
    samples: int | None = 1
    grip: float | None = None
    ends: float | None = None

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
    preconditioner, linear solutions.
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
    status: str = ""


AS_PRINTED: Mapping[str, object] = {
    "spacing": 100e-6,
    "corrosion": {"classes": 0, "rate_change": 0.4},
}
"""Changes of a scene for fields on the lattice of the published constants, one rate per node: what
published statements, and meshes among each other, are compared on."""


class Workshop:
    """Solid, fields and meshes of the reference screw in a folder, each made when first asked for.

    The screw is gripped as in a run unless a pull says otherwise.
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

        if rate_change is not None:
            changes["corrosion"] = {**changes.get("corrosion", {}), "rate_change": rate_change}
        scene = self.scene(alloy, immersion, spacing=spacing, **changes)
        solid = self.solid(scene)
        begun = time.process_time()
        region = liquid_domain(scene, solid.points)
        lattice, domain = domain_lattice(scene, region)
        metal, fraction = metal_of(scene, lattice, solid)
        exposed = exposure_of(scene, lattice, region, solid, fraction, self.folder)
        march = corrosion_scene(scene, alloy, lattice, domain, metal, fraction, exposed)
        self.setup_seconds[scene.lattice.spacing] = max(
            time.process_time() - begun, self.setup_seconds.get(scene.lattice.spacing, 0.0)
        )
        begun = time.process_time()
        times = scene.with_intact()
        result, _ = corrode_lean(
            march,
            [moment.seconds for moment in times],
            TimeStepping(scene.corrosion.scheme, rate_change=scene.corrosion.rate_change),
            tolerance=scene.corrosion.tolerance,
        )
        seconds = time.process_time() - begun
        if exposed is not None:
            result = by_nodes(result, metal)
        march = result.scene
        fields = zip(times, result.concentration, result.volume_loss, strict=True)
        for moment, concentration, loss in fields:
            np.savez(
                _field_path(self.folder, name, alloy, moment.label),
                origin=lattice.origin, spacing=lattice.spacing, concentration=concentration,
                metal=metal, solid=march.solid_concentration, capacity=march.capacity(),
                volume_loss=loss,
            )  # fmt: skip
        self.corrosion_seconds[alloy, name] = seconds
        return seconds

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
        """Run pulls, `workers` at a time; `done` hears each row; the order is that of the pulls."""
        pulls = list(pulls)
        for sizes in {(p.mesh_size, p.mesh_size_fine, p.ends): None for p in pulls}:
            self.mesh(*sizes)
        before = dict(os.environ)  # what is spawned inherits it
        os.environ.update(child_environment(ranks=1, threads=1))
        try:
            with ProcessPoolExecutor(
                workers, multiprocessing.get_context("spawn"), _warm_up
            ) as pool:
                waiting = {
                    pool.submit(pull_once, self.folder, pull, limit): n
                    for n, pull in enumerate(pulls)
                }
                rows: dict[int, Row] = {}
                for future in as_completed(waiting):
                    rows[waiting[future]] = future.result()
                    done(future.result())
        finally:
            os.environ.clear()
            os.environ.update(before)
        return [rows[n] for n in range(len(pulls))]


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
    for element in ("P1-Fbar", "P2"):
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
    from fem.constitutive.hardening import VoceHardening
    from fem.constitutive.material import Material
    from fem.solid import Grips
    from fem.strength import TensileSettings, tensile_test

    scene = resolve_scene([pull.alloy], ["0w"], "quick")
    values, test = scene.alloy(pull.alloy).material, scene.tensile
    with np.load(_mesh_path(folder, pull.mesh_size, pull.mesh_size_fine, pull.ends)) as mesh:
        points, cells = mesh["points"], mesh["cells"]
    with np.load(_field_path(folder, pull.field, pull.alloy, pull.immersion)) as field:
        damage = mapped_damage(points, cells, pull, field, 1.0 / values.q1)
    held = (test.bottom_grip, test.top_grip) if pull.grip is None else (pull.grip, pull.grip)
    grips = Grips(*held, test.lateral)
    begun = time.process_time()
    signal.signal(signal.SIGPROF, _overdue)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        result = tensile_test(
            points, cells, damage,
            Material(
                values.young_modulus, values.poisson_ratio,
                VoceHardening(
                    values.initial_yield_stress, values.hardening_capacity, values.hardening_rate
                ),
                values.q1,
            ),
            TensileSettings(
                pull.element, test.final_strain, min(0.002, pull.increment), pull.increment,
                peak_drop=test.peak_drop, tolerance=pull.tolerance, damage=pull.damage,
                damage_length=pull.damage_length, threads=1,
                grips=grips,
            ),
        )  # fmt: skip
    except _Overdue:
        seconds = time.process_time() - begun
        return Row(
            **asdict(pull), cells=len(cells), processor_seconds=seconds,
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
        status=result.status,
    )


def mapped_damage(points, cells, pull: Pull, field, maximum: float) -> np.ndarray:
    """f0 of a pull: (nc, nq) at the quadrature points, or (nc, 1) averaged over each cell."""
    from fem.quadrature import quadrature_points, sampling_points
    from pipeline.stages.damage_map import map_damage

    lattice = (field["origin"], field["spacing"], field["concentration"], field["metal"])
    if pull.samples is None:
        at, _ = quadrature_points(points, cells, pull.element)
        return map_damage(at, *lattice, float(field["solid"]), maximum)
    at, _ = sampling_points(points, cells, pull.samples)  # points of equal volumes
    return map_damage(at, *lattice, float(field["solid"]), maximum).mean(axis=1, keepdims=True)


def weeks(label: str) -> float:
    """Immersion time as typed, in weeks."""
    return parse_immersion_times([label])[0].seconds / (7 * 86400.0)


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """The rows as CSV, SI."""
    temporary = path.with_name(f".{path.name}")
    with temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    os.replace(temporary, path)


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
