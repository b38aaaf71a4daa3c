"""The tensile test as an input deck for CalculiX: one material per damage class.

What the deck keeps of the model: finite strains, J2 plasticity with the same hardening, moduli and
yield stress multiplied by 1 - q1 f0, the same nodes held and moved. What the deck leaves out: f
does not grow, mean stress does not lower the yield stress, and nothing tears; so its force is the
intact solid's as it is here, and that of corroded ones somewhat higher.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem.constitutive.gurson import RESIDUAL_STRENGTH
from fem.constitutive.hardening import VoceHardening, flow_stress
from fem.solid import guide_vertices, remains
from pipeline.export.state import CorrodedState
from pipeline.record.whole_file import whole_file

CLASSES = 20
MOST_CLASSES = 200
MM, MPA = 1e3, 1e-6  # of a metre, of a pascal

# CalculiX's order of the mid-edge nodes, as pairs of corners
_EDGES = np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])
# 200 pairs are the most that CalculiX 2.20 reads rightly
_PLASTIC_STRAINS = np.r_[np.linspace(0.0, 0.4, 161), np.linspace(0.42, 3.0, 39)]


@dataclass(frozen=True)
class DamageClasses:
    """The cells of the solid sorted by what is left of their strength.

    number (nc,): class of each cell, -1 where the cell is left out (dead, or joined to no grip);
    strength (classes,): 1 - q1 f0 of each class, mean over its volume.
    """

    number: NDArray[np.int64]
    strength: NDArray[np.float64]


def damage_classes(state: CorrodedState, count: int = CLASSES) -> DamageClasses:
    """Sort the cells into at most `count` classes of equal width in strength.

    Sound metal is a class of its own; classes without cells are left out. Cells that count as gone
    and pieces that do not join both grips are left out, as in the tensile test. Raises ValueError
    for a count out of range and where no piece joins both grips.
    """
    if not 1 <= count <= MOST_CLASSES:
        raise ValueError(f"--classes is {count}; it must be 1 to {MOST_CLASSES}")
    held = state.held
    bottom, top = held.at_bottom(state.points), held.at_top(state.points)
    left = remains(state.cells, ~state.dead, bottom, top)
    if left.severed:
        raise ValueError(
            f"{state.alloy} after {state.time.label} is severed: no piece joins both grips, so "
            "there is nothing to pull"
        )
    strength = state.strength_left
    sound = strength > 1.0 - 1e-6
    share = (strength - RESIDUAL_STRENGTH) / (1.0 - RESIDUAL_STRENGTH)
    number = np.clip((share * count).astype(np.int64), 0, count - 1)
    number[sound] = count
    number[~left.kept] = -1
    corners = state.points[state.cells]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    kept = number >= 0
    used, rank = np.unique(number[kept], return_inverse=True)
    total = np.bincount(rank, volume[kept])
    mean = np.bincount(rank, volume[kept] * strength[kept]) / total
    number[kept] = rank
    return DamageClasses(number, np.where(used == count, 1.0, mean))


def write_inp(state: CorrodedState, path: Path, classes: int = CLASSES) -> list[Path]:
    """Write the deck; `ccx NAME` runs it as it is (mm, N, MPa).

    P1 becomes C3D4, every other element C3D10, since CalculiX has no F-bar. The reaction of the
    top grip, and with it the peak force, is printed to NAME.dat. Raises ValueError for a load other
    than axial.
    """
    if state.hold.tensile.load != "axial":
        raise ValueError(
            f"the load of the run is {state.hold.tensile.load}; an .inp is written where the load "
            "is axial"
        )
    lines = _deck(state, damage_classes(state, classes))
    with whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace")
    return [path]


def _deck(state: CorrodedState, classes: DamageClasses) -> Iterator[str]:
    test, held = state.hold.tensile, state.held
    kept = np.flatnonzero(classes.number >= 0)
    cells = state.cells[kept]
    nodes, elements, kind = state.points, cells, "C3D4"
    if test.element != "P1":
        nodes, elements = ten_nodes(state.points, cells)
        kind = "C3D10"
    used = np.unique(elements)
    yield f"** perilife: {state.alloy} after {state.time.label}, held: {state.hold.name}"
    yield "** mm, N, MPa; element number = row of the cell in the mesh + 1"
    yield f"** {len(state.cells) - len(kept)} of {len(state.cells)} cells are gone and left out"
    yield "*NODE, NSET=ALL"
    for i, (x, y, z) in zip(used + 1, MM * nodes[used], strict=True):
        yield f"{i}, {x:.12g}, {y:.12g}, {z:.12g}"
    for k in range(len(classes.strength)):
        yield f"*ELEMENT, TYPE={kind}, ELSET=CLASS{k}"
        members = np.flatnonzero(classes.number[kept] == k)
        for i, cell in zip(kept[members] + 1, elements[members] + 1, strict=True):
            yield ", ".join(map(str, [i, *cell]))
    yield from _materials(state, classes.strength)
    yield from node_set("BOTTOM", used[held.at_bottom(nodes[used])])
    yield from node_set("TOP", used[held.at_top(nodes[used])])
    yield "*BOUNDARY"
    yield "BOTTOM, 3, 3"
    if test.lateral == "clamped":
        yield "BOTTOM, 1, 2"
        yield "TOP, 1, 2"
    else:  # three conditions a piece keep the piece from drifting and carry no force
        bottom = held.at_bottom(state.points)
        left = remains(cells, np.ones(len(cells), bool), bottom, held.at_top(state.points))
        for vertex, axis in guide_vertices(state.points, cells, left.pieces, bottom):
            yield f"{vertex + 1}, {axis + 1}, {axis + 1}"
    step = test.increment / test.final_strain
    yield "*STEP, NLGEOM, INC=10000"
    yield "*STATIC"
    yield f"{step:.6g}, 1., 1e-6, {step:.6g}"
    yield "*BOUNDARY"
    yield f"TOP, 3, 3, {MM * test.final_strain * held.length:.12g}"
    yield "*NODE PRINT, NSET=TOP, TOTALS=ONLY"
    yield "RF"
    yield "*NODE FILE"
    yield "U, RF"
    yield "*EL FILE"
    yield "S, PEEQ"
    yield "*END STEP"


def _materials(state: CorrodedState, strength: NDArray[np.float64]) -> Iterator[str]:
    values = state.material
    law = VoceHardening(
        values.initial_yield_stress, values.hardening_capacity, values.hardening_rate
    )
    flow = [flow_stress(law.kind, law.parameters(), e)[0] for e in _PLASTIC_STRAINS]
    for k, share in enumerate(strength):
        yield f"*MATERIAL, NAME=CLASS{k}"
        yield "*ELASTIC"
        yield f"{MPA * share * values.young_modulus:.12g}, {values.poisson_ratio:.12g}"
        yield "*PLASTIC"
        for stress, strain in zip(flow, _PLASTIC_STRAINS, strict=True):
            yield f"{MPA * share * stress:.10g}, {strain:.10g}"
        yield f"*SOLID SECTION, ELSET=CLASS{k}, MATERIAL=CLASS{k}"


def ten_nodes(
    points: NDArray[np.float64], cells: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """All nodes (n, 3) and cells (nc, 10) of straight ten-node cells, in CalculiX's order."""
    edges = np.sort(cells[:, _EDGES].reshape(-1, 2), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    nodes = np.concatenate([points, points[unique].mean(axis=1)])
    return nodes, np.c_[cells, len(points) + number.reshape(len(cells), 6)]


def node_set(name: str, numbers: NDArray[np.int64]) -> Iterator[str]:
    """A node set of zero-based numbers, sixteen a line."""
    yield f"*NSET, NSET={name}"
    for start in range(0, len(numbers), 16):
        yield ", ".join(str(n + 1) for n in numbers[start : start + 16])
