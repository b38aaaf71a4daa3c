"""The march of a couple on MPI ranks: the root marches, all of them solve for the potential.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 mpirun -n 4 python my_couple.py

Metal, patches, ions and files are the root's; the liquid's potential, on which the time goes, lies
on the blocks of all ranks.  What the root asks of its potential problem it announces first, and the
others do the same on their blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np
from mpi4py import MPI

from peri.coupled.galvanic import GalvanicResult, Renewal
from peri.coupled.galvanic import corrode as march
from peri.coupled.galvanic_scene import ROBIN, GalvanicScene
from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import Operator
from peri.parallel.ranks import Ranks
from peri.transport.potential.electrostatics import PotentialField, PotentialProblem

_END, _PLACE = "end", "place"


class LedPotential(PotentialProblem):
    """The root's potential problem, whose calls the other ranks make, too (`_follow`)."""

    def __init__(self, ranks: Ranks, lattice: Lattice, stencil: Stencil, *given, **named) -> None:
        self._ranks, self._announces = ranks, False
        ranks.comm.bcast((_PLACE, lattice, stencil))
        super().__init__(lattice, stencil, *given, processes=ranks, **named)
        self._announces = True

    @contextmanager
    def _announced(self, name: str, *given: object) -> Iterator[None]:
        """Tell the others what comes; what that calls in turn is theirs already."""
        outer, self._announces = self._announces, False
        if outer:
            self._ranks.comm.bcast((name, *given))
        try:
            yield
        finally:
            self._announces = outer

    def conduct(
        self, conductivity: float | np.ndarray | None, operator: Operator | None = None
    ) -> None:
        """See PotentialProblem."""
        with self._announced("conduct", None):
            super().conduct(conductivity, operator)

    def recede(self, depth: np.ndarray) -> None:
        """See PotentialProblem."""
        with self._announced("recede", depth):
            super().recede(depth)

    def solve(self, guess: np.ndarray | None = None, tolerance: float = 1e-9) -> PotentialField:
        """See PotentialProblem."""
        with self._announced("solve", None, tolerance):
            return super().solve(guess, tolerance)

    def level(self) -> PotentialField:
        """See PotentialProblem."""
        with self._announced("level"):
            return super().level()


def _follow(ranks: Ranks) -> BaseException | None:
    """Another rank's part of what the root announces, until it ends; the error that ended it."""
    problem: PotentialProblem | None = None
    while True:
        word, *given = ranks.comm.bcast(None)
        if word == _END:
            return given[0]
        try:
            if word == _PLACE:
                problem = PotentialProblem(*given, None, (), None, processes=ranks)
            else:
                getattr(problem, word)(*given)
        except (ValueError, ArithmeticError):
            continue  # raised on all ranks; the root decides what becomes of it


def corrode(
    scene: GalvanicScene | None,
    times: Sequence[float],
    renewal: Renewal | None = None,
    *,
    comm=MPI.COMM_WORLD,
    **named,
) -> GalvanicResult | None:
    """March a couple on all ranks of `comm`; see galvanic.corrode.

    Parameters
    ----------
    scene : GalvanicScene
        Needed on rank 0 only, as is everything else; a checkpoint does not depend on the number of
        ranks.

    Returns
    -------
    GalvanicResult on rank 0, None elsewhere.  It agrees with that of one process to 1e-10
    (tests/peri/coupled/test_galvanic_ranks.py).

    Raises
    ------
    ValueError
        For mirror nodes; if a rank's block would be narrower than the reach of the stencil; as
        galvanic.corrode does, on all ranks.
    """
    root = comm.rank == 0
    alone = comm.bcast(scene is not None and scene.robin != ROBIN[0])
    if alone:
        raise ValueError("robin: 'as_published' is solved in one process, not on ranks")
    whole = (scene.stencil, np.ones(scene.lattice.shape, bool)) if scene and root else (None, None)
    ranks = Ranks(comm, *whole)
    error: BaseException | None = None
    try:
        if not root:
            error = _follow(ranks)
            if error is not None:
                raise error
            return None
        assert scene is not None
        return march(scene, times, renewal, between=partial(LedPotential, ranks), **named)
    except BaseException as caught:
        error = caught
        raise
    finally:
        if root:
            comm.bcast((_END, error))
        ranks.close()
