"""The coarse space of two-level multigrid for the ten-node element: the four-node one, same cells.

It sees the jumps of stiffness from cell to cell as the ten-node element does, which aggregates of
nodes do not; only the halves of the edges are left to the smoother.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fem.discretisation import Discretisation
from fem.quadrature import EDGES


def vertex_interpolation(
    comm: MPI.Comm, discretisation: Discretisation, fixed: np.ndarray
) -> PETSc.Mat:
    """Displacement of the nodes from that of the vertices: (3 nodes, 3 vertices), for all ranks.

    A vertex has its own displacement, the middle of an edge the mean of its ends. fixed (n, 3):
    unknowns that no correction moves, as row or as column; a fixed vertex keeps its own entry, so
    that the coarse matrix stays regular.
    """
    d = discretisation
    owned, vertices = d.owned_nodes, d.mesh.input_vertices
    is_vertex = vertices >= 0
    here = comm.allgather(vertices[:owned][is_vertex[:owned]])
    total = sum(len(part) for part in here)
    number = np.empty(total, np.int64)
    number[np.concatenate(here)] = np.arange(total)

    ends = np.empty((len(vertices), 2), np.int64)  # local nodes
    ends[d.cells[:, 4:]] = d.cells[:, EDGES]
    ends[is_vertex] = np.flatnonzero(is_vertex)[:, None]
    ends, at_vertex, still = ends[:owned], is_vertex[:owned], fixed[:owned]

    share = np.where(at_vertex, 1.0, 0.5)[:, None, None] * ~np.swapaxes(fixed[ends], 1, 2)
    share[still] = 0.0
    share[at_vertex[:, None] & still] = 1.0
    column = 3 * number[vertices[ends]][:, None, :] + np.arange(3)[:, None]  # (owned, 3, 2)
    entries = np.ones(column.shape, bool)
    entries[at_vertex, :, 1] = False
    counts = np.where(at_vertex, 1, 2).repeat(3)
    matrix = PETSc.Mat().createAIJ(
        ((3 * owned, None), (3 * len(here[comm.rank]), 3 * total)),
        bsize=(3, 3),
        csr=(
            np.concatenate([[0], np.cumsum(counts)]).astype(PETSc.IntType),
            column[entries].astype(PETSc.IntType),
            share[entries],
        ),
        comm=comm,
    )
    matrix.assemble()
    return matrix
