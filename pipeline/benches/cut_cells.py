"""Benchmark of rate classes: a ball in clean liquid against its closed form.

The ball has three horizons' radius and the kinetics of Mg-5Gd; the exposure of its points is
known, so V_L(t) without a lattice is one quadrature.  Errors are the largest over 7, 28 and 56
days, medians over positions of the lattice.  saturated_liquid.py has the screw's times and the ball
that saturates its liquid, moving_front.py the rows of surfaces that move.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.lattice import ball as nodes_of_ball
from peri.engine.surface.rate_classes import rate_classes
from peri.engine.surface.triangles import Surface
from peri.omissions.reduced import ReducedCorrosion, factor_of
from pipeline.benches.moving_front import (
    edged_bodies,
    layered_plates,
    moving_balls,
    moving_plates,
    saturated_balls,
    stefan_fronts,
)
from pipeline.benches.result import Result
from pipeline.benches.saturated_liquid import (
    ball_in_own_liquid,
    screw_marches,
    screw_setup,
    screw_step,
)
from pipeline.geometry.cell_shares import cell_shares

Array = NDArray[np.float64]

HORIZON, RADIUS = 200e-6, 600e-6
SOLID, SATURATED, FLUX, LENGTH = 66082.4, 0.6608, 1.846e-6, 0.2355
"""C_solid, C_sat (mol/m3), flux (mol/m2/s) and l of Mg-5Gd (Table 5.1, converted)."""
DAYS = np.array([7.0, 28.0, 56.0])
_LAW = VolumeLossLaw(LENGTH)
_FACTOR = SOLID / (SOLID - SATURATED)


def cut_cells() -> list[Result]:
    """Three lattices, five positions each; two of the surface that moves."""
    moving = moving_balls(round_surface(1.0, 5), (2, 3, 4), 2, 0.02)
    moving += saturated_balls(round_surface(1.0, 4), 0.05)
    return (
        _measure((2, 3, 4), 5, 5)
        + resting_cut_cells()
        + moving
        + moving_plates((2,), 0.05)
        + layered_plates((2, 3, 4), 5, 0.05)
        + stefan_fronts((2, 3, 4, 6), 0.1, 5)
        + edged_bodies((2, 3, 4), 0.03)
    )


def resting_cut_cells() -> list[Result]:
    """What classes cost on the screw, and the ball in its own liquid."""
    ball = ball_in_own_liquid(round_surface(1.0, 4), (2, 3, 4))
    return screw_step(3) + screw_setup((2, 4)) + screw_marches() + ball


def small_cut_cells() -> list[Result]:
    """The coarsest lattice at one or two positions, on coarser triangles."""
    surface = round_surface(1.0, 4)
    return (
        _measure((2,), 2, 4)
        + ball_in_own_liquid(surface, (2,))
        + moving_balls(surface, (2,), 1, 0.1)
        + layered_plates((2,), 2, 0.1)
        + stefan_fronts((2, 3), 0.3)
    )


def _measure(ratios: tuple[int, ...], positions: int, refinements: int) -> list[Result]:
    surface = round_surface(RADIUS, refinements)
    exact = exact_loss()
    results = []
    for ratio in ratios:
        rng = np.random.default_rng(ratio)
        errors, before, seconds = [], [], []
        for shift in rng.random((positions, 3)):
            lattice = _lattice(ratio, shift)
            fraction = cell_shares(
                surface.vertices, surface.facets, lattice.origin, lattice.spacing, lattice.shape
            )
            start = time.process_time()
            classes = rate_classes(lattice, surface, HORIZON, fraction)
            seconds.append(time.process_time() - start)
            sums = 3 / (np.pi * HORIZON**2) * classes.exposure
            errors.append(_loss(sums, classes.volume, FLUX * HORIZON / (3 * SOLID)) / exact - 1)
            before.append(_loss_by_nodes(lattice, fraction) / exact - 1)
        worst, old = (np.abs(e).max(axis=1) for e in (np.array(errors), np.array(before)))
        target = {2: "<= 2e-3", 4: "<= 5e-4"}.get(ratio)
        spread = float(np.ptp(np.array(errors), axis=0).max())
        results += [
            Result(f"ball, delta/{ratio}: error of V_L", float(np.median(worst)), "1", target),
            Result(f"ball, delta/{ratio}: spread over positions", spread, "1", "<= 1e-3"),
            Result(f"ball, delta/{ratio}: error by nodes", float(np.median(old)), "1"),
            Result(f"ball, delta/{ratio}: set-up", float(np.median(seconds)), "s processor"),
        ]
    return results


def _lattice(ratio: int, shift: Array) -> Lattice:
    spacing = HORIZON / ratio
    half = int(np.ceil((RADIUS + HORIZON) / spacing)) + 2
    origin = tuple(float(s) * spacing - half * spacing for s in shift)
    return Lattice(origin, (spacing,) * 3, (2 * half + 1,) * 3)


def _loss(sums: Array, volumes: Array, diffusivity: float) -> Array:
    reduced = ReducedCorrosion(sums, volumes, _FACTOR)
    return reduced.volume_loss(DAYS * 86400.0, diffusivity, factor_of(_LAW)).value


def _loss_by_nodes(lattice: Lattice, fraction: Array) -> Array:
    """V_L of the same lattice where a node has one phase and one rate."""
    scene = CorrosionScene(
        lattice, HORIZON, nodes_of_ball(lattice, (0.0, 0.0, 0.0), RADIUS),
        metal_fraction=fraction, boundary="no_flux", solid_concentration=SOLID,
        saturation_concentration=SATURATED, dissolution_flux=FLUX, kinetics=_LAW,
    )  # fmt: skip
    reduced = ReducedCorrosion.of(scene)
    diffusivity = scene.base_interface_diffusivity()
    return reduced.volume_loss(DAYS * 86400.0, diffusivity, factor_of(_LAW)).value


def exact_loss() -> Array:
    """V_L of the ball at DAYS without a lattice: shells of 400 Gauss points, depth = u^4."""
    x, weight = np.polynomial.legendre.leggauss(400)
    u = (x + 1) / 2
    depth, shell = HORIZON * u**4, HORIZON * 4 * u**3 * weight / 2
    a = RADIUS - depth
    rest = (RADIUS**2 - a**2) / (2 * a) * (1 / depth - 1 / HORIZON)
    seen = 2 * np.pi * (np.log(HORIZON / depth) - rest + (HORIZON - depth) / (2 * a))
    volumes = np.append(4 * np.pi * a**2 * shell, 4 / 3 * np.pi * (RADIUS - HORIZON) ** 3)
    sums = 3 / (np.pi * HORIZON**2) * np.append(seen, 0.0)
    return _loss(np.maximum(sums, 0.0), volumes, FLUX * HORIZON / (3 * SOLID))


def round_surface(radius: float, refinements: int) -> Surface:
    """A ball's surface: an octahedron refined on the sphere, scaled to the ball's volume."""
    points = np.vstack([np.eye(3), -np.eye(3)])
    faces = np.array([
        (0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5),
    ])  # fmt: skip
    for _ in range(refinements + 1):
        pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        edges, where = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
        a, b, c = len(points) + where.reshape(3, -1)
        middle = points[edges].sum(axis=1)
        points = np.vstack([points, middle / np.linalg.norm(middle, axis=1)[:, None]])
        i, j, k = faces.T
        corners = ((i, a, c), (j, b, a), (k, c, b), (a, b, c))
        faces = np.vstack([np.stack(corner, axis=1) for corner in corners])
    volume = float(np.linalg.det(points[faces]).sum()) / 6
    return Surface(radius * (4 * np.pi / 3 / volume) ** (1 / 3) * points, faces)
