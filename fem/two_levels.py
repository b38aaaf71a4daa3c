"""One cycle of two-level multigrid on one rank, a preconditioner in the hands of PETSc's GMRES.

The smoother is a forward Gauss-Seidel sweep over nodes (blocks of 3) before and after the coarse
correction.  The stiffness is read from memory faster than it is computed with, so the sweeps read a
copy in single precision, in which a block's nine numbers lie together; and a sweep from zero leaves
a residual of the upper triangle alone, so that both together read the copy once.  What rounding
does to the preconditioner the outer iteration takes away, whose products have all digits.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fem.constitutive.compiled import kernel
from fem.discretisation import Discretisation


class TwoLevelCycle:
    """Context of a PETSc preconditioner of type python.

    interpolation: of the coarse unknowns to all (`fem.multigrid`); coarse: what solves the coarse
    system.  `set_up` and `refresh` come before the first `apply`.
    """

    def __init__(
        self, discretisation: Discretisation, interpolation: PETSc.Mat, coarse: PETSc.KSP
    ) -> None:
        self._d, self._interpolation, self._coarse = discretisation, interpolation, coarse
        owned = discretisation.owned_nodes
        self._diagonal = _diagonal_blocks(discretisation.row_start, discretisation.columns)
        self._blocks = np.empty((len(discretisation.columns), 9), np.float32)
        self._step, self._rest = np.zeros((owned, 3), np.float32), np.zeros((owned, 3))
        self._correction, self._right = interpolation.createVecs()
        self._coarse_step = self._correction.duplicate()

    def set_up(self) -> None:
        """Factorise the coarse matrix, or make its hierarchy, anew."""
        self._coarse.setUp()

    def refresh(self, values: np.ndarray) -> None:
        """Take new stiffness values (scalar CSR order of the assembly) for the smoother."""
        _pack(self._d.row_start, self._diagonal, values, self._blocks)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = an approximate solution for the right side x."""
        d, right = self._d, x.array_r.reshape(-1, 3)
        pattern = (d.row_start, d.columns, self._diagonal, self._blocks)
        _sweep_from_zero(*pattern, right, self._step)
        _residual(*pattern, self._step, self._rest)
        self._right.array[:] = self._rest.ravel()
        self._interpolation.multTranspose(self._right, self._correction)
        self._coarse.solve(self._correction, self._coarse_step)
        self._interpolation.mult(self._coarse_step, self._right)
        self._step += self._right.array_r.reshape(-1, 3)
        _sweep(*pattern, right, self._step)
        y.array[:] = self._step.ravel()

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Free PETSc's objects; the interpolation belongs to the caller."""
        for item in (self._correction, self._coarse_step, self._right, self._coarse):
            item.destroy()


def _diagonal_blocks(row_start: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Position of each row's diagonal block; columns are sorted within a row."""
    rows = np.repeat(np.arange(len(row_start) - 1), np.diff(row_start))
    return np.flatnonzero(columns == rows)


@kernel
def _pack(row_start, diagonal, values, blocks):
    """Blocks of nine numbers each from rows of scalars, diagonal ones inverted."""
    for row in range(row_start.size - 1):
        start, count = row_start[row], row_start[row + 1] - row_start[row]
        for i in range(3):
            at = 9 * start + i * 3 * count
            for block in range(count):
                for k in range(3):
                    blocks[start + block, 3 * i + k] = values[at + 3 * block + k]
        at = 9 * start + 3 * (diagonal[row] - start)
        width = 3 * count
        a, b, c = values[at], values[at + 1], values[at + 2]
        d, e, f = values[at + width], values[at + width + 1], values[at + width + 2]
        g, h, i = values[at + 2 * width], values[at + 2 * width + 1], values[at + 2 * width + 2]
        p, q, r = e * i - f * h, f * g - d * i, d * h - e * g
        scale = 1.0 / (a * p + b * q + c * r)
        inverse = (
            p, c * h - b * i, b * f - c * e,
            q, a * i - c * g, c * d - a * f,
            r, b * g - a * h, a * e - b * d,
        )  # fmt: skip
        for k in range(9):
            blocks[diagonal[row], k] = scale * inverse[k]


@kernel
def _minus_product(first, last, columns, blocks, vector, x, y, z):
    """(x, y, z) minus blocks first..last-1 times the vector; four sums side by side."""
    for at in range(first, last):
        node = columns[at]
        u, v, w = vector[node, 0], vector[node, 1], vector[node, 2]
        x -= blocks[at, 0] * u + blocks[at, 1] * v + blocks[at, 2] * w
        y -= blocks[at, 3] * u + blocks[at, 4] * v + blocks[at, 5] * w
        z -= blocks[at, 6] * u + blocks[at, 7] * v + blocks[at, 8] * w
    return x, y, z


@kernel
def _solve_block(inverse, x, y, z, row, vector):
    vector[row, 0] = inverse[0] * x + inverse[1] * y + inverse[2] * z
    vector[row, 1] = inverse[3] * x + inverse[4] * y + inverse[5] * z
    vector[row, 2] = inverse[6] * x + inverse[7] * y + inverse[8] * z


@kernel
def _sweep_from_zero(row_start, columns, diagonal, blocks, right, vector):
    """Gauss-Seidel forward, from zero: only blocks left of the diagonal are read."""
    for row in range(diagonal.size):
        x, y, z = np.float32(right[row, 0]), np.float32(right[row, 1]), np.float32(right[row, 2])
        here = diagonal[row]
        x, y, z = _minus_product(row_start[row], here, columns, blocks, vector, x, y, z)
        _solve_block(blocks[here], x, y, z, row, vector)


@kernel
def _residual(row_start, columns, diagonal, blocks, vector, rest):
    """What `_sweep_from_zero` leaves: minus the blocks right of the diagonal times its result."""
    zero = np.float32(0.0)
    for row in range(diagonal.size):
        rest[row, 0], rest[row, 1], rest[row, 2] = _minus_product(
            diagonal[row] + 1, row_start[row + 1], columns, blocks, vector, zero, zero, zero
        )


@kernel
def _sweep(row_start, columns, diagonal, blocks, right, vector):
    """Gauss-Seidel forward, from what the vector has."""
    for row in range(diagonal.size):
        x, y, z = np.float32(right[row, 0]), np.float32(right[row, 1]), np.float32(right[row, 2])
        here = diagonal[row]
        x, y, z = _minus_product(row_start[row], here, columns, blocks, vector, x, y, z)
        x, y, z = _minus_product(here + 1, row_start[row + 1], columns, blocks, vector, x, y, z)
        _solve_block(blocks[here], x, y, z, row, vector)
