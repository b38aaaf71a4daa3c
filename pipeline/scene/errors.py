"""The errors that were measured of a scene's settings, where it uses those of a preset."""

from dataclasses import dataclass

from pipeline.scene.mapping import mapping_of
from pipeline.scene.mechanics import EXPOSURES, PULLED_FACE_CELLS
from pipeline.scene.resolution import RESOLUTIONS, CorrosionError, Resolution, TensileError
from pipeline.scene.scene import HoldScene, Scene, ScrewGeometry


@dataclass(frozen=True)
class MeasuredHold:
    """The error of a way of holding, and the mesh sizes (m), element and increment it was of."""

    size: float
    size_fine: float
    size_ends: tuple[float | None, float | None]
    element: str
    increment: float
    error: TensileError


def _measured(
    hold: str,
    element: str,
    increment: float,
    parts: dict[str, tuple[float, float]],
    ends: float | None = None,
    options: str = "",
    settings: str = "",
) -> MeasuredHold:
    command = (
        f"perilife run --alloy {' '.join(parts)} --immersion 24w --hold {hold} "
        f"--mesh-size 0.2mm --mesh-size-fine 0.12mm{options}"
    )
    most = max(sum(both) for both in parts.values())
    error = TensileError(most, tuple(parts), "24w", None, command, parts, settings)
    return MeasuredHold(0.3e-3, 0.2e-3, (ends, ends), element, increment, error)


MEASURED: dict[str, MeasuredHold] = {
    "slot": _measured(
        "slot", "P2-Fbar", 0.02, {"Mg-5Gd": (0.02, 0.003), "Mg-10Gd": (0.01, 0.003)},
    ),
    "faces": _measured(
        "faces", "P1", 0.005, {"Mg-5Gd": (0.78, 0.003), "Mg-10Gd": (0.65, 0.003)},
        PULLED_FACE_CELLS, " --mesh-size-faces 33um",
        "cells of 33 µm at the faces in place of 50 µm",
    ),
}  # fmt: skip
"""Errors of ways of holding beside the shank, which the study of the presets has: by the mesh, and
by increments that leave a fifth of the lag (pipeline/MEASURED.md).  End faces have no limit, as
thinner cells carry less."""


def corrosion_error(scene: Scene) -> CorrosionError | None:
    """What was measured of the preset's lattice and time steps, if the scene uses just these.

    Only the reference screw was measured, with the rate classes of the preset and, apart, with one
    rate per node.
    """
    preset = RESOLUTIONS.get(scene.resolution)
    if preset is None or not (
        scene.geometry == ScrewGeometry()
        and _alike(scene.lattice, preset, spacing="spacing", horizon="horizon")
        and _alike(scene.corrosion, preset, rate_change="rate_change")
        and scene.corrosion.classes in (0, preset.classes)
        and _default(scene.corrosion, "scheme", "step", "saturation", "dissolution")
        and _default(scene.corrosion, "kinetics", "calibration", "influence", "coating")
    ):
        return None
    return preset.corrosion_error if scene.corrosion.classes else preset.node_error


def tensile_error(scene: Scene, hold: HoldScene) -> TensileError | None:
    """What was measured of the mesh and increment of a test, if the scene uses just these.

    Only the reference screw was measured, by the map by exposures: its shank with each preset,
    other ways of holding as MEASURED has them.
    """
    preset = RESOLUTIONS.get(scene.resolution)
    if preset is None or not (
        scene.geometry == ScrewGeometry()
        and _alike(scene.lattice, preset, horizon="horizon")
        and mapping_of(scene, hold.tensile) == EXPOSURES
        and _default(hold.tensile, "damage", "damage_length", "final_strain", "lateral", "load")
    ):
        return None
    if hold.name == "shank":
        known, error = preset, preset.tensile_error
        sizes = {"size": "mesh_size", "size_fine": "mesh_size_fine"}
    elif hold.name in MEASURED:
        known, error = MEASURED[hold.name], MEASURED[hold.name].error
        sizes = {"size": "size", "size_fine": "size_fine", "size_ends": "size_ends"}
    else:
        return None
    same = _alike(hold.mesh, known, **sizes) and _alike(
        hold.tensile, known, element="element", increment="increment"
    )
    return error if same else None


def strength_error(scene: Scene, hold: HoldScene) -> float | None:
    """Relative error of the strength left by mesh and increments, where it was measured."""
    known = tensile_error(scene, hold)
    measured = known is not None and all(alloy.name in known.alloys for alloy in scene.alloys)
    if not measured or scene.tensile.load != "axial":
        return None
    return max(known.of(alloy.name) for alloy in scene.alloys)


def _alike(settings: object, preset: Resolution | MeasuredHold, **names: str) -> bool:
    """Whether settings have the preset's values; names: field of the settings = of the preset."""
    return all(getattr(settings, ours) == getattr(preset, its) for ours, its in names.items())


def _default(settings: object, *names: str) -> bool:
    """Whether these fields of settings are as nobody changed them."""
    untouched = type(settings)()
    return all(getattr(settings, name) == getattr(untouched, name) for name in names)
