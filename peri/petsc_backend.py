"""The same corrosion march on MPI ranks, for domains beyond one machine.

Every rank holds a block of the lattice and runs the embedded solver's kernels on it.  PETSc's
DMDA brings the neighbours' values, its multigrid cycle (PCMG over a hierarchy of DMDAs, the level
operators matrix-free) preconditions; conjugate gradients, kinetics, metal elimination and
saturation are the embedded code, with its sums taken over the ranks (processes.py).

Start it with one thread per rank:

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 mpirun -n 4 python my_march.py
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from mpi4py import MPI

from peri.corrosion.run import CorrosionResult
from peri.corrosion.run import corrode as march
from peri.corrosion.scene import CorrosionScene
from peri.influence import Stencil
from peri.lattice import Lattice
from peri.petsc_multigrid import Ghosts, Multigrid
from peri.processes import OneProcess, share_out, work_per_plane

_ARRAYS = ("metal", "domain", "metal_fraction")


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
    solver tolerance (tests/peri/test_petsc_backend.py).

    Raises
    ------
    ValueError
        If a rank's block would be narrower than the reach of the stencil, or as corrode does.
    """
    ranks = Ranks(comm, scene)
    try:
        result = march(scene, times, *options, processes=ranks, **named)
    finally:
        ranks.close()
    return result if ranks.is_root else None


class Ranks(OneProcess):
    """The blocks of a lattice on the ranks of a communicator, with PETSc's DMDA between them.

    Parameters
    ----------
    comm : mpi4py communicator
    scene : CorrosionScene
        Used on rank 0: its stencil, and its domain to share out the work evenly.

    edges : per lattice axis, first node of each block and the lattice's end.
    """

    def __init__(self, comm, scene: CorrosionScene | None) -> None:
        self.comm, self.is_root = comm, comm.rank == 0
        octant, spacing, work = self.on_root(
            lambda: (scene.stencil.octant, scene.stencil.spacing, work_per_plane(scene.domain))
        )
        reach = Stencil(octant, spacing).reach
        lengths = [w.size for w in work]
        reach = tuple(min(r, n - 1) for r, n in zip(reach, lengths, strict=True))
        self.edges = share_out(work, max(reach), comm.size)
        self.shape = tuple(e[-1] for e in self.edges)
        self.shape3 = (1,) * (3 - len(self.shape)) + self.shape
        procs = tuple(len(e) - 1 for e in self.edges)
        self._blocks = [
            tuple(slice(e[p], e[p + 1]) for e, p in zip(self.edges, place, strict=True))
            for place in itertools.product(*map(range, procs))
        ]
        block = self._blocks[comm.rank]
        lead = 3 - len(block)
        self.block_shape = tuple(b.stop - b.start for b in block)
        self.start = (0,) * lead + tuple(b.start for b in block)
        self._reach = (0,) * lead + reach
        self.grid = Ghosts(comm, self.edges, max(reach))
        self._levels: dict = {}
        self._multigrid: Multigrid | None = None

    # --- fields ---------------------------------------------------------------------------

    def local_scene(self, scene: CorrosionScene | None) -> CorrosionScene:
        """The scene of this rank's block, from rank 0's."""
        common = self.on_root(
            lambda: {f.name: getattr(scene, f.name) for f in fields(scene) if f.name not in _ARRAYS}
        )
        lattice, lead = common.pop("lattice"), 3 - len(self.shape)
        start = self.start[lead:]
        origin = np.add(lattice.origin, np.multiply(start, lattice.spacing))
        whole: dict[str, np.ndarray] = {}
        self.on_root(lambda: whole.update(
            metal=scene.metal, domain=scene.domain, cell_capacity=scene.capacity(),
            held=scene.refreshed(),
        ))  # fmt: skip
        names = ("metal", "domain", "cell_capacity", "held")
        mine = {name: self.scatter(whole.pop(name, None)) for name in names}
        block = Lattice(tuple(origin), lattice.spacing, self.block_shape)
        return _BlockScene(lattice=block, **common, **mine)

    def with_ghosts(self, values: np.ndarray, window) -> np.ndarray:
        """A padded field with the neighbours' values in its ghosts (collective)."""
        own = self.grid.own
        if window is None:
            window = tuple(slice(0, n) for n in own.shape)
        else:
            own[:] = 0.0
        inner, cut = [], []
        for w, r, m in zip(window, self._reach, self.grid.margin, strict=True):
            inner.append(slice(r, r + w.stop - w.start))
            cut.append(slice(w.start + m - r, w.stop + m + r))
        own[window] = values[tuple(inner)]
        return np.ascontiguousarray(self.grid.update()[tuple(cut)])

    def extent(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Nodes per axis of the whole lattice."""
        return self.shape

    def gather(self, values: np.ndarray) -> np.ndarray:
        """The whole lattice's array on rank 0, an empty one elsewhere."""
        values = np.ascontiguousarray(values)
        if not self.is_root:
            self.comm.Send(values, dest=0)
            return np.empty(0, values.dtype)
        out = np.empty(self.shape, values.dtype)
        out[self._blocks[0]] = values
        for rank, block in enumerate(self._blocks[1:], 1):
            part = np.empty(tuple(b.stop - b.start for b in block), values.dtype)
            self.comm.Recv(part, source=rank)
            out[block] = part
        return out

    def scatter(self, values: np.ndarray | None) -> np.ndarray:
        """This rank's block of rank 0's array."""
        kind = self.from_root(values.dtype if self.is_root else None)
        if not self.is_root:
            out = np.empty(self.block_shape, kind)
            self.comm.Recv(out, source=0)
            return out
        for rank, block in enumerate(self._blocks[1:], 1):
            self.comm.Send(np.ascontiguousarray(values[block]), dest=rank)
        return np.ascontiguousarray(values[self._blocks[0]])

    # --- numbers --------------------------------------------------------------------------

    def total(self, value: float) -> float:
        """Sum over the ranks."""
        return self.comm.allreduce(value, MPI.SUM)

    def largest(self, value: float) -> float:
        """Maximum over the ranks."""
        return self.comm.allreduce(value, MPI.MAX)

    def any(self, flag: bool) -> bool:
        """Whether the flag holds on any rank."""
        return bool(self.comm.allreduce(bool(flag), MPI.LOR))

    def from_root(self, value):
        """Rank 0's value."""
        return self.comm.bcast(value, root=0)

    def on_root(self, action):
        """The result of an action that rank 0 takes; what it raises is raised on all ranks."""
        outcome, error = None, None
        if self.is_root:
            try:
                outcome = action()
            except Exception as caught:
                error = caught
        outcome, error = self.from_root((outcome, error))
        if error is not None:
            raise error
        return outcome

    # --- preconditioner -------------------------------------------------------------------

    def multigrid(self, capacity, sink, conductance, spacing, coarsest_start) -> Multigrid:
        """PETSc's multigrid in place of solvers.LocalMultigrid (same arguments).

        One at a time: a new one closes the one before, on all ranks together (Python's garbage
        collection would not keep the ranks in step).
        """
        if self._multigrid is not None:
            self._multigrid.close()
        self._multigrid = Multigrid(self, capacity, sink, conductance, spacing, coarsest_start)
        return self._multigrid

    def level(self, factors: np.ndarray) -> Ghosts | None:
        """The lattice aggregated by `factors` (3,); None where that would cut through blocks."""
        key = tuple(int(f) for f in factors)
        if key not in self._levels:
            along = list(zip(self.edges, key[3 - len(self.edges) :], strict=True))
            whole = all(n % f == 0 for edges, f in along for n in edges[:-1])
            coarse = [[-(-n // f) for n in edges] for edges, f in along]
            self._levels[key] = Ghosts(self.comm, coarse) if whole else None
        return self._levels[key]

    def close(self) -> None:
        """Free PETSc's objects (collective)."""
        for part in (self._multigrid, *self._levels.values(), self.grid):
            if part is not None:
                part.close()


@dataclass(frozen=True)
class _BlockScene(CorrosionScene):
    """A rank's block of a scene; what needs the whole lattice was computed on rank 0."""

    cell_capacity: np.ndarray | None = field(default=None, repr=False)
    held: np.ndarray | None = field(default=None, repr=False)

    def capacity(self) -> np.ndarray:
        """Relative volumes of the block's cells."""
        return self.cell_capacity

    def refreshed(self) -> np.ndarray:
        """The block's nodes held at zero."""
        return self.held
