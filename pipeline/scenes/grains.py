"""The scene of intergranular corrosion: boundaries of grains that dissolve faster than these."""

from __future__ import annotations

import functools

import numpy as np

from peri.corrosion.metal.microstructure import BOUNDARY, polycrystal
from peri.corrosion.metal.solids import Solid
from peri.corrosion.scene import CorrosionScene
from peri.engine.constants import FARADAY
from peri.engine.march.marching import TimeStepping
from pipeline.scenes.outcome import Prepared, Value
from pipeline.scenes.pits_2d import march_section, section

ALUMINIUM = {
    "solid_concentration": 1.0e5,
    "saturation_concentration": 3.0e3,
    "liquid_diffusivity": 5.4e-10,
}
CHARGE_NUMBER, CURRENT, GRAIN_SHARE = 3.0, 100.0, 0.02
GRAIN_SIZE = (30e-6, 15e-6)
"""Along the sheet and across it: rolled metal seen from its side."""


def grain_scene(
    spacing: float,
    grain_size: tuple[float, float] = GRAIN_SIZE,
    share: float = GRAIN_SHARE,
    seed: int = 1,
) -> CorrosionScene:
    """A section of rolled metal; boundaries two spacings (at least 2 um) wide.

    grain_size : along the sheet and across it, m.  share : current of the grains over that of the
    boundaries.
    """
    horizon = 2 * spacing
    lattice = section(120e-6, 80e-6, 2 * horizon, spacing)
    y = np.broadcast_to(lattice.coordinates()[1], lattice.shape)
    metal = np.ascontiguousarray(y < 0)
    structure = polycrystal(lattice, grain_size, max(2e-6, 2 * spacing), seed)
    phase = np.where(metal, 1 + (structure.phase == BOUNDARY), 0).astype(np.uint8)
    solid = ALUMINIUM["solid_concentration"]
    return CorrosionScene(
        lattice,
        horizon,
        metal,
        dissolution_flux=CURRENT / (CHARGE_NUMBER * FARADAY),
        dissolution="faradaic",
        solids=(Solid(solid, rate=share), Solid(solid)),
        phase=phase,
        **ALUMINIUM,
    )


def intergranular(spacing: float | None) -> Prepared:
    """The scene, ready to run."""
    spacing = spacing or 1e-6
    scene = grain_scene(spacing)
    table = [
        ("concentration of the metal", ALUMINIUM["solid_concentration"], "mol/m3"),
        ("saturation concentration", ALUMINIUM["saturation_concentration"], "mol/m3"),
        ("diffusivity", ALUMINIUM["liquid_diffusivity"], "m2/s"),
        ("charge number", CHARGE_NUMBER, "1"),
        ("current density of the boundaries", CURRENT, "A/m2"),
        ("share of it in the grains", GRAIN_SHARE, "1"),
        ("size of the grains along the sheet", GRAIN_SIZE[0], "m"),
        ("size of the grains across it", GRAIN_SIZE[1], "m"),
        ("width of the boundaries", max(2e-6, 2 * spacing), "m"),
        ("lattice spacing", spacing, "m"),
        ("horizon", 2 * spacing, "m"),
    ]
    values = {n: Value(v, u, "", "no source gives one", "assumed") for n, v, u in table}
    step = TimeStepping(step=20.0 * spacing / 1e-6)
    return Prepared(values, functools.partial(march_section, scene, step))
