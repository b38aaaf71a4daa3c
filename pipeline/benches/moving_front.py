"""Rows of `bench cut-cells` for surfaces that move: a ball dissolved to a third in clean liquid.

The ball has three horizons' radius; the reference is the same nonlocal model in radial shells.
Errors are the largest over 10, 20, 33, 50 and 67 % of V_L, medians over positions of the lattice.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.surface.rate_classes import CellExposure, cell_exposure
from peri.engine.surface.triangles import Surface
from peri.reference.moving_ball import dissolving_ball
from pipeline.benches.result import Result
from pipeline.stages.exposure import share_of_ball

Array = NDArray[np.float64]

RADIUS = 3.0
"""In horizons."""
LOSSES = np.array([0.1, 0.2, 0.33, 0.5, 0.667])
LAWS = {"proportional": 1e-5, "faradaic": 1e-5}
"""C_sat/C_solid by law."""


def moving_balls(
    surface: Surface, ratios: tuple[int, ...], positions: int, rate_change: float
) -> list[Result]:
    """Errors of V_L; surface: of a ball of radius 1."""
    results = []
    for law, saturated in LAWS.items():
        times, loss, _ = dissolving_ball(
            RADIUS, None if law == "faradaic" else saturated, RADIUS - 1.0, 400
        )
        moments = np.interp(LOSSES, loss, times)
        for ratio in ratios:
            errors, balance, seconds = [], [], []
            for shift in np.random.default_rng(ratio).random((positions, 3)):
                scene = _in_clean_liquid(surface, ratio, shift, law, saturated)
                start = time.process_time()
                found = corrode(scene, moments, TimeStepping(rate_change=rate_change))
                seconds.append(time.process_time() - start)
                errors.append(np.abs(found.volume_loss / LOSSES - 1).max())
                balance.append(np.abs(found.history["balance_error"]).max())
            name = f"dissolving ball, {law}, delta/{ratio}"
            target = {4: "<= 6e-3"}.get(ratio)
            results += [
                Result(f"{name}: error of V_L", float(np.median(errors)), "1", target),
                Result(f"{name}: balance", float(max(balance)), "1", "<= 1e-12"),
                Result(f"{name}: march", float(np.median(seconds)), "s processor"),
            ]
    return results


def _in_clean_liquid(
    surface: Surface, ratio: int, shift: Array, law: str, saturated: float
) -> CorrosionScene:
    """The ball in liquid held at zero; horizon, flux and C_solid are 1."""
    spacing = 1.0 / ratio
    half = int(np.ceil((RADIUS + 1.0) * ratio)) + 2
    origin = tuple(float(s - half) * spacing for s in shift)
    lattice = Lattice(origin, (spacing,) * 3, (2 * half + 1,) * 3)
    fraction = share_of_ball(lattice, (0.0, 0.0, 0.0), RADIUS)
    around = Surface(RADIUS * surface.vertices, surface.facets)
    seen = cell_exposure(lattice, around, 1.0, fraction)
    held = CellExposure(seen.metal, seen.liquid, None, np.where(fraction < 1, 1.0, 0.0))
    return CorrosionScene(
        lattice, 1.0, fraction > 0, solid_concentration=1.0, saturation_concentration=saturated,
        liquid_diffusivity=1e8, dissolution_flux=1.0, dissolution=law, kinetics=ConstantRate(),
        exposure=held,
    )  # fmt: skip
