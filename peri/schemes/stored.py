"""Weights kept bond by bond: any conductances at all, at 8 B a bond and node."""

from __future__ import annotations

import numpy as np

from peri.engine.operators import NonlocalSum, Operator, beside, neighbours, signed_bonds
from peri.schemes import bond_kernels


class BondTable:
    """out_i = sum_o table[i, o] u_{i+o} on a list of nodes.

    Parameters
    ----------
    bond_sum : NonlocalSum
        Lattice and padding; its stencil says which offsets there are, in the order of
        `operators.signed_bonds`.
    where : padded array
        Non-zero on the nodes that have a row, in C order.
    table : (rows, offsets)
    """

    def __init__(self, bond_sum: NonlocalSum, where: np.ndarray, table: np.ndarray) -> None:
        self.sum, self.table = bond_sum, np.ascontiguousarray(table, float)
        self.offsets = signed_bonds(bond_sum)[0]
        self.nodes, self.shifts = np.flatnonzero(where), flat_shifts(bond_sum, self.offsets)
        wanted = self.nodes.size, self.shifts.size
        if self.table.shape != wanted:
            raise ValueError(f"table: shape {self.table.shape}; {wanted} (nodes, bonds) are wanted")

    def __call__(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Fill `out` on the listed nodes, for a padded u; other nodes keep their value."""
        u = self.sum.processes.with_ghosts(u, self.sum.window)
        bond_kernels.stored_gain(u, out, self.nodes, self.shifts, self.table)
        return out


def flat_shifts(bond_sum: NonlocalSum, offsets: np.ndarray) -> np.ndarray:
    """Offsets as distances in a flattened padded array."""
    _, rows, columns = bond_sum.padded_shape
    return offsets @ np.array([rows * columns, columns, 1], np.int64)


class StoredBonds(Operator):
    """The operator of k_ij given bond by bond.

    Parameters
    ----------
    bond_sum : NonlocalSum
    unknown : padded array
    table : (unknown nodes, offsets)
        k_ij, see BondTable.
    diagonal : padded array, optional
        d_i; by default the sum of the row, so that nothing happens to a uniform field.  Bonds to
        nodes that do not exist must then be zero.
    symmetric : bool
        What the caller knows of k.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        unknown: np.ndarray,
        table: np.ndarray,
        diagonal: np.ndarray | None = None,
        symmetric: bool = False,
    ) -> None:
        self._bonds = BondTable(bond_sum, unknown, table)
        if diagonal is None:
            diagonal = np.zeros(bond_sum.padded_shape)
            diagonal.ravel()[self._bonds.nodes] = self._bonds.table.sum(axis=1)
        super().__init__(bond_sum, unknown, diagonal, symmetric)

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        out[:] = 0.0
        return self._bonds(u, out)

    def faces(self) -> list[np.ndarray]:
        """Half the second moments that the two nodes' rows have towards one another, over h^2."""
        to_unknown = np.empty_like(self._bonds.table)
        on = self.sum.processes.with_ghosts(self.unknown, self.sum.window).ravel()
        for o, shift in enumerate(self._bonds.shifts):
            to_unknown[:, o] = self._bonds.table[:, o] * on[self._bonds.nodes + shift]
        out = []
        for a in range(3):
            steps = self._bonds.offsets[:, a]
            sides = []
            for ahead in (1, -1):
                moment = np.zeros(self.sum.padded_shape)
                moment.ravel()[self._bonds.nodes] = to_unknown @ np.where(
                    ahead * steps > 0, steps.astype(float) ** 2, 0.0
                )
                sides.append(beside(self.sum, moment))
            up, down = neighbours(sides[0], a)[0], neighbours(sides[1], a)[1]
            both = neighbours(beside(self.sum, self.unknown), a)
            out.append(np.maximum(0.5 * (up + down), 0.0) * both[0] * both[1])
        return out
