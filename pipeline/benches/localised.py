"""Benchmarks of localised corrosion: bond damage, a crevice as a film, local rates, lacy covers."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from peri.corrosion import CorrosionScene, corrode
from peri.corrosion.metal.bond_damage import BondDamage
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.passivity import Repassivation
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping, march
from peri.engine.solvers import DiffusionSystem
from peri.omissions.thin_gap import ThinGapProblem
from pipeline.benches.corrosion import pitting_scene
from pipeline.benches.result import Result
from pipeline.scenes import crevice_lattice
from pipeline.scenes.crevices import (
    LENGTH,
    PUBLISHED_CURRENT_FACTOR,
    PUBLISHED_DIFFUSIVITY_FACTOR,
    crevice_625,
)
from pipeline.scenes.pits_2d import RUPTURE, lacy_metal

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


HOUR = 3600.0


def crevice(nodes: int = 1016, end: float = 72 * HOUR, length: float = LENGTH) -> list[Result]:
    """The crevice of alloy 625 to 72 h as a film, right and as printed, and on a lattice of 25:1.

    On a lattice of 25:1 with m = 4 the printed constants amount to 0.2176 of the diffusivity along
    the crevice and 7.57 times the interface's flux.  length : of the crevice on the lattice, m.
    """
    cases = {
        "seed 2 mm": crevice_625(2e-3, nodes),
        "seed 3 mm": crevice_625(3e-3, nodes),
        "seed 0.5 mm, as on the printed lattice": crevice_625(
            0.5e-3, nodes, PUBLISHED_DIFFUSIVITY_FACTOR, PUBLISHED_CURRENT_FACTOR
        ),
    }
    results = [Result("nodes", nodes, "1")]
    for name, scene in cases.items():
        started = time.process_time()
        done = march(ThinGapProblem(scene), [end], TimeStepping(rate_change=0.1))
        spent, history = time.process_time() - started, done.history
        results += [
            Result(f"film equation, {name}: wall time", done.wall_time, "s", "<= 10"),
            Result(f"{name}: processor time", spent, "s"),
            Result(f"{name}: steps", history["time"].size - 1, "1"),
            Result(f"{name}: area lost", 1e9 * history["lost"][-1], "um mm"),
            Result(f"{name}: active site from the mouth", 1e3 * history["active_site"][-1], "mm"),
            Result(f"{name}: deepest", 1e6 * history["deepest"][-1], "um"),
            Result(f"{name}: share saturated", history["saturated_share"][-1], "1"),
            Result(
                f"{name}: balance error",
                float(np.abs(history["balance_error"]).max()),
                "1",
                "<= 1e-10",
            ),
        ]
    return [*results, *crevice_on_a_lattice(end, length)]


def crevice_on_a_lattice(end: float, length: float = LENGTH) -> list[Result]:
    """Seed of 3 mm, nodes 25 um along and 1 um across, m = 4, beside the film on the same steps."""
    scene = crevice_lattice.crevice_on_lattice(3e-3, length=length)
    started = time.process_time()
    found = crevice_lattice.compare(scene, [max(end - HOUR, 0.75 * end), end])
    spent, history = time.process_time() - started, found.result.history
    lost = [float(found.lost(depth)[-1]) for depth in (found.lattice, found.film)]
    site = [found.site(depth) for depth in (found.lattice, found.film)]
    name = "lattice of 25:1"
    return [
        Result(f"{name}: nodes", scene.metal.size, "1"),
        Result(f"{name} and film: processor time", spent, "s", "<= 1800"),
        Result(f"{name}: steps", history["time"].size - 1, "1"),
        Result(f"{name}: area lost", 1e9 * lost[0], "um mm"),
        Result(
            f"{name}: area lost, apart from the film's", abs(lost[0] / lost[1] - 1), "1", "<= 0.01"
        ),
        Result(f"{name}: active site from the mouth", 1e3 * site[0], "mm"),
        Result(
            f"{name}: active site, apart from the film's",
            abs(site[0] / site[1] - 1),
            "1",
            "<= 0.02",
        ),
        Result(f"{name}: deepest", 1e6 * float(found.lattice[-1].max()), "um"),
        Result(f"{name}: deepest in the film", 1e6 * float(found.film[-1].max()), "um"),
        Result(f"{name}: iterations from scratch to 1e-8", iterations(scene), "1", "<= 20"),
        Result(
            f"{name}: balance error", float(np.abs(history["balance_error"]).max()), "1", "<= 1e-10"
        ),
    ]


def iterations(scene: CorrosionScene, tau: float = 60.0) -> int:
    """Of conjugate gradients for diffusion in a step (s), random right side, to 1e-8."""
    d, diffusivity = BiMaterial(scene), scene.liquid_diffusivity
    weight = d.free_volume
    diagonal = 1.0 / tau + diffusivity * d.neighbour_liquid
    on = (weight > 0).astype(float)
    sink = weight * (diagonal - diffusivity * d.sum(weight))
    if d.walls is not None:
        sink = sink + on * (d.walls.diagonal - d.walls.gain(on, np.zeros_like(on)))
    system = DiffusionSystem(d.sum, weight, diagonal, diffusivity, sink, walls=d.walls)
    right = on * np.random.default_rng(1).standard_normal(on.shape)
    return system.solve(np.zeros_like(on), right.copy(), 1e-8 * float(np.linalg.norm(right)))


def small_crevice() -> list[Result]:
    """The same on 127 nodes, and on a lattice of 6 mm, to 2 h: to see that it works."""
    return crevice(127, 2 * HOUR, 6e-3)


def pitting(shape: tuple[int, int, int] = (128, 128, 64), end: float = 83.0) -> list[Result]:
    """What rates by the concentration cost a pit of 304 steel, and a lacy cover in 3D.

    Ten explicit and three implicit steps of the pit of `pitting-step` with one rate, and with a
    rate for each metal node.  The lacy cover: that of the scene pit-lacy, its section turned into
    a sheet of as many nodes.
    """
    plain = pitting_scene(shape)
    film = Repassivation(1e-3, plain.saturation_concentration, passive_share=0.99, width=1.0)
    local = replace(plain, kinetics=film)
    results = [Result("nodes", int(np.prod(shape)), "1")]
    for name, scheme, count in (("explicit", "forward_euler", 10), ("implicit", "sdirk2", 3)):
        spent = {}
        for kind, scene in (("one rate", plain), ("local rates", local)):
            step = None if scheme == "forward_euler" else 4.0
            length = 0.4 * count if step is None else step * count
            corrode(scene, [0.1 * length], TimeStepping(scheme, step=step))  # compiled
            started = time.process_time()
            done = corrode(scene, [length], TimeStepping(scheme, step=step))
            spent[kind] = (time.process_time() - started) / (done.history["time"].size - 1)
            results.append(Result(f"{name} step, {kind}: processor time", spent[kind], "s"))
        ratio = spent["local rates"] / spent["one rate"]
        results.append(Result(f"{name} step, local rates over one rate", ratio, "1", "<= 1.3"))
    scene = lacy_sheet(shape)
    started = time.process_time()
    # Nodes empty in every step, where the second-order scheme falls back to this one.
    done = corrode(scene, [end], TimeStepping("backward_euler", step=0.5))
    history, metal = done.history, done.metal[-1]
    gone, surface = scene.metal & ~metal, int(np.flatnonzero(scene.metal.any(axis=(0, 1)))[-1])
    widest = float(np.sqrt(gone.any(axis=2).sum()) * scene.lattice.spacing[0])
    mouth = float(np.sqrt(gone[:, :, surface].sum()) * scene.lattice.spacing[0])
    return [
        *results,
        Result(f"lacy cover, {end:g} s: wall time", done.wall_time, "s", "<= 600"),
        Result("lacy cover: processor time", time.process_time() - started, "s"),
        Result("lacy cover: steps", history["time"].size - 1, "1"),
        Result("lacy cover: width of the pit", 1e6 * widest, "um"),
        Result("lacy cover: width of its mouth", 1e6 * mouth, "um"),
        Result(
            "lacy cover: balance error",
            float(np.abs(history["balance_error"]).max()),
            "1",
            "<= 1e-10",
        ),
    ]


def small_pitting() -> list[Result]:
    """The same on 32 x 32 x 24 nodes to 5 s: to see that it works."""
    return pitting((32, 32, 24), 5.0)


def lacy_sheet(shape: tuple[int, int, int], spacing: float = 2.5e-6) -> CorrosionScene:
    """The scene pit-lacy with a half ball for a nucleus, in a sheet; z up."""
    lattice = Lattice((0.0,) * 3, (spacing,) * 3, shape)
    x, y, z = lattice.coordinates()
    middle = 0.5 * spacing * (np.array(shape) - 1)
    top = spacing * (shape[2] - 4.5)
    metal = np.ascontiguousarray(np.broadcast_to(z < top, shape))
    away = (x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - top) ** 2
    return lacy_metal(lattice, metal, metal & (away < (20e-6) ** 2), 2 * spacing, rupture=RUPTURE)
