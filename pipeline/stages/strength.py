"""The tensile stage: one job file in, force-elongation curve out, in a process of its own.

Torsion and bending likewise: torque or moment against angle.

`perilife` starts `python -m pipeline.stages.strength JOB.json` per pull (under `mpirun -n NP`
when NP > 1), so that a crash or the memory of one test never touches the others.
"""

import json
import logging
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pipeline.geometry.mesh import read_mesh
from pipeline.record import children, interruption
from pipeline.record.machine import child_environment, mpirun, processor_cores
from pipeline.record.run_folder import write_json, write_text
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import MaterialParameters, TensileScene
from pipeline.stages.mapping import DAMAGE_FILE, read_damage

JOB_FILE = "tensile-job.json"
RESULT_FILE = "tensile.json"
CURVE_FILE = "tensile.csv"
PICTURE_FILE = "tensile.vtu"
SERIES_FILE = "tensile.pvd"
LOG_FILE = "tensile.log"
PROGRESS_FILE = ".tensile.progress"
CHECKPOINT_FILE = ".tensile.checkpoint.h5"
POLL_SECONDS = 0.1
CHECKPOINT_SECONDS = 30.0
SERIES_EVERY = 4
"""Increments from one file of the ParaView series to the next."""

_ORDER = ("force", "torque", "moment", "iterations", "halvings", "work", "stored", "dissipated")

logger = logging.getLogger(__name__)


class TensileStageError(RuntimeError):
    """A tensile test that ended without a result; the message says where its log is."""


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
        content = json.loads(Path(path).read_text())
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

    from fem.constitutive.hardening import VoceHardening
    from fem.constitutive.material import Material
    from fem.results import Checkpoint, CheckpointError, ParaviewSeries
    from fem.solid import Grips
    from fem.strength import TensileSettings, tensile_test

    comm = MPI.COMM_WORLD if comm is None else comm
    root = comm.rank == 0
    mesh = read_mesh(Path(job.geometry)) if root else None
    damage = read_damage(Path(job.damage) / DAMAGE_FILE) if root else None
    values, test = job.material, job.tensile
    out = Path(job.out)

    def advanced(fraction: float, text: str) -> None:
        write_text(out / PROGRESS_FILE, f"{fraction:.4f}")

    material = Material(
        young=values.young_modulus,
        poisson=values.poisson_ratio,
        hardening=VoceHardening(
            values.initial_yield_stress, values.hardening_capacity, values.hardening_rate
        ),
        q1=values.q1,
    )
    settings = TensileSettings(
        element=test.element,
        maximum_strain=test.final_strain,
        first_increment=min(0.002, test.increment),
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
    temporary = out / ".tensile.part.vtu"
    meshio.Mesh(
        mesh.points,
        [("tetra", mesh.cells)],
        point_data={"displacement_m": np.nan_to_num(displacement)},
        cell_data={"corrosion_damage": [damage.reshape(len(mesh.cells), -1).mean(axis=1)]},
    ).write(temporary)
    os.replace(temporary, out / PICTURE_FILE)


def written_files(folder: Path) -> list[Path]:
    """What a finished test left in `folder`; the files of the series but their list left out."""
    pictures = (folder / PICTURE_FILE, folder / SERIES_FILE)
    written = [path for path in pictures if path.exists()]  # a short test has no series
    return [folder / RESULT_FILE, folder / CURVE_FILE, *written]


def read_result(folder: Path) -> dict[str, object]:
    """Content of the tensile.json that a finished test left in `folder`."""
    return json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))


@dataclass
class _Running:
    job: TensileJob
    key: str
    process: subprocess.Popen
    started: float


def run_jobs(
    jobs: dict[str, TensileJob],
    ranks: int = 1,
    workers: int = 1,
    started: Callable[[str], None] = lambda key: None,
    advanced: Callable[[str, float], None] = lambda key, fraction: None,
    finished: Callable[[str, float], None] = lambda key, seconds: None,
    keep: tuple[int, ...] = (),
) -> None:
    """Run jobs in processes of their own, `workers` at a time with `ranks` ranks each.

    keep: descriptors that the processes inherit, the lock of the run folder (children.start).
    The callbacks are called in this process with the job's key.  When one job fails the others
    that run are allowed to end, then TensileStageError is raised; when this process is
    interrupted all children are ended first, and when it is killed they end with it.
    """
    command_line = _launcher(ranks)
    waiting = list(jobs.items())
    running: list[_Running] = []
    failures: list[str] = []
    try:
        while running or (waiting and not failures):
            while waiting and not failures and len(running) < workers:
                key, job = waiting.pop(0)
                running.append(_start(key, job, command_line, ranks, workers, keep))
                started(key)
            time.sleep(POLL_SECONDS)
            interruption.check()
            for item in list(running):
                code = item.process.poll()
                if code is None:
                    advanced(item.key, _read_fraction(Path(item.job.out)))
                    continue
                running.remove(item)
                # at once: a run that is killed later keeps this test and would keep the file
                (Path(item.job.out) / PROGRESS_FILE).unlink(missing_ok=True)
                if code == 0:
                    finished(item.key, time.monotonic() - item.started)
                else:
                    failures.append(_failure(item, code))
    finally:
        for item in running:
            children.end(item.process)
        for job in jobs.values():
            (Path(job.out) / PROGRESS_FILE).unlink(missing_ok=True)
    if failures:
        raise TensileStageError("; ".join(failures))


def run_jobs_here(
    jobs: dict[str, TensileJob],
    finished: Callable[[str, float], None] = lambda key, seconds: None,
    **others: object,
) -> None:
    """As `run_jobs`, one after another in this process, whose threads and descriptors they take.

    For a process that is itself a child: what crashes ends it, and an exception is that of the job.
    """
    for key, job in jobs.items():
        _forget_others(job)
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


def _launcher(ranks: int) -> list[str]:
    command = [sys.executable, "-m", "pipeline.stages.strength"]
    return command if ranks == 1 else [*mpirun(ranks, f"--np {ranks}"), *command]


def _environment(ranks: int, workers: int) -> dict[str, str]:
    """One thread per rank for BLAS; Numba gets what is left of the cores."""
    threads = max(1, processor_cores() // (ranks * workers))
    return child_environment(ranks, threads)


def _start(
    key: str,
    job: TensileJob,
    command_line: list[str],
    ranks: int,
    workers: int,
    keep: tuple[int, ...],
) -> _Running:
    _forget_others(job)
    path = job.write()
    with open(Path(job.out) / LOG_FILE, "w", encoding="utf-8") as log:
        process = children.start(
            [*command_line, str(path)],
            launcher=ranks > 1,
            keep=keep,
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=_environment(ranks, workers),
        )
    return _Running(job, key, process, time.monotonic())


def _forget_others(job: TensileJob) -> None:
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


def _failure(item: _Running, code: int) -> str:
    log = Path(item.job.out) / LOG_FILE
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    last = lines[-1].strip() if lines else "no message"
    return f"{item.key} ended with {children.how_it_ended(code)} ({last}; log: {log})"


def _read_fraction(folder: Path) -> float:
    try:
        return float((folder / PROGRESS_FILE).read_text())
    except (OSError, ValueError):
        return 0.0


def main(arguments: list[str]) -> int:
    """Entry point of the child process: run the one job named on the command line."""
    if len(arguments) != 1:
        print("usage: python -m pipeline.stages.strength JOB.json", file=sys.stderr)
        return 2
    children.end_with_parent()  # a rank's parent is mpirun
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8.0f ms %(message)s")
    run_job(TensileJob.read(Path(arguments[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
