"""The corrosion stage: from the solid to concentration fields at the immersion times.

`corrosion_scene` joins solid, lattice and constants; `corrode_alloy` marches once for all times
of one alloy and writes checkpoint, fields, history.csv and the ParaView series.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from peri.corrosion.coating import Coating
from peri.corrosion.results import write_corrosion, write_history, write_image_series
from peri.corrosion.run import CorrosionResult, corrode, file_under_coating
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice, ball, box_lattice, cylinder
from peri.engine.march.checkpoints import CheckpointError
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import Omission
from peri.engine.surface.rate_classes import CellExposure
from peri.omissions.planning import corrode_lean, plan_omissions
from peri.omissions.sampling_error import sampling_error
from pipeline.geometry.cell_shares import cell_shares
from pipeline.geometry.surface import Solid
from pipeline.geometry.voxels import metal_fraction
from pipeline.record.whole_file import write_arrays
from pipeline.scene.resolve import rate_law
from pipeline.scene.scene import CorrosionParameters, Scene
from pipeline.stages import ions as ion_stage
from pipeline.stages.by_nodes import by_nodes
from pipeline.stages.doses import DOSES_FILE, doses
from pipeline.stages.exposure import share_of_ball, share_of_cylinder, solid_exposure
from pipeline.stages.geometry import read_surface

logger = logging.getLogger(__name__)

CORROSION_FILE = "corrosion.h5"
CHECKPOINT_FILE = "checkpoint.h5"
HISTORY_FILE = "history.csv"
SERIES_FILE = "corrosion.pvd"

SURFACES = "PERILIFE_SURFACES"
"""Variable of the environment: a folder where the surfaces of all runs are kept, by hash."""


@dataclass(frozen=True)
class LiquidDomain:
    """The region around a solid that is computed: a cylinder along z or a ball (m)."""

    shape: str
    centre: tuple[float, float, float]
    radius: float
    height: float

    @property
    def lower(self) -> tuple[float, float, float]:
        """Lower corner of the box that holds the region."""
        x, y, z = self.centre
        return (x - self.radius, y - self.radius, z - self.height / 2)

    def shrunk(self, margin: float) -> LiquidDomain:
        """The region without its outermost layer of that thickness (m)."""
        radius, height = self.radius - margin, self.height - 2 * margin
        return replace(self, radius=max(radius, 0.0), height=max(height, 0.0))

    def share(self, lattice: Lattice) -> NDArray[np.float64]:
        """Share of each cell of a lattice that lies in the region."""
        if self.shape == "ball":
            return share_of_ball(lattice, self.centre, self.radius)
        return share_of_cylinder(lattice, self.centre, self.radius, self.height)

    @property
    def upper(self) -> tuple[float, float, float]:
        """Upper corner of the box that holds the region."""
        x, y, z = self.centre
        return (x + self.radius, y + self.radius, z + self.height / 2)


def liquid_domain(scene: Scene, surface_points: NDArray[np.float64]) -> LiquidDomain:
    """The region that keeps the scene's margins around the solid with these surface points.

    surface_points: (n, 3), m.  The centre is that of the solid's bounding box.
    """
    lower, upper = surface_points.min(axis=0), surface_points.max(axis=0)
    centre = 0.5 * (lower + upper)
    offset = surface_points - centre
    if scene.domain.shape == "ball":
        radius = float(np.linalg.norm(offset, axis=1).max()) + scene.domain.radial_margin
        height = 2 * radius
    else:
        radius = float(np.hypot(offset[:, 0], offset[:, 1]).max()) + scene.domain.radial_margin
        height = float(upper[2] - lower[2]) + 2 * scene.domain.axial_margin
    return LiquidDomain(scene.domain.shape, tuple(map(float, centre)), radius, height)


def domain_lattice(scene: Scene, domain: LiquidDomain) -> tuple[Lattice, NDArray[np.bool_]]:
    """The lattice that covers the region, and which of its nodes lie in it."""
    lattice = box_lattice(domain.lower, domain.upper, scene.lattice.spacing)
    return lattice, in_domain(lattice, domain)


def in_domain(lattice: Lattice, domain: LiquidDomain) -> NDArray[np.bool_]:
    """Which nodes of a lattice lie in the region."""
    if domain.shape == "ball":
        return ball(lattice, domain.centre, domain.radius)
    return cylinder(lattice, domain.centre, domain.radius, domain.height)


def dissolution_flux(parameters: CorrosionParameters, kernel_exponent: float) -> float:
    """Flux at zero volume loss that the published D_int stands for, mol/(m^2 s).

    D_int C_solid S with the front strength S (mean over orientations) of the stencil on which
    D_int was calibrated; stated as a flux it does not change with the lattice.
    """
    spacing = parameters.calibration_spacing
    stencil = diffusion_stencil(
        Lattice((0.0, 0.0, 0.0), (spacing,) * 3, (1, 1, 1)),
        parameters.calibration_horizon,
        kernel_exponent,
        calibration=parameters.calibration,
    )
    strength = stencil.mean_strength()
    return parameters.interface_diffusivity * parameters.solid_concentration * strength


def corrosion_scene(
    scene: Scene,
    alloy: str,
    lattice: Lattice,
    domain: NDArray[np.bool_],
    metal: NDArray[np.bool_],
    metal_fraction: NDArray[np.float64],
    exposure: CellExposure | None = None,
) -> CorrosionScene:
    """The peridynamic scene of one alloy on a lattice whose nodes are known to be metal or not.

    exposure: rate classes of the cells (`exposure_of`); all cells with metal are then metal.
    """
    parameters, settings = scene.alloy(alloy).corrosion.at_rest(), scene.corrosion
    if not metal.any():
        raise ValueError(
            f"lattice spacing is {scene.lattice.spacing:g} m; no node lies in the solid, so it "
            "must be smaller"
        )
    if exposure is not None:
        metal = metal_fraction > 0
    return CorrosionScene(
        lattice=lattice,
        horizon=scene.lattice.horizon,
        metal=metal,
        domain=domain | metal if exposure is None else exposure.inside > 0,
        metal_fraction=metal_fraction,
        boundary=scene.domain.boundary,
        solid_concentration=parameters.solid_concentration,
        saturation_concentration=parameters.saturation_concentration,
        liquid_diffusivity=parameters.liquid_diffusivity,
        dissolution_flux=dissolution_flux(parameters, settings.kernel_exponent),
        kinetics=rate_law(scene, alloy),
        kernel_exponent=settings.kernel_exponent,
        influence=settings.influence,
        calibration=settings.calibration,
        saturation=settings.saturation,
        dissolution=settings.dissolution,
        exposure=exposure,
        coating=None
        if settings.coating is None
        else Coating(settings.coating.factor, settings.coating.lifetime),
    )


def exposure_of(
    scene: Scene,
    lattice: Lattice,
    region: LiquidDomain,
    solid: Solid,
    fraction: NDArray[np.float64],
    folder: Path | None = None,
) -> CellExposure | None:
    """The rate classes that the scene asks for, with the domain's shares; None for one per node.

    folder: where the surface's part of it is kept between runs, unless SURFACES names another.
    """
    settings, horizon = scene.corrosion, scene.lattice.horizon
    if not settings.classes:
        return None
    folder = Path(os.environ[SURFACES]) if os.environ.get(SURFACES) else folder
    found = solid_exposure(
        solid, lattice, horizon, fraction, settings.classes, settings.kernel_exponent,
        settings.influence, folder,
    )  # fmt: skip
    inside = region.share(lattice)
    if scene.domain.boundary == "no_flux":
        return replace(found, inside=np.maximum(inside, fraction), held=np.zeros(lattice.shape))
    held = inside - region.shrunk(horizon).share(lattice)
    return replace(found, inside=np.maximum(inside, fraction), held=np.maximum(held, 0.0))


def degradation_rate(
    volume_loss: ArrayLike, seconds: ArrayLike, solid: Solid
) -> NDArray[np.float64]:
    """V_L V_0 / (A_0 t) of Hermann 2024, Eq. 5.34, in mm/year (of 365.25 days); NaN at time 0.

    V_0 and A_0 are those of the solid itself: a staircase of cells has more surface.
    """
    times = np.asarray(seconds, float)
    years = np.where(times > 0, times, np.nan) / (365.25 * 86400.0)
    return 1e3 * np.asarray(volume_loss, float) * solid.volume / (solid.area * years)


def metal_of(
    scene: Scene, lattice: Lattice, solid: Solid
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which nodes lie in the solid, and the metal share of each cell: exact for rate classes."""
    place = (lattice.origin, lattice.spacing, lattice.shape)
    if scene.corrosion.classes:
        share = cell_shares(solid.points, solid.triangles, *place)
        return metal_fraction(solid, *place, samples=1)[0], share
    return metal_fraction(solid, *place, samples=scene.lattice.samples)


def march_omissions(scene: Scene, solid: Solid) -> list[tuple[str, Omission]]:
    """What the march of each alloy would leave out or needs, with its bound: (alloy, omission).

    The bounds are those of one rate per node: a surface would cost more than it changes in them.
    """
    scene = replace(scene, corrosion=replace(scene.corrosion, classes=0))
    region = liquid_domain(scene, solid.points)
    lattice, domain = domain_lattice(scene, region)
    metal, fraction = metal_of(scene, lattice, solid)
    times = [time.seconds for time in scene.immersion]
    found = []
    for alloy in scene.alloys:
        corrosion = corrosion_scene(scene, alloy.name, lattice, domain, metal, fraction)
        tolerance, keep = scene.corrosion.tolerance, scene.corrosion.keep
        omissions = plan_omissions(corrosion, times, tolerance, keep)
        if scene.ions is not None:
            omissions = ion_stage.plan_ions(corrosion, scene.ions, omissions)
        found += [(alloy.name, omission) for omission in omissions]
    return found


def _sampling_error(corrosion: CorrosionScene, times: list[float]) -> float | None:
    """Error of V_L by the run's own sampling of the surface, where that can be told.

    None without rate classes, and under Faraday's law, whose march clean liquid does not reduce.
    """
    later = [time for time in times if time > 0]
    if corrosion.exposure is None or not later or not corrosion.dissolution.reduces:
        return None
    return sampling_error(corrosion, later)


def corrode_in_folder(
    scene: Scene,
    alloy: str,
    geometry: Path,
    out: Path,
    advanced: Callable[[float, str], None] | None = None,
    checkpoint_every: float = 30.0,
    march_by: Callable[..., CorrosionResult] = corrode,
    with_ions_by: Callable[..., tuple] = ion_stage.corrode_with_ions,
) -> tuple[list[Path], dict[str, object]]:
    """March one alloy through all immersion times of the scene (time zero included).

    Writes corrosion.h5, history.csv and the ParaView series to `out` and goes on from a
    checkpoint that an interrupted march of the same scene left there.  Returns the files and the
    numbers worth keeping: V_L per immersion time (nt,), the worst balance error, sizes.  march_by:
    what marches where no ions are followed (peri.omissions.planning.corrode_lean); with_ions_by:
    what does where they are.
    """
    solid = read_surface(geometry)
    region = liquid_domain(scene, solid.points)
    lattice, domain = domain_lattice(scene, region)
    metal, fraction = metal_of(scene, lattice, solid)
    exposure = exposure_of(scene, lattice, region, solid, fraction, geometry)
    corrosion = corrosion_scene(scene, alloy, lattice, domain, metal, fraction, exposure)
    checkpoint = out / CHECKPOINT_FILE
    times = [time.seconds for time in scene.with_intact()]

    stepping = TimeStepping(
        scheme=scene.corrosion.scheme,
        step=scene.corrosion.step,
        rate_change=scene.corrosion.rate_change,
    )

    def march(resume: bool) -> tuple:
        how = {
            "tolerance": scene.corrosion.tolerance,
            "refused": scene.corrosion.keep,
            "progress": advanced,
            "checkpoint": checkpoint,
            "resume": resume,
            "checkpoint_every": checkpoint_every,
        }
        if scene.ions is not None:
            return with_ions_by(corrosion, scene.ions, times, stepping, **how)
        return corrode_lean(corrosion, times, stepping, march_by=march_by, **how)

    try:
        under = file_under_coating(checkpoint)
        result, omissions, *with_ions = march(checkpoint.exists() or under.exists())
    except CheckpointError as error:
        logger.warning("%s; the march starts anew", error)
        checkpoint.unlink(missing_ok=True)
        result, omissions, *with_ions = march(False)
    (out / DOSES_FILE).unlink(missing_ok=True)
    if exposure is not None:
        dose = doses(result.scene, result.concentration)
        if dose is not None:
            write_arrays(out / DOSES_FILE, {"dose": dose}, compressed=True)
        result = by_nodes(result, metal)
    write_corrosion(out / CORROSION_FILE, result)
    history = dict(result.history)
    history["degradation_rate"] = degradation_rate(history["volume_loss"], history["time"], solid)
    write_history(out / HISTORY_FILE, history, {"degradation_rate": "mm_per_year"})
    write_image_series(out, result)
    for file in (checkpoint, file_under_coating(checkpoint)):
        file.unlink(missing_ok=True)
    balance = np.abs(np.asarray(result.history["balance_error"]))
    numbers = {
        "volume_loss": [float(value) for value in result.volume_loss],
        "degradation_rate": [
            None if time == 0 else float(degradation_rate(loss, time, solid))
            for loss, time in zip(result.volume_loss, times, strict=True)
        ],
        "balance_error": float(balance.max(initial=0.0)),
        "steps": int(balance.size),
        "nodes": int(corrosion.domain.sum()),
        "metal_nodes": int(corrosion.metal.sum()),
        "bonds_per_node": corrosion.stencil.bonds,
        **_rates(scene, alloy, corrosion),
        "sampling_error": _sampling_error(corrosion, times),
        "omissions": [
            {**asdict(o), "bound": o.bound if math.isfinite(o.bound) else None} for o in omissions
        ],
    }
    files = [out / name for name in (CORROSION_FILE, HISTORY_FILE, SERIES_FILE)]
    files += [out / DOSES_FILE] * (out / DOSES_FILE).exists()
    if scene.ions is not None:
        outputs, problem = with_ions
        more, numbers["ions"] = ion_stage.write(
            out, result, outputs, problem, scene.ions, solid.area
        )
        files += more
    return files, numbers


def _rates(scene: Scene, alloy: str, corrosion: CorrosionScene) -> dict[str, float]:
    """What the constants of an alloy became on this lattice; nothing where they are not known."""
    if not scene.alloy(alloy).corrosion.known:
        return {}
    return {
        "dissolution_flux": corrosion.dissolution_flux,
        "interface_diffusivity": corrosion.base_interface_diffusivity(),
    }
