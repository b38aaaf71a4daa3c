"""A scene of localised corrosion on MPI ranks: rank 0 does the run, all of them march."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pipeline.scenes.files import read_scene
from pipeline.scenes.outcome import Marchers
from pipeline.scenes.writing import march_and_write
from pipeline.stages.march_on_ranks import march_metal
from pipeline.stages.on_ranks import Done, Others, do_on_ranks, main


def march_on_ranks(
    name: str,
    scene_file: Path,
    checkpoint: Path,
    resume: bool,
    ranks: int,
    advanced: Callable[[float, str], None],
    keep: tuple[int, ...] = (),
) -> Done:
    """`march_and_write` for the scene.json of a run folder on so many ranks.

    advanced, keep, and what it raises: as `do_on_ranks`.
    """
    job = {
        "name": name, "scene": str(scene_file), "checkpoint": str(checkpoint), "resume": resume,
    }  # fmt: skip
    return do_on_ranks(__name__, job, scene_file.parent, ranks, advanced, keep)


def march_couple(comm, scene, times, renewal, **named):
    """peri.coupled.galvanic_ranks.corrode on all ranks of a communicator."""
    from peri.coupled import galvanic_ranks

    return galvanic_ranks.corrode(scene, times, renewal, comm=comm, **named)


def _lead(others: Others, job: dict, advanced: Callable[[float, str], None]) -> Done:
    """Rank 0: the scene and its files."""
    scene = read_scene(Path(job["scene"]))
    by = Marchers(*(partial(others.march_with, march) for march in (march_metal, march_couple)))
    return march_and_write(
        Path(job["out"]), scene.name, scene.prepared(), [time.seconds for time in scene.times],
        checkpoint=Path(job["checkpoint"]), resume=job["resume"], progress=advanced, by=by,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], _lead))
