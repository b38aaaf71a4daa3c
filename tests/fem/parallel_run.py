"""Run by test_parallel under mpirun: pulls or turns bars and writes the curves from rank 0.

parallel_run FILE.npz SOLVER:LOAD:MATERIALS ...
"""

import sys

import numpy as np
from mpi4py import MPI

from fem.constitutive import Material, VoceHardening
from fem.constitutive.hardening import TabulatedHardening
from fem.strength import TensileSettings, tensile_test
from tests.fem.meshes import round_bar


def pull(job: str):
    """The result of one job."""
    solver, load, materials = job.split(":")
    points, cells = round_bar(3, 4, 1e-3, 4e-3, waist=0.3)
    f0 = np.random.default_rng(1).uniform(0, 0.3, (len(cells), 4))
    f0[:20] = 2 / 3
    if MPI.COMM_WORLD.rank:
        points = cells = f0 = None
    settings = TensileSettings(
        maximum_strain=0.01, full_curve=True, tolerance=1e-8, linear_solver=solver, load=load
    )
    material = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))
    several = {}
    if materials == "two":
        steel = TabulatedHardening((0.0, 0.1), (300e6, 420e6))
        material = [material, Material(207e9, 0.29, steel)]
        above = None if points is None else points[cells, 2].mean(axis=1) > 2e-3
        several["material_of_cell"] = None if above is None else above.astype(int)
    return tensile_test(points, cells, f0, material, settings, **several)


if __name__ == "__main__":
    output, *jobs = sys.argv[1:]
    found = {}
    for name in jobs:
        result = pull(name)
        found[f"{name}/motion"], found[f"{name}/reaction"] = result.motion, result.reaction
        found[f"{name}/dead"] = result.dead_cells
    if MPI.COMM_WORLD.rank == 0:
        np.savez(output, **found)
