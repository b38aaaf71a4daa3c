"""Small marches of metal and ions to compare one process with MPI ranks; as a script it runs them.

mpirun -n 2 python -m tests.peri.coupled.rank_cases FILE.npz NAME...
"""

import dataclasses
import sys
from collections.abc import Callable
from functools import partial

import numpy as np

from peri.corrosion.electrode_kinetics import ElectrodeKinetics
from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.liquid_factors import LiquidFactors
from peri.corrosion.metal.solids import Solid
from peri.corrosion.scene import CorrosionScene
from peri.coupled.bath import Bath, Exchanges
from peri.coupled.degradation import Degradation
from peri.engine.lattice import ball, box_lattice
from peri.engine.march.marching import March, TimeStepping, march
from peri.engine.march.runge_kutta import RungeKutta
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.transport.chemistry.composition import CompositionError
from peri.transport.nernst_planck import TransportOptions
from tests.peri.coupled.test_charge_balance import ACTIVE, NOBLE, brine
from tests.peri.coupled.test_degradation import WEEK, medium
from tests.peri.coupled.test_vessels import BARE, DAY, HOUR, crumb

SOLID = 66082.4


def disc(flux: float = 2e-6, **changes) -> CorrosionScene:
    """2D: a disc of metal off the middle of a box of liquid; few nodes, so that one level does."""
    h = 0.1e-3
    lattice = box_lattice((0.0, 0.0), (12 * h, 11 * h), h)
    settings = {
        "solid_concentration": SOLID, "saturation_concentration": 6.6, "liquid_diffusivity": 8.7e-9,
        "dissolution_flux": flux, "kinetics": VolumeLossLaw(0.2355), **changes,
    }  # fmt: skip
    return CorrosionScene(lattice, 2 * h, ball(lattice, (5.5 * h, 5.5 * h), 1.8 * h), **settings)


def plates(balance: str = "mixed", **changes) -> CorrosionScene:
    """2D: an active and a noble block on either side of a box, one with the other by a wire."""
    h = 0.1e-3
    lattice = box_lattice((0.0, 0.0), (14 * h, 8 * h), h)
    x = lattice.coordinates()[0] / h + np.zeros(lattice.shape)
    phase = np.where(x < 3, 1, np.where(x > 10, 2, 0)).astype(np.uint8)
    active, noble = (
        dataclasses.replace(law, balance=balance, ph_reference=7.0, **changes)
        for law in (ACTIVE, NOBLE)
    )
    return CorrosionScene(
        lattice, 2 * h, phase > 0, boundary="no_flux", solid_concentration=SOLID,
        saturation_concentration=6.6, liquid_diffusivity=1e-9, dissolution_flux=1e-5,
        kinetics=active, phase=phase,
        solids=(
            Solid(SOLID, kinetics=active),
            Solid(SOLID, rate=NOBLE.free_current / ACTIVE.free_current, kinetics=noble),
        ),
    )  # fmt: skip


APPLIED = ElectrodeKinetics(
    1e-2, 1e-2, -2.0, -0.9, balance="applied", applied_potential=-1.6, ph_reference=7.0
)
NEUTRAL, SG = TransportOptions(), TransportOptions(flux_form="sg")
LIGHT = {"kinetics": ConstantRate(), "solid_concentration": 600.0, "saturation_concentration": 60.0}
"""Metal that is soon gone, node by node."""
SBF, SALINE = ("sbf", ("brucite", "calcite")), ("nacl", ("brucite",))


@dataclasses.dataclass(frozen=True)
class Case:
    """A march: scene, medium and its minerals' changes, what is asked of the problem, times."""

    make: Callable[[], CorrosionScene]
    medium: tuple
    times: tuple[float, ...]
    step: float | None
    options: TransportOptions = BARE
    scheme: str = "sdirk2"
    minerals: dict = dataclasses.field(default_factory=dict)
    asked: dict = dataclasses.field(default_factory=dict)


CASES = {
    # at rest, computed at the output times; sg goes bond by bond
    "rest": Case(disc, SBF, (0.0, DAY), DAY / 2, NEUTRAL),
    "rest-sg": Case(disc, ("sbf",), (DAY,), DAY, SG),
    "rest-3d": Case(partial(crumb, 2e-6, 0.5e-3), ("nacl",), (DAY,), DAY, NEUTRAL),
    # a mineral in equilibrium and a kinetic one
    "brucite": Case(partial(disc, 1e-4), SALINE, (WEEK / 8,), WEEK / 8, NEUTRAL),
    "calcite": Case(
        disc, SBF, (DAY,), DAY / 2, minerals={"region": "liquid", "nucleation_index": 0.5}
    ),
    # nodes that turn liquid while minerals are followed
    "goes": Case(
        partial(disc, 2e-5, **LIGHT), SALINE, (2.5 * HOUR,), HOUR / 2,
        asked={"storage": False, "minerals": True},
    ),
    # liquid that stores: a closed vessel; a pocket, metal that goes
    "closed": Case(partial(disc, boundary="no_flux"), SALINE, (HOUR,), HOUR, NEUTRAL),
    "stored-goes": Case(
        partial(disc, 2e-5, **LIGHT), ("nacl",), (2.5 * HOUR,), HOUR / 2, asked={"storage": True}
    ),
    # a bath, exchanged
    "bath": Case(
        disc, ("sbf",), (DAY,), DAY / 4,
        asked={"bath": Bath(3e-6, exchange=0.7 * DAY, open_to=("CO2",))},
    ),
    # metal that reads its liquid
    "reads": Case(
        partial(disc, kinetics=LiquidFactors(ConstantRate(), 0.5, 7.5724)), ("sbf",), (DAY,), DAY
    ),
    # currents between nodes
    "mixed": Case(plates, ("nacl",), (60.0,), 60.0, NEUTRAL, "backward_euler"),
    # next to no salt: a strong field
    "dilute": Case(plates, ("brine", 0.3), (1.0,), 1.0, NEUTRAL, "backward_euler"),
    "applied": Case(
        partial(disc, kinetics=APPLIED), ("nacl",), (HOUR,), HOUR, NEUTRAL, "backward_euler",
        asked={"storage": False},
    ),
}  # fmt: skip
STOPPED = {"goes": 4, "closed": 2, "reads": 2}
"""Marches that are stopped at so many reports."""
NUMBERS = ("net_charge", "lowest", "balance", "released", "fullest", "largest_potential", "pockets")


def problem_of(name: str, processes: OneProcess = ONE_PROCESS) -> Degradation:
    """A case's problem; the root of the processes makes the scene."""
    case = CASES[name]
    scene = case.make() if processes.is_root else None
    name, *more = case.medium
    found = brine(*more) if name == "brine" else medium(name, *more, **case.minerals)
    return Degradation(scene, found, case.options, processes=processes, **case.asked)


def marched(name: str, problem: Degradation, **options) -> March:
    """A case's march."""
    case = CASES[name]
    stepping: TimeStepping | Exchanges = TimeStepping(case.scheme, step=case.step)
    if "bath" in case.asked:
        stepping = Exchanges(RungeKutta(stepping), case.asked["bath"].exchange)
    return march(problem, case.times, stepping, **options)


def results(name: str, problem: Degradation, done: March) -> dict[str, np.ndarray]:
    """What is compared: history and the outputs' fields and numbers."""
    out = {f"{name}/history/{n}": values for n, values in done.history.items()}
    for n in ("ph", "potential", "species", "minerals", "concentration", "metal", *NUMBERS):
        out[f"{name}/{n}"] = np.array([output[n] for output in done.outputs])
    out[f"{name}/storage_bound"] = np.array(problem.storage_bound())
    space, liquid = problem.surroundings.space, problem.liquid_at(done.state)
    at_end = {"ph": problem.surroundings.liquid.ph(liquid), "psi": liquid.psi}
    at_end |= {f"species{k}": row for k, row in enumerate(liquid.concentration)}
    for n, values in at_end.items():  # in double precision
        out[f"{name}/end/{n}"] = space.processes.gather(space.crop(values))
    return out


def reductions(processes: OneProcess, part: slice) -> dict[str, object]:
    """What the processes' hooks give for parts of the same rows, and whether an error spreads."""
    rows = np.random.default_rng(5).normal(size=(40, 3))[part]
    last = part.stop is None

    def fail() -> None:
        if last:
            raise CompositionError("a node has none")

    try:
        processes.together(fail)
        said = ""
    except CompositionError as error:
        said = str(error)
    return {
        "said": said,
        "added": processes.added(rows.sum(axis=0)),
        "largest": processes.largest(rows.max(axis=0)),
        "norm": processes.norm(rows[:, 0]),
        "row_norms": processes.row_norms(rows.T),
        "least_squares": processes.least_squares(rows[:, 1:], rows[:, 0]),
        "first": processes.first(last),
    }


def main(path: str) -> None:
    """Run everything on the ranks of the world; rank 0 writes the results."""
    from mpi4py import MPI

    from peri.parallel.ranks import Ranks

    comm, out = MPI.COMM_WORLD, {}
    root = comm.rank == 0

    def on_ranks(name: str, **options) -> dict[str, np.ndarray]:
        scene = CASES[name].make() if root else None
        ranks = Ranks(comm, *((scene.stencil, scene.domain) if root else (None, None)))
        try:
            problem = problem_of(name, ranks)
            done = marched(name, problem, **options)
            found = results(name, problem, done)
        finally:
            ranks.close()
        return found

    only = sys.argv[2:] or CASES
    for name in only:
        out |= on_ranks(name)
    for name in STOPPED:
        if name not in only:
            continue
        calls = []

        def stop(fraction, text, calls=calls, reports=STOPPED[name]):
            calls.append(fraction)
            if len(calls) == reports:
                raise InterruptedError

        named = {"checkpoint": f"{path}.{name}"}
        try:
            on_ranks(name, progress=stop, checkpoint_every=0.0, **named)
        except InterruptedError:
            out[f"stopped/{name}"] = np.array(comm.gather(len(calls)) or 0)
        again = on_ranks(name, resume=True, checkpoint_every=1e9, **named)
        out |= {f"resumed/{n}": values for n, values in again.items()}
    scene = CASES["rest"].make()
    ranks = Ranks(comm, scene.stencil, scene.domain)
    edges = [*np.linspace(0, 40, comm.size + 1).astype(int)[:-1], None]
    found = comm.gather(reductions(ranks, slice(edges[comm.rank], edges[comm.rank + 1])))
    ranks.close()
    if root:
        for n in found[0]:
            out[f"reductions/{n}"] = np.array([each[n] for each in found])
        np.savez(path, ranks=comm.size, **out)


if __name__ == "__main__":
    main(sys.argv[1])
