"""Benchmarks of the peridynamic engine: bond sums, implicit solves, the published screw, pitting.

Each function measures on the machine it runs on and returns `Result`s; pipeline/bench.py names
them.  Times are medians of several runs where a run is short.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import numpy as np
from numba import njit, prange

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.planning import corrode_lean
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.influence import diffusion_stencil
from peri.lattice import Lattice, ball, box_lattice, cylinder
from peri.marching import TimeStepping
from peri.operators import NonlocalSum
from peri.solvers import DiffusionSystem
from pipeline.bench_result import Result

DAY = 86400.0
PUBLISHED_SECONDS = {"Mg-5Gd": (75_741, 6_125), "Mg-10Gd": (20_677, 3_129)}
"""Table 5.2 of the dissertation, 48 cores: full lattice and multi-grid."""


def _median_time(work: Callable[[], object], runs: int = 7) -> float:
    work()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


@njit(parallel=True, fastmath={"contract"})
def _multiply_add(values, rounds):
    """Many multiply-adds on rows that stay in the first-level cache."""
    for i in prange(values.shape[0]):
        a, b, c, d = values[i, 0], values[i, 1], values[i, 2], values[i, 3]
        for _ in range(rounds):
            for k in range(a.size):
                a[k] = a[k] * 0.999 + ((b[k] * 0.998 + c[k]) * 0.997 + d[k]) * 0.996


def peak_multiply_adds() -> float:
    """Multiply-adds per second that both threads reach on cached rows (double precision)."""
    values = np.ones((2, 4, 1024))
    rounds = 40_000
    seconds = _median_time(lambda: _multiply_add(values, rounds), 5)
    return 3.0 * values.shape[0] * values.shape[2] * rounds / seconds


def stencil() -> list:
    """Bond sums of the direct stencil and of the FFT on 128 x 128 x 128 nodes."""
    peak = peak_multiply_adds()
    results = [Result("measured peak multiply-adds", peak, "1/s")]
    shape = (128, 128, 128)
    lattice = Lattice((0.0,) * 3, (1.0,) * 3, shape)
    values = np.random.default_rng(1).random(shape)
    crossover = None
    for m in (2, 3, 4, 6, 8):
        kernel = diffusion_stencil(lattice, float(m))
        times = {}
        for method in ("direct", "fft"):
            operator = NonlocalSum(kernel, shape, method=method)
            field, out = operator.pad(values), np.zeros(operator.padded_shape)
            times[method] = _median_time(lambda o=operator, f=field, g=out: o(f, g))
        bonds = kernel.bonds * values.size
        target = ">= 5e9" if m <= 4 else None
        results += [
            Result(f"m = {m} bonds per node", kernel.bonds, "1"),
            Result(f"m = {m} direct", bonds / times["direct"], "bonds/s", target),
            Result(
                f"m = {m} direct over measured peak, one multiply-add a bond",
                bonds / times["direct"] / peak,
                "1",
            ),
            Result(f"m = {m} direct time", times["direct"], "s"),
            Result(f"m = {m} FFT time", times["fft"], "s"),
        ]
        if crossover is None and times["fft"] < times["direct"]:
            crossover = m
    results.append(
        Result("smallest measured m where the FFT is faster (0: none up to 8)", crossover or 0, "1")
    )
    return results


def implicit() -> list:
    """CG iterations to 1e-8 and time per unknown with a metal cylinder in the liquid ball."""
    results = []
    for spacing, m in ((100e-6, 2), (100e-6, 4), (50e-6, 2), (50e-6, 4)):
        for ratio in (1.0, 1e2, 1e4, 1e6):
            unknowns, iterations, seconds = _one_solve(spacing, m, ratio)
            name = f"{unknowns} unknowns, m = {m}, D dt/dx^2 = {ratio:.0e}"
            results += [
                Result(f"{name}: iterations", iterations, "1", "<= 20"),
                Result(f"{name}: time per unknown", 1e6 * seconds / unknowns, "us"),
            ]
    return results


def _one_solve(spacing: float, m: int, ratio: float) -> tuple[int, int, float]:
    radius = 4e-3
    lattice = box_lattice((-radius,) * 3, (radius,) * 3, spacing)
    domain = ball(lattice, (0, 0, 0), radius)
    metal = cylinder(lattice, (0, 0, 0), 1e-3, 4e-3)
    inner = ball(lattice, (0, 0, 0), radius - m * spacing)
    operator = NonlocalSum(diffusion_stencil(lattice, m * spacing), lattice.shape, wanted=domain)
    diffusivity = ratio * spacing**2
    liquid = domain & ~metal
    weight = operator.pad(liquid & inner)
    diagonal = 1.0 + diffusivity * operator(operator.pad(liquid))
    sink = weight * (1.0 + diffusivity * operator(operator.pad(liquid & ~inner)))
    system = DiffusionSystem(operator, weight, diagonal, diffusivity, sink)
    source = weight * operator(operator.pad(metal))
    norm = float(np.sqrt((source**2).sum()))
    iterations, times = 0, []
    for _ in range(3):
        x = np.zeros_like(source)
        start = time.perf_counter()
        iterations = system.solve(x, source.copy(), 1e-8 * norm)
        times.append(time.perf_counter() - start)
    return int(weight.sum()), iterations, min(times)


def published_screw(alloy: str, m: int, spacing: float = 50e-6) -> CorrosionScene:
    """The full-resolution scene of Table 5.2: a ball of radius 4 mm about the screw."""
    from dataclasses import replace

    from pipeline.corrosion_stage import corrosion_scene, metal_of
    from pipeline.geometry_stage import build_solid
    from pipeline.resolve import resolve_scene

    scene = resolve_scene([alloy], ["0w", "8w"], "standard")
    scene = replace(scene, lattice=replace(scene.lattice, spacing=spacing, horizon=m * spacing))
    solid = build_solid(scene)
    centre = 0.5 * (solid.points.min(axis=0) + solid.points.max(axis=0))
    lattice = box_lattice(centre - 4e-3, centre + 4e-3, spacing)
    metal, fraction = metal_of(scene, lattice, solid)
    return corrosion_scene(scene, alloy, lattice, ball(lattice, centre, 4e-3), metal, fraction)


def screw() -> list:
    """The published full screw run: 2.14e6 nodes, 56 days, both alloys, m = 2 and 4."""
    results = []
    for alloy, (full, multigrid) in PUBLISHED_SECONDS.items():
        results += [
            Result(f"{alloy} published full lattice, 48 cores", full, "s"),
            Result(f"{alloy} published multi-grid, 48 cores", multigrid, "s"),
        ]
        for m in (2, 4):
            scene = published_screw(alloy, m)
            name = f"{alloy}, m = {m}"
            march = corrode(scene, [56 * DAY])
            results += [
                Result(f"{name}: nodes", int(scene.domain.sum()), "1"),
                Result(f"{name}: liquid everywhere", march.wall_time, "s", "<= 900"),
                Result(f"{name}: steps", len(march.history["time"]) - 1, "1"),
                Result(f"{name}: CG iterations", int(march.history["iterations"].sum()), "1"),
                Result(f"{name}: volume loss", float(march.volume_loss[-1]), "1"),
                Result(
                    f"{name}: balance error",
                    float(np.abs(march.history["balance_error"]).max()),
                    "1",
                    "<= 1e-10",
                ),
            ]
            start = time.perf_counter()
            lean, omissions = corrode_lean(scene, [56 * DAY])
            if any(o.name == "liquid" and o.applied for o in omissions):
                bound = max(o.bound for o in omissions if o.applied)
                results += [
                    Result(
                        f"{name}: without what it does not need",
                        time.perf_counter() - start,
                        "s",
                        "<= 20",
                    ),
                    Result(f"{name}: bound of leaving it out", bound, "1"),
                    Result(
                        f"{name}: difference of volume loss, relative",
                        abs(lean.volume_loss[-1] / march.volume_loss[-1] - 1),
                        "1",
                    ),
                ]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    results.append(Result("peak memory", memory, "B", "<= 4e9"))
    return results


def pitting_step() -> list:
    """Explicit steps on 128 x 128 x 64 nodes of dissolving 304 steel, horizon 3 spacings."""
    spacing, shape = 2e-6, (128, 128, 64)
    lattice = Lattice((0.0,) * 3, (spacing,) * 3, shape)
    x, y, z = lattice.coordinates()
    middle = 0.5 * spacing * 127
    opening = (x - middle) ** 2 + (y - middle) ** 2 + (z - spacing * 63) ** 2 < (24e-6) ** 2
    metal = np.ascontiguousarray(np.broadcast_to((z < 48 * spacing) & ~opening, shape))
    scene = CorrosionScene(
        lattice,
        3 * spacing,
        metal,
        solid_concentration=143e3,
        saturation_concentration=5.1e3,
        liquid_diffusivity=8.5e-10,
        dissolution_flux=0.05,
        kinetics=ConstantRate(),
    )
    steps = 20
    from peri.corrosion.bimaterial import BiMaterial

    problem = BiMaterial(scene)
    limit = 1.0 / problem.fastest_rate()
    state = problem.initial_concentration.copy()
    state, _, _ = problem.explicit_step(state, limit, 0.0)
    start = time.perf_counter()
    for _ in range(steps):
        state, _, _ = problem.explicit_step(state, limit, 0.0)
    explicit = (time.perf_counter() - start) / steps
    march = corrode(scene, [300.0], TimeStepping("sdirk2", rate_change=0.2))
    return [
        Result("explicit step", explicit, "s", "0.24 (public pseudo-spectral code)"),
        Result("explicit step length", limit, "s"),
        Result("explicit run to 300 s", explicit * 300.0 / limit, "s"),
        Result("implicit run to 300 s", march.wall_time, "s"),
        Result("implicit steps to 300 s", len(march.history["time"]) - 1, "1", "653 (explicit)"),
    ]


def scaling() -> list:
    """Cost of one implicit solve against nodes, and of the bond sum on one and two threads."""
    import numba

    results = []
    for spacing in (400e-6, 200e-6, 100e-6, 50e-6):
        unknowns, iterations, seconds = _one_solve(spacing, 2, 1e4)
        results.append(
            Result(
                f"implicit solve, {unknowns} unknowns, {iterations} iterations",
                1e6 * seconds / unknowns,
                "us per unknown",
            )
        )
    shape = (128, 128, 128)
    operator = NonlocalSum(diffusion_stencil(Lattice((0.0,) * 3, (1.0,) * 3, shape), 4.0), shape)
    field, out = operator.pad(np.ones(shape)), np.zeros(operator.padded_shape)
    threads = numba.get_num_threads()
    for n in sorted({1, threads}):
        numba.set_num_threads(n)
        results.append(
            Result(
                f"bond sum m = 4, 2.1e6 nodes, threads {n}",
                _median_time(lambda: operator(field, out)),
                "s",
            )
        )
    numba.set_num_threads(threads)
    return results
