"""V_L(t) in clean liquid without a lattice of nodes: the limit delta/dx -> infinity, by rays.

In clean liquid a point x of the metal obeys C' = -lambda(x) g(V_L) C with
lambda(x) = D_int K int over the liquid within delta of |xi|^-(3+2q) dV, so in polar coordinates
lambda is a mean over directions of int dr / r^(1+2q) over the liquid stretches of a ray.  Points
and directions are random within strata; the solid is a fine picture of the metal's share.  The
scalar equation of peri.omissions.well_stirred then gives V_L(t).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np
from scipy.integrate import solve_ivp

from peri.corrosion.kinetics import Exposed
from peri.engine.influence import closed_constant
from peri.engine.lattice import box_lattice
from pipeline.geometry.surface import Solid
from pipeline.geometry.voxels import metal_fraction


def continuum_volume_loss(
    solid: Solid,
    horizon: float,
    dissolution_flux: float,
    solid_concentration: float,
    saturation_concentration: float,
    kinetics,
    times: Sequence[float],
    *,
    voxels: int = 16,
    cells: int = 8,
    directions: int = 96,
    seed: int = 1,
) -> np.ndarray:
    """Volume loss at `times` (s, ascending) of a solid in clean liquid, (nt,).

    Kernel 1/|xi|^3 (q = 0), constant influence function, in 3D: D_int = flux delta /
    (3 C_solid), K = 3 / (pi delta^2).  No node may fall to C_sat (as in `well_stirred`).

    Parameters
    ----------
    horizon, dissolution_flux, solid_concentration, saturation_concentration, kinetics
        As in peri.corrosion.scene.CorrosionScene, SI.
    voxels : int
        Voxels per horizon of the picture of the solid.
    cells : int
        Points per horizon and axis, one at random in each cell.
    directions : int
        Rays of each point.
    """
    spacing = horizon / voxels
    lower, upper = solid.points.min(axis=0), solid.points.max(axis=0)
    lattice = box_lattice(lower - 2 * spacing, upper + 2 * spacing, spacing)
    _, fraction = metal_fraction(solid, lattice.origin, lattice.spacing, lattice.shape, 4)
    points = _one_point_per_cell(lower, upper, horizon / cells, seed)
    turns = np.random.default_rng(seed + 1).random((len(points), 3))
    # In single precision the picture of the solid stays in the processor's caches.
    integral = _liquid_integrals(
        fraction.astype(np.float32), (points - np.asarray(lattice.origin)) / spacing,
        horizon / spacing, turns, directions,
    )  # fmt: skip
    integral = integral[integral >= 0]  # points of the metal
    constant = float(closed_constant(3, horizon, 0.0, "constant"))
    diffusivity = dissolution_flux * horizon / (3.0 * solid_concentration)
    rates = np.sort(diffusivity * constant * integral)
    # Neighbouring rates are merged: 4000 classes in place of each point.
    groups = np.array_split(rates, 4000)
    levels = np.array([g.mean() for g in groups])
    weights = np.array([g.size for g in groups]) / rates.size
    scale = solid_concentration / (solid_concentration - saturation_concentration)

    def loss(stretched: float) -> float:
        return min(1.0, scale * float(weights @ -np.expm1(-levels * stretched)))

    solution = solve_ivp(
        lambda t, s: [kinetics.rate(Exposed(loss(s[0])))],
        (0.0, times[-1]), [0.0], method="DOP853", t_eval=times, rtol=1e-9,
        atol=1e-9 / levels.max(),
    )  # fmt: skip
    return np.array([loss(s) for s in solution.y[0]])


def _one_point_per_cell(lower, upper, size, seed):
    """A random point in each cell of a grid over the box, (n, 3): far less noise than free ones."""
    counts = np.ceil((upper - lower) / size).astype(int)
    corners = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    corners = corners.reshape(-1, 3)
    return lower + size * (corners + np.random.default_rng(seed).random(corners.shape))


@numba.njit(parallel=True, cache=True)
def _liquid_integrals(fraction, points, reach, turns, directions):
    """int dr/r over the liquid, summed over all directions (sr); -1 for points in the liquid.

    points: in voxels from the first one, like the horizon `reach`; turns: three random numbers
    from 0 to 1 for each point, which turn its spiral of directions.
    """
    out = np.empty(points.shape[0])
    golden = math.pi * (3.0 - math.sqrt(5.0))
    steps = 64
    for p in numba.prange(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        if not _is_metal(fraction, x, y, z):
            out[p] = -1.0
            continue
        total = 0.0
        for d in range(directions):
            height = 1.0 - 2.0 * ((d + turns[p, 0]) / directions)
            ring = math.sqrt(max(0.0, 1.0 - height * height))
            angle = golden * d + 2.0 * math.pi * turns[p, 1]
            u, v, w = ring * math.cos(angle), ring * math.sin(angle), height
            # Which lattice axis the spiral winds about changes from point to point.
            if turns[p, 2] < 1.0 / 3.0:
                u, v, w = v, w, u
            elif turns[p, 2] < 2.0 / 3.0:
                u, v, w = w, u, v
            for k in range(1, steps):
                # r_k = delta (k / steps)^2: fine near the point, where 1/r is large.
                r = reach * ((k + 0.5) / steps) ** 2
                if not _is_metal(fraction, x + r * u, y + r * v, z + r * w):
                    total += 2.0 * math.log((k + 1.0) / k)
        out[p] = 4.0 * math.pi * total / directions
    return out


@numba.njit(inline="always")
def _is_metal(fraction, x, y, z):
    """Whether the metal's share, interpolated between voxels, is above one half.

    The share of a voxel cut by a plane is one half where the plane passes its middle, so plane
    faces lie where they belong whatever their direction.
    """
    if x < 0.0 or y < 0.0 or z < 0.0:
        return False
    i, j, k = int(x), int(y), int(z)
    if i >= fraction.shape[0] - 1 or j >= fraction.shape[1] - 1 or k >= fraction.shape[2] - 1:
        return False
    a, b, c = x - i, y - j, z - k
    low = (1 - b) * ((1 - c) * fraction[i, j, k] + c * fraction[i, j, k + 1])
    low += b * ((1 - c) * fraction[i, j + 1, k] + c * fraction[i, j + 1, k + 1])
    high = (1 - b) * ((1 - c) * fraction[i + 1, j, k] + c * fraction[i + 1, j, k + 1])
    high += b * ((1 - c) * fraction[i + 1, j + 1, k] + c * fraction[i + 1, j + 1, k + 1])
    return (1 - a) * low + a * high > 0.5
