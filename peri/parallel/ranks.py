"""The blocks of a lattice on MPI ranks, for domains beyond one machine.

Every rank holds a block of the lattice and runs the embedded solver's kernels on it.  PETSc's
DMDA brings the neighbours' values, its multigrid cycle (PCMG over a hierarchy of DMDAs, the level
operators matrix-free) preconditions; conjugate gradients, kinetics, metal elimination and
saturation are the embedded code, with its sums taken over the ranks (engine/processes.py).
"""

from __future__ import annotations

import itertools
import weakref

import numpy as np
from mpi4py import MPI

from peri.engine.influence import Stencil
from peri.engine.processes import LEAST_SINGULAR, OneProcess, share_out, work_per_plane
from peri.parallel.multigrid import Cycle, Ghosts, Multigrid


class Ranks(OneProcess):
    """The blocks of a lattice on the ranks of a communicator, with PETSc's DMDA between them.

    Parameters
    ----------
    comm : mpi4py communicator
    stencil : Stencil
    domain : bool array of the lattice's shape
        Nodes that exist, to share out the work evenly.  Both are used on rank 0 only; the others
        may pass None.

    edges : per lattice axis, first node of each block and the lattice's end.
    """

    whole = False

    def __init__(self, comm, stencil: Stencil | None, domain: np.ndarray | None) -> None:
        self.comm, self.is_root = comm, comm.rank == 0
        octant, spacing, work = self.on_root(
            lambda: (stencil.octant, stencil.spacing, work_per_plane(domain))
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
        self._cycles: list[tuple[weakref.ref[Multigrid], Cycle]] = []

    # --- fields ---------------------------------------------------------------------------

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

    def _reduced(self, value, operation):
        mine = np.array(value, float)  # as numbers: pickled ones take several messages
        out = np.empty_like(mine)
        self.comm.Allreduce(mine, out, operation)
        return out if out.ndim else float(out)

    def total(self, value: float) -> float:
        """Sum over the ranks."""
        return self._reduced(value, MPI.SUM)

    def added(self, values: np.ndarray) -> np.ndarray:
        """Sums over the ranks of each entry; the same on all of them to the last bit."""
        out = np.empty_like(values)
        self.comm.Reduce(np.ascontiguousarray(values), out, MPI.SUM, root=0)
        self.comm.Bcast(out, root=0)
        return out

    def largest(self, value):
        """Maximum over the ranks, of an array entry by entry."""
        return self._reduced(value, MPI.MAX)

    def norm(self, values: np.ndarray) -> float:
        """Root of the sum of squares of a field over the ranks."""
        return float(np.sqrt(self.total(float(np.vdot(values, values)))))

    def row_norms(self, rows: np.ndarray) -> np.ndarray:
        """The same of every row, (R,)."""
        return np.sqrt(self.added(np.einsum("rn,rn->r", rows, rows)))

    def least_squares(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Each rank brings its rows into a triangle; the triangles have the same solution."""
        triangle = np.linalg.qr(np.column_stack([matrix, right]), mode="r")
        parts = np.vstack(self.comm.allgather(triangle))
        found = np.linalg.lstsq(parts[:, :-1], parts[:, -1], rcond=LEAST_SINGULAR)[0]
        return self.from_root(found)

    def first(self, flag: bool) -> bool:
        """Whether this is the first of the ranks that the flag holds on."""
        flags = self.comm.allgather(bool(flag))
        return bool(flag) and flags.index(True) == self.comm.rank

    def any(self, flag: bool) -> bool:
        """Whether the flag holds on any rank."""
        return self.largest(float(bool(flag))) > 0

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

    def together(self, action):
        """The result of each rank's own action; the first rank's error is raised on all."""
        outcome, error = None, None
        try:
            outcome = action()
        except ArithmeticError as caught:
            error = caught
        if self.any(error is not None):
            raise next(e for e in self.comm.allgather(error) if e is not None)
        return outcome

    # --- preconditioner -------------------------------------------------------------------

    def multigrid(self, sink, faces, spacing, coarsest_start) -> Multigrid:
        """PETSc's multigrid in place of engine.multigrid.LocalMultigrid (same arguments).

        What it holds of PETSc is freed once no rank has it any more, on all of them together when
        the next one is made: Python's garbage collection would not keep the ranks in step.
        """
        unused = np.array([made() is None for made, _ in self._cycles], float)
        unused = self._reduced(unused, MPI.MIN) > 0
        for (_, cycle), gone in zip(self._cycles, unused, strict=True):
            if gone:
                cycle.close()
        self._cycles = [c for c, gone in zip(self._cycles, unused, strict=True) if not gone]
        made = Multigrid(self, sink, faces, spacing, coarsest_start)
        self._cycles.append((weakref.ref(made), made.held))
        return made

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
        cycles = (cycle for _, cycle in self._cycles)
        for part in (*cycles, *self._levels.values(), self.grid):
            if part is not None:
                part.close()
        self._cycles = []
