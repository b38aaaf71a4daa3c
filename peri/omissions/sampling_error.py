"""How far rate classes can be off, from what a scene knows itself: an error of V_L for any solid.

Two things stand between the classes of a cell and the surface: the parts in which the metal was
sampled, and the few classes that stand for all samples.  Clean liquid is one equation over either
(`reduced`), so that both are marched again by all samples, and by samples of parts twice as wide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from peri.corrosion.classes.volumes import constant_of
from peri.corrosion.scene import CorrosionScene
from peri.engine.surface.rate_classes import Rates
from peri.omissions.reduced import ReducedCorrosion, factor_of


def sampling_error(scene: CorrosionScene, times: ArrayLike) -> float:
    """Estimated error of V_L by sampling and classes, relative, the largest at `times` (s).

    The change of V_L in clean liquid between parts of the finest size and parts twice as wide,
    plus that between the classes and all samples.  It holds the metal's side only: neither time
    steps nor where a flux arrives in liquid that saturates.  Over the true error after 7, 28 and 56
    days (tests/peri/omissions/test_sampling_error.py) it is 1.4 and 1.1 of a ball at delta/2 and
    delta/3, and at delta/2 0.9 of a torus, 2.5 of a plate about one horizon thick, 2.7 of the
    screw, 8 of a cube and 5 of a plate of a fifth of a cell, which are sampled finer than it knows.

    Raises ValueError for a scene without rate classes or their samples, and as `reduced` does.
    """
    exposed = scene.exposure
    if exposed is None or exposed.sampled is None or exposed.coarser is None:
        raise ValueError("exposure: the scene has none with samples; cell_exposure keeps them")
    reduced = ReducedCorrosion.of(scene)

    def loss(of: ReducedCorrosion) -> np.ndarray:
        return of.volume_loss(
            scene.bare_time(times), scene.base_interface_diffusivity(), factor_of(scene.kinetics)
        ).value

    def by(rates: Rates) -> np.ndarray:
        sums = constant_of(scene) * rates.exposure
        return loss(ReducedCorrosion(sums, rates.volume, reduced.loss_per_dissolved))

    fine = by(exposed.sampled)
    lost = fine > 0
    if not lost.any():
        return 0.0
    apart = [np.abs(other[lost] / fine[lost] - 1) for other in (by(exposed.coarser), loss(reduced))]
    return float(sum(values.max() for values in apart))
