"""The tensile stage: one job in, force-elongation curve out, in this process.

Torsion and bending likewise: torque or moment against angle.  `pulls.py` does several in children.
"""

import json
import logging
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.geometry.mesh import read_mesh
from pipeline.record.run_folder import write_json, write_text
from pipeline.record.whole_file import whole_file
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import MaterialParameters, TensileScene
from pipeline.stages.mapping import DAMAGE_FILE, read_damage

if TYPE_CHECKING:
    from fem.constitutive.material import Material
    from fem.strength import TensileSettings

JOB_FILE = "tensile-job.json"
RESULT_FILE = "tensile.json"
CURVE_FILE = "tensile.csv"
PICTURE_FILE = "tensile.vtu"
SERIES_FILE = "tensile.pvd"
LOG_FILE = "tensile.log"
PROGRESS_FILE = ".tensile.progress"
CHECKPOINT_FILE = ".tensile.checkpoint.h5"
CHECKPOINT_SECONDS = 30.0
SERIES_EVERY = 4
"""Increments from one file of the ParaView series to the next."""

FIRST_INCREMENT, FIRST_INCREMENT_FACES = 0.002, 0.0002
"""Strain of the first increment, and that where an end face is pulled, whose outermost layer gives
way at 0.1 to 0.5 %. The next ones follow what f lags (`fem.settings.TensileSettings`)."""

_ORDER = ("force", "torque", "moment", "iterations", "halvings", "work", "stored", "dissipated")

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TensileJob:
    """Everything one tensile test needs, by path and value (SI)."""

    geometry: str
    damage: str
    out: str
    material: MaterialParameters
    tensile: TensileScene

    def write(self) -> Path:
        """Store the job in its output folder and return the path of the file."""
        path = Path(self.out) / JOB_FILE
        write_json(path, asdict(self))
        return path

    @staticmethod
    def read(path: Path) -> "TensileJob":
        """Read a job that `write` stored."""
        return TensileJob.from_json(json.loads(Path(path).read_text()))

    @staticmethod
    def from_json(content: dict) -> "TensileJob":
        """A job from what `asdict` makes of it."""
        content["material"] = MaterialParameters(**content["material"])
        content["tensile"] = TensileScene(**content["tensile"])
        return TensileJob(**content)


def run_job(job: TensileJob, comm: object = None) -> None:
    """Do one tensile test in this process and write its results on rank 0.

    comm: an mpi4py communicator, MPI.COMM_WORLD when None.
    Writes tensile.csv, tensile.json, the ParaView series tensile.pvd (every fourth increment) and
    tensile.vtu (the end, on the whole mesh) to `job.out`.  A checkpoint of an interrupted test of
    the same job is taken up; the ParaView series then begins there.
    """
    begun = time.process_time()
    from mpi4py import MPI

    from fem.results import Checkpoint, CheckpointError, ParaviewSeries
    from fem.strength import tensile_test

    comm = MPI.COMM_WORLD if comm is None else comm
    root = comm.rank == 0
    mesh = read_mesh(Path(job.geometry)) if root else None
    damage = read_damage(Path(job.damage) / DAMAGE_FILE) if root else None
    values, test = job.material, job.tensile
    out = Path(job.out)

    def advanced(fraction: float, text: str) -> None:
        write_text(out / PROGRESS_FILE, f"{fraction:.4f}")

    material, settings = material_of(values), settings_of(test)
    checkpoint = out / CHECKPOINT_FILE

    def pull(resume: Path | None):
        return tensile_test(
            mesh.points if root else None,
            mesh.cells if root else None,
            damage,
            material,
            settings,
            comm,
            advanced if root else None,
            observers=(
                ParaviewSeries(out, SERIES_EVERY),
                _Seldom(Checkpoint(checkpoint), comm, CHECKPOINT_SECONDS),
            ),
            resume=resume,
        )

    if comm.bcast(checkpoint.exists()):
        try:
            result = pull(checkpoint)
        except CheckpointError as error:
            logger.warning("%s; the test starts anew", error)
            result = pull(None)
    else:
        result = pull(None)
    if root:
        _write_result(out, result, test.load, time.process_time() - begun)
        _write_picture(out, mesh, damage, result)
        checkpoint.unlink(missing_ok=True)


def material_of(values: MaterialParameters) -> "Material":
    """The material of a test."""
    from fem.constitutive.hardening import VoceHardening
    from fem.constitutive.material import Material

    return Material(
        young=values.young_modulus,
        poisson=values.poisson_ratio,
        hardening=VoceHardening(
            values.initial_yield_stress, values.hardening_capacity, values.hardening_rate
        ),
        q1=values.q1,
    )


def settings_of(test: TensileScene) -> "TensileSettings":
    """The settings of a test, with as many threads as the environment says."""
    from fem.solid import Grips
    from fem.strength import TensileSettings

    return TensileSettings(
        element=test.element,
        maximum_strain=test.final_strain,
        first_increment=first_increment(test),
        maximum_increment=test.increment,
        full_curve=test.peak_drop >= 1,
        peak_drop=test.peak_drop,
        damage=test.damage,
        damage_length=test.damage_length,
        load=test.load,
        bending_azimuth=test.bending_azimuth or 0.0,
        grips=Grips(test.bottom_grip, test.top_grip, test.lateral),
        threads=int(os.environ.get("NUMBA_NUM_THREADS", "0")) or None,
    )


def first_increment(test: TensileScene) -> float:
    """Strain of a test's first increment."""
    pulled_face = test.load == "axial" and 0.0 in (test.bottom_grip, test.top_grip)
    return min(FIRST_INCREMENT_FACES if pulled_face else FIRST_INCREMENT, test.increment)


def compile_for(element: str) -> None:
    """Pull a cube of six cells of an element a little, which compiles what any test needs."""
    from mpi4py import MPI

    from fem.constitutive.hardening import VoceHardening
    from fem.constitutive.material import Material
    from fem.strength import TensileSettings, tensile_test

    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 1e-3  # m
    cells = [(0, 4, 6, 7), (0, 4, 5, 7), (0, 2, 6, 7), (0, 2, 3, 7), (0, 1, 5, 7), (0, 1, 3, 7)]
    metal = Material(young=43e9, poisson=0.3, hardening=VoceHardening(130e6, 120e6, 10.0))
    settings = TensileSettings(element, maximum_strain=0.01, maximum_increment=0.01, threads=1)
    tensile_test(corners, np.array(cells), 0.1, metal, settings, MPI.COMM_SELF)


class _Seldom:
    """Observer that hands on to another one when `seconds` have passed since it last did."""

    def __init__(self, observer: Callable, comm: object, seconds: float) -> None:
        self.observer, self.comm, self.seconds = observer, comm, seconds
        self.last = time.monotonic()

    def __call__(self, increment: object) -> None:
        """Collective: the clock of rank 0 counts."""
        if self.comm.bcast(time.monotonic() - self.last >= self.seconds):
            self.observer(increment)
            self.last = time.monotonic()


def _write_result(out: Path, result: object, load: str, seconds: float) -> None:
    """tensile.csv: one row per point of the curve; tensile.json: what follows from it, SI.

    seconds: of the processor.
    """
    names, motion, reaction = LOADS[load], result.load.motion, result.load.reaction
    history = result.history or {motion: result.motion, reaction: result.reaction}
    strain = history[motion] / result.load.extent
    units = {"elongation": "displacement_m", "angle": "angle_rad", "force": "force_N"}
    units |= {"torque": "torque_N_m", "moment": "moment_N_m", "work": "work_J"}
    units |= {"stored": "stored_J", "dissipated": "dissipated_J", "seconds": "seconds_s"}
    columns = {names.strain: strain, units[motion]: history[motion]}
    # a resumed test has its quantities in another order; the file has not
    ordered = sorted(history, key=lambda k: (_ORDER.index(k) if k in _ORDER else len(_ORDER), k))
    columns |= {units.get(k, k): history[k] for k in ordered if k != motion}
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(",".join(f"{value:.10g}" for value in row))
    write_text(out / CURVE_FILE, "\n".join(lines) + "\n")
    counts = ("cells", "dead_cells", "loose_cells", "loose_pieces", "lost_cells", "torn_cells")
    turned = {} if load == "axial" else {"angle_at_peak": float(result.motion_at_peak)}
    write_json(
        out / RESULT_FILE,
        {
            "load": load,
            f"peak_{reaction}": float(result.peak_reaction),
            names.strain_at_peak: float(result.motion_at_peak / result.load.extent),
            **turned,
            "status": result.status,
            "lag_at_peak": float(result.lag_at_peak),
            "length": float(result.length),
            "increments": len(strain) - 1,
            "processor_seconds": seconds,
            "memory_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            **{name: int(getattr(result, name)) for name in counts},
            "cost": {name: float(value) for name, value in result.cost.items()},
        },
    )


def _write_picture(out: Path, mesh: object, damage: np.ndarray, result: object) -> None:
    """tensile.vtu: displacement at the end (m) and mean damage per cell, for ParaView."""
    import meshio

    displacement = result.displacement
    if displacement is None:
        displacement = np.zeros_like(mesh.points)
    picture = meshio.Mesh(
        mesh.points,
        [("tetra", mesh.cells)],
        point_data={"displacement_m": np.nan_to_num(displacement)},
        cell_data={"corrosion_damage": [damage.reshape(len(mesh.cells), -1).mean(axis=1)]},
    )
    with whole_file(out / PICTURE_FILE) as temporary:
        picture.write(temporary)


def written_files(folder: Path) -> list[Path]:
    """What a finished test left in `folder`; the files of the series but their list left out."""
    pictures = (folder / PICTURE_FILE, folder / SERIES_FILE)
    written = [path for path in pictures if path.exists()]  # a short test has no series
    return [folder / RESULT_FILE, folder / CURVE_FILE, *written]


def read_result(folder: Path) -> dict[str, object]:
    """Content of the tensile.json that a finished test left in `folder`."""
    return json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))


def run_jobs_here(
    jobs: dict[str, TensileJob],
    finished: Callable[[str, float], None] = lambda key, seconds: None,
    **others: object,
) -> None:
    """As `run_jobs`, one after another in this process, whose threads and descriptors they take.

    For a process that is itself a child: what crashes ends it, and an exception is that of the job.
    """
    for key, job in jobs.items():
        forget_others(job)
        job.write()
        _forget_peak_memory()
        begun = time.monotonic()
        try:
            with _printing_to(Path(job.out) / LOG_FILE):
                run_job(job)
        finally:
            (Path(job.out) / PROGRESS_FILE).unlink(missing_ok=True)
        finished(key, time.monotonic() - begun)


def _forget_peak_memory() -> None:
    """Let `ru_maxrss` begin anew, where the system can (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


@contextmanager
def _printing_to(path: Path) -> Iterator[None]:
    """Within, what this process and its libraries print goes to a file."""
    kept = [os.dup(number) for number in (1, 2)]
    with open(path, "wb") as log:
        for number in (1, 2):
            os.dup2(log.fileno(), number)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
            os.close(old)


def forget_others(job: TensileJob) -> None:
    """Remove checkpoint and series that another job left in the folder of this one."""
    out = Path(job.out)
    try:
        same = TensileJob.read(out / JOB_FILE) == job
    except (OSError, ValueError, TypeError, KeyError):
        same = False
    checkpoint = out / CHECKPOINT_FILE
    if not same:
        checkpoint.unlink(missing_ok=True)
    if not checkpoint.exists():
        for path in (*out.glob("tensile_*.vtu"), out / SERIES_FILE):
            path.unlink(missing_ok=True)
