"""Growth of f averaged over a length, so that softening does not end in a single row of cells."""

from __future__ import annotations

import inspect

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg

# SciPy 1.12 renamed the argument
_TOLERANCE = {"rtol" if "rtol" in inspect.signature(cg).parameters else "tol": 1e-8}


class DamageLength:
    """Implicit gradient (Peerlings et al. 1996) for the plastic volume strain that opens pores.

    Solves  mean - length^2 Laplace(mean) = strain  with no flux at the surface, by linear elements
    with lumped mass on the vertices of the porous cells; the volume integral is conserved. Metal
    without pores takes no part, so that f = 0 stays f = 0.
    """

    def __init__(self, points: np.ndarray, cells: np.ndarray, length: float) -> None:
        """points: (n, 3) [m]; cells: (nc, 4); length [m]."""
        self.length = length
        self._cells, self._vertices = cells, len(points)
        corners = points[cells]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        inverse = np.linalg.inv(edges)
        self._gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        self.volumes = np.abs(np.linalg.det(edges)) / 6.0
        self._active = np.zeros(0, bool)
        self._matrix: csr_matrix | None = None

    def _assemble(self, active: np.ndarray) -> None:
        gradients, volumes = self._gradients[active], self.volumes[active]
        vertices, numbered = np.unique(self._cells[active], return_inverse=True)
        self._numbered = numbered.reshape(-1, 4)
        self._mass = np.bincount(
            self._numbered.ravel(), np.repeat(0.25 * volumes, 4), minlength=len(vertices)
        )
        values = (
            self.length**2
            * volumes[:, None, None]
            * np.einsum("cai,cbi->cab", gradients, gradients)
        )
        rows = np.repeat(self._numbered, 4, axis=1)
        columns = np.tile(self._numbered, (1, 4))
        shape = (len(vertices), len(vertices))
        stiffness = coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        self._matrix = (stiffness + diags(self._mass)).tocsr()
        self._inverse_diagonal = diags(1.0 / self._matrix.diagonal())
        self._active = active.copy()

    def average(self, strain: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Averaged strain of each cell; strain: (nc,); active: (nc,) bool, the porous cells.

        Cells that are not active keep what they have.
        """
        result = np.array(strain, float)
        if not active.any() or not np.any(strain[active]):
            return result
        if self._matrix is None or not np.array_equal(active, self._active):
            self._assemble(active)
        shares = 0.25 * self.volumes[active] * strain[active]
        right = np.bincount(self._numbered.ravel(), np.repeat(shares, 4), minlength=len(self._mass))
        mean, failed = cg(
            self._matrix, right, right / self._mass, atol=0.0, M=self._inverse_diagonal,
            **_TOLERANCE,
        )  # fmt: skip
        if failed:
            raise RuntimeError("the averaging of the damage did not converge")
        result[active] = mean[self._numbered].mean(axis=1)
        return result
