"""Benchmarks of the peridynamic engine: bond sums, implicit solves, the published screw, pitting.

Each function measures on the machine it runs on and returns `Result`s; registry.py names them.
Times are medians of several runs where a run is short.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import njit, prange

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.operators import NonlocalSum
from pipeline.benches.case import in_own_process, solve
from pipeline.benches.result import Result
from pipeline.record.machine import processor_cores

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


def peak_multiply_adds(rounds: int = 40_000) -> float:
    """Multiply-adds per second that both threads reach on cached rows (double precision)."""
    values = np.ones((2, 4, 1024))
    seconds = _median_time(lambda: _multiply_add(values, rounds), 5)
    return 3.0 * values.shape[0] * values.shape[2] * rounds / seconds


def stencil(
    edge: int = 128, ratios: tuple[int, ...] = (2, 3, 4, 6, 8), rounds: int = 40_000
) -> list:
    """Bond sums of the direct stencil and of the FFT on edge^3 nodes, horizons of m spacings.

    rounds: of the measurement of what the processor reaches at best.
    """
    peak = peak_multiply_adds(rounds)
    results = [Result("measured peak multiply-adds", peak, "1/s")]
    shape = (edge,) * 3
    lattice = Lattice((0.0,) * 3, (1.0,) * 3, shape)
    values = np.random.default_rng(1).random(shape)
    crossover = None
    for m in ratios:
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
        Result(
            f"smallest measured m where the FFT is faster (0: none up to {ratios[-1]})",
            crossover or 0,
            "1",
        )
    )
    return results


def small_stencil() -> list:
    """The same on 32 x 32 x 32 nodes for two horizons."""
    return stencil(32, (2, 3), 2_000)


IMPLICIT_LATTICES = ((100e-6, 2), (100e-6, 4), (50e-6, 2), (50e-6, 4))


def implicit(
    lattices: tuple[tuple[float, int], ...] = IMPLICIT_LATTICES,
    ratios: tuple[float, ...] = (1.0, 1e2, 1e4, 1e6),
) -> list:
    """CG iterations to 1e-8 and time per unknown with a metal cylinder in the liquid ball.

    lattices: spacing (m) and horizon over it; ratios: D dt/dx^2.
    """
    results = []
    for spacing, m in lattices:
        for ratio in ratios:
            found = solve(spacing, m, ratio)
            unknowns, iterations = found["unknowns"], found["iterations"]
            name = f"{unknowns} unknowns, m = {m}, D dt/dx^2 = {ratio:.0e}"
            results += [
                Result(f"{name}: iterations", iterations, "1", "<= 20"),
                Result(f"{name}: time per unknown", 1e6 * found["seconds"] / unknowns, "us"),
            ]
    return results


def small_implicit() -> list:
    """The same on one coarse lattice."""
    return implicit(((200e-6, 2),), (1.0, 1e4))


def screw(spacing: float = 50e-6, ratios: tuple[int, ...] = (2, 4)) -> list:
    """The published full screw run: 2.14e6 nodes, 56 days, both alloys, m = 2 and 4.

    Every march runs in a process of its own.  Where clean liquid is proven, a march with half
    the control target, the scalar equation (exact in time) and the same steps in clean liquid
    split the difference of the full march and the lean one into its error in time and the effect
    of the liquid.  Else the error in time is that of the same stepping on a lattice of twice the
    spacing against a quarter of the control target there.
    """
    results = []
    for alloy, (full, multigrid) in PUBLISHED_SECONDS.items():
        results += [
            Result(f"{alloy} published full lattice, 48 cores", full, "s"),
            Result(f"{alloy} published multi-grid, 48 cores", multigrid, "s"),
        ]
        for m in ratios:
            results += _screw_case(alloy, m, spacing)
    return results


def _screw_case(alloy: str, m: int, spacing: float) -> list:
    def march(spacing: float = spacing, **choices) -> dict:
        return in_own_process("screw_march", alloy=alloy, m=m, spacing=spacing, **choices)

    name = f"{alloy}, m = {m}"
    whole = march()
    lean = march(lean=True, steps=whole["step_lengths"])
    loss = whole["volume_loss"]
    found = [
        Result(f"{name}: nodes", whole["nodes"], "1"),
        Result(f"{name}: bonds per node", whole["bonds"], "1"),
        Result(f"{name}: liquid everywhere", whole["seconds"], "s", "<= 900"),
        Result(f"{name}: liquid everywhere, processor time", whole["processor_seconds"], "s"),
        Result(f"{name}: peak memory", whole["peak_bytes"], "B", "<= 4e9"),
        Result(f"{name}: steps", whole["steps"], "1"),
        Result(f"{name}: CG iterations", whole["iterations"], "1"),
        Result(f"{name}: volume loss", loss, "1"),
        Result(f"{name}: balance error", whole["balance_error"], "1", "<= 1e-10"),
    ]
    if not lean["clean_liquid"]:
        coarse, exact = march(2 * spacing), march(2 * spacing, rate_change=0.0125)
        error = abs(coarse["volume_loss"] / exact["volume_loss"] - 1)
        text = f"{name}: time-integration error, on a lattice of {2e6 * spacing:.0f} um"
        found.append(Result(text, error, "1", "<= 1e-3"))
    if "volume_loss" not in lean:
        return [*found, Result(f"{name}: nothing can be left out that costs time", 1, "1")]
    target = "<= 20" if lean["clean_liquid"] else None
    left_out = ", ".join(lean["left_out"])
    found += [
        Result(f"{name}: without {left_out}", lean["seconds"], "s", target),
        Result(f"{name}: its processor time", lean["processor_seconds"], "s"),
        Result(f"{name}: its peak memory", lean["peak_bytes"], "B", "<= 4e9"),
        Result(f"{name}: its volume loss", lean["volume_loss"], "1"),
        Result(f"{name}: bound of leaving it out, relative", lean["bound"], "1", "<= 1e-3"),
    ]
    if lean["clean_liquid"]:
        return found + _time_and_liquid(name, whole, march(rate_change=0.025), lean)
    difference = abs(loss / lean["volume_loss"] - 1)
    return [*found, Result(f"{name}: difference of the two, relative", difference, "1")]


def _time_and_liquid(name: str, whole: dict, finer: dict, lean: dict) -> list:
    """What the error in time and what the liquid makes of the difference of full and lean march.

    Lean, the march is exact in time; the full march's own steps in clean liquid (clean_losses)
    differ from it by the error in time alone, and from the full march by the liquid alone.
    """
    exact, clean = lean["volume_loss"], np.array(lean["clean_losses"])
    liquid = np.abs(np.array(whole["losses"]) / clean - 1)
    bound = f"<= {lean['bound']:.3g}"
    halved = f"{name}: with half the control target"
    return [
        Result(f"{halved}: steps", finer["steps"], "1"),
        Result(f"{halved}: time", finer["seconds"], "s"),
        Result(f"{halved}: volume loss", finer["volume_loss"], "1"),
        Result(
            f"{name}: change of the volume loss by halving it, relative",
            abs(whole["volume_loss"] / finer["volume_loss"] - 1),
            "1",
            "<= 1e-3",
        ),
        Result(f"{name}: full against lean, relative", abs(whole["volume_loss"] / exact - 1), "1"),
        Result(f"{halved}: full against lean", abs(finer["volume_loss"] / exact - 1), "1"),
        Result(
            f"{name}: of it the time-integration error (same steps, liquid left out)",
            abs(float(clean[-1]) / exact - 1),
            "1",
            "<= 1e-3",
        ),
        Result(f"{name}: of it the liquid (same steps)", float(liquid[-1]), "1", bound),
        Result(f"{name}: the same, largest over all steps", float(liquid.max()), "1", bound),
    ]


def small_screw() -> list:
    """The same on 200 um, m = 2: to see that it works."""
    return screw(2e-4, (2,))


def pitting_step(shape: tuple[int, int, int] = (128, 128, 64), end: float = 300.0) -> list:
    """An explicit and an implicit march of dissolving 304 steel to equal error, horizon 3 spacings.

    The error is that of the amount dissolved at the end, relative, against a march with a far
    smaller control target.  It is measured on a lattice of half the edges, where the longest
    implicit steps are chosen from which on all err no more than the explicit march; the times
    are those of the whole lattice.  Implicit steps begin with 2 s and are solved to 1e-6.
    """
    half = tuple(n // 2 for n in shape)
    change, errors = _equal_error(pitting_scene(half), end)
    scene = pitting_scene(shape)
    limit = 1.0 / BiMaterial(scene).fastest_rate()
    explicit = corrode(scene, [end], EXPLICIT)
    steps = len(explicit.history["time"]) - 1
    results = [
        Result("nodes", int(scene.domain.sum()), "1"),
        Result("explicit step", explicit.wall_time / steps, "s", "0.24 (public pseudo-spectral)"),
        Result("explicit step length, the limit of stability", limit, "s"),
        Result(f"explicit run to {end:g} s", explicit.wall_time, "s"),
        Result("explicit steps", steps, "1", "653 (public pseudo-spectral)"),
        Result("explicit: metal dissolved, share", float(explicit.volume_loss[-1]), "1"),
        *(Result(f"{name}: error of the amount dissolved", e, "1") for name, e in errors.items()),
    ]
    if change is None:
        return [*results, Result("no implicit march errs as little as the explicit one", 1, "1")]
    march = _implicit(scene, end, change)
    return [
        *results,
        Result(f"implicit run to {end:g} s at most at that error", march.wall_time, "s", "<= 30 s"),
        Result("its control target", change, "1"),
        Result("its steps", len(march.history["time"]) - 1, "1", "653 (public, explicit)"),
        Result("its metal dissolved, share", float(march.volume_loss[-1]), "1"),
    ]


EXPLICIT = TimeStepping("forward_euler")


def _implicit(scene: CorrosionScene, end: float, change: float) -> CorrosionResult:
    """Steps of the second order; their errors in time leave 1e-6 far behind."""
    stepping = TimeStepping("sdirk2", rate_change=change, first_step=2.0)
    return corrode(scene, [end], stepping, solver_tolerance=1e-6)


def _equal_error(scene: CorrosionScene, end: float) -> tuple[float | None, dict[str, float]]:
    """The longest controlled steps that err no more than the explicit march, and all errors."""
    exact = corrode(scene, [end], TimeStepping("sdirk2", rate_change=0.00625)).volume_loss[-1]

    def error(march: CorrosionResult) -> float:
        return abs(float(march.volume_loss[-1] / exact) - 1)

    errors, enough = {"explicit": error(corrode(scene, [end], EXPLICIT))}, None
    for change in (0.1, 0.05, 0.035, 0.025):
        found = errors[f"implicit {change:g}"] = error(_implicit(scene, end, change))
        # A small error that shorter steps do not confirm is luck.
        if found > errors["explicit"]:
            enough = None
        elif enough is None:
            enough = change
    return enough, errors


def small_pitting() -> list:
    """The same on 48 x 48 x 32 nodes to 60 s: to see that it works."""
    return pitting_step((48, 48, 32), 60.0)


def pitting_scene(shape: tuple[int, int, int]) -> CorrosionScene:
    """304 steel below refreshed liquid with a round opening in it, horizon 3 spacings.

    At this spacing the limit of stability gives about as many explicit steps to 300 s as the
    public code's 653.
    """
    spacing = 27.5e-6
    lattice = Lattice((0.0,) * 3, (spacing,) * 3, shape)
    x, y, z = lattice.coordinates()
    middle, surface = 0.5 * spacing * (shape[0] - 1), 0.75 * spacing * shape[2]
    radius = 12 * spacing * shape[0] / 128
    opening = (x - middle) ** 2 + (y - middle) ** 2 + (z - surface) ** 2 < radius**2
    metal = np.broadcast_to((z < surface) & ~opening, shape)
    return CorrosionScene(
        lattice,
        3 * spacing,
        np.ascontiguousarray(metal),
        solid_concentration=143e3,
        saturation_concentration=5.1e3,
        liquid_diffusivity=8.5e-10,
        dissolution_flux=0.05,
        kinetics=ConstantRate(),
    )


SCALING_SPACINGS = (300e-6, 138e-6, 64e-6, 30e-6)
"""Spacings of the ball of radius 4 mm that give 1e4, 1e5, 1e6 and 1e7 nodes."""


def scaling(spacings: tuple[float, ...] = SCALING_SPACINGS, march_spacing: float = 100e-6) -> list:
    """Cost and memory of an implicit solution from 1e4 to 1e7 nodes, threads 1 and 2, ranks 1 to 4.

    Every case runs in a process of its own; more ranks or threads than cores share them.
    """
    cores = processor_cores()
    results = [Result("cores", cores, "1")]
    for spacing in spacings:
        found = in_own_process("solve", spacing=spacing, m=2, ratio=1e4, threads=min(2, cores))
        name = f"{found['nodes']:.3g} nodes, m = 2"
        results += [
            Result(f"{name}: iterations to 1e-8", found["iterations"], "1", "<= 20"),
            Result(f"{name}: time per unknown", 1e6 * found["seconds"] / found["unknowns"], "us"),
            Result(
                f"{name}: processor time per unknown",
                1e6 * found["processor_seconds"] / found["unknowns"],
                "us",
            ),
            Result(f"{name}: memory per node", found["field_bytes"] / found["nodes"], "B"),
            Result(f"{name}: peak memory of the process", found["peak_bytes"], "B"),
        ]
    march = {"spacing": march_spacing, "steps": 4}
    for threads in (1, 2):
        found = in_own_process("ball_march", threads=threads, petsc=False, **march)
        name = f"march, {found['nodes']:.3g} nodes, 4 steps, threads {threads}"
        results.append(Result(name, found["seconds"], "s"))
    loss = found["volume_loss"]
    for ranks in (1, 2, 4):
        found = in_own_process("ball_march", ranks=ranks, petsc=True, **march)
        name = f"march, {found['nodes']:.3g} nodes, 4 steps, PETSc, ranks {ranks}"
        results += [
            Result(name, found["seconds"], "s"),
            Result(f"{name}: memory of all ranks", found["peak_bytes"], "B"),
            Result(
                f"{name}: difference of volume loss to one process, relative",
                abs(found["volume_loss"] / loss - 1),
                "1",
                "<= 1e-8",
            ),
        ]
    return results


def small_scaling() -> list:
    """The same with 1e4 and 3e4 nodes: to see that it works."""
    return scaling((300e-6, 200e-6), 200e-6)
