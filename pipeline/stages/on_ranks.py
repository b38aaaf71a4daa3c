"""MPI ranks for the marches of a run: one way to start them, whatever is marched.

`do_on_ranks` starts `mpirun -n N python -m MODULE JOB.json`, where MODULE calls `main` with what
its rank 0 does.  Rank 0 does all of a job as one process would; the others wait until it marches
and march with it (`Others`).
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from pipeline.record import children, interruption
from pipeline.record.machine import child_environment, mpirun
from pipeline.record.run_folder import write_json, write_text

JOB_FILE = "march-job.json"
DONE_FILE = "march-done.json"
PROGRESS_FILE = "march.progress"
LOG_FILE = "march.log"
POLL_SECONDS = 0.2
_REFUSED = 2

Done = tuple[list[Path], dict[str, object]]
"""The files and numbers of a job."""


class MarchError(RuntimeError):
    """A march on ranks that ended without a result; the message says where its log is."""


def do_on_ranks(
    module: str,
    job: dict[str, object],
    out: Path,
    ranks: int,
    advanced: Callable[[float, str], None],
    keep: tuple[int, ...] = (),
) -> Done:
    """Files and numbers that rank 0 of so many ranks returns for a job (JSON).

    module : that calls `main`.  job : with its `name` for messages.  out : the folder in which job,
    log and result are exchanged.  keep : descriptors that the ranks inherit, the lock of the run
    folder.

    Raises
    ------
    ValueError
        As rank 0 does.
    MarchError
        Where the ranks end in another way.
    """
    file, log = out / JOB_FILE, out / LOG_FILE
    (out / DONE_FILE).unlink(missing_ok=True)
    write_json(file, {**job, "out": str(out)})
    command = [*mpirun(ranks, f"--ranks {ranks}"), sys.executable, "-m", module, str(file)]
    with open(log, "w", encoding="utf-8") as stream:
        process = children.start(
            command, launcher=True, keep=keep, stdout=stream, stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL, env=child_environment(ranks, 1),
        )  # fmt: skip
    try:
        while process.poll() is None:
            time.sleep(POLL_SECONDS)
            interruption.check()
            share, text = _progress(out)
            advanced(share, text)
    finally:
        children.end(process)
        for name in (JOB_FILE, PROGRESS_FILE):
            (out / name).unlink(missing_ok=True)
    try:
        done = json.loads((out / DONE_FILE).read_text(encoding="utf-8"))
        (out / DONE_FILE).unlink()
    except (OSError, ValueError):
        lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
        last = lines[-1].strip() if lines else "no message"
        how = children.how_it_ended(process.returncode)
        raise MarchError(
            f"march of {job['name']} on {ranks} ranks ended with {how} ({last}; log: {log})"
        ) from None
    log.unlink(missing_ok=True)
    if "refused" in done:
        raise ValueError(done["refused"])
    return [Path(path) for path in done["files"]], done["numbers"]


def _progress(out: Path) -> tuple[float, str]:
    try:
        share, _, text = (out / PROGRESS_FILE).read_text(encoding="utf-8").partition(" ")
        return float(share), text
    except (OSError, ValueError):
        return 0.0, ""


class Others:
    """The other ranks, as rank 0 sees them: they do with it what it says."""

    def __init__(self, comm) -> None:
        self.comm = comm

    def march_with(self, march: Callable, scene, *given, progress=None, **named):
        """march(comm, scene, *given, **named) on all ranks; scene and progress on rank 0 only.

        march : a function of a module, by whose name the others find it.
        """
        self.comm.bcast((march, given, named))
        return march(self.comm, scene, *given, progress=progress, **named)

    def dismiss(self) -> None:
        """Nothing more is marched."""
        self.comm.bcast((None, (), {}))


def follow(comm) -> None:
    """Another rank: march with rank 0 whenever it does, until it dismisses the others."""
    while True:
        march, given, named = comm.bcast(None)
        if march is None:
            return
        try:
            march(comm, None, *given, **named)
        except ValueError:  # raised on all ranks; rank 0 decides what becomes of it
            continue


Lead = Callable[[Others, dict, Callable[[float, str], None]], Done]


def main(arguments: list[str], lead: Lead) -> int:
    """Entry point of a rank.

    lead : rank 0's work, from the other ranks, the job and a report of progress to its files and
    numbers; what it refuses as a ValueError is refused by `do_on_ranks`.
    """
    if len(arguments) != 1:
        print("usage: mpirun -n N python -m MODULE JOB.json", file=sys.stderr)
        return _REFUSED
    from mpi4py import MPI

    children.end_with_parent()  # a rank's parent is mpirun
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8.0f ms %(message)s")
    comm = MPI.COMM_WORLD
    try:
        if comm.rank == 0:
            _lead(comm, json.loads(Path(arguments[0]).read_text(encoding="utf-8")), lead)
        else:
            follow(comm)
    except BaseException:
        logging.getLogger(__name__).exception("rank %d ends", comm.rank)
        comm.Abort(1)  # the others would wait for this rank
    return 0


def _lead(comm, job: dict, lead: Lead) -> None:
    out, told = Path(job["out"]), -POLL_SECONDS

    def advanced(share: float, text: str = "") -> None:
        nonlocal told
        now = time.monotonic()
        if now - told >= POLL_SECONDS:  # nobody looks more often
            write_text(out / PROGRESS_FILE, f"{share:.4f} {text}")
            told = now

    others = Others(comm)
    try:
        files, numbers = lead(others, job, advanced)
        done = {"files": [str(path) for path in files], "numbers": numbers}
    except ValueError as error:
        done = {"refused": str(error)}
    write_json(out / DONE_FILE, done)
    others.dismiss()
