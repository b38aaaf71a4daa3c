"""How large the cells of a mesh are to be, told to gmsh for the model that it has loaded (mm)."""

import math
from collections.abc import Sequence

import gmsh
import numpy as np


def set_sizes(
    size: float, size_fine: float, ends: Sequence[tuple[float, float]], edges: Sequence[int]
) -> None:
    """Edge lengths (mm) of the cells of the loaded model.

    size: in the bulk; size_fine: on the sharp `edges` (tags of curves), or on the whole surface
    where there are none; ends: z of an end and the edge length within two of these lengths of it.
    Each grows to `size` over a distance of 2 `size`, that of the surface as the mesher grows its
    cells inward; the smallest counts.
    """
    for name in ("FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
    # into the volume only: seams of patches are ragged and short
    inward = 0 if len(edges) else -3
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", inward)
    fields = []
    if size_fine < size:
        fields.append(
            _at_edges(edges, size, size_fine) if len(edges) else _on_surface(size, size_fine)
        )
    fields += [_at_level(level, end, size) for level, end in ends]
    if not fields:
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        return
    least = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(least, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(least)


def _at_edges(edges: Sequence[int], size: float, size_fine: float) -> int:
    """A field by the distance to curves of the model."""
    field = gmsh.model.mesh.field
    distance = field.add("Distance")
    longest = max((_curve_length(tag) for tag in edges), default=1.0)
    field.setNumbers(distance, "CurvesList", list(edges))
    field.setNumber(distance, "Sampling", max(20, min(2000, math.ceil(2 * longest / size_fine))))
    return _growing(distance, size_fine, size, 0.5 * size_fine)


def _on_surface(size: float, size_fine: float) -> int:
    """A field that is `size_fine` on the model's surface and `size` inside."""
    field = gmsh.model.mesh.field
    constant = field.add("Constant")
    field.setNumbers(constant, "SurfacesList", [tag for _, tag in gmsh.model.getEntities(2)])
    field.setNumber(constant, "VIn", size_fine)
    field.setNumber(constant, "VOut", size)
    return constant


def _at_level(level: float, size_end: float, size: float) -> int:
    """A field by the distance along z to an end at z = `level`."""
    distance = gmsh.model.mesh.field.add("MathEval")
    gmsh.model.mesh.field.setString(distance, "F", f"Abs(z - ({level:.12g}))")
    return _growing(distance, size_end, size, 2.0 * size_end)


def _growing(distance: int, least: float, most: float, near: float) -> int:
    """A field that grows from `least` at the distance `near` to `most` at 2 `most`."""
    field = gmsh.model.mesh.field
    grow = field.add("Threshold")
    field.setNumber(grow, "InField", distance)
    field.setNumber(grow, "SizeMin", least)
    field.setNumber(grow, "SizeMax", most)
    field.setNumber(grow, "DistMin", near)
    field.setNumber(grow, "DistMax", max(2 * most, 2 * near))
    return grow


def _curve_length(tag: int) -> float:
    low, high = gmsh.model.getParametrizationBounds(1, tag)
    points = gmsh.model.getValue(1, tag, np.linspace(low[0], high[0], 33)).reshape(-1, 3)
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
