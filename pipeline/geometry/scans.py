"""A solid from an image: which voxels are metal, what is left out, and the surface around them."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from pipeline.geometry.image_files import Image, read_image
from pipeline.geometry.surface import (
    Solid,
    check_surface,
    solid_of_surface,
    surface_volume_and_area,
)
from pipeline.geometry.voxel_mask import VoxelMask, voxel_fraction
from pipeline.scene.image import ImageFile

logger = logging.getLogger(__name__)

SURFACE_CELLS = 128
"""Along the longest side of the solid, in the grid whose level surface bounds it: more cells than
voxels tell nothing, and the mesher takes 5 s for 180,000 triangles of a threaded pin."""

MOST_REMOVED = 0.05
"""Largest share of the metal that may hang on nothing; more is no dirt but a second body."""

LEVELS = (0.3, 0.7)
"""Between which the surface's level must lie; near 1/2 where walls are many voxels thick."""


def solid_from_image(source: ImageFile) -> Solid:
    """The one solid that an image shows, with its voxels.

    Metal is what `metal_of_image` finds.  The surface is the level surface (flying edges) of the
    metal's share of boxes two voxels wide, at the level, about 1/2, at which it encloses the
    volume of the metal voxels to 1e-4; it is checked like that of an STL file.  ValueError with
    one sentence.
    """
    path = Path(source.path)
    mask, facts = metal_of_image(read_image(path, source.voxel), source, path.name)
    points, triangles, level = level_surface(mask, path.name)
    check_surface(points, triangles, path.name)
    solid = solid_of_surface(path.name, points, triangles)
    facts |= {"surface_level": level}
    return replace(solid, reference_volume=mask.volume, voxels=mask, image=facts)


def metal_of_image(image: Image, source: ImageFile, name: str) -> tuple[VoxelMask, dict]:
    """The metal of an image, cut to the box that holds it, and what a reader has to know of it.

    Metal is every voxel at or above the threshold, or with the label, that hangs together over
    faces with the largest such body; the rest is left out where it is little.  Metal at the edge
    of the image is refused unless the source says that the solid ends there.
    """
    values = image.values
    if source.label is not None:
        found, asked = values == source.label, f"label is {source.label}"
    else:
        found, asked = values >= source.threshold, f"threshold is {source.threshold:g}"
    if found.all() or not found.any():
        low, high = values.min(), values.max()
        raise ValueError(
            f"{asked}; {'every' if found.all() else 'no'} voxel of {name} is metal then, whose "
            f"values go from {low:g} to {high:g}"
        )
    label, bodies = ndimage.label(found.T)  # across faces; transposed, as it lies in memory
    counts = np.bincount(label.ravel())
    counts[0] = 0
    largest = int(counts.argmax())
    removed = int(counts.sum() - counts[largest])
    if removed > MOST_REMOVED * counts.sum():
        second = np.sort(counts)[-2] / counts[largest]
        raise ValueError(
            f"{name} has {bodies} bodies of metal, the second {second:.2g} of the first; it must "
            f"have one, beside which at most {MOST_REMOVED:.0%} of the metal hang on nothing"
        )
    if removed:
        logger.warning(
            "%s: metal that hangs on nothing is left out, bodies %d, voxels %d",
            name, bodies - 1, removed,
        )  # fmt: skip
    box = ndimage.find_objects(label, largest)[largest - 1][::-1]
    metal = label.T[box] == largest
    del label
    faces = [
        (f"{sign}{axis}", int(np.count_nonzero(np.take(metal, place, a))))
        for a, axis in enumerate("xyz")
        for sign, place, at_edge in (
            ("-", 0, box[a].start == 0),
            ("+", -1, box[a].stop == values.shape[a]),
        )
        if at_edge
    ]
    if faces and not source.cap:
        sides = ", ".join(f"{side} ({count:,} voxels)" for side, count in faces)
        raise ValueError(
            f"{name} is cut by the image's edge at {sides}, where a face would corrode that the "
            "solid may not have; the image must go beyond the metal, or say --cap where the "
            "solid ends there"
        )
    corner = [image.origin[a] + image.voxel[a] * (box[a].start - 0.5) for a in range(3)]
    facts = {
        "voxels": list(values.shape),
        "voxel_size": list(image.voxel),
        "metal_voxels": int(np.count_nonzero(metal)),
        "removed_bodies": bodies - 1,
        "removed_voxels": removed,
        "cut_by_edge": [side for side, _ in faces],
    }
    return VoxelMask(metal, tuple(map(float, corner)), image.voxel), facts


def level_surface(mask: VoxelMask, name: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Points (n, 3) in m, outward triangles (nt, 3), and the level of the share of metal."""
    import pyvista

    size = np.array(mask.size)
    extent = size * mask.metal.shape
    step = np.maximum(size, extent.max() / SURFACE_CELLS)
    width = np.maximum(2 * size, step)
    shape = np.ceil((extent + width) / step).astype(int) + 2
    origin = mask.corner + extent / 2 - step * (shape - 1) / 2
    share = voxel_fraction(mask, origin, step, shape, width)
    grid = pyvista.ImageData(dimensions=shape, spacing=step, origin=origin)
    grid.point_data["share"] = share.ravel(order="F")

    def surface(level: float) -> tuple[np.ndarray, np.ndarray, float]:
        found = grid.contour([level], "share", method="flying_edges", compute_normals=False)
        points, triangles = found.points.astype(float), found.faces.reshape(-1, 4)[:, :0:-1]
        volume = surface_volume_and_area(points, triangles)[0] if len(points) else 0.0
        return points, triangles if volume >= 0 else triangles[:, ::-1], abs(volume)

    low, high = LEVELS
    wanted = mask.volume
    if not surface(high)[2] < wanted < surface(low)[2]:
        raise ValueError(
            f"{name} has parts about as thin as a voxel, so that no surface encloses the volume "
            "of its metal; its voxels must be smaller"
        )
    while True:
        level = (low + high) / 2
        points, triangles, volume = surface(level)
        if abs(volume - wanted) <= 1e-4 * wanted or high - low < 1e-6:
            return points, triangles, level
        low, high = (level, high) if volume > wanted else (low, level)
