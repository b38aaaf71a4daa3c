"""Broken bonds: one bit a bond, kept only in tiles of the lattice that hold a broken bond.

Everywhere else, and for all intact bonds, the fast convolution runs as before; what it counts
over broken bonds is taken out again, node by node, in those tiles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum, beside, neighbours, signed_bonds
from peri.schemes import bond_kernels
from peri.schemes.stored import flat_shifts

_TILE = (4, 8, 16)
"""Nodes of a tile per axis: 512 in 3D.  Smaller ones waste less around a crack, larger ones hold
fewer lists; a tile of 178 bonds takes 12 kB."""


class BrokenBonds:
    """Which bonds of a lattice are broken; a bond is broken from both of its ends.

    Parameters
    ----------
    stencil : Stencil
        The bonds of a node: its non-zero weights.
    shape : tuple of int
        Nodes of the lattice per axis.

    count : number of broken bonds, each counted once.
    offsets : (n, 3) the bonds of a node.
    """

    def __init__(self, stencil: Stencil, shape: tuple[int, ...]) -> None:
        base = NonlocalSum(stencil, shape)
        self.stencil, self.shape, self.reach = stencil, base.shape, base.reach
        self.lattice_shape = base.lattice_shape
        self.offsets, self.weights = signed_bonds(base)
        self.shifts = flat_shifts(base, self.offsets)
        self.words = max(1, -(-len(self.offsets) // 64))
        self.edges = tuple(min(e, n) for e, n in zip(_TILE, self.shape, strict=True))
        self._grid = tuple(-(-n // e) for n, e in zip(self.shape, self.edges, strict=True))
        self._slot = np.full(self._grid, -1, np.int64)
        self.corners = np.zeros((0, 3), np.int64)
        self.bits = np.zeros((0, int(np.prod(self.edges)), self.words), np.uint64)
        self.count = 0
        # The list is symmetric about its middle: the opposite of bond o is bond n - 1 - o.
        self._last = len(self.offsets) - 1

    def break_where(self, rule: Callable[[np.ndarray], np.ndarray]) -> int:
        """Break the bonds that a rule names; returns how many of them were whole.

        rule(offset) : for an offset (d,) of whole nodes, a bool array of the lattice's shape: does
        the bond from a node to the one at that offset break?  Each bond is asked for once, from
        one of its ends; answers for bonds that leave the lattice are ignored.
        """
        d, before = len(self.lattice_shape), self.count
        for o in range((self._last + 1) // 2):
            offset = self.offsets[o]
            named = np.asarray(rule(offset[3 - d :].copy()), bool).reshape(self.shape)
            here = tuple(
                slice(max(0, -s), max(0, n - max(0, s)))
                for s, n in zip(offset, self.shape, strict=True)
            )
            start = np.argwhere(named[here]) + [h.start for h in here]
            if start.size:
                self.count += self._set(start, o)
                self._set(start + offset, self._last - o)
        return self.count - before

    def break_pairs(self, one: np.ndarray, other: np.ndarray) -> int:
        """Break the bonds between nodes given by their indices, two arrays (n, d).

        Returns how many were whole.  Raises ValueError for a pair that has no bond.
        """
        d, before = len(self.lattice_shape), self.count
        one, other = (np.atleast_2d(np.asarray(v, np.int64)) for v in (one, other))
        steps = other - one
        number = {tuple(offset[3 - d :]): o for o, offset in enumerate(self.offsets.tolist())}
        for start, step in zip(one, steps, strict=True):
            o = number.get(tuple(step.tolist()))
            inside = all(0 <= a < n for a, n in zip(start, self.lattice_shape, strict=True))
            ends = all(0 <= a < n for a, n in zip(start + step, self.lattice_shape, strict=True))
            if o is None or not (inside and ends):
                raise ValueError(
                    f"pairs: no bond from node {start.tolist()} to {(start + step).tolist()}"
                )
            node = np.concatenate([np.zeros(3 - d, np.int64), start])[None, :]
            self.count += self._set(node, o)
            self._set(node + self.offsets[o], self._last - o)
        return self.count - before

    def _set(self, nodes: np.ndarray, o: int) -> int:
        """Set bit `o` of nodes (n, 3); returns how many were not set."""
        tile = nodes // self.edges
        flat = np.ravel_multi_index(tuple(tile.T), self._grid)
        new = np.unique(flat[self._slot.ravel()[flat] < 0])
        if new.size:
            self._slot.ravel()[new] = len(self.corners) + np.arange(new.size)
            corners = np.stack(np.unravel_index(new, self._grid), axis=1) * np.array(self.edges)
            self.corners = np.concatenate([self.corners, corners])
            empty = np.zeros((new.size, *self.bits.shape[1:]), np.uint64)
            self.bits = np.concatenate([self.bits, empty])
        within = np.ravel_multi_index(tuple((nodes - tile * self.edges).T), self.edges)
        place = self._slot.ravel()[flat], within, np.full(len(nodes), o // 64)
        bit = np.uint64(1) << np.uint64(o % 64)
        was = self.bits[place] & bit
        self.bits[place] |= bit
        return int((was == 0).sum())

    def of_nodes(self, where: np.ndarray) -> np.ndarray:
        """(nodes, bonds) bool: the broken bonds of the nodes where `where` (3 axes) is true."""
        nodes = np.argwhere(where)
        tile = nodes // self.edges
        slot = self._slot[tuple(tile.T)]
        within = np.ravel_multi_index(tuple((nodes - tile * self.edges).T), self.edges)
        out = np.zeros((len(nodes), len(self.offsets)), bool)
        some = np.flatnonzero(slot >= 0)
        words = self.bits[slot[some], within[some]]
        for o in range(len(self.offsets)):
            bit = np.uint64(1) << np.uint64(o % 64)
            out[some, o] = words[:, o // 64] & bit != 0
        return out

    def damage_index(self, there: np.ndarray | None = None) -> np.ndarray:
        """Broken share of each node's bonds to nodes of `there` (default: all), 0 without bonds."""
        shape = self.lattice_shape
        there = np.ones(shape, bool) if there is None else there
        bonds = Stencil((self.stencil.octant != 0).astype(float), self.stencil.spacing)
        whole = NonlocalSum(bonds, shape)
        standing = BrokenSum(bonds, shape, self)
        field = whole.pad(there)
        all_bonds, left = (np.rint(s.crop(s(field))) for s in (whole, standing))
        return np.where(there & (all_bonds > 0), 1.0 - left / np.maximum(all_bonds, 1.0), 0.0)


class BrokenSum(NonlocalSum):
    """A NonlocalSum over the bonds that stand; every operator of convolutions takes it as it is.

    Parameters
    ----------
    stencil : Stencil
        Even or odd; its bonds are among those of `broken`.
    shape, wanted, method : as for NonlocalSum
    broken : BrokenBonds
        Of the same lattice; bonds that break later count from the next sum on.  (Diagonals of
        operators made before do not change by themselves.)
    """

    def __init__(
        self,
        stencil: Stencil,
        shape: tuple[int, ...],
        broken: BrokenBonds,
        wanted: np.ndarray | None = None,
        method: str = "direct",
    ) -> None:
        super().__init__(stencil, shape, wanted, method)
        if broken.shape != self.shape or broken.reach != self.reach:
            raise ValueError(
                f"broken: bonds of {broken.shape} nodes with a reach of {broken.reach}; the sum "
                f"has {self.shape} and {self.reach}"
            )
        self.broken = broken
        offsets, weights = signed_bonds(self)
        own = {tuple(o): w for o, w in zip(offsets.tolist(), weights, strict=True)}
        listed = [tuple(o) for o in broken.offsets.tolist()]
        if not own.keys() <= set(listed):
            raise ValueError("stencil: it has bonds that `broken` does not list")
        self._weights = np.array([own.get(o, 0.0) for o in listed])

    def __call__(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        out = super().__call__(u, out)
        self._take_out(u, out, self._weights)
        return out

    def _take_out(self, u: np.ndarray, out: np.ndarray, weights: np.ndarray) -> None:
        b = self.broken
        if b.count:
            bond_kernels.take_out_broken(
                u, out, b.bits, b.corners, b.edges, b.shape, b.reach, b.offsets, b.shifts, weights
            )

    def intact(self, axis: int) -> np.ndarray | None:
        """Standing share of the second moment that the nodes beside a face have across it."""
        b = self.broken
        if not b.count:
            return None
        steps = b.offsets[:, axis].astype(float)
        sides = []
        for ahead in (1.0, -1.0):
            weights = b.weights * np.where(ahead * steps > 0, steps**2, 0.0)
            total = weights.sum()
            # Of the whole stencil, also beside the lattice's end: only broken bonds count.
            left = np.full(self.padded_shape, total)
            ones = np.ones(self.padded_shape)
            self._take_out(ones, left, weights)
            sides.append(beside(self, left / total if total > 0 else np.ones_like(left)))
        up, down = neighbours(sides[0], axis)[0], neighbours(sides[1], axis)[1]
        return 0.5 * (up + down)
