"""From names to numbers: builds the resolved scene out of presets, data files and options."""

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import perilife_data
from fem.constitutive.hardening import fit_voce
from perilife_data import OwnCorrosion
from pipeline.scene import holding
from pipeline.scene.classes import AUTO, with_classes
from pipeline.scene.laws.ions import IonSettings
from pipeline.scene.laws.rate_law import OF_THE_SET, read_kinetics
from pipeline.scene.mechanics import PULLED_FACE_CELLS
from pipeline.scene.resolution import Resolution, resolution
from pipeline.scene.scene import (
    AlloyScene,
    CorrosionParameters,
    CorrosionSettings,
    DomainSettings,
    Geometry,
    HoldScene,
    LatticeSettings,
    MaterialParameters,
    MeshSettings,
    Scene,
    SceneError,
    ScrewGeometry,
    SolidFile,
    TensileScene,
)
from pipeline.scene.solid_size import check_triangles
from pipeline.scene.units import METRES_PER, parse_immersion_times

DEFAULT_PARAMETER_SET = "table-5.1"
OWN_PARAMETERS = "the alloy's own"
"""What stands for the name of a set where the constants are those of the alloys' own files."""

NO_PARAMETERS = "none"

PULLED_FACE_INCREMENT = 0.005
"""Largest nominal strain increment where an end face is pulled, unless it is given."""

SOLID_SUFFIXES = (".step", ".stp", ".brep", ".stl")


def resolve_scene(
    alloys: list[str],
    immersion: list[str],
    resolution_name: str = "quick",
    *,
    parameter_set: str | None = None,
    geometry: Geometry | None = None,
    spacing: float | None = None,
    horizon: float | None = None,
    mesh_size: float | None = None,
    mesh_size_fine: float | None = None,
    mesh_size_faces: float | None = None,
    domain: DomainSettings | None = None,
    corrosion: dict[str, object] | None = None,
    hold: Sequence[str] = (),
    tensile: dict[str, object] | None = None,
    measured_volume_loss: dict[str, str] | None = None,
    ions: IonSettings | None = None,
) -> Scene:
    """Build the scene of a run.

    alloys: names of shipped alloys or paths of TOML files; immersion: times as typed (`8w`);
    parameter_set: name of a shipped set or path of a TOML file; None takes the constants in an
    alloy's own file, else those of DEFAULT_PARAMETER_SET, if it has any; lengths in m where the
    preset is not to be used; hold: ways of holding (pipeline.scene.holding), the shank where
    none is given; corrosion, tensile: fields of CorrosionSettings and TensileScene that differ
    from their defaults, the latter for all ways of holding (rate classes are "auto" unless given,
    scene.classes); measured_volume_loss: CSV file per alloy, plotted beside the result; ions: the
    medium (pipeline.scene.laws.ions) where the model is nnpp.

    Raises ValueError or FileNotFoundError with one sentence for whatever cannot be computed.
    """
    preset = resolution(resolution_name)
    times = parse_immersion_times(immersion)
    fits = [fit_of(perilife_data.load_alloy(name), parameter_set) for name in alloys]
    scenes = tuple(_alloy_scene(name, fit) for name, fit in zip(alloys, fits, strict=True))
    known = [fit for fit in fits if fit is not None]
    corrosion = dict(corrosion or {})
    exponents = {float(fit.parameters.kernel_exponent) for fit in known}
    classes = corrosion.pop("classes", AUTO)
    corrosion["classes"] = 0 if classes == AUTO else classes
    corrosion.setdefault("rate_change", preset.rate_change)
    corrosion.setdefault("kernel_exponent", exponents.pop() if len(exponents) == 1 else 0.0)
    geometry = geometry or ScrewGeometry()
    horizon = preset.horizon if horizon is None else horizon
    size = preset.mesh_size if mesh_size is None else mesh_size
    fine = preset.mesh_size_fine if mesh_size_fine is None else mesh_size_fine
    if mesh_size_fine is None and mesh_size is not None:
        fine = min(fine, size)
    lattice = LatticeSettings(preset.spacing if spacing is None else spacing, horizon)
    scene = Scene(
        resolution=resolution_name,
        parameter_set=_name_of_set(parameter_set, known),
        geometry=geometry,
        immersion=times,
        alloys=scenes,
        lattice=lattice,
        domain=domain or DomainSettings(boundary=_boundary(known)),
        corrosion=CorrosionSettings(**corrosion),
        holds=_holds(
            hold,
            geometry,
            lattice,
            preset,
            MeshSettings(size, fine),
            mesh_size_faces,
            dict(tensile or {}),
        ),  # fmt: skip
        measured_volume_loss=_by_alloy(measured_volume_loss or {}, scenes),
        ions=ions,
    )
    return with_classes(scene) if classes == AUTO else scene


def _by_alloy(measured: Mapping[str, str], alloys: Sequence[AlloyScene]) -> dict[str, str]:
    """Files of measurements by the name of their alloy, which may be given by its file, too."""
    names = {alloy.source: alloy.name for alloy in alloys} | {a.name: a.name for a in alloys}
    for name in measured:
        if name not in names:
            known = " or ".join(alloy.name for alloy in alloys)
            raise SceneError(f"volume loss is of '{name}'; it must be of {known}")
    return {names[name]: path for name, path in measured.items()}


def _holds(
    names: Sequence[str],
    geometry: Geometry,
    lattice: LatticeSettings,
    preset: Resolution,
    mesh: MeshSettings,
    faces_size: float | None,
    tensile: dict[str, object],
) -> tuple[HoldScene, ...]:
    """The ways of holding: those named, or the one with the depths that `tensile` gives.

    Where an end face is pulled the cells there are `faces_size` wide, or PULLED_FACE_CELLS, half a
    lattice spacing or a quarter of those at thread and slot, whichever is most: wider ones average
    the outermost layer, which has corroded, with the sound metal behind it.  Four-node cells and
    small increments are then the default, since such a layer gives way early.
    """
    given = {"bottom_grip", "top_grip"} & set(tensile)
    if given and names:
        option = min(given).replace("_", "-")
        raise SceneError(
            f"hold is {' '.join(names)}; it must be left out where --{option} is given"
        )
    deep = holding.crust_depth(geometry, lattice.horizon)
    if given:
        depths = (float(tensile.get("bottom_grip", deep)), float(tensile.get("top_grip", deep)))
        holding.check_ends(depths, geometry)
        ways = {holding.named(depths, geometry, lattice.horizon): depths}
    else:
        asked = holding.asked_for(list(names) or ["shank"], geometry, lattice.horizon)
        if len(set(asked)) < len(asked):
            raise SceneError(f"hold is {' '.join(asked)}; it must be without repetition")
        ways = {name: holding.grip_depths(name, geometry, lattice.horizon) for name in asked}
    load = tensile.get("load", "axial")
    if faces_size is not None:  # refused out of its range where no end face is pulled, too
        dataclasses.replace(mesh, size_bottom=faces_size)
    holds = []
    for name, (bottom, top) in ways.items():
        faces = 0.0 in (bottom, top) and load == "axial"
        defaults = {
            "element": "P1" if faces else preset.element,
            "increment": min(preset.increment, PULLED_FACE_INCREMENT)
            if faces
            else preset.increment,
            "lateral": "free" if load == "axial" else "clamped",
            "bending_azimuth": 0.0 if load == "bending" else None,
            "damage": "cell" if tensile.get("damage_length") else "point",
        }
        depths = {"bottom_grip": bottom, "top_grip": top}
        layer = faces_size
        if layer is None:
            layer = max(PULLED_FACE_CELLS, lattice.spacing / 2, mesh.size_fine / 4)
            layer = layer if layer < mesh.size else None
        ends = [layer if depth == 0.0 else None for depth in (bottom, top)]
        holds.append(
            HoldScene(
                name,
                dataclasses.replace(mesh, size_bottom=ends[0], size_top=ends[1]),
                TensileScene(**{**defaults, **tensile, **depths}),
            )
        )
    return tuple(holds)


def solid_file(path: str | Path, unit: str) -> SolidFile:
    """Describe a solid from a file; refuses a missing file, another format, a wrong unit."""
    path = Path(path)
    if unit not in METRES_PER:
        raise ValueError(f"unit is '{unit}'; it must be one of {', '.join(METRES_PER)}")
    if path.suffix.lower() not in SOLID_SUFFIXES:
        raise ValueError(f"solid is '{path}'; the file must end in {', '.join(SOLID_SUFFIXES)}")
    if not path.is_file():
        raise FileNotFoundError(f"solid is '{path}'; there is no such file")
    if path.suffix.lower() == ".stl":
        check_triangles(path)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return SolidFile(str(path.resolve()), unit, digest)


def fit_of(alloy: perilife_data.Alloy, parameter_set: str | None) -> OwnCorrosion | None:
    """Constants of an alloy with the scene they belong to; None where nobody has fitted any.

    A set that is named goes before the alloy's own file.  Raises ValueError where it lacks the
    alloy.
    """
    if parameter_set is None and alloy.corrosion is not None:
        return alloy.corrosion
    fitted = perilife_data.load_parameter_set(parameter_set or DEFAULT_PARAMETER_SET)
    if parameter_set is None and alloy.name not in fitted.alloys:
        return None
    return OwnCorrosion(fitted.medium, fitted.scene, fitted.for_alloy(alloy.name))


def _name_of_set(parameter_set: str | None, known: Sequence[OwnCorrosion]) -> str:
    """What the scene says of where its constants are from."""
    if parameter_set is not None:
        return parameter_set
    if not known:
        return NO_PARAMETERS
    default = perilife_data.load_parameter_set(DEFAULT_PARAMETER_SET)
    shared = any(fit.scene == default.scene for fit in known)
    return DEFAULT_PARAMETER_SET if shared else OWN_PARAMETERS


def _boundary(known: Sequence[OwnCorrosion]) -> str:
    """The boundary that the constants were fitted with; SceneError where they disagree."""
    boundaries = sorted({fit.scene.boundary for fit in known})
    if len(boundaries) > 1:
        raise SceneError(
            f"boundary is {' and '.join(boundaries)} in the fits of these alloys; it must be given "
            "with --boundary, or the alloys run one by one"
        )
    return boundaries[0] if boundaries else DomainSettings().boundary


def corrosion_parameters(
    alloy: perilife_data.Alloy, fit: OwnCorrosion | None
) -> CorrosionParameters:
    """Constants of a fit as a scene has them, SI; of an alloy without one C_solid alone."""
    if fit is None:
        return CorrosionParameters(float(alloy.solid_concentration), None, None, None, None)
    fitted, scene = fit.parameters, fit.scene
    return CorrosionParameters(
        solid_concentration=float(fitted.solid_concentration),
        saturation_concentration=float(fitted.saturation_concentration),
        liquid_diffusivity=float(fitted.liquid_diffusivity),
        interface_diffusivity=float(fitted.interface_diffusivity),
        volume_loss_scale=float(fitted.volume_loss_scale),
        calibration_spacing=float(scene.spacing),
        calibration_horizon=float(scene.spacing) * float(scene.horizon_ratio),
        calibration=scene.calibration,
    )


def _alloy_scene(name: str, fit: OwnCorrosion | None) -> AlloyScene:
    """The constants of one alloy: corrosion from its fit, mechanics from its file.

    The hardening curve is Voce's, fitted through yield stress, ultimate strength and uniform
    strain.
    """
    alloy = perilife_data.load_alloy(name)
    hardening = fit_voce(
        float(alloy.yield_stress),
        float(alloy.ultimate_tensile_strength),
        float(alloy.uniform_strain),
    )
    return AlloyScene(
        name=alloy.name,
        source=str(name),
        corrosion=corrosion_parameters(alloy, fit),
        material=MaterialParameters(
            young_modulus=float(alloy.young_modulus),
            poisson_ratio=float(alloy.poisson_ratio),
            initial_yield_stress=hardening.s0,
            hardening_capacity=hardening.Q,
            hardening_rate=hardening.b,
            q1=float(alloy.q1),
        ),
    )


def rate_law(scene: Scene, alloy: str) -> object:
    """The kinetics of an alloy; l of the volume-loss law is the parameter set's unless given.

    C_sat of a law is the alloy's: ValueError for another one.
    """
    from peri.corrosion.rate_laws import KINETICS

    name, numbers = read_kinetics(scene.corrosion.kinetics)
    constants = scene.alloy(alloy).corrosion.at_rest()
    of_the_set = {
        "length": constants.volume_loss_scale,
        "saturation_concentration": constants.saturation_concentration,
    }
    for law, number in sorted(OF_THE_SET):
        if law == name:
            numbers.setdefault(number, of_the_set[number])
    given, alloys = numbers.get("saturation_concentration"), of_the_set["saturation_concentration"]
    if given is not None and not math.isclose(given, alloys, rel_tol=1e-6):
        raise ValueError(
            f"kinetics is '{scene.corrosion.kinetics}'; its saturation_concentration must be left "
            f"out or be that of {alloy}, {alloys:g} mol/m^3"
        )
    try:
        return KINETICS[name](**numbers)
    except ValueError as error:
        raise ValueError(f"kinetics is '{scene.corrosion.kinetics}'; its {error}") from None
