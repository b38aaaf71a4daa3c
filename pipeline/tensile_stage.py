"""The tensile stage: one job file in, force-elongation curve out, in a process of its own.

`perilife` starts `python -m pipeline.tensile_stage JOB.json` per pull (under `mpirun -n NP`
when NP > 1), so that a crash or the memory of one test never touches the others.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import h5py

from pipeline.run_folder import write_json, write_text
from pipeline.scene import MaterialParameters, TensileScene

JOB_FILE = "tensile-job.json"
RESULT_FILE = "tensile.json"
CURVE_FILE = "tensile.csv"
LOG_FILE = "tensile.log"
PROGRESS_FILE = ".tensile.progress"
POLL_SECONDS = 0.1


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
    Writes tensile.csv (elongation, force), tensile.json and the ParaView series to `job.out`.
    """
    raise NotImplementedError("the tensile test is not connected yet")


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
) -> None:
    """Run jobs in processes of their own, `workers` at a time with `ranks` ranks each.

    The callbacks are called in this process with the job's key.  When one job fails the others
    that run are allowed to end, then TensileStageError is raised; when this process is
    interrupted all children are ended first.
    """
    command_line = _launcher(ranks)
    waiting = list(jobs.items())
    running: list[_Running] = []
    failures: list[str] = []
    try:
        while running or (waiting and not failures):
            while waiting and not failures and len(running) < workers:
                key, job = waiting.pop(0)
                running.append(_start(key, job, command_line, ranks, workers))
                started(key)
            time.sleep(POLL_SECONDS)
            for item in list(running):
                code = item.process.poll()
                if code is None:
                    advanced(item.key, _read_fraction(Path(item.job.out)))
                    continue
                running.remove(item)
                if code == 0:
                    finished(item.key, time.monotonic() - item.started)
                else:
                    failures.append(_failure(item, code))
    finally:
        for item in running:
            _end(item.process)
        for job in jobs.values():
            (Path(job.out) / PROGRESS_FILE).unlink(missing_ok=True)
    if failures:
        raise TensileStageError("; ".join(failures))


def _launcher(ranks: int) -> list[str]:
    if ranks == 1:
        return [sys.executable, "-m", "pipeline.tensile_stage"]
    mpirun = shutil.which("mpirun")
    if mpirun is None:
        raise FileNotFoundError(
            f"mpirun was not found on PATH; it must be installed for --np {ranks}"
        )
    return [mpirun, "-n", str(ranks), sys.executable, "-m", "pipeline.tensile_stage"]


def _environment(ranks: int, workers: int) -> dict[str, str]:
    """One thread per rank for BLAS; Numba gets what is left of the cores."""
    environment = dict(os.environ)
    cores = len(os.sched_getaffinity(0))
    environment["OMP_NUM_THREADS"] = "1"
    environment["NUMBA_NUM_THREADS"] = str(max(1, cores // (ranks * workers)))
    environment["OMPI_MCA_rmaps_base_oversubscribe"] = "1"
    environment["OMPI_MCA_hwloc_base_binding_policy"] = "none"
    if os.geteuid() == 0:
        environment["OMPI_ALLOW_RUN_AS_ROOT"] = "1"
        environment["OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"] = "1"
    root = str(Path(__file__).resolve().parents[1])
    environment["PYTHONPATH"] = os.pathsep.join(
        part for part in (root, environment.get("PYTHONPATH", "")) if part
    )
    return environment


def _start(
    key: str, job: TensileJob, command_line: list[str], ranks: int, workers: int
) -> _Running:
    path = job.write()
    with open(Path(job.out) / LOG_FILE, "w", encoding="utf-8") as log:
        process = subprocess.Popen(
            [*command_line, str(path)],
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=_environment(ranks, workers),
            start_new_session=True,
        )
    return _Running(job, key, process, time.monotonic())


def _end(process: subprocess.Popen) -> None:
    """End a child and whatever it started: its whole process group, first asked, then told."""
    for number, patience in ((signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0)):
        try:
            os.killpg(process.pid, number)
            process.wait(patience)
            return
        except ProcessLookupError:
            return
        except subprocess.TimeoutExpired:
            continue


def _failure(item: _Running, code: int) -> str:
    log = Path(item.job.out) / LOG_FILE
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    last = lines[-1].strip() if lines else "no message"
    return f"{item.key} ended with exit status {code} ({last}; log: {log})"


def _read_fraction(folder: Path) -> float:
    try:
        return float((folder / PROGRESS_FILE).read_text())
    except (OSError, ValueError):
        return 0.0


def main(arguments: list[str]) -> int:
    """Entry point of the child process: run the one job named on the command line."""
    if len(arguments) != 1:
        print("usage: python -m pipeline.tensile_stage JOB.json", file=sys.stderr)
        return 2
    run_job(TensileJob.read(Path(arguments[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
