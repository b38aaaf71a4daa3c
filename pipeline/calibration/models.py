"""What calibration fits: the volume loss of one alloy in a scene, as a function of its constants.

`reduced_model` answers in a millisecond with exact derivatives where the liquid stays clean;
`MarchModel` marches, with differences for derivatives, where it does not.  Both take the constants
by the names of the parameter sets.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import Omission
from peri.omissions.names import LIQUID
from peri.omissions.planning import corrode_lean, plan_omissions
from peri.omissions.reduced import ReducedCorrosion, factor_of
from pipeline.geometry.surface import Solid
from pipeline.record.machine import child_environment, processor_cores
from pipeline.scene.resolve import rate_law
from pipeline.scene.scene import CorrosionParameters, Scene, scene_from_json
from pipeline.stages.corrosion import (
    corrosion_scene,
    domain_lattice,
    exposure_of,
    liquid_domain,
    metal_of,
)
from pipeline.stages.geometry import build_solid

Array = NDArray[np.float64]

_STEP = 0.08
"""Of ln p, either side, for differences of marches: their error in time stays far below."""

_MARCH_CONTROL = 0.1
"""rate_change of the marches of a fit: 0.07 % of V_L (`perilife study corrosion`)."""


@dataclass(frozen=True)
class Searched:
    """A constant of a parameter set as a fit sees it: symbol, unit, and the range searched (SI).

    The ranges are those of Hermann 2024, 5.2.2, but for l, whose upper end 1/eps is 10 here: from
    there on the rate falls by less than a fifth until all metal is gone.
    """

    symbol: str
    unit: str
    dimension: str
    lower: float
    upper: float
    per_solid: bool = False

    def bounds(self, solid_concentration: float) -> tuple[float, float]:
        """The range; those of C_sat are shares of C_solid."""
        scale = solid_concentration if self.per_solid else 1.0
        return self.lower * scale, self.upper * scale


SEARCHED: dict[str, Searched] = {
    "interface_diffusivity": Searched("D_int", "m^2/s", "diffusivity", 2.2e-16, 4.2e-8),
    "liquid_diffusivity": Searched("D_liq", "m^2/s", "diffusivity", 2.2e-16, 4.2e-6),
    "saturation_concentration": Searched(
        "C_sat", "mol/m^3", "concentration", 0.99e-5, 0.33, per_solid=True
    ),
    "volume_loss_scale": Searched("l", "1", "dimensionless", 0.01, 10.0),
}

_SLOPE = {"interface_diffusivity": "diffusivity", "volume_loss_scale": "length"}
"""Constant of a parameter set -> the parameter of the reduced model that it is proportional to."""


def with_constants(scene: Scene, alloy: str, values: dict[str, float]) -> Scene:
    """The scene with other corrosion constants of one alloy (SI)."""
    alloys = tuple(
        replace(a, corrosion=replace(a.corrosion, **values)) if a.name == alloy else a
        for a in scene.alloys
    )
    return replace(scene, alloys=alloys)


def constants(scene: Scene, alloy: str) -> dict[str, float]:
    """The constants of one alloy that a fit may search, SI."""
    corrosion = scene.alloy(alloy).corrosion
    names = {f.name for f in fields(CorrosionParameters)}
    return {name: getattr(corrosion, name) for name in SEARCHED if name in names}


class Implant:
    """A solid on the lattice of a scene: what all constants of an alloy share.

    folder: where the surface's part of rate classes is kept between runs.
    """

    def __init__(self, scene: Scene, solid: Solid | None = None, folder: Path | None = None):
        self.solid, self.folder = solid or build_solid(scene), folder
        self.domain = liquid_domain(scene, self.solid.points)
        self.lattice, self.inside = domain_lattice(scene, self.domain)
        self.metal, self.fraction = metal_of(scene, self.lattice, self.solid)
        self.exposure = exposure_of(
            scene, self.lattice, self.domain, self.solid, self.fraction, folder
        )

    def corrosion(self, scene: Scene, alloy: str) -> CorrosionScene:
        """The peridynamic scene of one alloy, with rate classes where the scene has them."""
        return corrosion_scene(
            scene, alloy, self.lattice, self.inside, self.metal, self.fraction, self.exposure
        )


def liquid_omission(scene: Scene, alloy: str, implant: Implant, times: ArrayLike) -> Omission:
    """Whether the liquid may be left out for V_L at `times` (s), with the bound of doing so."""
    settings = scene.corrosion
    found = plan_omissions(
        implant.corrosion(scene, alloy), times, settings.tolerance, settings.keep
    )
    return next(omission for omission in found if omission.name == LIQUID)


class ReducedModel:
    """V_L of an alloy in clean liquid by its constants, with exact derivatives.

    scene, alloy: the constants that are not among `names` are theirs.  Constants that clean liquid
    does not know (D_liq, C_sat) have derivatives of zero.
    """

    def __init__(self, scene: Scene, alloy: str, implant: Implant, names: Sequence[str]):
        corrosion = implant.corrosion(scene, alloy)
        self.scene, self.alloy, self.names = scene, alloy, tuple(names)
        self.reduced = ReducedCorrosion.of(corrosion)
        set_value = scene.alloy(alloy).corrosion.interface_diffusivity
        self._bare_time = corrosion.bare_time
        self._per_set_value = corrosion.base_interface_diffusivity() / set_value

    def keeping(self, names: Sequence[str], held: dict[str, float]) -> ReducedModel:
        """The same implant with other free constants, the held ones at their values."""
        other = object.__new__(ReducedModel)
        other.__dict__ = dict(self.__dict__)
        other.names, other.scene = tuple(names), with_constants(self.scene, self.alloy, held)
        return other

    def acting(self) -> tuple[str, ...]:
        """Names of those among `names` that act on V_L in clean liquid."""
        law = rate_law(self.scene, self.alloy)
        acts = {"interface_diffusivity"}
        if self.scene.corrosion.kinetics == "volume_loss" and hasattr(law, "length"):
            acts.add("volume_loss_scale")
        return tuple(name for name in self.names if name in acts)

    def __call__(self, times: Array, logs: Array) -> tuple[Array, Array]:
        """V_L (nt,) and d V_L/d ln p (nt, np)."""
        values = dict(zip(self.names, map(float, np.exp(logs)), strict=True))
        scene = with_constants(self.scene, self.alloy, self._within(values))
        diffusivity = self._per_set_value * scene.alloy(self.alloy).corrosion.interface_diffusivity
        law = rate_law(scene, self.alloy)
        found = self.reduced.volume_loss(self._bare_time(times), diffusivity, factor_of(law))
        jacobian = np.zeros((len(times), len(self.names)))
        for name in self.acting():
            scale = diffusivity if name == "interface_diffusivity" else values[name]
            jacobian[:, self.names.index(name)] = found.slopes[_SLOPE[name]] * scale
        return found.value, jacobian

    def _within(self, values: dict[str, float]) -> dict[str, float]:
        return {k: v for k, v in values.items() if k in _SLOPE}


class MarchModel:
    """V_L of an alloy by marches; derivatives are central differences of marches side by side.

    executor: where the marches run (`marching_executor`).
    """

    def __init__(self, scene: Scene, alloy: str, names: Sequence[str], executor: Executor):
        self.scene, self.alloy, self.names = scene, alloy, tuple(names)
        self.executor = executor
        self.marches = 0

    def keeping(self, names: Sequence[str], held: dict[str, float]) -> MarchModel:
        """The same scene with other free constants, the held ones at their values."""
        scene = with_constants(self.scene, self.alloy, held)
        return MarchModel(scene, self.alloy, names, self.executor)

    def acting(self) -> tuple[str, ...]:
        """Every constant may act where the liquid counts."""
        free = self.scene.corrosion.kinetics == "volume_loss"
        return tuple(n for n in self.names if n != "volume_loss_scale" or free)

    def __call__(self, times: Array, logs: Array) -> tuple[Array, Array]:
        """V_L (nt,) and d V_L/d ln p (nt, np)."""
        moments = np.unique(times)
        steps = np.concatenate([np.zeros((1, len(logs))), *_pairs(len(logs))])
        jobs = []
        for step in steps:
            values = dict(zip(self.names, map(float, np.exp(logs + step)), strict=True))
            content = with_constants(self.scene, self.alloy, values).to_json()
            jobs.append(self.executor.submit(march, content, self.alloy, moments.tolist()))
        self.marches += len(jobs)
        losses = np.array([job.result() for job in jobs])
        at = np.searchsorted(moments, times)
        slopes = (losses[1::2] - losses[2::2]) / (2 * _STEP)
        return losses[0, at], slopes[:, at].T


def _pairs(count: int) -> list[Array]:
    return [np.array([step, -step]) for step in _STEP * np.eye(count)]


_IMPLANTS: dict[str, Implant] = {}
"""Of this worker process, by the hash of what they depend on: constants change, the solid not."""

_SURFACES: list[Path] = []
"""Of this worker process: the folder where the surface's part of an implant is kept."""


def march(content: dict, alloy: str, times: list[float]) -> list[float]:
    """V_L of a scene (its JSON) at times (s): the work of one process of a fit."""
    scene = scene_from_json(content)
    settings = scene.corrosion
    classes = (settings.classes, settings.kernel_exponent, settings.influence)
    key = repr((content["geometry"], content["lattice"], content["domain"], classes))
    if key not in _IMPLANTS:
        _IMPLANTS[key] = Implant(scene, folder=_SURFACES[-1] if _SURFACES else None)
    stepping = TimeStepping(settings.scheme, settings.step, _MARCH_CONTROL)
    positive = [time for time in times if time > 0]
    if not positive:
        return [0.0] * len(times)
    result, _ = corrode_lean(
        _IMPLANTS[key].corrosion(scene, alloy), positive, stepping,
        tolerance=settings.tolerance, refused=settings.keep,
    )  # fmt: skip
    return [0.0] * (len(times) - len(positive)) + [float(v) for v in result.volume_loss]


@contextmanager
def marching_executor(workers: int | None = None, surfaces: Path | None = None):
    """Processes that march side by side, one thread each.

    surfaces: folder of an implant, from which they read its surface's part.  `spawn`, because
    threads of Numba and OpenMP do not survive a fork.
    """
    workers = workers or processor_cores()
    wanted = child_environment(1, 1)
    kept = dict(os.environ)
    os.environ.update(wanted)
    try:
        with ProcessPoolExecutor(
            workers, get_context("spawn"), _SURFACES.append, (surfaces,)
        ) as executor:
            yield executor
    finally:
        os.environ.clear()
        os.environ.update(kept)
