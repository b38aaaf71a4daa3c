"""Stochastic concentration-dependent damage of the mechanical bonds of a corroding metal.

The metal's loss gives the corroded share of a node (Zhao et al. 2021, Eq. 23),

    d_c = (C_solid - C) / (C_solid - C_sat), between 0 and 1.

In the published procedure both ends of an intact bond draw a number in every step and break the
bond with probability P_n = (C_{n-1} - C_n) / (C_{n-1} - C_sat) (Eq. 25; Jafarzadeh et al. 2022
print d_c^{n+1} in its denominator, which exceeds 1).  The product of the survivals telescopes:
1 - P_n = (1 - d_n) / (1 - d_{n-1}), so the bond stands at any time with probability

    (1 - d_i) (1 - d_j),     d = largest d_c so far.

One number u_ij in [0, 1), a hash of the seed and of the pair of nodes, has the same law: the bond
is broken where u_ij >= (1 - d_i) (1 - d_j).  No bond is stored, and neither the steps nor the
order of evaluation, threads, blocks of the lattice or a resumed march change the result.

The expected damage index is 1 - (1 - d_i) mean_j (1 - d_j), above the d_c that Eq. 23 intends,
because either end may break the bond.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit, prange
from scipy.ndimage import distance_transform_edt, label

from peri.engine import hashing
from peri.engine.hashing import term
from peri.engine.influence import Stencil
from peri.engine.lattice import Lattice, family
from peri.engine.operators import NonlocalSum, signed_bonds

_MOST_NODES = 2**32


def hashed_uniform(seed: int, one: np.ndarray, other: np.ndarray, nodes: int) -> np.ndarray:
    """The number in [0, 1) of each pair of nodes; the same for both orders of the pair.

    The pair's number lo * nodes + hi is the counter of engine.hashing.

    Parameters
    ----------
    seed : int
        0 to 2^64 - 1.
    one, other : integer arrays
        Indices of nodes, 0 to nodes - 1, in C order of the whole lattice.
    nodes : int
        Of the whole lattice, at most 2^32.

    Raises
    ------
    ValueError
        For a seed or a number of nodes out of range.
    """
    _check(seed, nodes)
    a, b = np.asarray(one, np.uint64), np.asarray(other, np.uint64)
    with np.errstate(over="ignore"):
        pair = np.minimum(a, b) * np.uint64(nodes) + np.maximum(a, b)
    return hashing.uniform(seed, pair)


def _check(seed: int, nodes: int) -> None:
    hashing.stream(seed)
    if not 1 <= nodes <= _MOST_NODES:
        raise ValueError(f"lattice: {nodes} nodes; pairs are numbered for 1 to 2^32 nodes")


@dataclass(frozen=True)
class BondDamage:
    """The bonds between the nodes of a metal, and which of them corrosion has broken.

    Parameters
    ----------
    lattice : Lattice
        Or the box of it that one process holds, with its halo.
    horizon : float or one per axis
        m.
    solid : bool array of the lattice's shape
        Nodes that were metal at the start; bonds to other nodes are no mechanical bonds.
    solid_concentration, saturation_concentration : float
        mol/m^3, 0 <= C_sat < C_solid.
    seed : int
        0 to 2^64 - 1.
    corner, whole : tuples of int, optional
        Index of the box's first node in the whole lattice, and the shape of that, where `lattice`
        is a box of it.  Bonds that leave the box are not counted, so only nodes a horizon within
        it have the index that they have in the whole lattice.

    Raises
    ------
    ValueError
        For arrays of another shape, concentrations or a seed out of range, a box that leaves the
        whole lattice, a horizon below the spacing.
    """

    lattice: Lattice
    horizon: float | Sequence[float]
    solid: np.ndarray
    solid_concentration: float
    saturation_concentration: float
    seed: int = 0
    corner: tuple[int, ...] | None = None
    whole: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        shape, d = self.lattice.shape, self.lattice.dimension
        if self.solid.shape != shape or self.solid.dtype != bool:
            raise ValueError(f"solid: {self.solid.dtype} of {self.solid.shape}; bool of {shape}")
        low, high = self.saturation_concentration, self.solid_concentration
        if not (np.isfinite(high) and 0 <= low < high):
            raise ValueError(
                f"saturation_concentration: {low} mol/m^3; it must be at least 0 and below the "
                f"solid_concentration of {high} mol/m^3"
            )
        object.__setattr__(self, "corner", tuple(self.corner or (0,) * d))
        object.__setattr__(self, "whole", tuple(self.whole or shape))
        fits = len(self.corner) == len(self.whole) == d and all(
            0 <= c and c + n <= w for c, n, w in zip(self.corner, shape, self.whole, strict=True)
        )
        if not fits:
            raise ValueError(
                f"corner: {self.corner}; a box of {shape} nodes does not lie there within a "
                f"lattice of {self.whole}"
            )
        _check(self.seed, int(np.prod(self.whole, dtype=object)))
        self._sum  # noqa: B018 - refuses a horizon below the spacing now

    @cached_property
    def _sum(self) -> NonlocalSum:
        """Counts over the family."""
        bonds = family(self.lattice, self.horizon)
        octant = np.zeros(tuple(bonds.offsets.max(axis=0) + 1))
        octant[tuple(bonds.offsets.T)] = 1.0
        return NonlocalSum(Stencil(octant, self.lattice.spacing), self.lattice.shape)

    @cached_property
    def offsets(self) -> np.ndarray:
        """(n, 3) of all bonds of a node; the second half is the first one mirrored."""
        return signed_bonds(self._sum)[0]

    @cached_property
    def bonds(self) -> np.ndarray:
        """Bonds of each node of the solid to others, 0 elsewhere; integers."""
        return np.where(self.solid, np.rint(self._over_family(self.solid)), 0).astype(np.int64)

    def _over_family(self, values: np.ndarray) -> np.ndarray:
        return self._sum.crop(self._sum(self._sum.pad(values.astype(float))))

    def _boxed(self, values: np.ndarray) -> np.ndarray:
        """With three axes."""
        return np.ascontiguousarray(values).reshape(self._sum.shape)

    def _place(self) -> tuple[np.ndarray, np.ndarray]:
        """Corner and whole shape with three axes."""
        ahead = 3 - self.lattice.dimension
        return (
            np.array((0,) * ahead + tuple(self.corner), np.int64),
            np.array((1,) * ahead + tuple(self.whole), np.int64),
        )

    def corroded(self, concentration: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
        """The corroded share d of each node, Eq. 23, in [0, 1]; 1 for liquid.

        concentration : mol/m^3, of the lattice's shape.  before : the share so far, which the
        new one never falls below.
        """
        span = self.solid_concentration - self.saturation_concentration
        share = np.clip((self.solid_concentration - concentration) / span, 0.0, 1.0)
        return share if before is None else np.maximum(share, before)

    def damage_index(self, corroded: np.ndarray) -> np.ndarray:
        """Broken share of each node's bonds (Eq. 9 over the bonds), 0 for nodes without bonds.

        corroded : d of each node, as `corroded` gives it.
        """
        corner, whole = self._place()
        keep = self._boxed(1.0 - corroded)
        broken = _count_broken(
            keep, self._boxed(self.solid), self.offsets, corner, whole, hashing.stream(self.seed)
        ).reshape(self.solid.shape)
        return np.where(self.bonds > 0, broken / np.maximum(self.bonds, 1), 0.0)

    def expected_index(self, corroded: np.ndarray) -> np.ndarray:
        """The mean of `damage_index` over all seeds, in closed form: 1 - (1-d_i) mean_j (1-d_j)."""
        keep = np.where(self.solid, 1.0 - corroded, 0.0)
        mean = self._over_family(keep) / np.maximum(self.bonds, 1)
        return np.where(self.bonds > 0, np.clip(1.0 - keep * mean, 0.0, 1.0), 0.0)

    def broken(self, corroded: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The rule that schemes.broken.BrokenBonds.break_where asks for the bonds of an offset."""
        nodes = int(np.prod(self.whole))
        index = np.ravel_multi_index(
            tuple(
                np.indices(self.solid.shape) + np.reshape(self.corner, (-1, *[1] * self.solid.ndim))
            ),
            self.whole,
        )

        def rule(offset: np.ndarray) -> np.ndarray:
            here = tuple(
                slice(max(0, -s), max(0, n - max(0, s)))
                for s, n in zip(offset, self.solid.shape, strict=True)
            )
            there = tuple(slice(h.start + s, h.stop + s) for h, s in zip(here, offset, strict=True))
            u = hashed_uniform(self.seed, index[here], index[there], nodes)
            out = np.zeros(self.solid.shape, bool)
            stands = u < (1.0 - corroded[here]) * (1.0 - corroded[there])
            out[here] = self.solid[here] & self.solid[there] & ~stands
            return out

        return rule

    def pieces(self, corroded: np.ndarray) -> np.ndarray:
        """Number of the piece that each node with d < 1 belongs to; 0 for all others.

        Two nodes are of one piece where intact bonds join them.  Piece 1 has most nodes; of equal
        ones that with the first node comes first.  Of a box the pieces are those of the box.
        """
        corner, whole = self._place()
        alive = self.solid & (corroded < 1.0)
        roots = _join(
            self._boxed(1.0 - corroded),
            self._boxed(alive),
            self.offsets[len(self.offsets) // 2 :],
            corner,
            whole,
            hashing.stream(self.seed),
        )[alive.ravel()]
        kinds, of_node, sizes = np.unique(roots, return_inverse=True, return_counts=True)
        rank = np.empty(kinds.size, np.int64)
        rank[np.lexsort((kinds, -sizes))] = np.arange(1, kinds.size + 1)
        out = np.zeros(self.solid.shape, np.int64)
        out[alive] = rank[of_node]
        return out

    def detached(self, corroded: np.ndarray, held: np.ndarray | None = None) -> np.ndarray:
        """Metal (d < 1) that no chain of intact bonds joins to what is held; bool.

        held : nodes that stay in place (default: the largest piece).
        """
        pieces = self.pieces(corroded)
        anchored = np.array([1]) if held is None else np.unique(pieces[held])
        return (pieces > 0) & ~np.isin(pieces, anchored[anchored > 0])


def cut_off(metal: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Number (from 1; 0 elsewhere) of each piece of `left` that has been cut off.

    Of each piece of the metal at the start the largest part stays, by its nodes; cells that touch
    at a face, an edge or a corner hold together.

    metal, left : bool arrays, what was metal at the start and what is.
    """
    every_way = np.ones((3,) * metal.ndim, bool)
    parts, count = label(metal, every_way)
    pieces, number = label(left, every_way)
    if number <= count:
        return np.zeros(metal.shape, int)
    stays = np.zeros(number + 1, bool)
    for part in range(1, count + 1):
        sizes = np.bincount(pieces[parts == part], minlength=number + 1)
        sizes[0] = 0
        if sizes.any():
            stays[sizes.argmax()] = True
    return np.where(stays[pieces], 0, pieces)


def dissolve_islands(
    concentration: np.ndarray,
    islands: np.ndarray,
    liquid: np.ndarray,
    saturation_concentration: float,
) -> tuple[np.ndarray, float]:
    """Turn detached metal into liquid: what is above C_sat goes to the nearest liquid with room.

    Each island fills the liquid in order of the distance from its own nodes (in cells; of equal
    distances the node that comes first), up to C_sat.  The option of Zhao et al. 2021, 3.2.3
    (damage-dependent corrosion); it adds to the rate, which is why islands are kept by default.

    Parameters
    ----------
    concentration : float array
        mol/m^3; cells of equal volume.
    islands : int array
        0, or the number of the island that a node belongs to.
    liquid : bool array
        Nodes that can receive; an island's own nodes become liquid, too.

    Returns
    -------
    concentration, left : the new field, and the sum of concentrations (mol/m^3 times cells) that
    found no room.  Their sum is that before, to round-off.
    """
    out = concentration.copy()
    left = 0.0
    for number in np.unique(islands[islands > 0]):
        island = islands == number
        surplus = float(np.maximum(out[island] - saturation_concentration, 0.0).sum())
        out[island] = np.minimum(out[island], saturation_concentration)
        left += _fill(out, island, liquid, saturation_concentration, surplus)
    return out, left


def _fill(
    out: np.ndarray, island: np.ndarray, liquid: np.ndarray, most: float, surplus: float
) -> float:
    """Add `surplus` to the liquid around an island, in place; returns what found no room."""
    place = np.argwhere(island)
    reach = 4
    while surplus > 0:
        window = tuple(
            slice(max(0, a - reach), min(n, b + reach + 1))
            for a, b, n in zip(place.min(axis=0), place.max(axis=0), out.shape, strict=True)
        )
        whole = all(w == slice(0, n) for w, n in zip(window, out.shape, strict=True))
        distance = distance_transform_edt(~island[window])
        near = liquid[window] & (out[window] < most) & (whole | (distance <= reach))
        nodes = np.flatnonzero(near)
        nodes = nodes[np.argsort(distance.ravel()[nodes], kind="stable")]
        part = out[window].ravel()
        room = most - part[nodes]
        if room.sum() >= surplus or whole:
            before = np.concatenate([[0.0], np.cumsum(room)[:-1]])
            given = np.clip(surplus - before, 0.0, room)
            part[nodes] += given
            out[window] = part.reshape(out[window].shape)
            return surplus - float(given.sum()) if room.sum() < surplus else 0.0
        reach *= 2
    return 0.0


@njit(parallel=True, cache=True)
def _count_broken(keep, solid, offsets, corner, whole, stream):  # numba
    """Broken bonds of each node of the solid."""
    n0, n1, n2 = keep.shape
    nodes = np.uint64(whole[0] * whole[1] * whole[2])
    out = np.zeros(keep.shape, np.int64)
    # Of each row, from the first to behind the last node that has lost something.
    first, last = np.full((n0, n1), n2), np.zeros((n0, n1), np.int64)
    for row in prange(n0 * n1):
        i, j = row // n1, row % n1
        for k in range(n2):
            if solid[i, j, k] and keep[i, j, k] < 1.0:
                first[i, j] = min(first[i, j], k)
                last[i, j] = k + 1
    for row in prange(n0 * n1):
        i, j = row // n1, row % n1
        start = ((i + corner[0]) * whole[1] + j + corner[1]) * whole[2] + corner[2]
        for o in range(offsets.shape[0]):
            a, b, s = i + offsets[o, 0], j + offsets[o, 1], offsets[o, 2]
            if a < 0 or a >= n0 or b < 0 or b >= n1:
                continue
            step = (offsets[o, 0] * whole[1] + offsets[o, 1]) * whole[2] + s
            low = max(0, -s, min(first[i, j], first[a, b] - s))
            for k in range(low, min(n2, n2 - s, max(last[i, j], last[a, b] - s))):
                if not (solid[i, j, k] and solid[a, b, k + s]):
                    continue
                stands = keep[i, j, k] * keep[a, b, k + s]
                if stands >= 1.0:
                    continue
                one = np.uint64(start + k + min(step, 0))
                other = np.uint64(start + k + max(step, 0))
                if stands <= 0.0 or term(stream, one * nodes + other) >= stands:
                    out[i, j, k] += 1
    return out


@njit(cache=True)
def _root(parent, node):  # numba
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def _join(keep, alive, ahead, corner, whole, stream):  # numba
    """First node of the piece of each node; `ahead`: the offsets to nodes that come later."""
    n0, n1, n2 = keep.shape
    nodes = np.uint64(whole[0] * whole[1] * whole[2])
    parent = np.arange(n0 * n1 * n2)
    for i in range(n0):
        for j in range(n1):
            start = ((i + corner[0]) * whole[1] + j + corner[1]) * whole[2] + corner[2]
            for k in range(n2):
                if not alive[i, j, k]:
                    continue
                for o in range(ahead.shape[0]):
                    a, b, c = i + ahead[o, 0], j + ahead[o, 1], k + ahead[o, 2]
                    if a < 0 or a >= n0 or b < 0 or b >= n1 or c < 0 or c >= n2:
                        continue
                    if not alive[a, b, c]:
                        continue
                    one = _root(parent, (i * n1 + j) * n2 + k)
                    other = _root(parent, (a * n1 + b) * n2 + c)
                    if one == other:
                        continue
                    step = (ahead[o, 0] * whole[1] + ahead[o, 1]) * whole[2] + ahead[o, 2]
                    low, high = np.uint64(start + k), np.uint64(start + k + step)
                    stands = keep[i, j, k] * keep[a, b, c]
                    if term(stream, low * nodes + high) < stands:
                        parent[max(one, other)] = min(one, other)
    for node in range(parent.size):
        parent[node] = _root(parent, node)
    return parent
