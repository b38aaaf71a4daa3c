"""Cells that two phases share: handing volumes to neighbours, boxes around marked cells."""

from __future__ import annotations

import itertools

import numpy as np


def hand_over(amount: np.ndarray, receiver: np.ndarray) -> np.ndarray:
    """Split each cell's amount evenly over its nearest receiving neighbours (faces, then all)."""
    out = np.zeros_like(amount)
    window = around(amount != 0)
    if window is not None:
        out[window] = _hand_over_everywhere(amount[window], receiver[window])
    return out


def around(cells: np.ndarray) -> tuple[slice, ...] | None:
    """The part of a box that holds the marked cells and their neighbours; None without any."""
    window = []
    for a in range(cells.ndim):
        marked = np.flatnonzero(cells.any(axis=tuple(b for b in range(cells.ndim) if b != a)))
        if not marked.size:
            return None
        window.append(slice(max(0, marked[0] - 1), marked[-1] + 2))
    return tuple(window)


def _hand_over_everywhere(amount: np.ndarray, receiver: np.ndarray) -> np.ndarray:
    out = np.zeros_like(amount)
    d = amount.ndim
    moves = [m for m in itertools.product((-1, 0, 1), repeat=d) if any(m)]
    left = amount
    for ring in ([m for m in moves if sum(map(abs, m)) == 1], moves):
        shifted = [_shift(receiver.astype(float), m) for m in ring]
        count = sum(shifted)
        each = np.where(count > 0, left / np.maximum(count, 1), 0.0)
        for m, has in zip(ring, shifted, strict=True):
            out += _shift(each * has, tuple(-v for v in m))
        left = np.where(count > 0, 0.0, left)
        if not left.any():
            break
    return out


def _shift(values: np.ndarray, move: tuple[int, ...]) -> np.ndarray:
    """out[i] = values[i + move], zero from outside."""
    out = np.zeros_like(values)
    target, source = [], []
    for m, n in zip(move, values.shape, strict=True):
        target.append(slice(max(0, -m), n - max(0, m)))
        source.append(slice(max(0, m), n - max(0, -m)))
    out[tuple(target)] = values[tuple(source)]
    return out
