"""Whether lattice, mesh and grips suit the solid, and the lattice spacing that does."""

import dataclasses
import math

import numpy as np

from pipeline.geometry.surface import Solid
from pipeline.scene.checks import SceneError, at_most
from pipeline.scene.scene import Scene, ScrewGeometry
from pipeline.scene.units import format_length

SHORTEST, LONGEST = 0.1e-3, 1.0
"""m; a solid whose longest side is outside has been read in another unit than it was drawn in."""
UNIT_BY = {"file": "--unit", "image": "--voxel"}
"""Kind of a geometry -> the option that says how long its numbers are."""
CELLS_PER_FEATURE = 2
"""Lattice cells that the smallest feature of a solid must span."""


def check_sizes(scene: Scene, solid: Solid) -> None:
    """Refuse a lattice too coarse for the solid's smallest feature, and grips that leave no test.

    Between the grips there must be two edges of the mesh at least.  A solid that is far too large
    or small is refused by its size, before that shows in memory or grips.
    """
    longest = float(np.ptp(solid.points, axis=0).max())
    if not SHORTEST <= longest <= LONGEST:
        option = UNIT_BY.get(scene.geometry.kind)
        hint = f" ({option} says how long its numbers are)" if option else ""
        raise SceneError(
            f"{solid.name} is {format_length(longest)} long; it must be "
            f"{format_length(SHORTEST)} to {format_length(LONGEST)}{hint}"
        )
    length = float(np.ptp(solid.points[:, 2]))
    for hold in scene.holds:
        grips = (hold.tensile.bottom_grip, hold.tensile.top_grip)
        if not at_most(sum(grips) + 2.0 * hold.mesh.size, length):
            raise SceneError(
                f"the grips hold {format_length(grips[0])} and {format_length(grips[1])} "
                f"(--bottom-grip, --top-grip); together it must be at most "
                f"{format_length(max(length - 2.0 * hold.mesh.size, 0.0))}, the length of the "
                f"{solid.name} less two edges of the mesh"
            )
    _check_spacing(scene, solid.smallest_feature, solid.name)


def check_screw(scene: Scene) -> None:
    """Refuse a lattice too coarse for the screw before it is built; a solid file passes."""
    if isinstance(scene.geometry, ScrewGeometry):
        _check_spacing(scene, scene.geometry.parameters.smallest_feature, "screw")


def _check_spacing(scene: Scene, feature: float, name: str) -> None:
    limit = feature / CELLS_PER_FEATURE
    if not at_most(scene.lattice.spacing, limit):
        raise SceneError(
            f"lattice spacing is {format_length(scene.lattice.spacing)}; it must be at most "
            f"{format_length(limit)}, half of the smallest feature of the {name} "
            f"({_way_out(scene, limit)})"
        )


def with_fitting_spacing(scene: Scene) -> tuple[Scene, Solid | None]:
    """The scene with the coarsest spacing that does, at most its own; and the solid if built.

    It does where the smallest feature of the solid spans two cells (--spacing auto).  SceneError
    where the scene's horizon is too long for such a spacing.
    """
    if isinstance(scene.geometry, ScrewGeometry):
        solid, feature = None, scene.geometry.parameters.smallest_feature
    else:
        from pipeline.stages.geometry import build_solid

        solid = build_solid(scene)
        feature = solid.smallest_feature
    limit = feature / CELLS_PER_FEATURE
    if at_most(scene.lattice.spacing, limit):
        return scene, solid
    spacing = fitting_spacing(limit)
    if scene.lattice.horizon > 8.0 * spacing:
        raise SceneError(
            f"the smallest feature of the solid is {format_length(feature)} and asks for a lattice "
            f"spacing of {format_length(spacing)}; the horizon, "
            f"{format_length(scene.lattice.horizon)}, must be at most 8 of them (--horizon "
            f"{typed(fitting_spacing(8.0 * spacing))})"
        )
    lattice = dataclasses.replace(scene.lattice, spacing=spacing)
    return dataclasses.replace(scene, lattice=lattice), solid


def fitting_spacing(limit: float) -> float:
    """A length (m) at most `limit`, of three digits, so that a person can type it."""
    digits = 2 - math.floor(math.log10(limit * 1e6))
    micrometres = math.floor(limit * 1e6 * 10**digits * (1.0 + 1e-12)) / 10**digits
    return float(f"{micrometres:g}e-6")


def typed(length: float) -> str:
    """A length (m) as the command line takes it: 83.3um."""
    return f"{length * 1e6:.6g}um"


def _way_out(scene: Scene, limit: float) -> str:
    spacing = fitting_spacing(limit)
    if scene.lattice.horizon > 8.0 * spacing:
        return f"--spacing {typed(spacing)} --horizon {typed(fitting_spacing(8.0 * spacing))}"
    return f"--spacing {typed(spacing)}, or --spacing auto"
