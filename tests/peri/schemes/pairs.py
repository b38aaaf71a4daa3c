"""Operators of bonds written down pair by pair, to check the fast ones against."""

import itertools

import numpy as np

from peri.engine.influence import Stencil, diffusion_stencil
from peri.engine.lattice import Lattice

CASES = {
    # shape, horizon, spacing: even and odd sizes, boxes thinner than the horizon, one node, rows
    # beyond one tile of the convolution (16) and of the broken bonds (4 x 8 x 16)
    "1D": ((37,), 3.0, (1.0,)),
    "1D, one node": ((1,), 2.0, (1.0,)),
    "2D": ((9, 21), 2.0, (1.0, 1.0)),
    "2D, stretched": ((7, 12), (2.0, 6.0), (1.0, 3.0)),
    "3D": ((5, 9, 6), 2.0, (1.0, 1.0, 1.0)),
    "3D, thin": ((2, 18, 4), 3.0, (1.0, 1.0, 1.0)),
}


def stencil_of(name: str) -> Stencil:
    shape, horizon, spacing = CASES[name]
    return diffusion_stencil(Lattice((0.0,) * len(shape), spacing, shape), horizon)


def signed_weight(stencil: Stencil, offset) -> float:
    """Weight of one bond; 0 beyond the reach."""
    if any(abs(o) > r for o, r in zip(offset, stencil.reach, strict=True)):
        return 0.0
    value = stencil.octant[tuple(abs(o) for o in offset)]
    for o, parity in zip(offset, stencil.parity, strict=True):
        if o < 0:
            value = value * parity
    return float(value)


def pair_values(shape, value, reach=None):
    """Dense (N, N) of value(i, j, offset) over pairs of different nodes (within `reach`)."""
    number = {node: n for n, node in enumerate(itertools.product(*map(range, shape)))}
    out = np.zeros((len(number), len(number)))
    reach = reach or [n - 1 for n in shape]
    offsets = [o for o in itertools.product(*[range(-r, r + 1) for r in reach]) if any(o)]
    for i, row in number.items():
        for offset in offsets:
            j = tuple(a + o for a, o in zip(i, offset, strict=True))
            if j in number:
                out[row, number[j]] = value(i, j, offset)
    return out


def random_nodes(shape, rng):
    """Which nodes exist (most), and which of those are unknown (most of them)."""
    there = rng.random(shape) < 0.8
    there.flat[0] = True
    unknown = there & (rng.random(shape) < 0.7)
    unknown.flat[0] = True
    return there, unknown


def plain(function):
    """The Python function behind a compiled kernel."""
    return getattr(function, "__wrapped__", None) or function.py_func
