"""The geometry stage: solid, surface for the lattice, tetrahedral mesh, and their checks."""

import logging
import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from pipeline.geometry.mesh import write_mesh
from pipeline.geometry.surface import Solid
from pipeline.geometry.voxel_mask import VoxelMask
from pipeline.record.run_folder import write_json, write_text
from pipeline.record.whole_file import whole_file
from pipeline.scene.image import ImageFile
from pipeline.scene.scene import Scene, ScrewGeometry

logger = logging.getLogger(__name__)

SURFACE_FILE = "surface.h5"
CAD_FILE = "solid.brep"
CHECKS_FILE = "geometry.json"
MESH_FILE = "mesh.h5"
MESH_PICTURE = "mesh.vtu"
SCHEMA_VERSION = 1
IMAGE_NUMBERS = ("metal_voxels", "removed_bodies", "removed_voxels", "cut_by_edge")
_NUMBERS = ("volume", "area", "reference_volume", "reference_area", "smallest_feature")


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Give Ctrl-C and SIGTERM back to Python: gmsh takes them and leaves the system's default."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in handlers.items():
                if handler is not None:
                    signal.signal(number, handler)


def build_solid(scene: Scene) -> Solid:
    """The solid of the scene; ValueError or FileNotFoundError with one sentence."""
    from pipeline.geometry import solids

    with _signals_kept():
        if isinstance(scene.geometry, ScrewGeometry):
            return solids.screw_solid(scene.geometry.parameters)
        if isinstance(scene.geometry, ImageFile):
            from pipeline.geometry.scans import solid_from_image

            return solid_from_image(scene.geometry)
        return solids.solid_from_file(scene.geometry.path, scene.geometry.unit)


def write_geometry(
    scene: Scene, folder: Path, solid: Solid | None = None
) -> tuple[list[Path], dict[str, object]]:
    """Write solid, surface, meshes and geometry.json; returns the files and the main numbers.

    The first way of holding has its mesh in the folder itself, one with another mesh in a folder of
    its name.
    """
    from pipeline.geometry import solids

    solid = solid if solid is not None else build_solid(scene)
    meshes = {}
    for name, sizes in scene.meshes().items():
        with _signals_kept():
            meshes[name] = solids.tetrahedral_mesh(
                solid, sizes.size, sizes.size_fine, sizes.size_ends
            )
        (folder / name).mkdir(exist_ok=True)
        write_mesh(meshes[name], folder / name)
    mesh = meshes[""]
    write_surface(folder, solid)
    if solid.cad:
        write_text(folder / CAD_FILE, solid.cad)
    numbers = {name: getattr(solid, name) for name in _NUMBERS}
    numbers |= {"bounding_box": solid.bounding_box, "mesh_volume": mesh.quality["volume"]}
    others = {name: other.quality for name, other in meshes.items() if name}
    checks = {"name": solid.name, **numbers, "mesh": mesh.quality, "other_meshes": others}
    if solid.image is not None:
        checks["image"] = solid.image
        numbers |= {name: solid.image[name] for name in IMAGE_NUMBERS}
    write_json(folder / CHECKS_FILE, checks)
    numbers |= {name: mesh.quality[name] for name in ("cells", "points", "min_shape")}
    names = [SURFACE_FILE, CHECKS_FILE, *[CAD_FILE] * bool(solid.cad)]
    files = [folder / name for name in names]
    files += [folder / name / file for name in meshes for file in (MESH_FILE, MESH_PICTURE)]
    return files, numbers


def write_surface(folder: Path, solid: Solid) -> None:
    """Store the surface of a solid with its measures as surface.h5 (points in m)."""
    with whole_file(folder / SURFACE_FILE) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs["name"] = solid.name
        for name in _NUMBERS:
            file.attrs[name] = getattr(solid, name)
        file.attrs["bounding_box"] = solid.bounding_box
        points = file.create_dataset("points", data=solid.points)
        points.attrs["unit"] = "m"
        file.create_dataset("triangles", data=solid.triangles)
        if solid.voxels is not None:
            bits = np.packbits(solid.voxels.metal.T)
            voxels = file.create_dataset("voxels", data=bits, compression="gzip")
            voxels.attrs["shape"] = solid.voxels.metal.shape
            voxels.attrs["corner"], voxels.attrs["size"] = solid.voxels.corner, solid.voxels.size
            voxels.attrs["description"] = "metal 1, else 0, eight voxels a byte, x fastest"


def read_surface(folder: Path) -> Solid:
    """The solid that `write_surface` stored, without its CAD model."""
    with h5py.File(folder / SURFACE_FILE) as file:
        lower, upper = file.attrs["bounding_box"]
        return Solid(
            name=str(file.attrs["name"]),
            **{name: float(file.attrs[name]) for name in _NUMBERS},
            bounding_box=(tuple(map(float, lower)), tuple(map(float, upper))),
            points=file["points"][:],
            triangles=file["triangles"][:],
            voxels=_read_voxels(file["voxels"]) if "voxels" in file else None,
        )


def _read_voxels(stored: h5py.Dataset) -> VoxelMask:
    shape = tuple(int(n) for n in stored.attrs["shape"])
    metal = np.unpackbits(stored[:], count=math.prod(shape)).view(bool).reshape(shape[::-1]).T
    corner, size = (tuple(map(float, stored.attrs[name])) for name in ("corner", "size"))
    return VoxelMask(metal, corner, size)
