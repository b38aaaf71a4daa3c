"""Small marches to compare one process with MPI ranks; as a script it runs them on ranks.

mpirun -n 2 python -m tests.peri.parallel.rank_cases FILE.npz [NAME...]
"""

import sys
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from peri.corrosion import CorrosionScene
from peri.corrosion.blocks import block_scene
from peri.corrosion.coating import Coating
from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.laws import INTERFACE_LAWS
from peri.engine.lattice import Lattice, ball, box_lattice, cylinder
from peri.engine.march.marching import TimeStepping
from peri.engine.operators import NonlocalSum
from peri.engine.processes import ONE_PROCESS
from peri.engine.solvers import DiffusionSystem, LinearSystem
from peri.engine.surface.rate_classes import CellExposure, cell_exposure
from peri.schemes.bonds import (
    Exponential,
    Harmonic,
    geometric_conductances,
    mean_conductances,
    square_root_fluxes,
)
from tests.peri.bodies import ball as balls
from tests.peri.corrosion.nodes.test_pores import gap
from tests.peri.corrosion.scenes import LAWS, WEEK, law_scene
from tests.peri.corrosion.test_local_kinetics import Inhibited, Passivating
from tests.peri.engine.surface.test_rate_classes import share_of_ball

DAY = 86400.0
SOLVER_TOLERANCE = 1e-10


def ball_scene() -> CorrosionScene:
    """3D: a rod off the middle of a ball of refreshed liquid, on cells with metal fractions."""
    lattice = box_lattice((-1e-3, -0.9e-3, -1e-3), (1e-3, 0.9e-3, 1e-3), 1e-4)
    metal = cylinder(lattice, (1e-4, 0, -1e-4), 3.2e-4, 7e-4)
    fraction = np.where(metal, 0.9, 0.0)
    fraction[~metal & cylinder(lattice, (1e-4, 0, -1e-4), 4.3e-4, 9e-4)] = 0.2
    return CorrosionScene(
        lattice, 2e-4, metal, domain=ball(lattice, (0, 0, 0), 1e-3), metal_fraction=fraction,
        solid_concentration=65000.0, saturation_concentration=500.0, liquid_diffusivity=1e-9,
        interface_diffusivity=1e-13, kinetics=VolumeLossLaw(0.2),
    )  # fmt: skip


def closed_scene() -> CorrosionScene:
    """2D, nothing leaves: liquid saturates beside the metal, horizon of three spacings."""
    lattice = box_lattice((0.0, 0.0), (3.2e-3, 2.4e-3), 1e-4)
    return CorrosionScene(
        lattice, 3e-4, ball(lattice, (1.0e-3, 0.9e-3), 5e-4), boundary="no_flux",
        solid_concentration=1000.0, saturation_concentration=100.0, liquid_diffusivity=1e-12,
        dissolution_flux=1e-6,
    )  # fmt: skip


def line_scene() -> CorrosionScene:
    """1D: metal that dissolves node by node into refreshed liquid."""
    lattice = box_lattice((0.0,), (40e-6,), 1e-6)
    metal = (lattice.coordinates()[0] > 12e-6) & (lattice.coordinates()[0] < 24e-6)
    return CorrosionScene(
        lattice, 2e-6, metal, solid_concentration=1000.0, saturation_concentration=300.0,
        liquid_diffusivity=1e-12, interface_diffusivity=1e-13,
    )  # fmt: skip


def gap_scene() -> CorrosionScene:
    """2D, a gap on 10 : 1 whose liquid conducts along its walls, too."""
    return gap(pores=False)


def alone_scene() -> CorrosionScene:
    """2D: metal that is marched without its liquid, by Faraday's law."""
    lattice = box_lattice((0.0, 0.0), (2.4e-3, 2.0e-3), 1e-4)
    return CorrosionScene(
        lattice, 2e-4, ball(lattice, (1.0e-3, 0.9e-3), 5e-4), saturation="none",
        solid_concentration=1000.0, saturation_concentration=100.0, liquid_diffusivity=1e-9,
        dissolution_flux=1e-6, dissolution="faradaic",
    )  # fmt: skip


@lru_cache
def end_of_ball() -> tuple[Lattice, CellExposure]:
    """A ball of 1.2 horizons with rate classes at one end of a lattice: a block has no metal."""
    lattice = Lattice((-2.4, -2.1, -1.9), (0.5,) * 3, (20, 9, 8))
    fraction = share_of_ball(lattice, 1.2, rays=8)
    return lattice, cell_exposure(lattice, balls(1.2, 2, scaled=True), 1.0, fraction)


def class_scene(horizon: float = 1.0, **options) -> CorrosionScene:
    """Rate classes that dissolve within their cells, horizon of two or three spacings."""
    lattice, exposure = end_of_ball()
    settings = {
        "solid_concentration": 100.0, "saturation_concentration": 30.0, "dissolution_flux": 0.05,
        "liquid_diffusivity": 1.0, **options,
    }  # fmt: skip
    metal = exposure.metal.fraction > 0
    return CorrosionScene(lattice, horizon, metal, exposure=exposure, **settings)


_CLOSED = {"boundary": "no_flux", "liquid_diffusivity": 1e-2, "saturation_concentration": 5.0}
CLASSES = {
    "classes-aged": (
        {"kinetics": Passivating(500.0), "coating": Coating(0.1, 50.0), "dissolution_flux": 0.2},
        (250.0,),
        TimeStepping("sdirk2", step=100.0),  # in which skin classes go below zero
    ),
    "classes-inhibited": (
        {**_CLOSED, "kinetics": Inhibited(20.0)},
        (300.0,),
        TimeStepping("sdirk2", step=150.0),
    ),
    "classes-faradaic": (
        {**_CLOSED, "dissolution": "faradaic", "horizon": 1.5},
        (450.0,),
        TimeStepping("sdirk2", step=150.0),
    ),
}
"""Both laws of the bonds, clean and saturated; rates by age, coating and the liquid."""
MARCHES = {
    "ball": (ball_scene, (0.5 * DAY, DAY), TimeStepping("sdirk2", step=0.5 * DAY)),
    "closed": (closed_scene, (2 * DAY,), TimeStepping("backward_euler", step=DAY)),
    "line": (line_scene, (0.0, 60.0), TimeStepping("sdirk2", step=10.0)),
    "gap": (gap_scene, (400.0,), TimeStepping("backward_euler", step=100.0)),
    "pores": (gap, (3e3,), TimeStepping("backward_euler", step=500.0)),
    "pores-closed": (
        partial(gap, boundary="no_flux", renewed=None),
        (2e3,),
        TimeStepping("backward_euler", step=500.0),
    ),
    "alone": (alone_scene, (1.5 * DAY,), TimeStepping("backward_euler", step=0.25 * DAY)),
}
# Every law of the rate with every law of the bonds.
MARCHES |= {
    f"{bond}-{name}": (
        partial(law_scene, law, bond),
        (0.5 * WEEK, WEEK),
        TimeStepping("sdirk2", step=0.5 * WEEK),
    )
    for name, law in LAWS.items()
    for bond in INTERFACE_LAWS
}
MARCHES |= {
    name: (partial(class_scene, **options), times, stepping)
    for name, (options, times, stepping) in CLASSES.items()
}
BY_DEFAULT = (
    "ball", "closed", "line", "gap", "pores", "pores-closed", "alone", "proportional-acidity",
    "faradaic-repassivation", *CLASSES,
)  # fmt: skip
"""What two ranks march without `slow`, which adds the other laws."""


def options(name: str) -> dict[str, object]:
    """How a march is made: its solver's tolerance (of saturated classes, whose factors know it,
    and of what pores hold, which is metal's), and whether without its liquid."""
    exact = name in CLASSES or name.startswith("pores")
    tolerance = 1e-12 if exact else SOLVER_TOLERANCE
    return {"solver_tolerance": tolerance, "alone": name == "alone"}


STOPPED = {"line": 3, "pores": 3, "classes-faradaic": 3}
"""Marches that are stopped at so many reports."""
STIFFNESSES = (1.0, 1e3, 1e6)


def diffusion_system(scene, processes=ONE_PROCESS, stiffness=1.0):
    """Shifted diffusion on the scene's liquid with D dt / dx^2 = stiffness, and a right side."""
    local = block_scene(scene, processes)
    shape = local.lattice.shape
    bond_sum = NonlocalSum(local.stencil, shape, wanted=local.domain, processes=processes)
    weight = bond_sum.pad(np.where(local.metal | local.refreshed(), 0.0, local.capacity()))
    domain = bond_sum.pad(local.domain)
    diagonal = 1.0 / (stiffness * local.lattice.spacing[0] ** 2) + bond_sum(domain)
    sink = weight * (diagonal - bond_sum(weight))
    # A right side that does not depend on the blocks: rough in space, zero off the unknowns.
    position = [1e4 * x for x in local.lattice.coordinates()]
    rough = np.broadcast_to(sum(np.sin((5 + 7 * a) * x) for a, x in enumerate(position)), shape)
    return DiffusionSystem(bond_sum, weight, diagonal, 1.0, sink), weight * bond_sum.pad(rough)


OPERATORS = {
    "mean": lambda s, kappa, drift, on, here: mean_conductances(s, kappa, on),
    "geometric": lambda s, kappa, drift, on, here: geometric_conductances(s, kappa, on),
    "harmonic": lambda s, kappa, drift, on, here: Harmonic(s, kappa, on),
    "square root": lambda s, kappa, drift, on, here: square_root_fluxes(s, drift, here, on),
    "exponential": lambda s, kappa, drift, on, here: Exponential(s, drift, here, on),
    "exponential, on the fly": lambda s, kappa, drift, on, here: Exponential(
        s, drift, here, on, stored=False
    ),
}


def bond_system(name, scene, processes=ONE_PROCESS):
    """A steady system of one kind of bond in the scene's liquid, and a right side."""
    local = block_scene(scene, processes)
    shape = local.lattice.shape
    bond_sum = NonlocalSum(local.stencil, shape, wanted=local.domain, processes=processes)
    pad = bond_sum.pad
    here = pad(local.domain & ~local.metal)
    unknown = pad(local.domain & ~local.metal & ~local.refreshed())
    x, y, z = (1e3 * c for c in local.lattice.coordinates())
    kappa = here * pad(np.exp(np.sin(3 * x) + y + 0 * z))
    drift = here * pad(4 * x + np.cos(5 * y) + 0 * z)
    operator = OPERATORS[name](bond_sum, kappa, drift, unknown, here)
    rough = np.broadcast_to(np.sin(50 * x) + np.sin(70 * y) + np.sin(90 * z), shape)
    return LinearSystem(operator), unknown * pad(rough)


def solve(system, right, processes=ONE_PROCESS):
    """Solution on the lattice and the iterations that it took."""
    x = np.zeros_like(right)
    norm = np.sqrt(processes.total(float((right**2).sum())))
    count = system.solve(x, right.copy(), SOLVER_TOLERANCE * norm)
    return processes.gather(system.sum.crop(x)), count


def main(path: str, *names: str) -> None:
    """Run all marches, or these, and the rest on the ranks; rank 0 writes the results."""
    from mpi4py import MPI

    from peri.corrosion.ranks import corrode

    comm, out = MPI.COMM_WORLD, {}
    root = comm.rank == 0
    for name in names or MARCHES:
        make, times, stepping = MARCHES[name]
        result = corrode(make() if root else None, times, stepping, **options(name))
        if root:
            for field in ("concentration", "metal", "volume_loss"):
                out[f"{name}/{field}"] = getattr(result, field)
            for field, values in result.history.items():
                out[f"{name}/history/{field}"] = values
    others(comm, path, out)
    if root:
        np.savez(path, **out)


def others(comm, path: str, out: dict) -> None:
    """Linear systems, marches that are stopped and resumed, and a refusal; rank 0 fills out."""
    from peri.corrosion.ranks import corrode
    from peri.parallel.ranks import Ranks

    root = comm.rank == 0
    for stiffness in STIFFNESSES:
        scene = ball_scene()
        ranks = Ranks(comm, scene.stencil, scene.domain)
        x, count = solve(*diffusion_system(scene, ranks, stiffness), ranks)
        ranks.close()
        out[f"diffusion/{stiffness:g}"], out[f"diffusion/{stiffness:g}/iterations"] = x, count
    for name in OPERATORS:
        scene = ball_scene()
        ranks = Ranks(comm, scene.stencil, scene.domain)
        x, count = solve(*bond_system(name, scene, ranks), ranks)
        ranks.close()
        out[f"bonds/{name}"], out[f"bonds/{name}/iterations"] = x, count
    # A march that rank 0 stops after some reports leaves a checkpoint, and goes on from there.
    for name, reports in STOPPED.items():
        make, times, stepping = MARCHES[name]
        scene, calls = make() if root else None, []

        def stop(fraction, text, calls=calls, reports=reports):
            calls.append(fraction)
            if len(calls) == reports:
                raise InterruptedError

        how = {**options(name), "checkpoint": f"{path}.{name}"}
        try:
            corrode(scene, times, stepping, progress=stop, checkpoint_every=0.0, **how)
        except InterruptedError:
            out[f"stopped/{name}"] = comm.gather(len(calls))
        result = corrode(scene, times, stepping, resume=True, checkpoint_every=1e9, **how)
        if root:
            out[f"resumed/{name}"] = result.concentration
    # Blocks narrower than the reach.
    lattice = box_lattice((0.0,), (3e-6,), 1e-6)
    small = replace(line_scene(), lattice=lattice, metal=np.zeros(3, bool), domain=None)
    try:
        corrode(small if root else None, (1.0,))
    except ValueError as error:
        out["refusal"] = str(error)


if __name__ == "__main__":
    main(*sys.argv[1:])
