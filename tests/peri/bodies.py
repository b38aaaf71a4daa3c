"""Closed triangle surfaces of simple bodies, and what is known of them exactly."""

import numpy as np
from numpy.typing import NDArray

from peri.engine.surface.triangles import Surface


def box(lower, upper) -> Surface:
    """A cuboid of twelve triangles."""
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    facets = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
    return Surface(low + corners * (high - low), np.array(facets))


def ball(radius: float, refinements: int, scaled: bool = False) -> Surface:
    """An icosahedron refined on the sphere; scaled: to the ball's own volume."""
    g = 0.5 * (1 + 5**0.5)
    vertices = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0)]
    vertices += [(c, a, b) for a, b, c in vertices] + [(b, c, a) for a, b, c in vertices]
    vertices = np.array(vertices, float)
    pairs = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 2.1
    facets = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if pairs[i, j] and pairs[j, k] and pairs[i, k]
    ]
    facets = np.array(facets)
    inward = np.linalg.det(vertices[facets]) < 0
    facets[inward] = facets[inward][:, ::-1]
    vertices /= np.linalg.norm(vertices, axis=1)[:, None]
    for _ in range(refinements):
        edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]))
        edges, where = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = len(vertices) + where.reshape(3, -1)
        middle = vertices[edges].sum(axis=1)
        vertices = np.vstack([vertices, middle / np.linalg.norm(middle, axis=1)[:, None]])
        i, j, k = facets.T
        facets = np.vstack(
            [np.stack(t, axis=1) for t in ((i, a, c), (j, b, a), (k, c, b), (a, b, c))]
        )
    if scaled:
        volume = np.linalg.det(vertices[facets]).sum() / 6
        vertices = vertices * (4 * np.pi / 3 / volume) ** (1 / 3)
    return Surface(radius * vertices, facets)


def ball_exposure(depth: NDArray, radius: float, horizon: float) -> NDArray:
    """Lambda in a ball of more than half the horizon's radius, q = 0, omega = 1.

    The share of a sphere of radius s about a point at distance a from the centre that lies
    outside is 1/2 - (R^2 - a^2 - s^2) / (4 a s) for s > R - a; times 4 pi / s, over s.
    """
    a = radius - depth
    rest = (radius**2 - a**2) / (2 * a) * (1 / depth - 1 / horizon)
    value = np.log(horizon / depth) - rest + (horizon - depth) / (2 * a)
    return 2 * np.pi * np.where(depth < horizon, value, 0.0)


def turned(surface: Surface, seed: int) -> tuple[Surface, NDArray]:
    """The surface in a random orientation, and the matrix that turned it."""
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    return Surface(surface.vertices @ rotation.T, surface.facets), rotation
