"""The map stage: corrosion damage f0 on the mesh of the intact solid, per cell or point."""

import os
from pathlib import Path

import h5py
import numpy as np

from fem.quadrature import find_element, quadrature_points, sampling_points
from peri.corrosion.results import read_corrosion
from pipeline.geometry.mesh import read_mesh
from pipeline.scene.mapping import by_nodes_because
from pipeline.scene.mechanics import EXPOSURES, NODES
from pipeline.scene.scene import HoldScene, Scene
from pipeline.scene.units import ImmersionTime
from pipeline.stages.corrosion import CORROSION_FILE
from pipeline.stages.damage_map import (
    conserved,
    conserving_map,
    lost_volume_on_lattice,
    lost_volume_on_mesh,
    net_section,
)
from pipeline.stages.doses import (
    DOSES_FILE,
    damage_by_dose,
    exposure_at,
    kernel_of,
    part_means,
    skin_exposure,
    skin_points,
)
from pipeline.stages.geometry import SURFACE_FILE, read_surface

DAMAGE_FILE = "damage.h5"
SCHEMA_VERSION = 1
BLIND_METAL = "metal that saw no liquid at first has lost more than a thousandth of what is lost"
"""Why a march whose scene allows exposures left no doses (doses.doses)."""


def map_in_folder(
    scene: Scene,
    alloy: str,
    moment: ImmersionTime,
    hold: HoldScene,
    geometry: Path,
    corrosion: Path,
    out: Path,
) -> tuple[list[Path], dict[str, object]]:
    """Map the field of one immersion time and write damage.h5; returns the files and numbers.

    geometry: folder with the mesh of this way of holding.  The numbers hold the mean of f0 over
    the mesh, the volumes lost on the lattice, on the mesh as found, and on the mesh as mapped (the
    lattice's, both before f0 is cut off at 1/q1), what is left of the smallest net section between
    the grips, and which map it was (nodes or exposures) and why, where it was nodes.
    """
    mesh = read_mesh(geometry)
    fields = read_corrosion(corrosion / CORROSION_FILE)
    number = int(np.flatnonzero(fields["times"] == moment.seconds)[0])
    maximum = 1.0 / scene.alloy(alloy).material.q1
    solid = float(fields["solid_concentration"])
    mapping, because = _chosen(scene, moment, hold, corrosion)
    one_per_cell = hold.tensile.damage == "cell"
    if not one_per_cell:
        points, weights = quadrature_points(mesh.points, mesh.cells, hold.tensile.element)
    elif mapping == EXPOSURES:
        points, weights = skin_points(mesh.points, mesh.cells)
    else:  # the field varies within a cell; one point in it misses a tenth of the loss
        points, weights = sampling_points(mesh.points, mesh.cells)
    place = (fields["lattice/origin"], fields["lattice/spacing"])
    lost_by = (fields["concentration"][number], fields["metal"], solid)
    if mapping == EXPOSURES:
        surface = read_surface(geometry if (geometry / SURFACE_FILE).exists() else geometry.parent)
        kernel = kernel_of(scene)
        seen = (
            skin_exposure(mesh.points, mesh.cells, surface, kernel, geometry)
            if one_per_cell
            else exposure_at(points, surface, kernel, geometry)
        )
        with np.load(corrosion / DOSES_FILE) as stored:
            damage = damage_by_dose(points, seen, *place, stored["dose"][number])
        held = fields["capacity"] * place[1].prod()
        whole, exponent, lost = conserved(damage, weights, lost_volume_on_lattice(*lost_by, held))
    else:
        whole, exponent, lost = conserving_map(
            points, weights, *place, *lost_by, fields["capacity"]
        )
    damage, volume = np.minimum(whole, maximum), float(weights.sum())
    numbers = {
        "mapping": mapping,
        "mapping_because": because,
        "mean_corrosion_damage": float((damage * weights).sum() / volume),
        "maximum_corrosion_damage": float(damage.max()),
        "volume_share_at_maximum": float(weights[damage >= maximum - 1e-12].sum() / volume),
        "net_section_left": _net_section_left(hold, mesh.points, fields, number, solid, maximum),
        **lost,
        "mapped_lost_volume": lost_volume_on_mesh(whole, weights),
    }
    parts = None
    if one_per_cell:
        damage = ((damage * weights).sum(axis=1) / weights.sum(axis=1))[:, None]
        parts = part_means(whole, weights) if mapping == EXPOSURES else None
    path = out / DAMAGE_FILE
    write_damage(path, damage, moment, hold.tensile.element, exponent, mapping, parts)
    return [path], numbers


def _chosen(
    scene: Scene, moment: ImmersionTime, hold: HoldScene, corrosion: Path
) -> tuple[str, str]:
    """The map of a test, and why it is nodes; ValueError where the one asked for cannot be had."""
    if moment.seconds == 0:
        return NODES, "nothing has corroded"
    because = by_nodes_because(scene, hold.tensile)
    if because or (corrosion / DOSES_FILE).exists():
        return (NODES if because else EXPOSURES), because
    if hold.tensile.mapping == EXPOSURES:
        raise ValueError(f"mapping is exposures; it must be nodes or auto where {BLIND_METAL}")
    return NODES, BLIND_METAL


def map_intact(moment: ImmersionTime, hold: HoldScene, geometry: Path, out: Path) -> None:
    """Write the damage.h5 of a solid of which nothing has corroded: zeros (nc, nq or 1).

    geometry: folder with the mesh of this way of holding.  It is what `map_in_folder` writes of
    time zero, which needs no march (tests/end_to_end/test_coarse_run.py).
    """
    one_per_cell = hold.tensile.damage == "cell"
    count = 1 if one_per_cell else find_element(hold.tensile.element).points
    out.mkdir(parents=True, exist_ok=True)
    damage = np.zeros((len(read_mesh(geometry).cells), count))
    write_damage(out / DAMAGE_FILE, damage, moment, hold.tensile.element, 0.0, NODES)


def _net_section_left(
    hold: HoldScene, points: np.ndarray, fields: dict, number: int, solid: float, maximum: float
) -> float | None:
    """Smallest net section between the grips over that of the intact solid; None without a layer.

    fields: of the corrosion stage; number: of the immersion time in them.
    """
    spacing, metal = fields["lattice/spacing"], fields["metal"]
    height = fields["lattice/origin"][2] + spacing[2] * np.arange(metal.shape[2])
    low = points[:, 2].min() + hold.tensile.bottom_grip
    high = points[:, 2].max() - hold.tensile.top_grip
    between = (low <= height) & (height <= high)
    if not between.any():
        return None
    now, intact = (
        net_section(c, metal, fields["capacity"], spacing, solid, maximum)[between].min()
        for c in (fields["concentration"][number], np.where(metal, solid, 0.0))
    )
    return float(now / intact) if intact > 0.0 else None


def write_damage(
    path: Path,
    damage: np.ndarray,
    moment: ImmersionTime,
    element: str,
    exponent: float,
    mapping: str,
    parts: np.ndarray | None = None,
) -> None:
    """Store f0 (nc, nq or 1), in the order of the mesh's cells, in one step.

    mapping, exponent: the map, and with what it was scaled (damage_map.scaled_damage), by which the
    report maps nodes to other points; parts (nc, 8): damage of the eighths of cells, not cut off.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with h5py.File(temporary, "w") as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs["element"] = element
        file.attrs["immersion"] = moment.label
        file.attrs["immersion_seconds"] = moment.seconds
        file.attrs["mapping"] = mapping
        file.attrs["exponent"] = exponent
        data = file.create_dataset("f0", data=damage, compression="lzf")
        data.attrs["unit"] = "1"
        data.attrs["dimensions"] = "cell, quadrature point"
        if parts is not None:
            data = file.create_dataset("parts", data=parts.astype(np.float32), compression="lzf")
            data.attrs["unit"] = "1"
            data.attrs["dimensions"] = "cell, part of it (geometry.mesh.refine_tetrahedra)"
    os.replace(temporary, path)


def read_damage(path: Path) -> np.ndarray:
    """f0 (nc, nq or 1) as `write_damage` stored it."""
    with h5py.File(path) as file:
        return file["f0"][:]
