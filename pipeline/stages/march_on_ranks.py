"""The corrosion stage of a run on MPI ranks: one large march, shared out by PETSc."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pipeline.scene.scene import Scene, scene_from_json
from pipeline.stages.on_ranks import Done, Others, do_on_ranks, follow, main


def corrode_on_ranks(
    scene: Scene,
    alloy: str,
    geometry: Path,
    out: Path,
    ranks: int,
    advanced: Callable[[float, str], None],
    keep: tuple[int, ...] = (),
) -> Done:
    """`corrosion.corrode_in_folder` on so many ranks; the same files and numbers.

    advanced, keep, and what it raises: as `do_on_ranks`.
    """
    job = {"name": alloy, "scene": scene.to_json(), "alloy": alloy, "geometry": str(geometry)}
    return do_on_ranks(__name__, job, out, ranks, advanced, keep)


def march_metal(comm, scene, times, stepping, **named):
    """peri.corrosion.ranks.corrode on all ranks of a communicator."""
    from peri.corrosion import ranks

    return ranks.corrode(scene, times, stepping, comm=comm, **named)


def march_ions(comm, scene, ions, times, stepping, **named):
    """ions.corrode_with_ions on all ranks of a communicator."""
    from peri.omissions.planning import corrode_lean
    from peri.parallel.ranks import Ranks
    from pipeline.stages.ions import corrode_with_ions

    given = (scene.stencil, scene.domain) if comm.rank == 0 else (None, None)
    ranks = Ranks(comm, *given)

    def alone(scene, times, stepping, **options):
        found = []

        def lean() -> None:
            others = Others(comm)
            by = partial(others.march_with, march_metal)
            try:
                found.extend(corrode_lean(scene, times, stepping, march_by=by, **options))
            finally:
                others.dismiss()

        if comm.rank:
            follow(comm)
        ranks.on_root(lean)  # what it raises is raised on all
        return tuple(found) or (None, [])

    try:
        return corrode_with_ions(
            scene, ions, times, stepping, processes=ranks, alone=alone, **named
        )
    finally:
        ranks.close()


def _lead(others: Others, job: dict, advanced: Callable[[float, str], None]) -> Done:
    """Rank 0: the stage."""
    from pipeline.stages.corrosion import corrode_in_folder

    return corrode_in_folder(
        scene_from_json(job["scene"]), job["alloy"], Path(job["geometry"]), Path(job["out"]),
        advanced, march_by=partial(others.march_with, march_metal),
        with_ions_by=partial(others.march_with, march_ions),
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], _lead))
