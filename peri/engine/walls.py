"""What a wall takes from the conduction along it, given back by bonds to the next nodes.

A node beside a wall has no bonds into it.  Across the wall that is right: nothing, or what a patch
carries, crosses there.  Along the wall the same bonds are missing, and a layer of the horizon's
width conducts less: a film of three horizons' thickness loses a tenth (measured; see the tests).
The missing second moment along the wall, m_a = 1 - sum_j w_ij xi_a^2 / 2 times (1 - n_a^2)^2 (n:
the wall's normal, the direction in which the liquid's share falls, by the missing bonds), is added
as a conductance between neighbouring nodes, so that a uniform gradient along a flat wall that is
parallel to an axis carries the current of its whole section.  Along oblique walls less is given
back, and the square keeps what these bonds carry across such a wall small.  A wall that liquid has
entered (`open`) conducts along itself what that liquid's section does.
"""

from __future__ import annotations

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum, Operator


class Walls:
    """Conduction along walls on the lattice of a sum; walls may move (`update`).

    Parameters
    ----------
    bond_sum : NonlocalSum
        Of unit diffusivity.

    diagonal : padded array, what the links add to a node's sum of conductances.
    """

    def __init__(self, bond_sum: NonlocalSum) -> None:
        self.sum = bond_sum
        stencil, d = bond_sum.stencil, bond_sum.stencil.dimension
        position = np.meshgrid(
            *[h * np.arange(n) for h, n in zip(stencil.spacing, stencil.octant.shape, strict=True)],
            indexing="ij",
        )

        # A gradient is the first moment over the square of the spacing: on a stretched lattice the
        # moment alone would point along the long spacing.
        gradient = [x * (min(stencil.spacing) / h) ** 2 for h, x in
                    zip(stencil.spacing, position, strict=True)]  # fmt: skip

        def moment(weights: np.ndarray, odd: int | None) -> NonlocalSum:
            parity = tuple(-1 if a == odd else 1 for a in range(d))
            part = Stencil(weights, stencil.spacing, parity)
            return NonlocalSum(part, bond_sum.lattice_shape, processes=bond_sum.processes)

        self._first = [moment(stencil.octant * x, a) for a, x in enumerate(gradient)]
        self._second = [moment(stencil.octant * x**2, None) for x in position]
        self._index = np.arange(np.prod(bond_sum.padded_shape)).reshape(bond_sum.padded_shape)
        self.diagonal = np.zeros(bond_sum.padded_shape)
        self.links: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]] = []

    def missing(self, volume: np.ndarray) -> list[np.ndarray]:
        """m_a (1 - n_a^2)^2 of every liquid node, an array per lattice axis; 0 elsewhere.

        volume : relative volume of each cell's liquid, of the lattice's shape.
        """
        return [lacking for lacking, _ in self._beside(volume)]

    def _beside(self, volume: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The same, and (1 - n_a^2)^2 of the liquid nodes beside a wall, per axis."""
        stencil, field = self.sum.stencil, self.sum.pad(volume)
        liquid = np.asarray(volume) > 0
        normal = [self.sum.crop(first(field)) for first in self._first]
        squared = sum(n**2 for n in normal)
        # Between bonds that only differ by round-off there is no wall.
        wall = squared > 1e-16 * stencil.total**2 * min(stencil.spacing) ** 2
        whole = np.where(wall, squared, 1.0)
        out = []
        for a, second in enumerate(self._second):
            lacking = 1.0 - 0.5 * self.sum.crop(second(field))
            across = np.where(wall, normal[a] ** 2 / whole, 1.0)
            along = np.where(liquid, (1.0 - across) ** 2, 0.0)
            out.append((np.maximum(lacking, 0.0) * along, along))
        return out

    def update(self, volume: np.ndarray, conductivity: np.ndarray) -> None:
        """Take the liquid's cells and what each conducts; a face has the harmonic mean of both."""
        self._conducts = np.where(np.asarray(volume) > 0, conductivity, 0.0)
        self._lacking = self._beside(volume)
        self.open(np.zeros(np.shape(volume)))

    def open(self, behind: np.ndarray) -> None:
        """Take the liquid in the walls.

        behind : its volume behind each liquid node, relative to a cell's; of the lattice's shape.
        """
        base, kappa = self.sum, self._around(self._conducts)
        self.links, diagonal = [], np.zeros(base.padded_shape)
        lead = 3 - len(base.lattice_shape)
        for axis, (lacking, along) in enumerate(self._lacking, lead):
            missing = self._around(lacking + along * behind)
            low, high = (_padded_side(base, axis, side) for side in (0, 1))
            total = kappa[low] + kappa[high]
            mean = 2.0 * kappa[low] * kappa[high] / np.where(total > 0, total, 1.0)
            face = (mean * 0.5 * (missing[low] + missing[high])).ravel()
            face = face / base.spacing[axis] ** 2
            # Most faces are far from walls.
            some = np.flatnonzero(face)
            near, far = (self._index[side].ravel()[some] for side in (low, high))
            face = face[some]
            # Along one axis every node is at most once the near and once the far one.
            diagonal.ravel()[near] += face
            diagonal.ravel()[far] += face
            self.links.append((near, far, face, axis))
        self.diagonal = self._own(diagonal)

    def _around(self, values: np.ndarray) -> np.ndarray:
        """A padded copy of a lattice array, with what other processes hold beside it."""
        return self.sum.processes.with_ghosts(self.sum.pad(values), self.sum.window).copy()

    def _own(self, padded: np.ndarray) -> np.ndarray:
        """Nothing but this process's nodes, in place."""
        if self.sum.processes.whole:
            return padded
        return self.sum.pad(self.sum.crop(padded))

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Add sum over a node's links of conductance times u beyond, in place."""
        values = self.sum.processes.with_ghosts(u, self.sum.window).ravel()
        target = out.ravel()
        for near, far, face, _ in self.links:
            target[near] += face * values[far]
            target[far] += face * values[near]
        if not self.sum.processes.whole:
            out[:] = self._own(out)
        return out

    def flow(self, u: np.ndarray) -> np.ndarray:
        """What the links bring each node, sum of conductance times difference; padded."""
        return self.gain(u, -self.diagonal * u)


class WithWalls(Operator):
    """An operator of the liquid's bonds plus the conduction along walls that they lack.

    Parameters
    ----------
    operator : Operator
        Its nodes and bonds.
    walls : Walls
        Of the same lattice.
    """

    def __init__(self, operator: Operator, walls: Walls) -> None:
        self._base, self._walls = operator, walls
        diagonal = operator.diagonal() + walls.diagonal * operator.unknown
        super().__init__(operator.sum, operator.unknown, diagonal, operator.symmetric)

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        self._base.gain(u, out)
        out += self.unknown * self._walls.gain(u, np.zeros(self.sum.padded_shape))
        return out

    def faces(self) -> list[np.ndarray]:
        out = self._base.faces()
        on = self.sum.processes.with_ghosts(self.unknown, self.sum.window).ravel().copy()
        for near, far, face, axis in self._walls.links:
            if not near.size:
                continue
            # A face's place is that of the node behind it, one further along its axis.
            padded = np.zeros(self.sum.padded_shape)
            padded.ravel()[near] = face * on[near] * on[far]
            before = list(self.sum.interior)
            before[axis] = slice(before[axis].start - 1, before[axis].stop)
            out[axis] = out[axis] + padded[tuple(before)]
        return out


def _padded_side(bond_sum: NonlocalSum, axis: int, side: int) -> tuple[slice, ...]:
    """The nodes below (side 0) or above the faces across an axis (of three), one more around."""
    out = list(bond_sum.interior)
    inner, width = out[axis], min(bond_sum.reach[axis], 1)
    out[axis] = slice(inner.start - width + side, inner.stop + width - 1 + side)
    return tuple(out)
