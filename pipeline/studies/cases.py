"""The reference screw on lattices of a study: scenes, their surfaces, one march of one of them.

What a lattice has of the solid (metal, surface) is the same for all alloys and made once; with a
folder it is kept there, and so is what every march found, so that an interrupted study goes on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import box_lattice
from peri.engine.march.marching import TimeStepping
from peri.omissions.sampling_error import sampling_error
from peri.omissions.well_stirred import well_stirred
from pipeline.geometry.surface import Solid
from pipeline.record.run_folder import write_json
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import Scene
from pipeline.stages.corrosion import (
    corrosion_scene,
    domain_lattice,
    exposure_of,
    in_domain,
    liquid_domain,
    metal_of,
)
from pipeline.stages.geometry import build_solid
from pipeline.studies.reference import continuum_volume_loss

DAY = 86400.0
HOUR = 3600.0
TIMES = (7 * DAY, 28 * DAY, 56 * DAY)
ALONE = (*TIMES, 168 * DAY)
"""Where marches end that stop nowhere before: steps are longest there."""
CLASSES = 3
"""Rate classes of the study, those that `--classes auto` takes."""

EXACT = "exact in time"
"""Clean liquid by the scalar equation, as a run solves it."""


@dataclass(frozen=True)
class March:
    """What one march found; seconds are of the processor.

    volume_loss: at the times of the march; own: what the scene finds of its error itself, None by
    nodes; setup: of metal and surface, once for a lattice; march: of the march.
    """

    volume_loss: tuple[float, ...]
    own: float | None
    nodes: int
    steps: int
    setup: float
    march: float


@dataclass(frozen=True)
class Place:
    """Which lattice: horizon over spacing, classes (0: one rate per node), and where it lies.

    position: 0 as a run lays it, others at random.
    """

    ratio: int
    classes: int = CLASSES
    position: int = 0

    def shift(self) -> NDArray[np.float64] | None:
        """By which part of a spacing the lattice is moved along each axis; None at position 0."""
        if not self.position:
            return None
        return np.random.default_rng((self.ratio, self.position)).random(3)


class Cases:
    """Corrosion scenes of one alloy on lattices of one solid.

    keep: a folder in which surfaces and the results of marches stay; those of another code must
    be deleted by whoever changes it.
    """

    def __init__(self, alloy: str, solid: Solid | None = None, keep: Path | None = None) -> None:
        self.alloy = alloy
        self.base = resolve_scene([alloy], ["0w", "8w"], "quick")
        self.horizon = self.base.lattice.horizon
        self.solid = solid or build_solid(self.base)
        self.keep = keep

    def settings(self, ratio: int, classes: int = 0, horizon: float | None = None) -> Scene:
        """The scene with spacing = horizon / ratio."""
        horizon = horizon or self.horizon
        lattice = replace(self.base.lattice, spacing=horizon / ratio, horizon=horizon)
        corrosion = replace(self.base.corrosion, classes=classes)
        return replace(self.base, lattice=lattice, corrosion=corrosion)

    def scene(
        self, ratio: int, horizon: float | None = None, place: Place | None = None
    ) -> CorrosionScene:
        """The peridynamic scene; one rate per node as a run lays it, unless a place is given."""
        place = place or Place(ratio, 0)
        scene = self.settings(ratio, place.classes, horizon)
        region = liquid_domain(scene, self.solid.points)
        shift = place.shift()
        if shift is None:
            lattice, domain = domain_lattice(scene, region)
        else:
            spacing = scene.lattice.spacing
            start = np.asarray(region.lower) - (1.0 - shift) * spacing
            lattice = box_lattice(start, np.asarray(region.upper) + spacing, spacing)
            domain = in_domain(lattice, region)
        metal, fraction = metal_of(scene, lattice, self.solid)
        exposed = exposure_of(scene, lattice, region, self.solid, fraction, self.keep)
        return corrosion_scene(scene, self.alloy, lattice, domain, metal, fraction, exposed)

    def exact(self) -> NDArray[np.float64]:
        """V_L at TIMES in clean liquid without a lattice."""
        scene = self.scene(2)

        def work() -> dict[str, object]:
            found = continuum_volume_loss(
                self.solid, self.horizon, scene.dissolution_flux, scene.solid_concentration,
                scene.saturation_concentration, scene.kinetics, TIMES, voxels=24,
            )  # fmt: skip
            return {"volume_loss": found.tolist()}

        return np.array(self._kept(f"{self.alloy} reference", work)["volume_loss"])

    def march(
        self, place: Place, how: TimeStepping | str, times: tuple[float, ...] = TIMES
    ) -> March:
        """March at a place: with these steps the liquid is computed, EXACT leaves it out."""
        # The surface belongs to the lattice, whatever the alloy: its seconds are kept by lattice.
        lattice = f"{place.ratio}-{place.classes}-{place.position}"
        name = how if isinstance(how, str) else f"{how.scheme}-{how.step}-{how.rate_change}"
        if times != TIMES:
            name += " to " + "-".join(f"{time / DAY:g}" for time in times)

        def work() -> dict[str, object]:
            begun = time.process_time()
            scene = self.scene(place.ratio, place=place)
            setup = {"seconds": time.process_time() - begun}
            setup = self._kept(f"set-up {lattice}", lambda: setup)
            begun = time.process_time()
            result = _solved(scene, how, times)
            seconds = time.process_time() - begun
            return asdict(
                March(
                    tuple(map(float, result.volume_loss)),
                    sampling_error(scene, TIMES) if place.classes else None,
                    int(scene.domain.sum()), len(result.history["time"]) - 1,
                    float(setup["seconds"]), seconds,
                )
            )  # fmt: skip

        found = self._kept(f"{self.alloy} {lattice} {name}", work)
        return March(**{**found, "volume_loss": tuple(found["volume_loss"])})

    def _kept(self, name: str, work: Callable[[], dict]) -> dict:
        """What `work` gives, from the folder where it was done before."""
        if self.keep is None:
            return work()
        path = self.keep / f"{name.replace(' ', '_')}.json"
        if not path.exists():
            write_json(path, work())
        return json.loads(path.read_text(encoding="utf-8"))


def _solved(
    scene: CorrosionScene, how: TimeStepping | str, times: tuple[float, ...]
) -> CorrosionResult:
    if how == EXACT:
        return well_stirred(scene, times)
    assert isinstance(how, TimeStepping)
    return corrode(scene, times, how)


def screw_scene(alloy: str, ratio: int, saturation: str) -> CorrosionScene:
    """The scene of an alloy's published set, one rate per node, spacing = horizon / ratio."""
    return replace(Cases(alloy).scene(ratio), saturation=saturation)
