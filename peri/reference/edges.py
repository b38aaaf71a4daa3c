"""What the edge of a lattice does to nonlocal diffusion, against exact local solutions.

A node near the edge has part of its family only.  For a plane edge across a lattice axis and
fields that are uniform along it (or grow in proportion to the distance along it), the stencil's
sum over the planes of nodes is all that matters: exact sums and small dense solutions, no march.
Lengths are given in m, like the stencil's spacing.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import toeplitz

from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum


def lost_width(stencil: Stencil, axis: int = 0, along: int = 1) -> float:
    """Width of liquid that a no-flux wall takes from a flux along it, m.

    A concentration that grows along the wall stays so on the lattice, but a node at a distance z
    carries only the share half sum_j w xi_along^2 < 1 of what it should, the sum over the nodes
    that exist.  Summed over z this is sum_{xi_axis > 0} xi_axis w xi_along^2 / 2: delta/8 in 3D
    and 4 delta/(9 pi) in 2D for a fine lattice, q = 0 and omega = 1.
    """
    carried = _carried(stencil, axis, along)
    return float(stencil.spacing[axis] * (np.arange(carried.size) * carried).sum())


def lost_width_with_scaled_bonds(
    stencil: Stencil, axis: int = 0, along: int = 1, planes: int = 40
) -> float:
    """The same where bonds carry factors g_i g_j that restore each node's bond sum, m.

    g_i sum_j w g_j over the nodes that exist is the bond sum of a full family: the usual volume
    correction of a truncated family, made symmetric so that nothing is lost or gained.
    """
    n = planes * stencil.reach[axis]
    weight = _matrix(_by_plane(stencil, axis), n)
    g = np.ones(n)
    for _ in range(200):
        g = np.sqrt(g * stencil.total / (weight @ g))
    carried = _matrix(_carried(stencil, axis, along), n)
    return float(0.5 * stencil.spacing[axis] * (n - g @ carried @ g))


def lost_width_of_a_tube(stencil: Stencil, radius: float) -> float:
    """The same of a no-flux tube along the last axis, per its circumference, m (3D only).

    The tube is classified node by node about a centre off the lattice.
    """
    h = stencil.spacing[0]
    n = int(math.ceil(radius / h)) + 1
    x = h * (np.arange(-n, n + 1) + 0.31)
    inside = x[:, None] ** 2 + x[None, :] ** 2 <= radius**2
    squared = (stencil.spacing[2] * np.arange(stencil.octant.shape[2])) ** 2
    across = (stencil.octant * squared).sum(axis=2)  # both directions of the axis, halved
    operator = NonlocalSum(Stencil(across, stencil.spacing[:2]), inside.shape)
    share = operator.crop(operator(operator.pad(inside)))
    return float((1.0 - share)[inside].sum() * h * h / (2.0 * math.pi * radius))


def mode_rates(stencil: Stencil, planes: int, axis: int = 0) -> tuple[float, float]:
    """Decay rate of cos(pi x / L) between two no-flux walls, over that of local diffusion.

    L : `planes` node planes.  The second number is that of the same wave without walls, which
    errs because the operator is nonlocal and not because of an edge.
    """
    half = _by_plane(stencil, axis)
    matrix = _diffusion(half, planes)
    wave = math.pi / planes
    exact = (wave / stencil.spacing[axis]) ** 2
    slowest = np.sort(np.linalg.eigvalsh(-matrix))[1]
    bulk = 2.0 * (half * (1.0 - np.cos(wave * np.arange(half.size)))).sum()
    return float(slowest / exact), float(bulk / exact)


def held_layer_offset(stencil: Stencil, layers: int, axis: int = 0, planes: int = 40) -> float:
    """How far beyond its inner face a held layer seems to hold its value, m.

    `layers` planes of nodes at each of two edges are held at 0 and at 1; the face lies half a
    spacing before the first of them.  The steady flux between them is that of local diffusion
    over the distance of the faces plus twice this.
    """
    n = planes * stencil.reach[axis]
    matrix = _diffusion(_by_plane(stencil, axis), n)
    u, free = np.zeros(n), np.zeros(n, bool)
    u[n - layers :] = 1.0
    free[layers : n - layers] = True
    u[free] = np.linalg.solve(matrix[np.ix_(free, free)], -(matrix @ u)[free])
    h = stencil.spacing[axis]
    flux = h * float((matrix @ u)[:layers].sum())
    return 0.5 * (1.0 / flux - h * (n - 2 * layers))


def _by_plane(stencil: Stencil, axis: int) -> np.ndarray:
    """Bond sum to the plane of nodes at each distance along the axis, one direction, 1/m^2."""
    counted = stencil.octant * stencil.multiplicity
    planes = counted.sum(axis=tuple(a for a in range(stencil.dimension) if a != axis))
    return np.concatenate([planes[:1], 0.5 * planes[1:]])


def _carried(stencil: Stencil, axis: int, along: int) -> np.ndarray:
    """Half the second moment along `along` of the bonds to the plane at each distance."""
    shape = [1] * stencil.dimension
    shape[along] = -1
    distance = stencil.spacing[along] * np.arange(stencil.octant.shape[along])
    weighted = Stencil(0.5 * stencil.octant * distance.reshape(shape) ** 2, stencil.spacing)
    return _by_plane(weighted, axis)


def _matrix(by_distance: np.ndarray, planes: int) -> np.ndarray:
    """The sums between `planes` planes with nothing beyond them."""
    return toeplitz(np.pad(by_distance, (0, planes - by_distance.size)))


def _diffusion(by_distance: np.ndarray, planes: int) -> np.ndarray:
    matrix = _matrix(by_distance, planes)
    return matrix - np.diag(matrix.sum(axis=1))
