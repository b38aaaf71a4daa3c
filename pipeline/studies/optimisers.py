"""Two searches that need no derivatives, to be compared with least squares: a swarm and CMA-ES.

Both minimise a function of points of the unit cube; a caller decides what the cube stands for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Loss = Callable[[Array], float]

INERTIA, PULL = 0.7298, 1.49618
"""Of a particle's way, and of its own and the swarm's best place (Clerc and Kennedy 2002)."""


def swarm(loss: Loss, dimension: int, particles: int, iterations: int, seed: int) -> Array:
    """Particle swarm (Kennedy and Eberhart 1995) in the unit cube; returns the best place.

    Each iteration evaluates every particle; those that leave the cube stop at its wall.
    """
    random = np.random.default_rng(seed)
    places = random.random((particles, dimension))
    ways = 0.1 * (random.random((particles, dimension)) - 0.5)
    own, own_loss = places.copy(), np.array([loss(place) for place in places])
    for _ in range(iterations):
        best = own[np.argmin(own_loss)]
        shares = random.random((2, particles, dimension))
        ways = INERTIA * ways + PULL * (shares[0] * (own - places) + shares[1] * (best - places))
        places = places + ways
        outside = (places < 0) | (places > 1)
        places, ways = np.clip(places, 0.0, 1.0), np.where(outside, 0.0, ways)
        found = np.array([loss(place) for place in places])
        better = found < own_loss
        own[better], own_loss[better] = places[better], found[better]
    return own[np.argmin(own_loss)]


def cma_es(loss: Loss, dimension: int, evaluations: int, seed: int) -> Array:
    """Covariance matrix adaptation (Hansen 2016, arXiv:1604.00772) in the unit cube.

    Begins at a random place with a step of 0.3; points outside count as their projection onto the
    cube plus the square of the distance.  Ends after the evaluations, or where the step is below
    1e-10; returns the best place.
    """
    n, random = dimension, np.random.default_rng(seed)
    size = 4 + int(3 * np.log(n))
    weights = np.log((size + 1) / 2) - np.log(np.arange(1, size // 2 + 1))
    weights /= weights.sum()
    effective = 1.0 / np.sum(weights**2)
    of_step = (effective + 2) / (n + effective + 5)
    damping = 1 + 2 * max(0.0, np.sqrt((effective - 1) / (n + 1)) - 1) + of_step
    of_path = (4 + effective / n) / (n + 4 + 2 * effective / n)
    one = 2 / ((n + 1.3) ** 2 + effective)
    many = min(1 - one, 2 * (effective - 2 + 1 / effective) / ((n + 2) ** 2 + effective))
    usual = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # length of a normal vector
    mean, step, covariance = random.random(n), 0.3, np.eye(n)
    step_path, path = np.zeros(n), np.zeros(n)
    best, best_loss, spent, generation = mean, np.inf, 0, 0
    while spent + size <= evaluations and step * np.sqrt(covariance.diagonal().max()) > 1e-10:
        values, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(values, 1e-300))
        moves = random.standard_normal((size, n)) @ root.T
        places = mean + step * moves
        inside = np.clip(places, 0.0, 1.0)
        away = np.sum((places - inside) ** 2, axis=1)
        found = np.array([loss(place) for place in inside]) + away
        spent, generation = spent + size, generation + 1
        order = np.argsort(found)
        if found[order[0]] < best_loss:
            best, best_loss = inside[order[0]], found[order[0]]
        chosen = moves[order[: len(weights)]]
        move = weights @ chosen
        mean = mean + step * move
        whitened = axes @ ((axes.T @ move) / np.sqrt(np.maximum(values, 1e-300)))
        step_path = (1 - of_step) * step_path
        step_path += np.sqrt(of_step * (2 - of_step) * effective) * whitened
        length = np.linalg.norm(step_path) / np.sqrt(1 - (1 - of_step) ** (2 * generation))
        steady = float(length < (1.4 + 2 / (n + 1)) * usual)
        path = (1 - of_path) * path + steady * np.sqrt(of_path * (2 - of_path) * effective) * move
        kept = 1 - one - many + one * (1 - steady) * of_path * (2 - of_path)
        covariance = kept * covariance + one * np.outer(path, path)
        covariance = covariance + many * (chosen.T * weights) @ chosen
        step *= np.exp(of_step / damping * (np.linalg.norm(step_path) / usual - 1))
    return best
