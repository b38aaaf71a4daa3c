"""Conductances of bonds: means, geometric and harmonic means, exponential fitting.

The arithmetic and the geometric mean and the square-root flux are convolutions and cost one or
two fast sums; the harmonic mean and the exponential fitting (Scharfetter and Gummel) look at each
bond.  The square-root and the fitted flux of a drifting species vanish in Boltzmann equilibrium,
C ~ exp(-s), whatever the step of s over a bond, and keep concentrations positive.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from peri.engine.operators import (
    LARGEST_SCALE,
    Convolution,
    ConvolutionSum,
    LocalCoefficients,
    NonlocalSum,
    Operator,
    beside,
    neighbours,
    signed_bonds,
)
from peri.schemes import bond_kernels
from peri.schemes.broken import BrokenSum
from peri.schemes.stored import BondTable, flat_shifts

_LARGEST_RANGE = 600.0
"""Largest range of s over the nodes for which exp(s / 2) is formed (doubles end at 1400)."""

_BLOCK = 2048
"""Nodes whose bonds are stored at a time: their intermediate arrays stay in the cache."""


def mean_conductances(
    bond_sum: NonlocalSum, conductivity: np.ndarray, unknown: np.ndarray, coefficient: float = 1.0
) -> ConvolutionSum:
    """k_ij = coefficient w_ij (kappa_i + kappa_j) / 2 as two convolutions; symmetric.

    Parameters
    ----------
    bond_sum : NonlocalSum
    conductivity : padded array, >= 0
        Nodes where it vanishes do not exist.
    unknown : padded array
        1 on the nodes whose equation this is; other existing nodes are held.
    coefficient : float
    """
    there = (conductivity > 0).astype(float)
    on = unknown * there
    half = 0.5 * coefficient
    terms = [
        Convolution(bond_sum, on * conductivity, there, coefficient=half),
        Convolution(bond_sum, on, conductivity, coefficient=half),
    ]
    return ConvolutionSum(terms, symmetric=True)


def geometric_conductances(
    bond_sum: NonlocalSum, conductivity: np.ndarray, unknown: np.ndarray, coefficient: float = 1.0
) -> Convolution:
    """k_ij = coefficient w_ij sqrt(kappa_i kappa_j), one convolution; symmetric.

    Parameters: as for mean_conductances.
    """
    root = np.sqrt(conductivity)
    return Convolution(bond_sum, unknown * root, root, coefficient=coefficient, symmetric=True)


def square_root_fluxes(
    bond_sum: NonlocalSum,
    drift: np.ndarray,
    there: np.ndarray,
    unknown: np.ndarray,
    coefficient: float = 1.0,
) -> Convolution:
    """Flux into i: coefficient w_ij [exp(u/2) C_j - exp(-u/2) C_i], u = s_j - s_i; not symmetric.

    One convolution.  For y = exp(s/2) C, and with the equation of node i times exp(s_i/2), the
    matrix is that of Convolution(bond_sum, unknown, there, diagonal, coefficient, symmetric=True)
    with diagonal_i = coefficient exp(s_i/2) sum_j w_ij exp(-s_j/2): symmetric.

    Parameters
    ----------
    bond_sum : NonlocalSum
    drift : padded array
        s = z F phi / (R T).
    there, unknown : padded arrays
        1 on the nodes that exist, and on those whose equation this is.
    coefficient : float
        D, m^2/s.

    Raises
    ------
    ValueError
        If s spans more than 600 over the nodes.
    """
    up, down = _half_factors(bond_sum, drift, there)
    # l_i d_i = coefficient exp(s_i/2) sum_j w_ij exp(-s_j/2), with l_i = exp(-s_i/2)
    diagonal = coefficient * up**2 * bond_sum(down)
    return Convolution(bond_sum, unknown * down, up, diagonal, coefficient)


def _half_factors(
    bond_sum: NonlocalSum, drift: np.ndarray, there: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """exp(s/2) and exp(-s/2) on the nodes that exist, s from the middle of its range."""
    spread, level = _centred(bond_sum, drift, there)
    if not spread <= _LARGEST_RANGE:
        raise ValueError(
            f"drift: spans {spread:.4g} over the nodes; at most {_LARGEST_RANGE:g} are allowed "
            "(Exponential takes any)"
        )
    on = there > 0
    return np.where(on, np.exp(0.5 * level), 0.0), np.where(on, np.exp(-0.5 * level), 0.0)


def _centred(
    bond_sum: NonlocalSum, drift: np.ndarray, there: np.ndarray
) -> tuple[float, np.ndarray]:
    """Range of s over the nodes that exist, and s minus the middle of it (0 elsewhere)."""
    values = drift[there > 0]
    largest = bond_sum.processes.largest
    high = largest(float(values.max(initial=-np.inf)))
    low = -largest(float((-values).max(initial=-np.inf)))
    if high < low:
        return 0.0, np.zeros_like(drift)
    return high - low, np.where(there > 0, drift - 0.5 * (low + high), 0.0)


class BondConductance(Operator):
    """k_ij = coefficient w_ij g(i, j), a rule g for each bond between nodes that exist.

    The rule is evaluated anew in every product, or once and stored: 8 B a bond and node, which
    pays where g is dear (an exponential) and a solver asks for many products.

    Parameters
    ----------
    bond_sum : NonlocalSum
    field : padded array
        What the rule looks at, node by node.
    there, unknown : padded arrays
        1 on the nodes that exist, and on those whose equation this is.
    coefficient : float
        Times the stencil's weights.
    stored : bool
        Whether to keep the bonds' values.
    symmetric : bool

    Raises
    ------
    ValueError
        For a sum with broken bonds, unless the bonds' values are stored.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        field: np.ndarray,
        there: np.ndarray,
        unknown: np.ndarray,
        coefficient: float,
        stored: bool,
        symmetric: bool,
    ) -> None:
        if isinstance(bond_sum, BrokenSum) and not stored:
            raise ValueError("stored: False; with broken bonds the values of bonds must be stored")
        self.there, self.coefficient = there, coefficient
        self.sum = bond_sum
        self._field = self._neighbours_field(field)
        self._offsets, self._weights = signed_bonds(bond_sum)
        super().__init__(bond_sum, unknown * there, np.zeros(bond_sum.padded_shape), symmetric)
        self._table: BondTable | None = None
        if stored:
            self._store()
        else:
            self._sum_bonds(self._filled(there), self._diagonal, outward=True)
            self._diagonal *= coefficient * self.unknown

    @abstractmethod
    def rule(self, here: np.ndarray, near: np.ndarray) -> np.ndarray:
        """g(i, j) of the field's values at i and at j."""

    @abstractmethod
    def _sum_bonds(self, u: np.ndarray, out: np.ndarray, outward: bool = False) -> None:
        """out_i = sum_j w_ij g(i, j) u_j on the fly, or with g(j, i); ghosts of u filled."""

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        if self._table is not None:
            out[:] = 0.0
            return self._table(u, out)
        self._sum_bonds(self._filled(self.there * u), out)
        out *= self.coefficient * self.unknown
        return out

    def _neighbours_field(self, field: np.ndarray) -> np.ndarray:
        return self._filled(field).copy()  # the next exchange may use the same memory

    def _filled(self, u: np.ndarray) -> np.ndarray:
        return self.sum.processes.with_ghosts(u, self.sum.window)

    def _store(self) -> None:
        """Keep k_ij of the unknown nodes' bonds, and the diagonal, sum_j k_ji."""
        nodes, field = np.flatnonzero(self.unknown), self._field.ravel()
        there = self._filled(self.there).ravel()
        shifts = flat_shifts(self.sum, self._offsets)
        table, outflow = np.empty((nodes.size, shifts.size)), np.empty(nodes.size)
        broken = None
        if isinstance(self.sum, BrokenSum):
            broken = self.sum.broken.of_nodes(self.unknown[self.sum.interior] > 0)
        for first in range(0, nodes.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            ends = nodes[block, None] + shifts
            weight = self.coefficient * self._weights * there[ends]
            if broken is not None:
                weight[broken[block]] = 0.0
            here, near = field[nodes[block], None], field[ends]
            table[block] = weight * self.rule(here, near)
            outflow[block] = (weight * self.rule(near, here)).sum(axis=1)
        self._table = BondTable(self.sum, self.unknown, table)
        self._diagonal.ravel()[nodes] = outflow


class Harmonic(BondConductance):
    """k_ij = coefficient w_ij 2 kappa_i kappa_j / (kappa_i + kappa_j); symmetric.

    Parameters
    ----------
    bond_sum, unknown, coefficient, stored : as for BondConductance
    conductivity : padded array, >= 0
        Nodes where it vanishes do not exist.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        conductivity: np.ndarray,
        unknown: np.ndarray,
        coefficient: float = 1.0,
        stored: bool = False,
    ) -> None:
        on = conductivity > 0
        resistance = np.where(on, 1.0 / np.where(on, conductivity, 1.0), np.inf)
        super().__init__(
            bond_sum, resistance, on.astype(float), unknown, coefficient, stored, symmetric=True
        )

    def _neighbours_field(self, field: np.ndarray) -> np.ndarray:
        # Beyond the lattice's ends an exchange leaves zeros.
        filled = super()._neighbours_field(field)
        return np.where(filled > 0, filled, np.inf)

    def rule(self, here: np.ndarray, near: np.ndarray) -> np.ndarray:
        return 2.0 / (here + near)

    def _sum_bonds(self, u: np.ndarray, out: np.ndarray, outward: bool = False) -> None:
        bond_kernels.harmonic_gain(
            u, out, self._field, self.sum.tiles, *self.sum.rows, self._offsets, self._weights
        )

    def faces(self) -> list[np.ndarray]:
        on = self.unknown > 0
        conductivity = beside(self.sum, np.where(on, 1.0 / np.where(on, self._field, 1.0), 0.0))
        out = []
        for a, h in enumerate(self.sum.spacing):
            low, high = neighbours(conductivity, a)
            total = low + high
            mean = 2.0 * low * high / np.where(total > 0, total, 1.0)
            out.append(_standing(self.sum, self.coefficient / h**2 * mean, a))
        return out


class Exponential(BondConductance):
    """Exponential fitting: flux into i is D w_ij [B(-u) C_j - B(u) C_i], u = s_j - s_i.

    B(x) = x / (exp(x) - 1); not symmetric.  Exact in equilibrium for any step of s, central
    differences for small ones.  The scale exp(s/2) makes the matrix symmetric, with couplings
    D w_ij (u/2) / sinh(u/2); these precondition it while s spans at most
    operators.LARGEST_SCALE says.

    Parameters
    ----------
    bond_sum, there, unknown, stored : as for BondConductance
    drift : padded array
        s = z F phi / (R T).
    coefficient : float
        D, m^2/s.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        drift: np.ndarray,
        there: np.ndarray,
        unknown: np.ndarray,
        coefficient: float = 1.0,
        stored: bool = True,
    ) -> None:
        super().__init__(
            bond_sum,
            np.where(there > 0, drift, 0.0),
            there,
            unknown,
            coefficient,
            stored,
            symmetric=False,
        )

    def rule(self, here: np.ndarray, near: np.ndarray) -> np.ndarray:
        difference = near - here
        flat = difference == 0
        safe = np.where(flat, 1.0, difference)
        with np.errstate(over="ignore"):
            return np.where(flat, 1.0, -safe / np.expm1(-safe))

    def _sum_bonds(self, u: np.ndarray, out: np.ndarray, outward: bool = False) -> None:
        bond_kernels.exponential_gain(
            u,
            out,
            self._field,
            -1.0 if outward else 1.0,
            self.sum.tiles,
            *self.sum.rows,
            self._offsets,
            self._weights,
        )

    def faces(self) -> list[np.ndarray]:
        on, drift = beside(self.sum, self.unknown), beside(self.sum, self._field)
        out = []
        for a, h in enumerate(self.sum.spacing):
            (low, high), (here, near) = neighbours(on, a), neighbours(drift, a)
            half = np.minimum(0.5 * np.abs(near - here), 350.0)
            flat = half == 0
            share = np.where(flat, 1.0, half / np.sinh(np.where(flat, 1.0, half)))
            out.append(_standing(self.sum, self.coefficient / h**2 * low * high * share, a))
        return out

    def local(self) -> LocalCoefficients:
        on = self.unknown > 0
        spread, level = _centred(self.sum, self._field, self.unknown)
        if spread > 2.0 * np.log(LARGEST_SCALE):
            return super().local()
        scale = np.where(on, np.exp(0.5 * level), 1.0)
        # Row sums of the scaled operator: d_i - s_i sum_j k_ij / s_j.
        down = np.where(on, 1.0 / scale, 0.0)
        sums = self.diagonal() - scale * self.gain(down, np.zeros(self.sum.padded_shape))
        sink = np.maximum((sums * self.unknown)[self.sum.interior], 0.0)
        return LocalCoefficients(sink, self.faces(), scale)


def _standing(bond_sum: NonlocalSum, face: np.ndarray, axis: int) -> np.ndarray:
    intact = bond_sum.intact(axis)
    return face if intact is None else face * intact
