"""One case of a benchmark in a process of its own, so that its peak memory is its own.

`in_own_process` starts `python -m pipeline.benches.case`, under mpirun for several ranks; the case
prints its numbers as one line of JSON.  A new case is one function in CASES.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pipeline.record import children
from pipeline.record.machine import child_environment, mpirun

logger = logging.getLogger(__name__)

DAY = 86400.0
MARK = "perilife-bench-case "
BALL_RADIUS = 4e-3


def in_own_process(case: str, *, ranks: int = 0, threads: int | None = None, **arguments) -> dict:
    """Run a case and return its numbers; ranks > 0: under mpirun, one thread each.

    Says on standard error which case runs and how long it took.
    Raises FileNotFoundError where mpirun is needed and absent, RuntimeError where the case fails
    (with the last line that it said).
    """
    command = [sys.executable, "-m", "pipeline.benches.case", case, json.dumps(arguments)]
    if ranks:
        command, threads = [*mpirun(ranks, "the ranks of scaling"), *command], 1
    environment = child_environment(ranks, threads)
    given = ", ".join(f"{k} {v}" for k, v in arguments.items() if not isinstance(v, list))
    print(f"{case} {given} ...", end=" ", file=sys.stderr, flush=True)
    begun = time.monotonic()
    child = children.start(
        command,
        launcher=ranks > 0,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        printed, told = child.communicate()
    finally:
        children.end(child)
    print(f"{time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    for line in printed.splitlines():
        if line.startswith(MARK):
            return json.loads(line[len(MARK) :])
    said = (told.strip() or "nothing").splitlines()[-1]
    raise RuntimeError(
        f"the case {case} of the benchmark ended with "
        f"{children.how_it_ended(child.returncode)}: {said}"
    )


def peak_memory() -> float:
    """Largest resident memory of this process so far, bytes (of its own, not of its parent)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024.0 * int(line.split()[1])
    import resource

    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


# --- cases ------------------------------------------------------------------------------------


def solve(spacing: float, m: int, ratio: float) -> dict:
    """One linear solution to 1e-8 in a liquid ball about a metal cylinder, D dt/dx^2 = ratio."""
    from peri.engine.influence import diffusion_stencil
    from peri.engine.lattice import ball, box_lattice, cylinder
    from peri.engine.operators import NonlocalSum
    from peri.engine.solvers import DiffusionSystem

    def once(spacing: float) -> dict:
        lattice = box_lattice((-BALL_RADIUS,) * 3, (BALL_RADIUS,) * 3, spacing)
        domain = ball(lattice, (0, 0, 0), BALL_RADIUS)
        metal = cylinder(lattice, (0, 0, 0), 1e-3, 4e-3)
        inner = ball(lattice, (0, 0, 0), BALL_RADIUS - m * spacing)
        stencil = diffusion_stencil(lattice, m * spacing)
        operator = NonlocalSum(stencil, lattice.shape, wanted=domain)
        diffusivity = ratio * spacing**2
        liquid = domain & ~metal
        weight = operator.pad(liquid & inner)
        diagonal = 1.0 + diffusivity * operator(operator.pad(liquid))
        sink = weight * (1.0 + diffusivity * operator(operator.pad(liquid & ~inner)))
        system = DiffusionSystem(operator, weight, diagonal, diffusivity, sink)
        source = weight * operator(operator.pad(metal))
        norm = float(np.sqrt((source**2).sum()))
        iterations, times, processor = 0, [], []
        for _ in range(3):
            x = np.zeros_like(source)
            start, begun = time.perf_counter(), time.process_time()
            iterations = system.solve(x, source.copy(), 1e-8 * norm)
            times.append(time.perf_counter() - start)
            processor.append(time.process_time() - begun)
        return {
            "nodes": int(domain.sum()),
            "unknowns": int(weight.sum()),
            "iterations": int(iterations),
            "seconds": min(times),
            "processor_seconds": min(processor),
        }

    once(BALL_RADIUS / 10)  # compiles
    idle = peak_memory()
    found = once(spacing)
    return {**found, "peak_bytes": peak_memory(), "field_bytes": peak_memory() - idle}


def screw_march(
    alloy: str,
    m: int,
    spacing: float,
    rate_change: float = 0.05,
    lean: bool = False,
    steps: list[float] | None = None,
) -> dict:
    """The screw in a ball of liquid of radius 4 mm, 56 days: all computed, or what is needed.

    lean: with what is not needed left out; where that is the liquid, the march is a scalar
    equation, exact in time.  steps: of a march with all computed, s; a lean case then also
    takes these steps in clean liquid, apart from its own time.
    """
    from peri.corrosion.run import corrode
    from peri.engine.march.marching import TimeStepping
    from peri.omissions.names import LIQUID, SOLID_CORE
    from peri.omissions.planning import corrode_lean, plan_omissions
    from peri.omissions.well_stirred import clean_march

    scene = published_screw(alloy, m, spacing)
    times = [56 * DAY]
    corrode(published_screw(alloy, m, 4e-4), [DAY], TimeStepping("sdirk2", step=DAY))  # compiles
    start, begun = time.perf_counter(), time.process_time()
    if lean:
        planned = {o.name for o in plan_omissions(scene, times) if o.applied}
        if planned <= {SOLID_CORE}:
            # That costs nothing in any march: there is nothing to compare.
            return {"left_out": sorted(planned), "clean_liquid": False}
        start, begun = time.perf_counter(), time.process_time()
        result, omissions = corrode_lean(scene, times)
        applied = [o for o in omissions if o.applied]
        found = {
            "left_out": [o.name for o in applied],
            "clean_liquid": any(o.name == LIQUID for o in applied),
            "bound": max((o.bound for o in applied), default=0.0),
        }
    else:
        result = corrode(scene, times, TimeStepping("sdirk2", rate_change=rate_change))
        found = {
            "iterations": int(result.history["iterations"].sum()),
            "balance_error": float(np.abs(result.history["balance_error"]).max()),
            "step_lengths": result.history["step"][1:].tolist(),
            "losses": result.history["volume_loss"][1:].tolist(),
        }
    found |= {
        "seconds": time.perf_counter() - start,
        "processor_seconds": time.process_time() - begun,
        "nodes": int(scene.domain.sum()),
        "bonds": scene.stencil.bonds,
        "steps": len(result.history["time"]) - 1,
        "volume_loss": float(result.volume_loss[-1]),
        "peak_bytes": peak_memory(),
    }
    if steps and found.get("clean_liquid"):
        found["clean_losses"] = clean_march(scene, steps).tolist()
    return found


def published_screw(alloy: str, m: int, spacing: float = 50e-6):
    """The full-resolution scene of Table 5.2: a ball of radius 4 mm about the screw."""
    from dataclasses import replace

    from peri.engine.lattice import ball, box_lattice
    from pipeline.scene.resolve import resolve_scene
    from pipeline.scene.scene import DomainSettings
    from pipeline.stages.corrosion import corrosion_scene, metal_of
    from pipeline.stages.geometry import build_solid

    scene = resolve_scene([alloy], ["0w", "8w"], "standard", corrosion={"classes": 0})
    lattice_settings = replace(scene.lattice, spacing=spacing, horizon=m * spacing)
    # The ball is laid out below; margins of its radius say that it has room for the horizon.
    room = DomainSettings("ball", BALL_RADIUS, BALL_RADIUS)
    scene = replace(scene, lattice=lattice_settings, domain=room)
    solid = build_solid(scene)
    centre = 0.5 * (solid.points.min(axis=0) + solid.points.max(axis=0))
    lattice = box_lattice(centre - BALL_RADIUS, centre + BALL_RADIUS, spacing)
    metal, fraction = metal_of(scene, lattice, solid)
    return corrosion_scene(
        scene, alloy, lattice, ball(lattice, centre, BALL_RADIUS), metal, fraction
    )


@contextmanager
def _measured(comm) -> Iterator[dict]:
    """What the block costs, on all ranks of a communicator, or in this process (None)."""
    idle, start, begun, found = peak_memory(), time.perf_counter(), time.process_time(), {}
    yield found
    own = (time.process_time() - begun, peak_memory(), peak_memory() - idle)
    found["seconds"] = time.perf_counter() - start
    every = [own] if comm is None else comm.gather(own)
    if every is not None:
        processor, peaks, grown = zip(*every, strict=True)
        found["processor_seconds"], found["peak_bytes"] = sum(processor), sum(peaks)
        found["rank_bytes"], found["rank_field_bytes"] = list(peaks), list(grown)


def ball_march(spacing: float, steps: int, petsc: bool) -> dict | None:
    """Fixed steps of a cylinder in a liquid ball, embedded or over PETSc on the ranks."""
    from peri.corrosion.kinetics import VolumeLossLaw
    from peri.corrosion.run import corrode
    from peri.corrosion.scene import CorrosionScene
    from peri.engine.lattice import ball, box_lattice, cylinder
    from peri.engine.march.marching import TimeStepping

    march, comm = corrode, None
    if petsc:
        from mpi4py.MPI import COMM_WORLD as comm

        from peri.corrosion.ranks import corrode as march
    root = comm is None or comm.rank == 0

    def scene(spacing: float):
        lattice = box_lattice((-BALL_RADIUS,) * 3, (BALL_RADIUS,) * 3, spacing)
        return CorrosionScene(
            lattice, 2 * spacing, cylinder(lattice, (0, 0, 0), 1e-3, 4e-3),
            domain=ball(lattice, (0, 0, 0), BALL_RADIUS), solid_concentration=66082.4,
            saturation_concentration=0.66, liquid_diffusivity=8.7e-9, dissolution_flux=5e-9,
            kinetics=VolumeLossLaw(0.2355),
        )  # fmt: skip

    stepping = TimeStepping("sdirk2", step=DAY)
    march(scene(4e-4) if root else None, [DAY], stepping)  # compiles
    with _measured(comm) as costs:
        whole = scene(spacing) if root else None
        result = march(whole, [steps * DAY], stepping)
    if not root:
        return None
    return {
        **costs,
        "nodes": int(whole.domain.sum()),
        "iterations": int(result.history["iterations"].sum()),
        "volume_loss": float(result.volume_loss[-1]),
    }


def ion_march(spacing: float, steps: int, petsc: bool) -> dict | None:
    """Steps of 3 h of metal in body fluid, three minerals and the potential; as ball_march."""
    from peri.engine.march.marching import TimeStepping
    from peri.engine.march.marching import march as march_problem
    from peri.engine.processes import ONE_PROCESS
    from pipeline.benches.ions import STEP, problem_of, scene_of

    comm = None
    if petsc:
        from mpi4py.MPI import COMM_WORLD as comm

        from peri.parallel.ranks import Ranks
    root = comm is None or comm.rank == 0

    def march(spacing: float, steps: int) -> tuple:
        scene = scene_of(spacing) if root else None
        ranks = ONE_PROCESS
        if petsc:
            ranks = Ranks(comm, *((scene.stencil, scene.domain) if root else (None, None)))
        problem = problem_of(scene, True, "electroneutral", ranks)
        stepping = TimeStepping("backward_euler", step=STEP)
        done = march_problem(problem, [STEP * steps], stepping)
        if petsc:
            ranks.close()
        return scene, done

    march(180e-6, 1)  # compiles
    with _measured(comm) as costs:
        scene, done = march(spacing, steps)
    if not root:
        return None
    return {
        **costs,
        "nodes": int(scene.domain.sum()),
        "iterations": int(done.history["iterations"].sum()),
        "volume_loss": float(done.history["volume_loss"][-1]),
    }


def couple_march(spacing: float, steps: int, petsc: bool) -> dict | None:
    """AE44 beside steel for six hours a step, the potential renewed in each; as ball_march."""
    from peri.coupled.galvanic import Renewal, corrode
    from pipeline.scenes.couples import ae44_scene

    march, comm = corrode, None
    if petsc:
        from mpi4py.MPI import COMM_WORLD as comm

        from peri.coupled.galvanic_ranks import corrode as march
    root = comm is None or comm.rank == 0
    renewal = Renewal(longest=0.25 * DAY)
    march(ae44_scene("mild-steel", 0.5e-3, 1e-3) if root else None, [0.1 * DAY], renewal)
    with _measured(comm) as costs:
        scene = ae44_scene("mild-steel", spacing) if root else None
        result = march(scene, [0.25 * DAY * steps], renewal)
    if not root:
        return None
    amount = result.history["metal_amount"]
    return {
        **costs,
        "nodes": int(np.prod(scene.lattice.shape)),
        "iterations": int(result.history["iterations"].sum()),
        "volume_loss": float(1.0 - amount[-1] / amount[0]),
    }


def image_to_solid(path: str, voxel: float, threshold: float) -> dict:
    """From an image file to the surface around its metal and to the metal's share of a lattice."""
    from peri.engine.lattice import box_lattice
    from pipeline.geometry.scans import solid_from_image
    from pipeline.geometry.voxels import metal_fraction
    from pipeline.scene.image import ImageFile

    start = time.perf_counter()
    solid = solid_from_image(ImageFile(path, "", (voxel,) * 3, threshold))
    lattice = box_lattice(*solid.bounding_box, 50e-6)
    wide = tuple(n + 4 for n in lattice.shape)  # with what lies beyond the outermost points
    origin = np.asarray(lattice.origin) - 100e-6
    _, fraction = metal_fraction(solid, origin, lattice.spacing, wide)
    return {
        "seconds": time.perf_counter() - start,
        "peak_bytes": peak_memory(),
        "surface": solid.volume,
        "lattice": float(fraction.sum()) * 50e-6**3,
        "triangles": len(solid.triangles),
    }


CASES = {
    "solve": solve,
    "screw_march": screw_march,
    "ball_march": ball_march,
    "ion_march": ion_march,
    "couple_march": couple_march,
    "image_to_solid": image_to_solid,
}


def main() -> None:
    """Run the case named by the first argument with the JSON of the second."""
    found = CASES[sys.argv[1]](**json.loads(sys.argv[2]))
    if found is not None:
        print(MARK + json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
