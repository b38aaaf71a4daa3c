"""The errors that were measured of a scene's settings, where it uses those of a preset."""

from pipeline.scene.resolution import RESOLUTIONS, CorrosionError, Resolution, TensileError
from pipeline.scene.scene import HoldScene, Scene, ScrewGeometry


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
    """What was measured of the preset's mesh and increment, if the test uses just these.

    Only the shank of the reference screw was measured.
    """
    preset = RESOLUTIONS.get(scene.resolution)
    if preset is None or not (
        hold.name == "shank"
        and scene.geometry == ScrewGeometry()
        and _alike(scene.lattice, preset, horizon="horizon")
        and _alike(hold.mesh, preset, size="mesh_size", size_fine="mesh_size_fine")
        and _alike(hold.tensile, preset, element="element", increment="increment")
        and _default(hold.tensile, "damage", "damage_length", "final_strain", "lateral", "load")
    ):
        return None
    return preset.tensile_error


def strength_error(scene: Scene, hold: HoldScene) -> float | None:
    """Relative error of the strength left by mesh and increments, where it was measured."""
    known = tensile_error(scene, hold)
    measured = known is not None and all(alloy.name in known.alloys for alloy in scene.alloys)
    return known.error if measured and scene.tensile.load == "axial" else None


def _alike(settings: object, preset: Resolution, **names: str) -> bool:
    """Whether settings have the preset's values; names: field of the settings = of the preset."""
    return all(getattr(settings, ours) == getattr(preset, its) for ours, its in names.items())


def _default(settings: object, *names: str) -> bool:
    """Whether these fields of settings are as nobody changed them."""
    untouched = type(settings)()
    return all(getattr(settings, name) == getattr(untouched, name) for name in names)
