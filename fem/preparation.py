"""What rank 0 makes of the input of a test: checks, what is left of the solid, who owns what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fem import compat
from fem.constitutive.gurson import LIMIT, Q1
from fem.constitutive.laws import Laws, checked_materials
from fem.constitutive.material import Material
from fem.discretisation import Discretisation, build
from fem.loading import Load, make_load
from fem.patches import make_patches, sound_patches
from fem.quadrature import Element, find_element
from fem.settings import TensileSettings
from fem.solid import Held, Remains, destinations, guide_vertices, remains

# f up to which plastic flow is nearly isochoric, so that four-node cells lock. With 0.1 the patches
# hold cells of too different pressures: after 24 weeks stored and dissipated energy are 13 % more
# than the work of the grips; with 0.02 they are 0.1 % more.
_SOUND = 0.02


def is_sound(damage: np.ndarray) -> np.ndarray:
    """Cells (nc,) whose change of volume F-bar averages, by f (nc, nq)."""
    return damage.mean(axis=1) < _SOUND


@dataclass
class Prepared:
    """What rank 0 knows of the input."""

    points: np.ndarray
    cells: np.ndarray
    damage: np.ndarray
    held: Held
    load: Load
    left: Remains
    guides: list[tuple[int, int]]
    plan: tuple[np.ndarray, np.ndarray]
    kept: np.ndarray  # original numbers of the kept cells
    groups: np.ndarray  # patch of each kept cell
    laws: Laws  # of all cells

    def summary(self) -> dict:
        """The small part that every rank needs."""
        counts = {
            "cells": len(self.cells),
            "dead_cells": self.left.dead,
            "loose_cells": self.left.loose_cells,
            "loose_pieces": self.left.loose_pieces,
        }
        return {
            "severed": self.left.severed,
            "held": self.held,
            "load": self.load,
            "guides": self.guides,
            "counts": counts,
        }


def prepare(
    points: np.ndarray,
    cells: np.ndarray,
    f0: np.ndarray,
    materials: Sequence[Material],
    material_of_cell: np.ndarray | None,
    settings: TensileSettings,
    element: Element,
    ranks: int,
) -> Prepared:
    """Check the input of `tensile_test` and share it out to `ranks` ranks; may raise ValueError."""
    points = np.ascontiguousarray(points, float)
    cells = np.ascontiguousarray(cells, np.int64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"points have shape {points.shape}; finite (n, 3) coordinates in m are needed"
        )
    if cells.ndim != 2 or cells.shape[1] != 4 or not len(cells):
        raise ValueError(f"cells have shape {cells.shape}; (nc, 4) vertex numbers are needed")
    if cells.min() < 0 or cells.max() >= len(points):
        raise ValueError(f"cells name vertex {cells.max()}; there are {len(points)}")
    damage = np.asarray(f0, float)
    shape = (len(cells), element.points)
    if damage.shape == (len(cells),):
        damage = damage[:, None]
    if damage.shape not in ((), (len(cells), 1), shape):
        raise ValueError(f"f0 has shape {damage.shape}; element {element.name} needs {shape}")
    damage = np.array(np.broadcast_to(damage, shape))
    laws = Laws.of(materials, checked_materials(materials, material_of_cell, len(cells)))
    largest = 1.0 / laws.per_cell(Q1)
    if not (
        np.isfinite(damage).all() and damage.min() >= 0 and (damage <= largest * (1 + 1e-9)).all()
    ):
        raise ValueError(
            f"f0 runs from {damage.min()} to {damage.max()}; it must lie in "
            f"[0, 1/q1 = {largest.min():.6g}]"
        )
    if settings.damage == "cell":
        damage[:] = (damage @ element.weights / element.weights.sum())[:, None]
    held = Held.of(points, settings.grips)
    limit = laws.per_cell(LIMIT)
    alive = ~(damage >= limit).all(axis=1)
    bottom, top = held.at_bottom(points), held.at_top(points)
    left = remains(cells, alive, bottom, top)
    load = make_load(settings.load, settings.bending_azimuth, points, cells, held)
    guides: list[tuple[int, int]] = []
    if not left.severed and settings.lateral_free:
        guides = guide_vertices(points, cells, left.pieces, bottom)
    kept = np.flatnonzero(left.kept)
    groups, plan = np.arange(len(kept)), (np.zeros(0), np.zeros(1))
    if len(kept):
        if element.patches:
            sound = is_sound(damage[kept])
            groups = sound_patches(cells[kept], len(points), sound, laws.of_cell[kept])
        plan = destinations(points, cells[kept], groups, ranks)
    damage = np.minimum(damage, limit)
    return Prepared(points, cells, damage, held, load, left, guides, plan, kept, groups, laws)


def whole_mesh(
    points: np.ndarray, cells: np.ndarray, element: str, threads: int = 1
) -> Discretisation:
    """All cells of a mesh on this rank alone, sound and of one material: for tests and benchmarks.

    points (n, 3) [m]; cells (nc, 4).
    """
    kind = find_element(element)
    groups = make_patches(cells, len(points)) if kind.patches else np.arange(len(cells))
    plan = destinations(points, cells, groups, 1)
    local = compat.distribute(MPI.COMM_SELF, points, cells, plan, kind.order)
    return build(local, kind, groups[local.original_cells], threads)
