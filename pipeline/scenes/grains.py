"""The scene of intergranular corrosion: boundaries of grains that dissolve faster than these."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from peri.corrosion.metal.microstructure import BOUNDARY, polycrystal
from peri.corrosion.metal.solids import Solid
from peri.corrosion.scene import CorrosionScene
from peri.engine.constants import FARADAY
from pipeline.scenes.pits_2d import section

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
    width: float | None = None,
    current: float = CURRENT,
    charge: float = CHARGE_NUMBER,
    ratio: float = 2,
    size: tuple[float, float] = (120e-6, 80e-6),
    alloy: Mapping[str, float] = ALUMINIUM,
) -> CorrosionScene:
    """A section of rolled metal; boundaries two spacings (at least 2 um) wide, or of a `width`.

    grain_size : along the sheet and across it, m.  share : current of the grains over that of the
    boundaries.  ratio : horizon over spacing.  size : width and depth of the section, m.  alloy :
    as ALUMINIUM.
    """
    horizon = ratio * spacing
    lattice = section(*size, 2 * horizon, spacing)
    y = np.broadcast_to(lattice.coordinates()[1], lattice.shape)
    metal = np.ascontiguousarray(y < 0)
    structure = polycrystal(lattice, grain_size, width or max(2e-6, 2 * spacing), seed)
    phase = np.where(metal, 1 + (structure.phase == BOUNDARY), 0).astype(np.uint8)
    solid = alloy["solid_concentration"]
    return CorrosionScene(
        lattice,
        horizon,
        metal,
        dissolution_flux=current / (charge * FARADAY),
        dissolution="faradaic",
        solids=(Solid(solid, rate=share), Solid(solid)),
        phase=phase,
        **alloy,
    )
