"""The map stage: corrosion damage f0 on the mesh of the intact solid, per cell or point."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from fem.quadrature import find_element, sampling_points
from peri.corrosion.results import read_corrosion
from pipeline.geometry.mesh import read_mesh
from pipeline.geometry.surface import Solid
from pipeline.record.whole_file import whole_file
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
    Kernel,
    damage_by_dose,
    kernel_of,
    part_means,
    skin_exposure,
    skin_points,
)
from pipeline.stages.geometry import SURFACE_FILE, read_surface

_SLOPE = 4.0 * np.sqrt(5.0)
"""Of the four quadrature points: f_q = mean + _SLOPE (first moment of f with its coordinate q)."""
DAMAGE_FILE = "damage.h5"
SCHEMA_VERSION = 1
BLIND_METAL = "metal that saw no liquid at first has lost more than a thousandth of what is lost"
"""Why a march whose scene allows exposures left no doses (doses.doses)."""


@dataclass(frozen=True)
class Seen:
    """What maps by exposures: the solid, how its points see liquid, and the cells' doses.

    dose: (nx, ny, nz), NaN where there is none (pipeline.stages.doses).
    """

    solid: Solid
    kernel: Kernel
    dose: np.ndarray


@dataclass(frozen=True)
class Lost:
    """What a lattice has lost at one time.

    origin, spacing: (3,), m; concentration (mol/m^3), metal and capacity (cells of metal that a
    node stands for): (nx, ny, nz); solid_concentration: mol/m^3; seen: None maps by nodes.
    """

    origin: np.ndarray
    spacing: np.ndarray
    concentration: np.ndarray
    metal: np.ndarray
    capacity: np.ndarray
    solid_concentration: float
    seen: Seen | None = None


@dataclass(frozen=True)
class Mapped:
    """Damage of the mesh, not cut off: at points of each cell, with their volumes (nc, np), m^3.

    exponent: with what it was scaled; lost: the volumes lost before that (damage_map.conserved);
    at: (nc, np, 3) the points, m, of cells with the corners (nc, 4, 3).
    """

    damage: np.ndarray
    weights: np.ndarray
    exponent: float
    lost: dict[str, float]
    at: np.ndarray
    corners: np.ndarray

    def cut_off(self, maximum: float) -> np.ndarray:
        """f0 (nc, nq), at most `maximum`."""
        return np.minimum(self.damage, maximum)

    def cell_means(self, maximum: float) -> np.ndarray:
        """Means (nc, 1) of f0 over each cell."""
        return np.average(self.cut_off(maximum), 1, self.weights)[:, None]

    def at_points(self, maximum: float, count: int) -> np.ndarray:
        """f0 (nc, count) of each cell's quadrature points, one or four.

        Of four points: the linear field in the cell that has the mean and the first moments of f0,
        so that it carries what f0 does under a strain that is linear there; where that is below 0
        or above `maximum` at a point, it is cut off and the other points make up for the mean.
        """
        mean = self.cell_means(maximum)
        if count == 1:
            return mean
        middle = self.corners.mean(axis=1)
        share = self.cut_off(maximum) * self.weights / self.weights.sum(axis=1, keepdims=True)
        moment = np.einsum("cp,cpd->cd", share, self.at) - mean * middle
        # of the barycentric coordinates, along which the linear field rises
        edges = np.swapaxes(self.corners[:, 1:] - self.corners[:, :1], 1, 2)
        along = np.linalg.solve(edges, moment[..., None])[..., 0]
        along = np.concatenate([-along.sum(axis=1, keepdims=True), along], axis=1)
        found = np.clip(mean + _SLOPE * along, 0.0, maximum)
        now = found.mean(axis=1, keepdims=True)
        room = maximum - now
        down = np.divide(mean, now, out=np.ones_like(now), where=now > 0)
        up = np.divide(maximum - mean, room, out=np.ones_like(now), where=room > 0)
        return np.where(now > mean, found * down, maximum - (maximum - found) * up)


def map_lost(
    points: np.ndarray,
    cells: np.ndarray,
    lost: Lost,
    halvings: int = 1,
    folder: Path | None = None,
) -> Mapped:
    """The damage of a mesh that loses what the lattice has lost.

    points (n, 3) m, cells (nc, 4): of the intact solid.  halvings: how often the edges of a cell
    are halved for the points that means are taken of, at least once: the field varies within a
    cell, and its quadrature points alone miss up to a tenth of the loss (pipeline/MEASURED.md).
    folder: where what the points see is kept.
    """
    seen, place = lost.seen, (lost.origin, lost.spacing)
    field = (lost.concentration, lost.metal, lost.solid_concentration)
    if seen is None:
        at, weights = sampling_points(points, cells, halvings)
        found = conserving_map(at, weights, *place, *field, lost.capacity)
    else:
        at, weights = skin_points(points, cells, halvings)
        exposure = skin_exposure(points, cells, seen.solid, seen.kernel, folder, halvings)
        damage = damage_by_dose(at, exposure, *place, seen.dose)
        gone = lost_volume_on_lattice(*field, lost.capacity * np.prod(lost.spacing))
        found = conserved(damage, weights, gone)
    damage, exponent, volumes = found
    return Mapped(damage, weights, exponent, volumes, at, points[cells])


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
    points = points_of(hold.tensile.element, hold.tensile.damage)
    seen = None
    if mapping == EXPOSURES:
        surface = read_surface(geometry if (geometry / SURFACE_FILE).exists() else geometry.parent)
        with np.load(corrosion / DOSES_FILE) as stored:
            seen = Seen(surface, kernel_of(scene), stored["dose"][number])
    lattice = Lost(
        fields["lattice/origin"], fields["lattice/spacing"], fields["concentration"][number],
        fields["metal"], fields["capacity"], solid, seen,
    )  # fmt: skip
    mapped = map_lost(mesh.points, mesh.cells, lattice, folder=geometry)
    weights, damage = mapped.weights, mapped.cut_off(maximum)
    volume = float(weights.sum())
    numbers = {
        "mapping": mapping,
        "mapping_because": because,
        "mean_corrosion_damage": float((damage * weights).sum() / volume),
        "maximum_corrosion_damage": float(damage.max()),
        "volume_share_at_maximum": float(weights[damage >= maximum - 1e-12].sum() / volume),
        "net_section_left": _net_section_left(hold, mesh.points, fields, number, solid, maximum),
        **mapped.lost,
        "mapped_lost_volume": lost_volume_on_mesh(mapped.damage, weights),
    }
    parts = part_means(mapped.damage, weights) if mapping == EXPOSURES else None
    path, f0 = out / DAMAGE_FILE, mapped.at_points(maximum, points)
    write_damage(path, f0, moment, hold.tensile.element, mapped.exponent, mapping, parts)
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
    out.mkdir(parents=True, exist_ok=True)
    damage = np.zeros(
        (len(read_mesh(geometry).cells), points_of(hold.tensile.element, hold.tensile.damage))
    )
    write_damage(out / DAMAGE_FILE, damage, moment, hold.tensile.element, 0.0, NODES)


def points_of(element: str, damage: str) -> int:
    """How many f0 a cell has: one where f is one per cell, else one per quadrature point."""
    return 1 if damage == "cell" else find_element(element).points


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
    with whole_file(path) as temporary, h5py.File(temporary, "w") as file:
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


def read_damage(path: Path) -> np.ndarray:
    """f0 (nc, nq or 1) as `write_damage` stored it."""
    with h5py.File(path) as file:
        return file["f0"][:]
