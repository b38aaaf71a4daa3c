"""Benchmark of the assembly: processor time per cell, with the stiffness and without."""

from __future__ import annotations

import time

import numpy as np

from pipeline.benches.result import Result

CELLS = 6000
DAMAGE, STRAIN = 0.05, 0.01
ELEMENTS = ("P1", "P1-Fbar", "P2", "P2-Fbar")


def assembly(cells: int = CELLS) -> list[Result]:
    """A block in which every point yields, material included, on one thread, per element."""
    return [result for element in ELEMENTS for result in _of_element(element, cells)]


def _of_element(element: str, cells: int) -> list[Result]:
    from fem.quadrature_state import QuadratureState

    assembler = _assembler(element, round((cells / 6) ** (1 / 3)))
    discretisation = assembler.discretisation
    count, points = discretisation.volumes.shape
    state = QuadratureState(np.full((count, points), DAMAGE))
    x, y, z = discretisation.coordinates.T
    displacement = STRAIN * np.c_[np.sin(y), 0.4 * x * z - 0.5 * y, z + 0.3 * z**2 + x * y]

    def seconds(stiffness: bool) -> float:
        best = np.inf
        for _ in range(4):  # the first one compiles
            begun = time.process_time()
            result = assembler.assemble(displacement, state, stiffness)
            best = min(best, time.process_time() - begun)
        if result.failed:
            raise RuntimeError(f"{result.failed} points of the block have no state")
        return best / count

    return [
        Result(f"assembly of {element}: processor time per cell", seconds(True), "s"),
        Result(f"assembly of {element}: without the stiffness", seconds(False), "s"),
        Result(
            f"assembly of {element}: share of the points that yield",
            float((state.new.strain > 0.0).mean()),
            "1",
        ),
    ]


def _assembler(element: str, side: int):
    """A cube of edge 1 m, `side` bricks along each, in six tetrahedra each."""
    from itertools import permutations

    from fem.assembly import Assembler
    from fem.constitutive import Material, fit_voce
    from fem.constitutive.laws import Laws
    from fem.preparation import whole_mesh

    number = np.arange((side + 1) ** 3).reshape(3 * (side + 1,))
    points = np.argwhere(number >= 0) / side
    cells = []
    for order in permutations(range(3)):
        walk = np.zeros((4, 3), int)  # corner to corner along the axes in this order
        for step, axis in enumerate(order):
            walk[step + 1 :, axis] = 1
        corners = [number[tuple(slice(k, k + side) for k in corner)] for corner in walk]
        cells.append(np.stack(corners, axis=-1).reshape(-1, 4))
    cells = np.concatenate(cells)
    material = Material(43e9, 0.3, fit_voce(130e6, 220e6, 0.19))
    discretisation = whole_mesh(points, cells, element)
    return Assembler(discretisation, Laws.of([material], np.zeros(len(cells), int)), 1)
