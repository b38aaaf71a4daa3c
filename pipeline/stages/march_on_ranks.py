"""The corrosion stage of a run on MPI ranks: one large march, shared out by PETSc.

`corrode_on_ranks` starts `mpirun -n N python -m pipeline.stages.march_on_ranks JOB.json`.  Rank 0
does the whole stage as one process would; the others wait until it marches and march with it.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from pipeline.record import children, interruption
from pipeline.record.machine import child_environment, mpirun
from pipeline.record.run_folder import write_json, write_text
from pipeline.scene.scene import Scene, scene_from_json

JOB_FILE = "march-job.json"
DONE_FILE = "march-done.json"
PROGRESS_FILE = "march.progress"
LOG_FILE = "march.log"
POLL_SECONDS = 0.2
_REFUSED = 2


class MarchError(RuntimeError):
    """A march on ranks that ended without a result; the message says where its log is."""


def corrode_on_ranks(
    scene: Scene,
    alloy: str,
    geometry: Path,
    out: Path,
    ranks: int,
    advanced: Callable[[float, str], None],
    keep: tuple[int, ...] = (),
) -> tuple[list[Path], dict[str, object]]:
    """`corrosion.corrode_in_folder` on so many ranks; the same files and numbers.

    keep: descriptors that the ranks inherit, the lock of the run folder.

    Raises
    ------
    ValueError
        As that does.
    MarchError
        Where the ranks end in another way.
    """
    job, log = out / JOB_FILE, out / LOG_FILE
    (out / DONE_FILE).unlink(missing_ok=True)
    places = {"geometry": str(geometry), "out": str(out)}
    write_json(job, {"scene": scene.to_json(), "alloy": alloy, **places})
    command = [*mpirun(ranks, f"--ranks {ranks}"), sys.executable, "-m", __spec__.name, str(job)]
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
            f"march of {alloy} on {ranks} ranks ended with {how} ({last}; log: {log})"
        ) from None
    if "refused" in done:
        raise ValueError(done["refused"])
    log.unlink(missing_ok=True)
    return [Path(path) for path in done["files"]], done["numbers"]


def _progress(out: Path) -> tuple[float, str]:
    try:
        share, _, text = (out / PROGRESS_FILE).read_text(encoding="utf-8").partition(" ")
        return float(share), text
    except (OSError, ValueError):
        return 0.0, ""


def _lead(comm, content: dict) -> None:
    """Rank 0: the stage; every march is announced to the others first."""
    from peri.corrosion import ranks
    from pipeline.stages.corrosion import corrode_in_folder

    out = Path(content["out"])

    def march(scene, times: Sequence[float], stepping, **named: object):
        comm.bcast(("march", list(map(float, times)), stepping, _shared(named)))
        return ranks.corrode(scene, times, stepping, comm=comm, **named)

    def march_with_ions(scene, ions, times: Sequence[float], stepping, **named: object):
        comm.bcast(("march with ions", ions, list(map(float, times)), stepping, _shared(named)))
        return _with_ions(comm, scene, ions, times, stepping, alone_by=march, **named)

    def advanced(share: float, text: str = "") -> None:
        write_text(out / PROGRESS_FILE, f"{share:.4f} {text}")

    try:
        files, numbers = corrode_in_folder(
            scene_from_json(content["scene"]), content["alloy"], Path(content["geometry"]), out,
            advanced, march_by=march, with_ions_by=march_with_ions,
        )  # fmt: skip
        done = {"files": [str(path) for path in files], "numbers": numbers}
    except ValueError as error:
        done = {"refused": str(error)}
    write_json(out / DONE_FILE, done)
    comm.bcast(("end",))


def _shared(named: dict[str, object]) -> dict[str, object]:
    """The options of a march that all ranks have."""
    return {name: value for name, value in named.items() if name != "progress"}


def _with_ions(comm, scene, ions, times, stepping, alone_by=None, **named):
    """ions.corrode_with_ions on all ranks; alone_by: what rank 0 marches the metal alone with."""
    from peri.omissions.planning import corrode_lean
    from peri.parallel.ranks import Ranks
    from pipeline.stages.ions import corrode_with_ions

    given = (scene.stencil, scene.domain) if comm.rank == 0 else (None, None)
    ranks = Ranks(comm, *given)

    def alone(scene, times, stepping, **options):
        found = []

        def lean() -> None:
            try:
                found.extend(corrode_lean(scene, times, stepping, march_by=alone_by, **options))
            finally:
                comm.bcast(("end",))

        if comm.rank:
            _follow(comm)
        ranks.on_root(lean)  # what it raises is raised on all
        return tuple(found) or (None, [])

    try:
        return corrode_with_ions(
            scene, ions, times, stepping, processes=ranks, alone=alone, **named
        )
    finally:
        ranks.close()


def _follow(comm) -> None:
    """Another rank: march with rank 0 whenever it does."""
    from peri.corrosion import ranks

    while True:
        word, *given = comm.bcast(None)
        if word == "end":
            return
        *given, named = given
        try:
            if word == "march":
                ranks.corrode(None, *given, comm=comm, **named)
            else:
                _with_ions(comm, None, *given, **named)
        except ValueError:  # raised on all ranks; rank 0 decides what becomes of it
            continue


def main(arguments: list[str]) -> int:
    """Entry point of a rank."""
    if len(arguments) != 1:
        print("usage: python -m pipeline.stages.march_on_ranks JOB.json", file=sys.stderr)
        return _REFUSED
    from mpi4py import MPI

    children.end_with_parent()  # a rank's parent is mpirun
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8.0f ms %(message)s")
    comm = MPI.COMM_WORLD
    try:
        if comm.rank == 0:
            _lead(comm, json.loads(Path(arguments[0]).read_text(encoding="utf-8")))
        else:
            _follow(comm)
    except BaseException:
        logging.getLogger(__name__).exception("rank %d ends", comm.rank)
        comm.Abort(1)  # the others would wait for this rank
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
