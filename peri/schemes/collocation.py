"""Weighted least squares collocation: rows that are exact for quadratics next to any boundary.

Dissertation 3.2 (Eqs 3.22 to 3.31): a quadratic is fitted to the values of a node's neighbours
and its own, and the diffusion operator is that of the fit; for second-order monomials the
nonlocal integral (Eqs 3.62 to 3.67) is the Laplacian of the fit.  Nodes that have all neighbours
share one even stencil, a fast convolution; the others have a row of their own, one-sided, so the
matrix is not symmetric, and its entries may be negative.
"""

from __future__ import annotations

import itertools

import numpy as np

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum, Operator, product_faces, signed_bonds
from peri.schemes.stored import BondTable, flat_shifts


def fit_weight(distance: np.ndarray, largest: float) -> np.ndarray:
    """Weight of a neighbour at `distance` in the fit, Eq. 3.26; `largest` over the cloud."""
    return np.expm1(64.0 - 16.0 * (distance / largest) ** 2) / np.expm1(64.0)


def laplacian_row(bonds: np.ndarray) -> np.ndarray:
    """Coefficients of u_j - u_i in the Laplacian of the fit at node i.

    bonds : (n, d) vectors to the neighbours, m.  Returns (n,), 1/m^2.
    Raises ValueError where the neighbours do not determine a quadratic.
    """
    d = bonds.shape[1]
    scale = np.abs(bonds).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(scale > 0, bonds / np.where(scale > 0, scale, 1.0), 0.0)
    pairs = list(itertools.combinations_with_replacement(range(d), 2))
    monomials = np.stack(
        [np.ones(len(x)), *(x[:, a] for a in range(d)), *(x[:, a] * x[:, b] for a, b in pairs)], 1
    )
    own = np.zeros(monomials.shape[1])
    own[0] = 1.0
    distance = np.linalg.norm(bonds, axis=1)
    largest = float(distance.max(initial=0.0)) or 1.0
    root = np.sqrt(np.concatenate([[1.0], fit_weight(distance, largest)]))
    fit = root[:, None] * np.vstack([own, monomials])
    values, vectors = np.linalg.svd(fit, full_matrices=False)[1:]
    if len(fit) < fit.shape[1] or values[-1] <= 1e-9 * values[0]:
        raise ValueError("neighbours: they do not determine a quadratic")
    wanted = np.zeros(fit.shape[1])
    for p, (a, b) in enumerate(pairs):
        if a == b:
            wanted[1 + d + p] = 2.0 / scale[a] ** 2
    # Row = wanted' (F'F)^-1 F' with F = root * monomials.
    inverse = vectors.T @ ((vectors @ wanted) / values**2)
    return (fit @ inverse * root)[1:]


class Collocation(Operator):
    """(A u)_i = D sum_j l_ij (u_i - u_j), l the Laplacian of the fitted quadratic; not symmetric.

    Parameters
    ----------
    stencil : Stencil
        Its bonds are the neighbours that a fit looks at; their weights play no part.
    shape : tuple of int
        Nodes of the lattice per axis.
    there, unknown : bool arrays of `shape`
        Nodes that exist, and those whose equation this is (the others are held).
    diffusivity : float
        D, m^2/s.

    regular : number of unknown nodes with all neighbours.

    Raises
    ------
    ValueError
        If the neighbours of an unknown node do not determine a quadratic (too few, or in one
        line or plane).
    """

    def __init__(
        self,
        stencil: Stencil,
        shape: tuple[int, ...],
        there: np.ndarray,
        unknown: np.ndarray,
        diffusivity: float = 1.0,
    ) -> None:
        listing = NonlocalSum(Stencil((stencil.octant != 0).astype(float), stencil.spacing), shape)
        offsets = signed_bonds(listing)[0]
        d = stencil.dimension
        bonds = offsets[:, 3 - d :] * np.array(stencil.spacing)
        complete = listing.reach[3 - d :] == stencil.reach
        octant = np.zeros(listing.octant.shape)
        if complete:
            octant[tuple(np.abs(offsets).T)] = laplacian_row(bonds)
        fast = NonlocalSum(
            Stencil(octant[(0,) * (3 - d)], stencil.spacing), shape, wanted=np.asarray(unknown)
        )
        on = fast.pad(np.logical_and(there, unknown))
        self._there = fast.pad(there)
        nodes = np.flatnonzero(on)
        shifts = flat_shifts(listing, offsets)
        count = listing(self._there).ravel()[nodes]
        own = count < offsets.shape[0] - 0.5 if complete else np.ones(nodes.size, bool)
        near = self._there.ravel()[nodes[own][:, None] + shifts] > 0
        table = _rows(bonds, near, diffusivity)
        diagonal = np.zeros(fast.padded_shape)
        diagonal.ravel()[nodes] = diffusivity * fast.stencil.total
        diagonal.ravel()[nodes[own]] = table.sum(axis=1)
        super().__init__(fast, on, diagonal, symmetric=False)
        self.diffusivity, self.regular = diffusivity, int((~own).sum())
        special = np.zeros(fast.padded_shape)
        special.ravel()[nodes[own]] = 1.0
        self._own = BondTable(listing, special, table)

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        u = self._there * u
        self.sum(u, out)
        out *= self.diffusivity * self.unknown
        return self._own(u, out)

    def faces(self) -> list[np.ndarray]:
        return product_faces(self.sum, self.unknown, self.unknown, self.diffusivity)


def _rows(bonds: np.ndarray, near: np.ndarray, diffusivity: float) -> np.ndarray:
    """Rows of their own, (nodes, bonds); each pattern of neighbours `near` is fitted once."""
    table = np.zeros(near.shape)
    _, first, number = np.unique(
        np.packbits(near, axis=1), axis=0, return_index=True, return_inverse=True
    )
    for p, pattern in enumerate(near[first]):
        try:
            row = laplacian_row(bonds[pattern])
        except ValueError as error:
            raise ValueError(
                f"there: {int((number == p).sum())} nodes have {int(pattern.sum())} neighbours, "
                "which do not determine a quadratic"
            ) from error
        table[np.ix_(number == p, pattern)] = diffusivity * row
    return table
