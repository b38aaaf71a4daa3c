"""Small couples to compare one process with MPI ranks; as a script it marches them on ranks.

mpirun -n 2 python -m tests.peri.coupled.galvanic_rank_cases FILE.npz NAME...
"""

import sys
from dataclasses import replace

import numpy as np

from peri.corrosion.polarization import ButlerVolmerCurve, PiecewiseTafelCurve, TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, Renewal
from peri.coupled.galvanic_ions import Ions
from peri.engine.lattice import Lattice
from peri.transport.potential.conductivity import IonConductivity
from peri.transport.potential.polarization import LinearPolarization

DAY = 86400.0
AE44 = PiecewiseTafelCurve(
    (
        TafelCurve(0.014, 0.022018951276110654, -1.55),
        TafelCurve(21.145, 0.15944576128865037, -1.48),
        TafelCurve(58.107, 0.400, -1.41),
    ),
    (-1.48, -1.41),
)


def side_by_side() -> GalvanicScene:
    """2D: AE44 beside steel below brine; nodes go."""
    h, shape = 0.5e-3, (40, 24)
    lattice = Lattice((0.5 * h,) * 2, (h, h), shape)
    x, y = lattice.coordinates()
    solid = np.broadcast_to(y < 4e-3, shape)
    metals = (
        Metal("steel", solid & (x < 10e-3), TafelCurve(0.00125, -0.153, -0.58)),
        Metal("AE44", solid & (x > 10e-3), AE44, 67860.0, 2.0, self_corrosion=1.0),
    )
    return GalvanicScene(lattice, 2 * h, metals, 2.5)


def with_ions() -> GalvanicScene:
    """The same in liquid that follows its ions, with salt."""
    scene = side_by_side()
    _, y = scene.lattice.coordinates()
    top = np.broadcast_to(y > 11e-3, scene.lattice.shape)
    law = IonConductivity(2.5, 2.0, 0.7e-9)
    return replace(scene, ions=Ions(0.7e-9, law, 60.0, top))


def around_a_ball() -> GalvanicScene:
    """3D: a ball that dissolves over a plate, some of the liquid held."""
    h, shape = 1e-3, (14, 12, 20)
    lattice = Lattice((0.5 * h,) * 3, (h,) * 3, shape)
    x, y, z = lattice.coordinates()
    ball = (x - 7e-3) ** 2 + (y - 6e-3) ** 2 + (z - 10e-3) ** 2 < (3.2e-3) ** 2
    plate = np.broadcast_to((z < 3e-3) & (x > 3e-3), shape)
    held = np.where(np.broadcast_to(z > 18e-3, shape), 0.05, np.nan)
    metals = (
        Metal("ball", ball, ButlerVolmerCurve(0.05, -1.5), 7e4, 2.0),
        Metal("plate", plate, LinearPolarization(-0.5, 0.5)),
    )
    return GalvanicScene(lattice, 2 * h, metals, 1.0, held=held)


def line() -> GalvanicScene:
    """1D: two plates, one dissolves."""
    h = 1e-3
    x = np.arange(40)
    metals = (
        Metal("anode", x < 12, LinearPolarization(0.1, 1e-3), 143e3, 2.0),
        Metal("cathode", x >= 34, LinearPolarization(0.6, 1e-3)),
    )
    return GalvanicScene(Lattice((0.0,), (h,), x.shape), 2 * h, metals, 2.5)


MARCHES = {
    "side by side": (side_by_side, [0.0, 2 * DAY], Renewal(0.25)),
    "with ions": (with_ions, [0.5 * DAY, DAY], Renewal(0.5, conductivity=0.3)),
    "ball": (around_a_ball, [200 * DAY], Renewal(0.5)),
    "line": (line, [100 * DAY], Renewal(1.0)),
}
STOPPED = "with ions"
TOLERANCE = 1e-11
"""Of the potential's charge balances."""


def main(path: str, *names: str) -> None:
    """March these on the ranks of the world, all without a name; rank 0 writes the results."""
    from mpi4py import MPI

    from peri.coupled.galvanic_ranks import corrode

    comm, out = MPI.COMM_WORLD, {}
    root = comm.rank == 0

    def keep(name, result):
        if root:
            assert result is not None
            for field in (result.fields, result.history):
                out.update({f"{name}/{key}": values for key, values in field.items()})

    for name in names or MARCHES:
        make, times, renewal = MARCHES[name]
        scene = make() if root else None
        keep(name, corrode(scene, times, renewal, solver_tolerance=TOLERANCE))
    make, times, renewal = MARCHES[STOPPED]
    calls = []

    def stop(share, text):
        calls.append(share)
        if share > 0.6:
            raise InterruptedError

    scene = make() if root else None
    options = {"checkpoint": f"{path}.h5", "solver_tolerance": TOLERANCE}
    try:
        corrode(scene, times, renewal, progress=stop, checkpoint_every=0.0, **options)
    except InterruptedError:
        out["stopped"] = comm.gather(len(calls))
    keep("resumed", corrode(scene, times, renewal, resume=True, checkpoint_every=1e9, **options))
    mirrored = replace(line(), robin="as_published")
    sinkless = replace(line().metals[0], law=TafelCurve(1.0, 0.1, 0.0))
    for name, other in (("mirrors", mirrored), ("no sink", replace(line(), metals=(sinkless,)))):
        try:
            corrode(other if root else None, [1.0])
        except ValueError as error:
            out[name] = comm.gather(str(error))
    if root:
        np.savez(path, **out)


if __name__ == "__main__":
    main(*sys.argv[1:])
