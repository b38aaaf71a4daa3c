"""Damage by what each point has seen of the liquid: within a cell the skin is gone first.

In clean liquid a point of the metal keeps exp(-Lambda z) of its content, Lambda its exposure
(`peri.engine.surface.exposure`) and z one number for all metal, the integral of K D_int g.  Where
liquid saturates, z differs from place to place, but smoothly.  A cell with rate classes has lost as
much as they lose by one z, its dose; a point between the cells takes the dose between theirs and
its own exposure.  So the steep profile below the surface comes from the surface, and the lattice
gives only what varies slowly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem.quadrature import find_element
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.checkpoints import fingerprint
from peri.engine.surface.exposure import exposure
from peri.engine.surface.triangles import Surface
from pipeline.geometry.mesh import refine_tetrahedra, surface_faces
from pipeline.geometry.surface import Solid
from pipeline.geometry.true_volume import Gaps
from pipeline.record.whole_file import write_arrays
from pipeline.scene.scene import Scene
from pipeline.stages.damage_map import interpolated

Array = NDArray[np.float64]
Kernel = tuple[float, float, str]
"""Horizon (m), exponent and influence function of an exposure (peri.engine.surface.exposure)."""

DOSES_FILE = "doses.npz"
_UNSEEN = 1e-3
"""Of what is lost: the most that metal without exposure at the start may have lost."""
_ROUND_OFF = 1e-12
"""Of the metal: such a loss is that of the means of classes."""
_LEAST_LEFT = 1e-15
"""Of a cell: what is left counts as this much at least."""
_SLIVER = 0.02
"""Of a cell: with less metal its dose is that of the outermost metal alone and does not speak for
the space around, where others do (pipeline/MEASURED.md)."""
_ROUNDS = 100
_SETTLED = 1e-12
_PARTS = 8
"""Of a cell, its edges halved."""
_SKIN_SHARE, _SKIN_DEPTH, _INNER_DEPTH = 0.5063296, 0.05878696, 0.4461163
"""Three points of a part below its face at the surface: their share of it and their depth, over its
height; depth of the fourth.  Means of depth, its square and its logarithm are exact with them."""
_ASIDE = 0.7188559
"""Place of the three between the middle (1/3) and the edges of the face (1): exact for squares."""


def doses(scene: CorrosionScene, concentration: Array) -> Array | None:
    """z of every cell at every time (nt, nx, ny, nz), the inverse of an exposure; NaN without one.

    Cells with less than a fiftieth of metal have none, unless all have as little.

    concentration: (nt, nx, ny, nz), mol/m^3, the mean of each cell's metal.  None without rate
    classes, for a law of the bond that does not decay, and where metal that saw no liquid at the
    start has lost more than a thousandth of all: then exposures at the start do not say where.
    """
    if scene.exposure is None or not scene.dissolution.reduces:
        return None
    metal = scene.exposure.metal
    seeing = metal.volume * metal.exposure > 0
    cells, row = np.unique(metal.cell[seeing], return_inverse=True)
    order, place = np.argsort(row, kind="stable"), np.empty(row.size, int)
    place[order] = np.arange(row.size) - np.searchsorted(row[order], row[order])
    share = np.zeros((cells.size, int(place.max(initial=-1)) + 1))
    rate = np.zeros_like(share)
    share[row, place] = metal.volume[seeing]
    rate[row, place] = metal.exposure[seeing]
    fraction = metal.fraction.ravel()
    share /= fraction[cells][:, None]
    blind = np.maximum(1.0 - share.sum(axis=1), 0.0)
    slivers = fraction[cells] < _SLIVER
    slivers &= not slivers.all()
    out = np.full((len(concentration), fraction.size), np.nan)
    for n, values in enumerate(concentration):
        left = np.clip(values.ravel() / scene.solid_concentration, 0.0, 1.0)
        lost = fraction * (1.0 - left)
        unseen = float(lost.sum()) - float(lost[cells].sum())
        if unseen > _UNSEEN * float(lost.sum()) + _ROUND_OFF * float(fraction.sum()):
            return None
        dose = _dose(share, rate, blind, np.maximum(left[cells], _LEAST_LEFT))
        out[n, cells] = np.where(slivers, np.nan, dose)
    return out.reshape(concentration.shape)


def _dose(share: Array, rate: Array, blind: Array, left: Array) -> Array:
    """z >= 0 with blind + sum share exp(-rate z) = left, by rows; Newton's method on the logarithm.

    That is convex and falls, so that z rises to the solution from zero; where the blind share alone
    is more than what is left, all that sees liquid goes.
    """
    fastest = rate.max(axis=1)
    most = -np.log(_LEAST_LEFT) / np.where(rate > 0, rate, np.inf).min(axis=1)
    z = np.zeros(len(left))
    for _ in range(_ROUNDS):
        kept = share * np.exp(-rate * z[:, None])
        now, slope = blind + kept.sum(axis=1), (kept * rate).sum(axis=1)
        step = np.divide(now * np.log(now / left), slope, out=np.zeros_like(z), where=slope > 0)
        after = np.clip(z + np.maximum(step, 0.0), 0.0, most)
        if (np.abs(after - z) * fastest).max(initial=0.0) <= _SETTLED:
            break
        z = after
    return z


def skin_points(points: Array, cells: NDArray[np.int64], halvings: int = 1) -> tuple[Array, Array]:
    """Points (nc, np, 3) m and volumes (nc, np) m^3 for the mean over a cell of damage by exposure.

    points (n, 3), cells (nc, 4): the mesh of a solid that sees liquid on its whole surface.  Each
    cell has 8^halvings parts of four points, one part after another as `refine_tetrahedra` has
    them.  Below the surface an exposure grows with the logarithm of the depth.  A part with a face
    there has four points that are exact for it, and for quadratics, as those of the other parts are
    (tests/pipeline/stages/test_doses.py).
    """
    corners, _, barycentric, share = _skin(points, cells, halvings)
    at = np.einsum("pqa,pad->pqd", barycentric, corners)
    edges = corners[:, 1:] - corners[:, :1]
    volume = share * (np.abs(np.linalg.det(edges)) / 6.0)[:, None]
    return at.reshape(len(cells), -1, 3), volume.reshape(len(cells), -1)


def skin_exposure(
    points: Array,
    cells: NDArray[np.int64],
    solid: Solid,
    kernel: Kernel,
    folder: Path | None = None,
    halvings: int = 1,
) -> Array:
    """Lambda (nc, np) at the `skin_points` of a solid's mesh, as deep below the surface itself.

    The mesh has the solid's volume place by place, but its facets lie within and outside of the
    surface by turns: the points below a facet are moved with it onto the surface; infinite outside
    all the same.  folder: where it is kept, by the hash of all it depends on.
    """
    surface = Surface(solid.points, solid.triangles)
    mark = fingerprint(surface.vertices, surface.facets, points, cells, halvings, *kernel)
    kept = None if folder is None else folder / f"seen-{mark[:16]}.npz"
    if kept is not None and kept.exists():
        with np.load(kept) as stored:
            return stored["seen"]
    corners, face, barycentric, _ = _skin(points, cells, halvings)
    at = np.einsum("pqa,pad->pqd", barycentric, corners)
    skin = np.flatnonzero(face < 4)
    at[skin] += _onto_surface(corners[skin], face[skin], barycentric[skin], solid)
    seen = exposure(at.reshape(-1, 3), surface, *kernel)
    seen = np.where(seen < 0.0, np.inf, seen).reshape(len(cells), -1)
    if kept is not None:
        write_arrays(kept, {"seen": seen})
    return seen


def _skin(points: Array, cells: NDArray[np.int64], halvings: int) -> tuple[Array, ...]:
    """Of all parts: corners (np, 4, 3), face at the surface (4: none), points, their shares."""
    parts = cells
    for _ in range(halvings):
        points, parts = refine_tetrahedra(points, parts)
    at_surface = surface_faces(parts)
    face = np.where(at_surface.any(axis=1), at_surface.argmax(axis=1), 4)
    plain = find_element("P2")
    rules = [*map(_skin_rule, range(4)), (plain.barycentric, plain.weights / plain.weights.sum())]
    barycentric, share = (np.array([rule[k] for rule in rules])[face] for k in (0, 1))
    return points[parts], face, barycentric, share


def _onto_surface(corners: Array, face: NDArray[np.int64], at: Array, solid: Solid) -> Array:
    """By what (np, nq, 3) points of parts move so that the parts' faces lie on the surface.

    corners (np, 4, 3), m; face (np,): the number of the node that the face lies opposite to; at
    (np, nq, 4): barycentric.  That node stays.
    """
    row = np.arange(len(face))
    top = corners[row, face]
    others = np.array([[k for k in range(4) if k != f] for f in range(4)])[face]
    base = corners[row[:, None], others]
    normal = np.cross(base[:, 1] - base[:, 0], base[:, 2] - base[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal *= np.sign(np.einsum("pd,pd->p", normal, base[:, 0] - top))[:, None]
    normal /= 2.0 * area[:, None]
    share = 1.0 - at[row, :, face]  # of the way from the node to the face
    foot = top[:, None] + (np.einsum("pqa,pad->pqd", at, corners) - top[:, None]) / share[..., None]
    gap = Gaps(solid.points, solid.triangles, float(np.sqrt(np.median(area))))(foot, normal)
    gap = np.where(np.abs(gap) < np.sqrt(area)[:, None], gap, 0.0)
    return (share * gap)[..., None] * normal[:, None]


def _skin_rule(face: int) -> tuple[Array, Array]:
    """Barycentric coordinates (4, 4) and shares (4,) of the points of a part by its face."""
    aside = np.full((3, 3), 0.5 * (1.0 - _ASIDE)) + np.eye(3) * 0.5 * (3.0 * _ASIDE - 1.0)
    along = [*((1.0 - _SKIN_DEPTH) * aside), np.full(3, (1.0 - _INNER_DEPTH) / 3.0)]
    depth = [_SKIN_DEPTH] * 3 + [_INNER_DEPTH]
    points = [np.insert(row, face, deep) for row, deep in zip(along, depth, strict=True)]
    return np.array(points), np.array([_SKIN_SHARE / 3.0] * 3 + [1.0 - _SKIN_SHARE])


def part_means(values: Array, weights: Array) -> Array:
    """Means (nc, 8) over the parts of cells of values (nc, 32) at their `skin_points`."""
    shape = (len(values), _PARTS, -1)
    return np.average(values.reshape(shape), axis=2, weights=weights.reshape(shape))


def kernel_of(scene: Scene) -> Kernel:
    """The kernel by which the points of a scene see its liquid."""
    settings = scene.corrosion
    return float(scene.lattice.horizon), float(settings.kernel_exponent), settings.influence


def damage_by_dose(points: Array, seen: Array, origin: Array, spacing: Array, dose: Array) -> Array:
    """f = 1 - exp(-Lambda z) at points (..., 3) with exposures `seen` (...), not cut off.

    dose: z of the cells (nx, ny, nz), NaN where there is none; interpolated as `map_damage` does.
    """
    at = interpolated(points, origin, spacing, np.nan_to_num(dose), np.isfinite(dose))
    with np.errstate(invalid="ignore"):
        return np.where((at > 0) & (seen > 0), -np.expm1(-seen * at), 0.0)
