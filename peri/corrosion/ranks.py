"""The same corrosion march on MPI ranks, for domains beyond one machine.

Start it with one thread per rank:

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 mpirun -n 4 python my_march.py
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

from peri.corrosion.run import CorrosionResult
from peri.corrosion.run import corrode as march
from peri.corrosion.scene import CorrosionScene
from peri.parallel.ranks import Ranks


def corrode(
    scene: CorrosionScene | None, times: Sequence[float], *options, comm=MPI.COMM_WORLD, **named
) -> CorrosionResult | None:
    """March a corrosion scene on all ranks of `comm`; see corrosion.corrode.

    Parameters
    ----------
    scene : CorrosionScene
        Needed on rank 0 only, which deals it out; the others may pass None.
    times, options, named :
        As for corrosion.corrode, the same on every rank; a checkpoint is written and read by
        rank 0 and does not depend on the number of ranks.

    Returns
    -------
    CorrosionResult on rank 0, None elsewhere.  It agrees with the embedded solver's to the
    solver tolerance (tests/peri/parallel/test_ranks.py).

    Raises
    ------
    ValueError
        If a rank's block would be narrower than the reach of the stencil, or as corrode does.
    """
    given = (scene.stencil, scene.domain) if comm.rank == 0 else (None, None)
    ranks = Ranks(comm, *given)
    try:
        result = march(scene, times, *options, processes=ranks, **named)
    finally:
        ranks.close()
    return result if ranks.is_root else None
