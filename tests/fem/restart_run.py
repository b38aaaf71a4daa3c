"""Run by test_results, also under mpirun: a whole, an interrupted or a resumed test."""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fem.constitutive import Material, VoceHardening
from fem.constitutive.gurson import LIMIT
from fem.results import Checkpoint
from fem.strength import TensileSettings, tensile_test
from tests.fem.meshes import round_bar

MATERIAL = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))


class Interrupted(Exception):
    """Stands for the end of the process."""


class Stop:
    """Observer that ends the test at an increment."""

    def __init__(self, number):
        self.number = number

    def __call__(self, increment):
        if increment.number == self.number:
            raise Interrupted


def scene(element):
    """A waisted bar with random damage, dead cells, and cells that die during the test."""
    points, cells = round_bar(3, 4, 1e-3, 4e-3, waist=0.3)
    shape = (len(cells), 4 if element.startswith("P2") else 1)
    f0 = np.random.default_rng(1).uniform(0, 0.3, shape)
    f0[:20] = 2 / 3
    waist = abs(points[cells, 2].mean(axis=1) - 2e-3) < 0.5e-3
    f0[np.flatnonzero(waist)[::6]] = MATERIAL.parameters()[LIMIT] - 0.003
    return points, cells, f0


def run(element, mode, checkpoint, strain=0.03):
    """mode: "whole", "interrupted" (after 6 increments) or "resumed"."""
    comm = MPI.COMM_WORLD
    points, cells, f0 = scene(element) if comm.rank == 0 else (None, None, None)
    settings = TensileSettings(
        element=element, maximum_strain=strain, full_curve=True, tolerance=1e-8,
        maximum_increment=0.003,
    )  # fmt: skip
    observers = [Checkpoint(checkpoint), Stop(6)] if mode == "interrupted" else []
    return tensile_test(
        points, cells, f0, MATERIAL, settings, comm, observers=observers,
        resume=checkpoint if mode == "resumed" else None,
    )  # fmt: skip


if __name__ == "__main__":
    element, checkpoint, output, own_checkpoint = sys.argv[1:]
    result = run(element, "resumed", Path(checkpoint))
    if MPI.COMM_WORLD.rank == 0:
        np.savez(output, **result.history, displacement=result.displacement, lost=result.lost_cells)
    try:
        run(element, "interrupted", Path(own_checkpoint))
    except Interrupted:
        sys.exit(0)
    sys.exit("the second test was not interrupted")
