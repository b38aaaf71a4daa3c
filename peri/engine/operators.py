"""Nonlocal sums over a lattice as operators: apply, pad, restrict; direct or by FFT.

Fields live in *padded* arrays: three axes (a one- or two-dimensional lattice uses the last ones),
a ghost margin of the stencil's reach on each side, zero in the ghosts.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from peri.engine import kernels
from peri.engine.influence import Stencil
from peri.engine.processes import ONE_PROCESS, OneProcess

_TILE_ROWS = 16


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

    def pad(self, values: np.ndarray) -> np.ndarray:
        """A padded copy of a lattice array."""
        out = np.zeros(self.padded_shape)
        out[self.interior] = np.asarray(values, float).reshape(self.shape)
        return out

    def crop(self, padded: np.ndarray) -> np.ndarray:
        """The lattice part of a padded array (a copy, of the lattice's shape)."""
        return np.array(padded[self.interior], order="C").reshape(self.lattice_shape)

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
