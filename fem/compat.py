"""Every call that depends on the version of dolfinx.

The rest of the package sees a `LocalMesh` of NumPy arrays. Tried with dolfinx 0.5.2 (Debian
12) and 0.9.0 (Debian 13, by `.ci/try-newer-dolfinx`); other versions are refused.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LocalMesh:
    """The part of a distributed mesh that one rank holds: owned cells first, then ghost cells.

    Ghosts are all cells that share a vertex with an owned one, so that every row of an owned node
    can be assembled without communication.
    """

    cells: np.ndarray  # (nl, nodes per cell) local node numbers
    original_cells: np.ndarray  # (nl,) position in the input
    owned_cells: int
    coordinates: np.ndarray  # (n, 3) of the local nodes, owned first [m]
    input_vertices: np.ndarray  # (n,) vertex number of the input, -1 for mid-edge nodes
    owned_nodes: int
    global_nodes: np.ndarray  # (n,) global numbers
    total_nodes: int
    mesh: Any  # dolfinx mesh and space, for output
    space: Any


def distribute(
    comm: MPI.Comm,
    points: np.ndarray | None,
    cells: np.ndarray | None,
    destinations: tuple[np.ndarray, np.ndarray] | None,
    order: int,
) -> LocalMesh:
    """Distribute a tetrahedral mesh and build its Lagrange space.

    points (n, 3) and cells (nc, 4) are read on rank 0 only. destinations: (ranks, offsets) of an
    adjacency list that names for each cell its owner first and then the ranks that ghost it.
    """
    if comm.rank == 0:
        ranks, offsets = destinations
        ranks, offsets = np.asarray(ranks, np.int32), np.asarray(offsets, np.int32)
        plan = _adjacency(ranks, offsets)
        points = np.ascontiguousarray(points, float)
        cells = np.ascontiguousarray(cells, np.int64)
    else:
        plan = _adjacency(np.zeros(0, np.int32), np.zeros(1, np.int32))
        points, cells = np.zeros((0, 3)), np.zeros((0, 4), np.int64)
    mesh, space = _make(comm, points, cells, plan, order)
    cell_map = mesh.topology.index_map(3)
    local_cells = cell_map.size_local + cell_map.num_ghosts
    original = np.array(mesh.topology.original_cell_index, dtype=np.int64)[:local_cells]
    dofmap = _rows(space.dofmap.list, local_cells)
    corners = _rows(mesh.geometry.dofmap, local_cells)
    node_map = space.dofmap.index_map
    nodes = node_map.size_local + node_map.num_ghosts
    global_nodes = node_map.local_to_global(np.arange(nodes, dtype=np.int32))
    vertices = np.full(nodes, -1, dtype=np.int64)
    vertices[dofmap[:, :4]] = np.array(mesh.geometry.input_global_indices, np.int64)[corners]
    return LocalMesh(
        cells=dofmap,
        original_cells=original,
        owned_cells=cell_map.size_local,
        coordinates=np.array(space.tabulate_dof_coordinates())[:nodes],
        input_vertices=vertices,
        owned_nodes=node_map.size_local,
        global_nodes=np.asarray(global_nodes, dtype=np.int64),
        total_nodes=node_map.size_global,
        mesh=mesh,
        space=space,
    )


def _rows(adjacency: Any, rows: int) -> np.ndarray:
    """A dofmap as (rows, width) int32: an adjacency list up to 0.7, an array since 0.8."""
    return np.array(getattr(adjacency, "array", adjacency), dtype=np.int32).reshape(rows, -1)


def _adjacency(data: np.ndarray, offsets: np.ndarray) -> Any:
    from dolfinx import graph

    make = getattr(graph, "create_adjacencylist", None) or graph.adjacencylist  # renamed in 0.8
    return make(data, offsets)


def _make(comm: MPI.Comm, points: np.ndarray, cells: np.ndarray, plan: Any, order: int) -> tuple:
    """Mesh with the cells where `plan` has them, and its Lagrange space of vectors."""
    make = _make_0_5 if check_version().startswith("0.5.") else _make_0_9
    return make(comm, points, cells, plan, order)


def check_version() -> str:
    """Version of the installed dolfinx; ImportError where there is none or one not tried."""
    import dolfinx

    version = str(dolfinx.__version__)
    if version.split(".")[:2] not in (["0", "5"], ["0", "9"]):
        raise ImportError(
            f"dolfinx is {version}; fem/compat.py knows 0.5 (Debian 12) and 0.9 (Debian 13)"
        )
    return version


def _make_0_5(comm, points, cells, plan, order) -> tuple:
    import dolfinx
    import ufl
    from dolfinx import cpp

    domain = ufl.Mesh(ufl.VectorElement("Lagrange", "tetrahedron", 1))
    geometry = cpp.fem.CoordinateElement(cpp.mesh.CellType.tetrahedron, 1)
    bare = cpp.mesh.create_mesh(
        comm,
        cpp.graph.AdjacencyList_int64(cells),
        geometry,
        points,
        cpp.mesh.GhostMode.shared_facet,
        lambda *_: plan,
    )
    domain._ufl_cargo = bare
    mesh = dolfinx.mesh.Mesh(bare, domain)
    return mesh, dolfinx.fem.VectorFunctionSpace(mesh, ("Lagrange", order))


def _make_0_9(comm, points, cells, plan, order) -> tuple:
    import basix.ufl
    import dolfinx

    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    mesh = dolfinx.mesh.create_mesh(comm, cells, points, element, lambda *_: plan)
    return mesh, dolfinx.fem.functionspace(mesh, ("Lagrange", order, (3,)))
