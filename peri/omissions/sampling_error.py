"""How far rate classes can be off, from what a scene knows itself: an error of V_L for any solid.

Two things stand between the classes of a cell and the surface: the parts in which the metal was
sampled, and the few classes that stand for all samples.  Clean liquid is one equation over either
(`reduced`), so that some of the cells, as all of the metal, are marched by their classes, by all
their samples, and by samples of parts half and twice as wide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from peri.corrosion.classes.volumes import constant_of
from peri.corrosion.scene import CorrosionScene
from peri.engine.surface.rate_classes import Rates
from peri.omissions.reduced import ReducedCorrosion, factor_of, refuse_other_laws

_FINER = 4.0 / 3.0
"""The error over the change to parts half as wide, of an error of second order; one that falls more
slowly, as a torus's, is more."""
_COARSER = 0.25
"""Share of the change to parts twice as wide that the error is at least: of an error of second
order a third is left, of one that falls faster, as at edges, less."""


def sampling_error(scene: CorrosionScene, times: ArrayLike) -> float:
    """Estimated error of V_L by sampling and classes, relative, the largest at `times` (s).

    Four thirds of the change of V_L in clean liquid between samples and samples of parts half as
    wide, or a quarter of that to parts twice as wide where that is more, plus the change between
    the classes and all samples.  It holds the metal's side only: neither time steps nor
    where a flux arrives in liquid that saturates.  tests/peri/omissions/test_sampling_error.py has
    it over the true error after 7, 28 and 56 days.

    Raises ValueError for a scene without rate classes or their samples, and as `reduced` does.
    """
    check = None if scene.exposure is None else scene.exposure.check
    if check is None:
        raise ValueError("exposure: the scene has none with samples; cell_exposure keeps them")
    refuse_other_laws(scene)
    excess = scene.solid_concentration / (
        scene.solid_concentration - scene.saturation_concentration
    )

    def loss(rates: Rates) -> np.ndarray:
        reduced = ReducedCorrosion(constant_of(scene) * rates.exposure, rates.volume, excess)
        return reduced.volume_loss(
            scene.bare_time(times), scene.base_interface_diffusivity(), factor_of(scene.kinetics)
        ).value

    samples = loss(check.samples)
    lost = samples > 0
    if not lost.any():
        return 0.0
    finer, coarser, classes = (
        float(np.abs(loss(by)[lost] / samples[lost] - 1).max())
        for by in (check.finer, check.coarser, check.classes)
    )
    return max(_FINER * finer, _COARSER * coarser) + classes
