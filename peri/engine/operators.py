"""Nonlocal operators on a lattice, matrix-free: bond sums and what they are made into.

Fields live in *padded* arrays: three axes (a one- or two-dimensional lattice uses the last ones),
a ghost margin of the stencil's reach on each side, zero in the ghosts.

An `Operator` is (A u)_i = d_i u_i - sum_j k_ij u_j on the nodes that are unknown.  Convolution
(k_ij = l_i w_ij r_j) and sums of convolutions are here; conductances of single bonds, broken bonds,
tensors and one-sided stencils are in peri.schemes.
"""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from peri.engine import kernels
from peri.engine.influence import Stencil
from peri.engine.processes import ONE_PROCESS, OneProcess

_TILE_ROWS = 16

LARGEST_SCALE = 1e30
"""Largest ratio of two scales by which a preconditioner is made symmetric.  Scaled, drifts of 10
and 50 over the lattice take 8 and 21 iterations instead of 22 and 83; at ratios of 1e87 and more
the solver's round-off is scaled, too, and it fails (tests/peri/schemes/test_systems.py)."""

Fields = tuple[np.ndarray, ...]


class NonlocalSum:
    """out_i = sum_j w_ij u_j on a lattice, matrix-free.

    The stencil is even or odd in each axis, which the compiled kernel uses (kernels.convolve).

    Parameters
    ----------
    stencil : Stencil
    shape : tuple of int
        Nodes per axis of the lattice (1 to 3 axes).
    wanted : bool array of `shape`, optional
        Nodes whose sum is needed; rows outside their range are skipped and left unchanged.
    method : {"direct", "fft"}
        "fft" is a real FFT pair on the padded box: its cost does not depend on the horizon.
    processes : OneProcess or its like
        Who holds the rest of the lattice when `shape` is a block of it.
    window : tuple of slices, optional
        The part of the block that `shape` covers (default: all of it).
    """

    def __init__(
        self,
        stencil: Stencil,
        shape: tuple[int, ...],
        wanted: np.ndarray | None = None,
        method: str = "direct",
        processes: OneProcess = ONE_PROCESS,
        window: tuple[slice, ...] | None = None,
    ) -> None:
        if method not in ("direct", "fft"):
            raise ValueError(f"method: {method!r}; allowed: direct, fft")
        if method == "fft" and processes is not ONE_PROCESS:
            raise ValueError("method: 'fft' needs the whole lattice in one process; use 'direct'")
        if len(shape) != stencil.dimension:
            raise ValueError(f"shape: {shape} does not have the stencil's {stencil.dimension} axes")
        self.stencil = stencil
        self.lattice_shape = tuple(shape)
        self.method = method
        self.processes, self.window = processes, window
        lead = (1,) * (3 - len(shape))
        self.shape = lead + self.lattice_shape
        # Bonds longer than the lattice find no partner; the constants keep those of the stencil.
        octant = stencil.octant[tuple(map(slice, processes.extent(self.lattice_shape)))]
        self.octant = octant.reshape(lead + octant.shape)
        self.reach = tuple(n - 1 for n in self.octant.shape)
        self.padded_shape = tuple(n + 2 * r for n, r in zip(self.shape, self.reach, strict=True))
        self.interior = tuple(slice(r, r + n) for n, r in zip(self.shape, self.reach, strict=True))
        active = np.ones(self.shape, bool) if wanted is None else wanted.reshape(self.shape)
        self.low, self.high = _row_ranges(active)
        self._tiles = _tiles(self.low, self.high)
        self._signs = (1,) * len(lead) + stencil.parity
        self._shells = _shells(self.octant, self._signs)
        if method == "fft":
            self._transform = self._fft_symbol()

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
        """The rows with work, and the reach: what the compiled loops over rows take."""
        return self.low, self.high, self.reach

    @property
    def tiles(self) -> np.ndarray:
        """(nt, 3) blocks of rows with work, for the compiled loops over tiles."""
        return self._tiles

    @property
    def spacing(self) -> tuple[float, ...]:
        """Node distance on three axes, m (1 along the axes that the lattice lacks)."""
        return (1.0,) * (3 - len(self.stencil.spacing)) + self.stencil.spacing

    def intact(self, axis: int) -> np.ndarray | None:
        """Share of the bonds across each face normal to `axis` that stand; None: all do."""
        return None

    def pad(self, values: np.ndarray) -> np.ndarray:
        """A padded copy of a lattice array."""
        out = np.zeros(self.padded_shape)
        out[self.interior] = np.asarray(values, float).reshape(self.shape)
        return out

    def crop(self, padded: np.ndarray) -> np.ndarray:
        """The lattice part of a padded array (a copy, of the lattice's shape)."""
        return np.array(padded[self.interior], order="C").reshape(self.lattice_shape)

    def on_rows_of(self, nodes: np.ndarray, around: bool = False) -> NonlocalSum:
        """The same sum on the range of each row that holds some nodes (padded, bool).

        around : or what is in their reach, those of other blocks included.
        """
        if around:
            nodes = self.processes.with_ghosts(nodes.astype(float), self.window) > 0
            low, high = _row_ranges(nodes)
            size = tuple(2 * r + 1 for r in self.reach[:2])
            low = np.where(high > low, low, nodes.shape[2])
            low = ndimage.minimum_filter(low, size, mode="nearest")[self.interior[:2]]
            high = ndimage.maximum_filter(high, size, mode="nearest")[self.interior[:2]]
            # From places in padded rows to those in rows of the interior, a reach farther out.
            there, most = high > 0, self.shape[2]
            low = np.where(there, (low - 2 * self.reach[2]).clip(0, most), 0)
            high = np.where(there, high.clip(max=most), 0)
        else:
            low, high = _row_ranges(nodes[self.interior])
        other = copy.copy(self)
        other.low, other.high, other._tiles = low, high, _tiles(low, high)
        return other

    @functools.cached_property
    def _bonds(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets of the bonds in a flat padded array, and their weights."""
        offsets, weights = signed_bonds(self)
        _, rows, columns = self.padded_shape
        return offsets @ np.array([rows * columns, columns, 1]), weights

    def around(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes and all that are in their reach, flat indices of the padded array; of this block's
        nodes only, which lie within its interior."""
        there = np.zeros(self.padded_shape, bool)
        flat = there.ravel()
        flat[nodes] = True
        flat[(nodes[:, None] + self._bonds[0]).ravel()] = True
        return np.flatnonzero(there)

    def at(self, u: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """The sum at some nodes (flat indices of the padded array); directly, bond by bond."""
        u = self.processes.with_ghosts(u, self.window)
        return kernels.convolve_at(u.ravel(), nodes, *self._bonds)

    def __call__(self, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """The sum for a padded field; `out` must not be `u`."""
        if out is None:
            out = np.zeros(self.padded_shape)
        u = self.processes.with_ghosts(u, self.window)
        if self.method == "fft":
            spectrum = fft.rfftn(u[self.interior], s=self._fft_shape, workers=-1)
            spectrum *= self._transform
            full = fft.irfftn(spectrum, s=self._fft_shape, workers=-1)
            out[self.interior] = full[tuple(slice(0, n) for n in self.shape)]
        else:
            kernels.convolve(u, out, self._tiles, self.low, self.high, self.reach, *self._shells)
        return out

    def _fft_symbol(self) -> np.ndarray:
        self._fft_shape = tuple(
            fft.next_fast_len(n + r, real=True) for n, r in zip(self.shape, self.reach, strict=True)
        )
        wrapped = np.zeros(self._fft_shape)
        signed = [np.arange(-r, r + 1) for r in self.reach]
        grids = np.ix_(*[s % n for s, n in zip(signed, self._fft_shape, strict=True)])
        values = self.octant[np.ix_(*[np.abs(s) for s in signed])]
        for a, sign in enumerate(self._signs):
            if sign < 0:
                # The sum runs over receiving nodes: an offset is that of the other node.
                shape = [1, 1, 1]
                shape[a] = -1
                values = -values * np.sign(signed[a]).reshape(shape)
        wrapped[grids] = values
        symbol = fft.rfftn(wrapped, workers=-1)
        return symbol.real if min(self._signs) > 0 else symbol


@dataclass(frozen=True)
class LocalCoefficients:
    """The local operator that a nonlocal one tends to for long waves: sink u - div(t grad u).

    sink : (nx, ny, nz) row sums, >= 0.
    faces : per axis, (nx + 1, ny, nz), (nx, ny + 1, nz), (nx, ny, nz + 1): conductances between
        neighbouring nodes, those to the nodes beside a block included; 0 at the lattice's ends.
    scale : padded array, optional
        s with diag(s) A diag(1/s) symmetric: the coefficients are then those of that operator.
    """

    sink: np.ndarray
    faces: list[np.ndarray]
    scale: np.ndarray | None = None


class Operator(ABC):
    """(A u)_i = d_i u_i - sum_j k_ij u_j on the unknown nodes i, zero elsewhere; matrix-free.

    Parameters
    ----------
    bond_sum : NonlocalSum
        Lattice, rows with work, padding and processes.
    unknown : padded array
        1 on the nodes whose equation this is, 0 elsewhere.
    diagonal : padded array
        d_i.
    symmetric : bool
        Whether k_ij = k_ji among the unknown nodes.

    right : padded array or None
        r of an operator with k_ij = l_i w_ij r_j: solvers hand r u to `apply` at no cost.
    """

    right: np.ndarray | None = None

    def __init__(
        self, bond_sum: NonlocalSum, unknown: np.ndarray, diagonal: np.ndarray, symmetric: bool
    ) -> None:
        self.sum, self.unknown, self._diagonal = bond_sum, unknown, diagonal
        self.symmetric = symmetric

    @abstractmethod
    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        """out_i = sum_j k_ij u_j on the unknown nodes, for any padded u (held nodes included)."""

    @abstractmethod
    def faces(self) -> list[np.ndarray]:
        """Conductances of LocalCoefficients between unknown nodes."""

    def apply(self, u: np.ndarray, out: np.ndarray, scaled: np.ndarray | None = None) -> float:
        """out = A u for u that is zero off the unknowns; returns this process's u . A u.

        scaled : `right` times u, where the caller has it.
        """
        self.gain(u, out)
        products = kernels.diffusion_rows(u, out, self.unknown, self._diagonal, 1.0, *self.sum.rows)
        return float(products.sum())

    def diagonal(self) -> np.ndarray:
        """d_i, padded; zero off the unknowns."""
        return self.unknown * self._diagonal

    def row_sums(self) -> np.ndarray:
        """(A 1)_i over the unknown nodes, padded: what a node exchanges with held ones."""
        out = np.zeros(self.sum.padded_shape)
        self.apply(self.unknown, out)
        return out * self.unknown

    def local(self) -> LocalCoefficients:
        """The local operator of the same coefficients, for the preconditioner."""
        sink = np.maximum(self.row_sums()[self.sum.interior], 0.0)
        return LocalCoefficients(sink, self.faces())


class Convolution(Operator):
    """k_ij = coefficient l_i w_ij r_j: one fast sum a product; symmetric where l is r.

    (A u)_i = l_i (diagonal_i u_i - coefficient sum_j w_ij r_j u_j).  For every positive l, r the
    operator is similar to a symmetric one (scale s = sqrt(r / l)), which preconditions it.

    Parameters
    ----------
    bond_sum : NonlocalSum
    left : padded array
        l_i, zero off the unknowns.
    right : padded array, optional
        r_j; positive on the unknowns, and on held nodes where `gain` is asked for their share.
        By default `left`.
    diagonal : padded array, optional
        By default coefficient sum_j w_ij r_j: nothing happens to a uniform field.
    coefficient : float
        Times the stencil's weights (a diffusivity, m^2/s, gives k in 1/s).
    symmetric : bool, optional
        By default whether `right` is `left`; True where both agree on the unknowns and `right`
        holds further nodes.
    """

    def __init__(
        self,
        bond_sum: NonlocalSum,
        left: np.ndarray,
        right: np.ndarray | None = None,
        diagonal: np.ndarray | None = None,
        coefficient: float = 1.0,
        symmetric: bool | None = None,
    ) -> None:
        right = left if right is None else right
        if diagonal is None:
            diagonal = coefficient * bond_sum(right)
        symmetric = left is right if symmetric is None else symmetric
        super().__init__(bond_sum, (left > 0).astype(float), diagonal, symmetric)
        self.left, self.right, self.coefficient = left, right, coefficient
        self._middle = left if right is left else np.sqrt(left * right * self.unknown)

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        self.sum(self.right * u, out)
        out *= self.coefficient * self.left
        return out

    def apply(self, u: np.ndarray, out: np.ndarray, scaled: np.ndarray | None = None) -> float:
        self.sum(self.right * u if scaled is None else scaled, out)
        products = kernels.diffusion_rows(
            u, out, self.left, self._diagonal, self.coefficient, *self.sum.rows
        )
        return float(products.sum())

    def diagonal(self) -> np.ndarray:
        return self.left * self._diagonal

    def with_diagonal(self, diagonal: np.ndarray) -> Convolution:
        """The same bonds with another diagonal_i, a padded array."""
        other = copy.copy(self)
        other._diagonal = diagonal
        return other

    def faces(self) -> list[np.ndarray]:
        return product_faces(self.sum, self._middle, self._middle, self.coefficient)

    def local(self) -> LocalCoefficients:
        if self.symmetric:
            return super().local()
        # With m = sqrt(l r) and s = sqrt(r / l), s A / s couples by m_i w_ij m_j.
        sink = self.diagonal() - self.coefficient * self._middle * self.sum(self._middle)
        on = self.unknown > 0
        scale = np.where(on, self._middle, 1.0) / np.where(on, self.left, 1.0)
        largest = self.sum.processes.largest
        ratio = largest(scale[on].max(initial=0.0)) * largest((1.0 / scale[on]).max(initial=0.0))
        if ratio > LARGEST_SCALE:
            return super().local()
        sink = np.maximum((sink * self.unknown)[self.sum.interior], 0.0)
        return LocalCoefficients(sink, self.faces(), scale)


def signed_bonds(bond_sum: NonlocalSum) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n, 3) and weights (n,) of a sum's bonds one by one, all orthants."""
    reach, signs = bond_sum.reach, (1,) * (3 - bond_sum.stencil.dimension) + bond_sum.stencil.parity
    grids = np.meshgrid(*[np.arange(-r, r + 1) for r in reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)
    weights = bond_sum.octant[tuple(np.abs(offsets).T)]
    for a, sign in enumerate(signs):
        if sign < 0:
            weights = weights * np.where(offsets[:, a] < 0, -1.0, 1.0)
    used = weights != 0
    return offsets[used].astype(np.int64), weights[used]


class ConvolutionSum(Operator):
    """A sum of convolutions over the same unknowns: k_ij = sum_r l^r_i w^r_ij r^r_j.

    Mean conductances are two of them (see peri.schemes.bonds).

    Parameters
    ----------
    terms : sequence of Convolution
        On one lattice; their stencils may differ (in reach, too, if each has its own NonlocalSum
        of the same padding, i.e. the same stencil shape).
    symmetric : bool
        What the caller knows of the sum.

    Raises
    ------
    ValueError
        If the terms differ in their unknowns or there are none.
    """

    def __init__(self, terms: Sequence[Convolution], symmetric: bool) -> None:
        if not terms:
            raise ValueError("terms: none; a sum of convolutions needs at least one")
        first = terms[0]
        for term in terms[1:]:
            if not np.array_equal(term.unknown, first.unknown):
                raise ValueError("terms: they differ in the nodes where `left` is positive")
        diagonal = sum(term.diagonal() for term in terms)
        super().__init__(first.sum, first.unknown, np.asarray(diagonal), symmetric)
        self.terms = list(terms)
        self._part = np.zeros(first.sum.padded_shape)

    def gain(self, u: np.ndarray, out: np.ndarray) -> np.ndarray:
        self.terms[0].gain(u, out)
        for term in self.terms[1:]:
            out += term.gain(u, self._part)
        return out

    def faces(self) -> list[np.ndarray]:
        parts = [
            product_faces(term.sum, term.left, term.unknown * term.right, term.coefficient)
            for term in self.terms
        ]
        return [np.sum(along, axis=0) for along in zip(*parts, strict=True)]


def product_faces(
    bond_sum: NonlocalSum, one: np.ndarray, other: np.ndarray, coefficient: float
) -> list[np.ndarray]:
    """coefficient / h_a^2 (one_i other_j + one_j other_i) / 2 between neighbours, per axis."""

    def product(low: Fields, high: Fields, conductance: float) -> np.ndarray:
        return conductance * low[0] * high[0]

    def mean_product(low: Fields, high: Fields, conductance: float) -> np.ndarray:
        return conductance * 0.5 * (low[0] * high[1] + low[1] * high[0])

    same = one is other
    fields = [beside(bond_sum, v) for v in ((one,) if same else (one, other))]
    out = []
    for a, h in enumerate(bond_sum.spacing):
        low, high = zip(*(neighbours(f, a) for f in fields), strict=True)
        face = (product if same else mean_product)(low, high, coefficient / h**2)
        intact = bond_sum.intact(a)
        out.append(face if intact is None else face * intact)
    return out


def beside(bond_sum: NonlocalSum, values: np.ndarray) -> np.ndarray:
    """A padded field's interior with one layer around: the neighbouring block's values, or zero."""
    filled = bond_sum.processes.with_ghosts(values, bond_sum.window)
    layer, missing = [], []
    for r, n in zip(bond_sum.reach, bond_sum.shape, strict=True):
        width = min(r, 1)
        layer.append(slice(r - width, r + n + width))
        missing.append((1 - width, 1 - width))
    return np.pad(filled[tuple(layer)], missing)


def neighbours(layered: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Values on both sides of the faces across an axis, of a field with one layer around."""
    inside = [slice(1, -1)] * 3
    low, high = list(inside), list(inside)
    low[axis], high[axis] = slice(0, -1), slice(1, None)
    return layered[tuple(low)], layered[tuple(high)]


def _row_ranges(active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one past the last active node of every row (both 0 where there is none)."""
    present = active.any(axis=2)
    low = np.where(present, active.argmax(axis=2), 0)
    high = np.where(present, active.shape[2] - active[:, :, ::-1].argmax(axis=2), 0)
    return low.astype(np.int64), high.astype(np.int64)


def _tiles(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Blocks (plane, first row, last row) of rows with work; the kernel runs over these."""
    tiles = []
    for i, row in enumerate(high > low):
        filled = np.flatnonzero(row)
        if filled.size:
            for j in range(filled[0], filled[-1] + 1, _TILE_ROWS):
                tiles.append((i, j, min(j + _TILE_ROWS, filled[-1] + 1)))
    return np.array(tiles, np.int64).reshape(-1, 3)


def _shells(octant: np.ndarray, signs: tuple[int, ...]) -> tuple:
    """Rows of the stencil grouped by equal weight columns, in the form the kernel takes."""
    groups: dict[bytes, list[tuple[int, int]]] = {}
    scale = np.abs(octant).max()

    def column(a: int, b: int) -> np.ndarray:
        return octant[a, b] if b >= 0 else signs[1] * octant[a, -b]

    for a in range(octant.shape[0]):
        for b in range(octant.shape[1]):
            if octant[a, b].any():
                for signed in {b, -b}:
                    key = np.round(column(a, signed) / scale, 13).tobytes()
                    groups.setdefault(key, []).append((a, signed))
    groups = groups or {b"": [(0, 0)]}  # no bonds at all: one shell of zeros
    # Longest columns first, so that the shells that matter at distance c are the first ones.
    ordered = sorted(groups.values(), key=lambda p: -np.flatnonzero(column(*p[0])).max(initial=0))
    sources = np.array([row for rows in ordered for row in rows], np.int64)
    start = np.cumsum([0] + [len(rows) for rows in ordered])
    weights = np.array([column(*rows[0]) for rows in ordered]).T.copy()
    used = np.array([int(np.flatnonzero(w).max(initial=-1)) + 1 for w in weights])
    return (
        sources[:, 0].copy(),
        sources[:, 1].copy(),
        start.astype(np.int64),
        weights,
        np.maximum(used, 1),
        float(signs[0]),
        float(signs[2]),
    )
