"""A rank's share of the problem as flat arrays: gradients, volumes, sparsity, thread slabs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from fem.compat import LocalMesh
from fem.quadrature import Element


@dataclass(frozen=True)
class Discretisation:
    """Everything the assembly reads.

    Cells come in groups over which the volume change may be averaged: patches of the four-node
    F-bar element, single cells otherwise. Groups are sorted along z, so that slabs of them can be
    assembled in parallel.
    """

    element: Element
    cells: np.ndarray  # (nl, nn) int32 local nodes
    original_cells: np.ndarray  # (nl,) position in the mesh of the kept cells
    owned: np.ndarray  # (nl,) bool
    coordinates: np.ndarray  # (n, 3) [m]
    gradients: np.ndarray  # (nl, nq, nn, 3) reference-configuration gradients [1/m]
    volumes: np.ndarray  # (nl, nq) [m^3]
    groups: Groups
    row_start: np.ndarray  # (owned nodes + 1,) block rows
    columns: np.ndarray  # (blocks,) local node of each block
    position: np.ndarray  # block of each node pair of each group, -1 for rows of other ranks
    slabs: list[tuple[int, int]]  # ranges of groups; those with even, then those with odd number
    mesh: LocalMesh

    @property
    def owned_nodes(self) -> int:
        """Nodes whose rows this rank holds."""
        return self.mesh.owned_nodes


@dataclass(frozen=True)
class Groups:
    """Cells cell_start[g]:cell_start[g+1] and nodes nodes[node_start[g]:node_start[g+1]] of g."""

    cell_start: np.ndarray  # (ng + 1,)
    node_start: np.ndarray  # (ng + 1,)
    nodes: np.ndarray  # local nodes
    place: np.ndarray  # (nl, nn) number of a cell's node within its group
    pair_start: np.ndarray  # (ng + 1,) into the positions: nodes squared per group


def build(mesh: LocalMesh, element: Element, groups: np.ndarray, threads: int) -> Discretisation:
    """Prepare a local mesh for assembly with `threads` threads; groups: (nl,) patch numbers."""
    height = mesh.coordinates[mesh.cells[:, :4], 2].mean(axis=1)
    _, group = np.unique(groups, return_inverse=True)
    group_height = np.bincount(group, height) / np.maximum(np.bincount(group), 1)
    order = np.lexsort((mesh.original_cells, groups, group_height[group]))
    cells = np.ascontiguousarray(mesh.cells[order])
    corners = mesh.coordinates[cells[:, :4]]
    jacobians = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # dX/dxi, (nl, 3, 3)
    determinants = np.linalg.det(jacobians)
    if len(determinants) and not np.all(np.abs(determinants) > 0):
        raise ValueError("the mesh has a cell of zero volume; every cell must have a positive one")
    inverse = np.linalg.inv(jacobians)
    gradients = np.einsum("qai,cij->cqaj", element.reference_gradients(), inverse, optimize=True)
    volumes = np.abs(determinants)[:, None] * element.weights[None]
    grouped = _group(cells, groups[order])
    nodes = len(mesh.coordinates)
    row_start, columns = _block_rows(grouped.node_start, grouped.nodes, mesh.owned_nodes, nodes)
    position = _block_positions(
        grouped.node_start, grouped.nodes, grouped.pair_start, mesh.owned_nodes, row_start, columns
    )
    return Discretisation(
        element=element,
        cells=cells,
        original_cells=mesh.original_cells[order],
        owned=order < mesh.owned_cells,
        coordinates=mesh.coordinates,
        gradients=np.ascontiguousarray(gradients),
        volumes=volumes,
        groups=grouped,
        row_start=row_start,
        columns=columns,
        position=position,
        slabs=_slabs(grouped, nodes, threads),
        mesh=mesh,
    )


def _group(cells: np.ndarray, groups: np.ndarray) -> Groups:
    """Groups of consecutive cells with equal number."""
    first = np.flatnonzero(np.concatenate([[True], groups[1:] != groups[:-1]]))[: len(cells)]
    cell_start = np.concatenate([first, [len(cells)]]).astype(np.int64)
    node_start, nodes, place = _group_nodes(cells, cell_start)
    size = np.diff(node_start)
    pair_start = np.concatenate([[0], np.cumsum(size * size)])
    return Groups(cell_start, node_start, nodes, place, pair_start)


@njit(cache=True, nogil=True)
def _group_nodes(cells, cell_start):
    groups = cell_start.size - 1
    node_start = np.zeros(groups + 1, np.int64)
    nodes = np.empty(cells.size, np.int32)
    place = np.empty(cells.shape, np.int32)
    for g in range(groups):
        begin = end = node_start[g]
        for c in range(cell_start[g], cell_start[g + 1]):
            for a in range(cells.shape[1]):
                at = begin
                while at < end and nodes[at] != cells[c, a]:
                    at += 1
                if at == end:
                    nodes[end] = cells[c, a]
                    end += 1
                place[c, a] = at - begin
        node_start[g + 1] = end
    return node_start, nodes[: node_start[-1]].copy(), place


def _slabs(groups: Groups, nodes: int, threads: int) -> list[tuple[int, int]]:
    """2 t ranges of groups such that ranges of equal parity share no node; fewer if impossible."""
    total = len(groups.cell_start) - 1
    for count in range(threads, 1, -1):
        bounds = np.linspace(0, total, 2 * count + 1).astype(int)
        ranges = [(int(a), int(b)) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        clash = False
        for parity in (0, 1):
            seen = np.zeros(nodes, bool)
            for start, stop in ranges[parity::2]:
                mine = groups.nodes[groups.node_start[start] : groups.node_start[stop]]
                clash = clash or bool(seen[mine].any())
                seen[mine] = True
        if not clash:
            return ranges
    return [(0, total)]


@njit(cache=True, nogil=True)
def _incident(node_start, group_nodes, nodes):
    count = np.zeros(nodes + 1, np.int64)
    for node in group_nodes:
        count[node + 1] += 1
    start = np.cumsum(count)
    fill = start[:-1].copy()
    incident = np.empty(start[-1], np.int32)
    for g in range(node_start.size - 1):
        for k in range(node_start[g], node_start[g + 1]):
            node = group_nodes[k]
            incident[fill[node]] = g
            fill[node] += 1
    return start, incident


@njit(cache=True, nogil=True)
def _block_rows(node_start, group_nodes, owned_nodes, nodes):
    """Sorted neighbours of every owned node: (row_start, columns)."""
    start, incident = _incident(node_start, group_nodes, nodes)
    marker = np.full(nodes, -1, np.int64)
    row_start = np.zeros(owned_nodes + 1, np.int64)
    for i in range(owned_nodes):
        found = 0
        for k in range(start[i], start[i + 1]):
            g = incident[k]
            for node in group_nodes[node_start[g] : node_start[g + 1]]:
                if marker[node] != i:
                    marker[node] = i
                    found += 1
        row_start[i + 1] = row_start[i] + found
    marker[:] = -1
    columns = np.empty(row_start[-1], np.int32)
    for i in range(owned_nodes):
        at = row_start[i]
        for k in range(start[i], start[i + 1]):
            g = incident[k]
            for node in group_nodes[node_start[g] : node_start[g + 1]]:
                if marker[node] != i:
                    marker[node] = i
                    columns[at] = node
                    at += 1
        columns[row_start[i] : row_start[i + 1]].sort()
    return row_start, columns


@njit(cache=True, nogil=True)
def _block_positions(node_start, group_nodes, pair_start, owned_nodes, row_start, columns):
    position = np.full(pair_start[-1], -1, np.int32)
    for g in range(node_start.size - 1):
        nodes = group_nodes[node_start[g] : node_start[g + 1]]
        for a in range(nodes.size):
            row = nodes[a]
            if row >= owned_nodes:
                continue
            neighbours = columns[row_start[row] : row_start[row + 1]]
            for b in range(nodes.size):
                at = row_start[row] + np.searchsorted(neighbours, nodes[b])
                position[pair_start[g] + a * nodes.size + b] = at
    return position
