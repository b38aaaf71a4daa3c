"""A rank's share of the problem as flat arrays: gradients, volumes, sparsity, thread slabs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from fem.compat import LocalMesh
from fem.quadrature import Element


@dataclass(frozen=True)
class Discretisation:
    """Everything the assembly reads. Cells are sorted along z, so that slabs can run in parallel."""

    element: Element
    cells: np.ndarray  # (nl, nn) int32 local nodes
    original_cells: np.ndarray  # (nl,) position in the mesh of the kept cells
    owned: np.ndarray  # (nl,) bool
    coordinates: np.ndarray  # (n, 3) [m]
    gradients: np.ndarray  # (nl, nq, nn, 3) reference-configuration gradients [1/m]
    volumes: np.ndarray  # (nl, nq) [m^3]
    row_start: np.ndarray  # (owned nodes + 1,) block rows
    columns: np.ndarray  # (blocks,) local node of each block
    position: np.ndarray  # (nl, nn * nn) block of each node pair, -1 for rows of other ranks
    slabs: list[tuple[int, int]]  # cell ranges; those with even, then those with odd number
    mesh: LocalMesh

    @property
    def owned_nodes(self) -> int:
        """Nodes whose rows this rank holds."""
        return self.mesh.owned_nodes


def build(mesh: LocalMesh, element: Element, threads: int) -> Discretisation:
    """Prepare a local mesh for assembly with up to `threads` threads."""
    corners = mesh.coordinates[mesh.cells[:, :4]]
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    cells = np.ascontiguousarray(mesh.cells[order])
    corners = corners[order]
    jacobians = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # dX/dxi, (nl, 3, 3)
    determinants = np.linalg.det(jacobians)
    if len(determinants) and not np.all(np.abs(determinants) > 0):
        raise ValueError("the mesh has a cell of zero volume; every cell must have a positive one")
    inverse = np.linalg.inv(jacobians)
    gradients = np.einsum("qai,cij->cqaj", element.reference_gradients(), inverse, optimize=True)
    volumes = np.abs(determinants)[:, None] * element.weights[None]
    row_start, columns = _block_rows(cells, mesh.owned_nodes, len(mesh.coordinates))
    position = _block_positions(cells, mesh.owned_nodes, row_start, columns)
    return Discretisation(
        element=element,
        cells=cells,
        original_cells=mesh.original_cells[order],
        owned=order < mesh.owned_cells,
        coordinates=mesh.coordinates,
        gradients=np.ascontiguousarray(gradients),
        volumes=volumes,
        row_start=row_start,
        columns=columns,
        position=position,
        slabs=_slabs(cells, len(mesh.coordinates), threads),
        mesh=mesh,
    )


def _slabs(cells: np.ndarray, nodes: int, threads: int) -> list[tuple[int, int]]:
    """2 t ranges of cells such that ranges of equal parity share no node; fewer if impossible."""
    for count in range(threads, 0, -1):
        bounds = np.linspace(0, len(cells), 2 * count + 1).astype(int)
        ranges = [(int(a), int(b)) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        if count == 1:
            return [(0, len(cells))]
        clash = False
        for parity in (0, 1):
            seen = np.zeros(nodes, bool)
            for start, stop in ranges[parity::2]:
                mine = np.unique(cells[start:stop])
                clash = clash or bool(seen[mine].any())
                seen[mine] = True
        if not clash:
            return ranges
    return [(0, len(cells))]


@njit(cache=True, nogil=True)
def _incident(cells, nodes):
    count = np.zeros(nodes + 1, np.int64)
    for c in range(cells.shape[0]):
        for a in range(cells.shape[1]):
            count[cells[c, a] + 1] += 1
    start = np.cumsum(count)
    fill = start[:-1].copy()
    incident = np.empty(start[-1], np.int32)
    for c in range(cells.shape[0]):
        for a in range(cells.shape[1]):
            node = cells[c, a]
            incident[fill[node]] = c
            fill[node] += 1
    return start, incident


@njit(cache=True, nogil=True)
def _block_rows(cells, owned_nodes, nodes):
    """Sorted neighbours of every owned node: (row_start, columns)."""
    start, incident = _incident(cells, nodes)
    marker = np.full(nodes, -1, np.int64)
    row_start = np.zeros(owned_nodes + 1, np.int64)
    for i in range(owned_nodes):
        found = 0
        for k in range(start[i], start[i + 1]):
            for node in cells[incident[k]]:
                if marker[node] != i:
                    marker[node] = i
                    found += 1
        row_start[i + 1] = row_start[i] + found
    marker[:] = -1
    columns = np.empty(row_start[-1], np.int32)
    for i in range(owned_nodes):
        at = row_start[i]
        for k in range(start[i], start[i + 1]):
            for node in cells[incident[k]]:
                if marker[node] != i:
                    marker[node] = i
                    columns[at] = node
                    at += 1
        columns[row_start[i] : row_start[i + 1]].sort()
    return row_start, columns


@njit(cache=True, nogil=True)
def _block_positions(cells, owned_nodes, row_start, columns):
    nn = cells.shape[1]
    position = np.full((cells.shape[0], nn * nn), -1, np.int64)
    for c in range(cells.shape[0]):
        for a in range(nn):
            row = cells[c, a]
            if row >= owned_nodes:
                continue
            neighbours = columns[row_start[row] : row_start[row + 1]]
            for b in range(nn):
                position[c, a * nn + b] = row_start[row] + np.searchsorted(neighbours, cells[c, b])
    return position.astype(np.int32)
