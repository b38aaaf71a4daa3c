"""Small tetrahedral meshes made with NumPy, so that the tests of `fem` need no mesh generator."""

from __future__ import annotations

from itertools import permutations

import numpy as np


def box(
    shape: tuple[int, int, int], size: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Kuhn's six tetrahedra per brick: points (n, 3) [m], cells (6 nx ny nz, 4)."""
    nx, ny, nz = shape
    axes = [np.linspace(0.0, s, n + 1) for s, n in zip(size, shape, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    corner = np.stack([i, j, k], axis=-1).reshape(-1, 3)
    cells = []
    for order in permutations(range(3)):
        steps = np.zeros((4, 3), int)
        for at, axis in enumerate(order):
            steps[at + 1 :, axis] += 1
        v = corner[:, None, :] + steps[None]
        cells.append((v[..., 0] * (ny + 1) + v[..., 1]) * (nz + 1) + v[..., 2])
    return points, np.concatenate(cells)


def round_bar(
    across: int, along: int, radius: float, length: float, waist: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """A bar of circular section (square mapped to disc), thinner by `waist` at z = L/2."""
    points, cells = box((across, across, along), (2.0, 2.0, length))
    x, y = points[:, 0] - 1.0, points[:, 1] - 1.0
    largest = np.maximum(abs(x), abs(y))
    norm = np.hypot(x, y)
    factor = np.where(norm > 0, largest / np.where(norm > 0, norm, 1.0), 0.0)
    local = radius * (1.0 - waist * np.exp(-(((points[:, 2] / length - 0.5) / 0.15) ** 2)))
    points[:, 0], points[:, 1] = x * factor * local, y * factor * local
    corners = points[cells]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    flat = abs(volumes) <= 1e-12 * abs(volumes).max()
    return points, cells[~flat]


def distorted_box(
    shape: tuple[int, int, int] = (2, 2, 3),
    size: tuple[float, float, float] = (1e-3, 1e-3, 1.5e-3),
    amount: float = 0.15,
) -> tuple[np.ndarray, np.ndarray]:
    """A box whose inner vertices are displaced at random, by `amount` of the spacing."""
    points, cells = box(shape, size)
    spacing = np.array(size) / np.array(shape)
    inner = np.all((points > 1e-9) & (points < np.array(size) - 1e-9), axis=1)
    noise = np.random.default_rng(2).uniform(-amount, amount, points.shape) * spacing
    points[inner] += noise[inner]
    return points, cells


def quarter_bar(
    across: int, along: int, radius: float, length: float, taper: float
) -> tuple[np.ndarray, np.ndarray]:
    """x, y, z > 0 of a bar with its middle at z = 0; radius (1 - taper) there, linear to the end.

    length: of the whole bar. Cells are finer towards the middle. The radius is scaled such that
    the volume is that of the smooth body in spite of the straight edges of the cells.
    """
    points, cells = box((across, across, along), (1.0, 1.0, 1.0))
    x, y, z = points.T.copy()
    norm = np.hypot(x, y)
    factor = np.where(norm > 0, np.maximum(x, y) / np.where(norm > 0, norm, 1.0), 0.0)
    z = z**1.6
    local = radius * (1.0 - taper + taper * z)
    points = np.c_[x * factor * local, y * factor * local, 0.5 * length * z]
    corners = points[cells]
    volume = abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0
    small, large = radius * (1.0 - taper), radius
    exact = np.pi / 24.0 * length * (small**2 + small * large + large**2)
    points[:, :2] *= np.sqrt(exact / volume)
    return points, cells
