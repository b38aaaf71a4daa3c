"""Benchmarks of galvanic corrosion: the potential at every size, and a couple to three days."""

from __future__ import annotations

import time

import numpy as np

from peri.coupled.galvanic import Renewal, corrode
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.electrostatics import Electrode, PotentialProblem
from perilife_data import load_electrode
from pipeline.benches.result import Result
from pipeline.scene.laws.polarization import polarization_law
from pipeline.scenes.couples import ae44_scene

DAY = 86400.0


def galvanic(edges: tuple[int, ...] = (22, 46, 100, 128), spacing: float = 0.1e-3) -> list[Result]:
    """Potentials of a bar of AE44 and steel in a cube of brine, and AE44 beside steel for 3 days.

    edges : nodes along an edge of the cube (128: 2.1e6 nodes).  The renewed potential is that
    after a tenth of the upper face of the AE44 has gone, from the one before.
    """
    results = []
    for n in edges:
        results += _potential(n)
    scene = ae44_scene("mild-steel", spacing, max(0.4e-3, 2 * spacing))
    started = time.process_time()
    done = corrode(scene, [3 * DAY], Renewal())
    spent, history = time.process_time() - started, done.history
    depth = done.depths()[-1]
    name = f"AE44 and steel, {scene.metal().size} nodes, 3 d"
    return [
        *results,
        Result(name, done.wall_time, "s", "<= 120 (30,000 nodes)"),
        Result(f"{name}: processor time", spent, "s"),
        Result(f"{name}: steps", history["time"].size - 1, "1"),
        Result(f"{name}: Newton steps, most", float(history["newton"].max()), "1", "<= 8"),
        Result(f"{name}: current at the start", history["current_AE44"][0], "A/m", "0.4120"),
        Result(f"{name}: deepest", 1e3 * float(depth.max()), "mm"),
        Result(
            f"{name}: Faraday's law left open",
            float(np.abs(history["faraday_error"]).max()),
            "1",
            "<= 1e-12",
        ),
        Result(
            f"{name}: currents left open",
            float(np.abs(history["imbalance"]).max()),
            "1",
            "<= 1e-12",
        ),
    ]


def _potential(n: int) -> list[Result]:
    """From scratch, and renewed, on n^3 nodes, horizon two spacings."""
    h = 20e-3 / n
    lattice = Lattice((0.5 * h,) * 3, (h,) * 3, (n, n, n))
    x, y, z = lattice.coordinates()
    metal = np.broadcast_to((z < 5e-3) & (np.abs(y - 10e-3) < 5e-3), lattice.shape)
    laws = [polarization_law(load_electrode(name)) for name in ("mild-steel", "AE44")]
    stencil = diffusion_stencil(lattice, 2 * h)

    def problem(solid: np.ndarray) -> PotentialProblem:
        sides = (solid & (x < 10e-3), solid & (x > 10e-3))
        electrodes = [Electrode(m, law) for m, law in zip(sides, laws, strict=True)]
        return PotentialProblem(lattice, stencil, ~solid, electrodes, 2.5)

    started, processor = time.perf_counter(), time.process_time()
    first = problem(metal).solve()
    seconds, spent = time.perf_counter() - started, time.process_time() - processor
    gone = metal & (x > 10e-3) & (x < 11e-3) & (z > 5e-3 - 1.01 * h)
    guess = np.where(gone, np.nanmean(first.potential), first.potential)
    started, processor = time.perf_counter(), time.process_time()
    again = problem(metal & ~gone).solve(guess=guess)
    renewed, spent_again = time.perf_counter() - started, time.process_time() - processor
    name = f"potential, {n**3} nodes"
    return [
        Result(f"{name}, from scratch", seconds, "s", "<= 12 (2e6 nodes)"),
        Result(f"{name}, from scratch: processor time", spent, "s"),
        Result(f"{name}: Newton steps", first.newton, "1", "<= 8"),
        Result(f"{name}: CG iterations of a Newton step", first.iterations / first.newton, "1",
               "<= 20"),
        Result(f"{name}, renewed", renewed, "s", "<= 3 (2e6 nodes)"),
        Result(f"{name}, renewed: processor time", spent_again, "s"),
        Result(f"{name}, renewed: Newton steps", again.newton, "1", "<= 8"),
        Result(f"{name}: currents left open", abs(first.imbalance), "1", "<= 1e-12"),
    ]  # fmt: skip


def small_galvanic() -> list[Result]:
    """Potentials of 1,000 nodes and the couple on 1,875: to see that it works."""
    return galvanic((10,), 0.4e-3)
