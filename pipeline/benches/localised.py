"""Benchmarks of localised corrosion: stochastic bond damage."""

from __future__ import annotations

import time

import numpy as np

from peri.corrosion.bond_damage import BondDamage
from peri.engine.lattice import Lattice
from pipeline.benches.result import Result

HORIZON_RATIO = 4


def bond_damage(shape: tuple[int, int, int] = (128, 128, 64)) -> list[Result]:
    """Damage index of every node, m = 4: a corroded layer one horizon thick, and all corroded.

    The layer is what a scene has; a metal corroded throughout hashes every bond, the most that
    there can be.
    """
    spacing = 1e-6
    lattice = Lattice((0.0,) * 3, (spacing,) * 3, shape)
    depth = np.broadcast_to(np.arange(shape[2])[::-1], shape)
    damage = BondDamage(
        lattice, HORIZON_RATIO * spacing, np.ones(shape, bool), 143e3, 5.1e3, seed=1
    )
    layer = np.clip(1.0 - (depth - 0.25 * shape[2]) / HORIZON_RATIO, 0.0, 1.0)
    throughout = np.random.default_rng(1).uniform(0.01, 0.99, shape)
    results = [
        Result("nodes", layer.size, "1"),
        Result("bonds per node", len(damage.offsets), "1"),
    ]
    for name, share, target in (
        ("a layer of one horizon", layer, "<= 1 (1e6 nodes)"),
        ("every bond hashed", throughout, None),
    ):
        damage.damage_index(share)  # compiled
        start, processor = time.perf_counter(), time.process_time()
        index = damage.damage_index(share)
        wall, spent = time.perf_counter() - start, time.process_time() - processor
        start = time.perf_counter()
        expected = damage.expected_index(share)
        closed = time.perf_counter() - start
        some = (expected > 0) & (expected < 1)
        results += [
            Result(f"damage index, {name}", wall, "s", target),
            Result(f"its processor time, {name}", spent, "s"),
            Result(f"expected index, {name}", closed, "s"),
            Result(
                f"mean index over expected, less 1, {name}",
                float(index[some].mean() / expected[some].mean() - 1),
                "1",
            ),
        ]
    return results


def small_bond_damage() -> list[Result]:
    """The same on 32 x 32 x 32 nodes: to see that it works."""
    return bond_damage((32, 32, 32))
