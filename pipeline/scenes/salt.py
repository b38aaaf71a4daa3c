"""The film of salt at the bottom of a pit: thickness, and what it takes of the potential."""

from __future__ import annotations

import numpy as np

from peri.corrosion.metal.salt_film import SaltFilm, carried_share
from peri.corrosion.run import CorrosionResult
from peri.engine.constants import FARADAY
from peri.engine.results import Field, axes_of


def bare_current(result: CorrosionResult, film: SaltFilm) -> float:
    """i_0 of metal without a film, A/m^2."""
    return film.charge_number * FARADAY * (result.scene.dissolution_flux or 0.0)


def film_currents(result: CorrosionResult, film: SaltFilm) -> np.ndarray:
    """Current density near every liquid node at each output, A/m^2: the bare one without a film."""
    share = np.ones(result.concentration.shape)
    if result.theta is not None:
        stencil = result.scene.interface_stencil
        for n, (theta, metal) in enumerate(zip(result.theta, result.metal, strict=True)):
            share[n] = carried_share(theta, metal, stencil)
    return bare_current(result, film) * share


def film_fields(result: CorrosionResult, film: SaltFilm) -> dict[str, Field]:
    """Thickness of the film and its drop in the liquid that sees metal, 0 where there is none."""
    currents, bare = film_currents(result, film), bare_current(result, film)
    over = ("time", *axes_of(result.scene.lattice))
    return {
        "salt_film": Field(film.thickness(currents, bare), "m", over),
        "salt_drop": Field(film.drop(currents, bare), "V", over),
    }


def film_summary(result: CorrosionResult, film: SaltFilm) -> dict[str, tuple[float, str]]:
    """The film of the last output where it takes most of the potential."""
    lowest, bare = film_currents(result, film)[-1].min(), bare_current(result, film)
    if not lowest < bare:
        return {}
    return {
        "thickness of the salt film at the end, largest": (film.thickness(lowest, bare), "m"),
        "potential over it, largest": (film.drop(lowest, bare), "V"),
        "it follows its current within": (film.settling(lowest, bare), "s"),
    }
