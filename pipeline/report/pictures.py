"""Pictures of the corroded solid, rendered off screen with VTK.

`screw_picture` renders one state of a tetrahedral mesh with a corrosion damage per node.  A crash
of a graphics library must not take a finished computation with it, so the report renders through
`render_pictures`, which does the same in a child process and says in one sentence what failed.
`write_overview` combines pictures and the strength curve in one PNG.

`python -m pipeline.report.pictures JOB.npz` is that child process.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.record import children
from pipeline.record.whole_file import whole_file, write_arrays

if TYPE_CHECKING:
    import pyvista

    from pipeline.record.run_results import RunResults

logger = logging.getLogger(__name__)

#: Corrosion damage at which the metal carries nothing, 1/q1 with q1 = 1.5.
MAXIMUM_DAMAGE = 2.0 / 3.0
#: What is given per cell is averaged at the nodes and so reaches the maximum only in the middle of
#: what is gone; it counts as gone from this share of the maximum on.
GONE = 0.97
#: Colours of corrosion damage from none to the maximum: sound metal light grey, then yellow to
#: brown with falling lightness, readable without colour vision.
DAMAGE_COLOURS = ("#d5dae1", "#f0dca0", "#eeb04e", "#d97a1e", "#a8480c", "#6e2a08")
#: Pixels of a picture, which the page shows smaller until it is enlarged.
SIZE = (420, 616)
Cut = Literal["whole", "half", "quarter"]
SHELL_COLOUR = "#8593a6"


def damage_at_points(
    points: NDArray[np.float64], cells: NDArray[np.int64], cell_damage: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Volume-weighted average of a damage per cell at the mesh points.

    Parameters
    ----------
    points : (n, 3) coordinates, m.
    cells : (nc, 4) four-node tetrahedra.
    cell_damage : (nc,) or (nc, nq) corrosion damage f0 per cell or quadrature point, [0, 2/3].

    Returns
    -------
    (n,) corrosion damage, within the range of the cells around; 0 at points that no cell uses.
    """
    damage = np.asarray(cell_damage, dtype=float).reshape(len(cells), -1).mean(axis=1)
    corner = points[cells]
    edges = corner[:, 1:] - corner[:, :1]
    volume = np.abs(np.linalg.det(edges)) / 6.0
    weight = np.bincount(cells.ravel(), np.repeat(volume, 4), minlength=len(points))
    total = np.bincount(cells.ravel(), np.repeat(volume * damage, 4), minlength=len(points))
    return np.divide(total, weight, out=np.zeros(len(points)), where=weight > 0.0)


def screw_picture(
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    corrosion_damage: NDArray[np.float64],
    *,
    cut: Cut = "whole",
    size: tuple[int, int] = SIZE,
    maximum_damage: float = MAXIMUM_DAMAGE,
    outline: bool = True,
    azimuth: float = 35.0,
    elevation: float = 22.0,
) -> NDArray[np.uint8]:
    """Render the metal that is left, coloured by corrosion damage, on a transparent background.

    Metal at `maximum_damage` carries nothing and is not drawn; with `outline` the intact solid
    stands around what is left as a faint shell.  All pictures of a mesh have one camera and scale.

    Parameters
    ----------
    points : (n, 3) coordinates of the original solid, m; the long axis is z.
    cells : (nc, 4) four-node tetrahedra.
    corrosion_damage : (n,) at the points, best not cut off at the maximum, so that the surface at
        the maximum is smooth; or (nc,) or (nc, nq) in the cells.
    cut : what is taken away to show the inside: nothing ("whole"), the half that faces the viewer
        ("half") or the quarter that does ("quarter").
    size : width and height of the picture, pixels.
    azimuth, elevation : direction of view, degrees.

    Returns
    -------
    (height, width, 4) RGBA, uint8.
    """
    import pyvista
    from matplotlib.colors import LinearSegmentedColormap
    from PIL import Image

    points = np.asarray(points, dtype=float)
    damage = np.asarray(corrosion_damage, dtype=float)
    if damage.shape != (len(points),):
        damage = damage_at_points(points, cells, damage) / GONE
    low, high = points.min(axis=0), points.max(axis=0)
    centre, scale = 0.5 * (low + high), 1.0 / (high - low).max()
    cell_types = np.full(len(cells), pyvista.CellType.TETRA)
    padded = np.column_stack([np.full(len(cells), 4), cells]).ravel()
    intact = pyvista.UnstructuredGrid(padded, cell_types, (points - centre) * scale)
    intact.point_data["corrosion_damage"] = damage

    turn, rise = np.radians(azimuth), np.radians(elevation)
    facing = np.array([np.cos(turn), np.sin(turn), 0.0])
    left = intact
    if damage.max() >= maximum_damage:
        left = intact.clip_scalar(scalars="corrosion_damage", value=maximum_damage, invert=True)
    left = _cut(left, cut, turn)

    oversampling = 2
    plotter = pyvista.Plotter(
        off_screen=True, window_size=[oversampling * s for s in size], lighting="none"
    )
    plotter.disable_anti_aliasing()  # beside oversampling: twice the time
    # Translucent parts blend with the background colour even where that is transparent.
    plotter.set_background(SHELL_COLOUR)
    try:
        _add_lights(plotter, pyvista, turn)
        if left.n_cells:
            surface = left.extract_surface(algorithm="dataset_surface").triangulate()
            surface = surface.compute_normals(
                split_vertices=True, feature_angle=35.0, cell_normals=False
            )
            plotter.add_mesh(
                surface,
                scalars="corrosion_damage",
                clim=(0.0, maximum_damage),
                cmap=LinearSegmentedColormap.from_list("corrosion", DAMAGE_COLOURS),
                smooth_shading=True,
                show_scalar_bar=False,
                ambient=0.38,
                diffuse=0.72,
                specular=0.12,
                specular_power=18,
            )
        if outline and damage.max() > 0.0:
            shell = intact.extract_surface(algorithm="dataset_surface")
            shell = _cut(shell, cut, turn)
            plotter.add_mesh(
                shell, color=SHELL_COLOUR, opacity=0.16, lighting=False, culling="front"
            )
        view = np.array([*(np.cos(rise) * facing[:2]), np.sin(rise)])
        plotter.camera.position = tuple(5.0 * view)
        plotter.camera.focal_point = (0.0, 0.0, 0.0)
        plotter.camera.up = (0.0, 0.0, 1.0)
        plotter.enable_parallel_projection()
        plotter.camera.parallel_scale = _half_height(high - low, rise, size) * scale
        image = plotter.screenshot(None, transparent_background=True, return_img=True)
    finally:
        plotter.close()
    small = Image.fromarray(np.asarray(image)).resize(size, Image.Resampling.LANCZOS)
    return np.asarray(small)


def _cut(mesh: pyvista.DataSet, cut: Cut, turn: float) -> pyvista.DataSet:
    """What is left of a mesh around the origin when the part that faces the viewer is taken."""
    if cut == "whole" or not mesh.n_cells:
        return mesh

    def keep(part: pyvista.DataSet, angle: float, behind: bool = True) -> pyvista.DataSet:
        normal = (np.cos(turn + angle), np.sin(turn + angle), 0.0)
        return part.clip(normal=normal, origin=(0.0, 0.0, 0.0), invert=behind)

    if cut == "half":
        return keep(mesh, 0.0)
    left, right = np.radians(-15.0), np.radians(75.0)  # the left of the view keeps its outside
    return keep(mesh, left).merge(keep(keep(mesh, left, behind=False), right))


def _half_height(extent: NDArray[np.float64], rise: float, size: tuple[int, int]) -> float:
    """Half the height of the view that holds the bounding box turned any way, with a margin."""
    across = float(np.hypot(extent[0], extent[1])) / np.sqrt(2.0)
    height = extent[2] * np.cos(rise) + across * np.sin(rise)
    return 0.515 * max(height, across * size[1] / size[0])


def _add_lights(plotter: object, pyvista: object, turn: float) -> None:
    """A key light from the upper left of the view, a weak fill from the right, one from above."""
    for angle, height, intensity in ((-0.6, 0.9, 0.68), (0.9, 0.2, 0.32), (0.0, 3.0, 0.2)):
        position = (5.0 * np.cos(turn + angle), 5.0 * np.sin(turn + angle), 5.0 * height)
        light = pyvista.Light(
            position=position,
            focal_point=(0.0, 0.0, 0.0),
            intensity=intensity,
            light_type="scene light",
        )
        light.positional = False
        plotter.add_light(light)


@dataclass(frozen=True)
class PictureRequest:
    """One picture to render: which damage field, how it is cut, and the PNG to write."""

    damage: NDArray[np.float64]
    path: Path
    cut: Cut = "whole"


def render_pictures(
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    requests: Sequence[PictureRequest],
    *,
    size: tuple[int, int] = SIZE,
    maximum_damage: float = MAXIMUM_DAMAGE,
    timeout: float = 300.0,
) -> str:
    """Write the pictures asked for in a child process; return "" or one sentence of what failed.

    Pictures finished before a failure stay.  Never raises for a failure of the graphics libraries.
    """
    if not requests:
        return ""
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "job.npz"
        unique = {id(request.damage): request.damage for request in requests}
        order = {key: number for number, key in enumerate(unique)}
        fields = {f"damage_{order[key]}": damage for key, damage in unique.items()}
        plan = [
            {"path": str(Path(r.path).resolve()), "cut": r.cut, "damage": order[id(r.damage)]}
            for r in requests
        ]
        settings = json.dumps([plan, list(size), maximum_damage])
        write_arrays(job, {"points": points, "cells": cells, "plan": settings, **fields})
        package_parent = str(Path(__file__).resolve().parents[2])
        search_path = os.pathsep.join(filter(None, [package_parent, os.environ.get("PYTHONPATH")]))
        try:
            child = children.start(
                [sys.executable, "-m", "pipeline.report.pictures", str(job)],
                env={**os.environ, "PYTHONPATH": search_path},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
        except OSError as error:
            return f"rendering could not be started: {error}"
        try:
            _, said = child.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            return f"rendering did not finish within {timeout:.0f} s"
        finally:
            children.end(child)
    if child.returncode == 0:
        return ""
    logger.warning("rendering failed:\n%s", said)
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    reason = lines[-1] if lines else "no message"
    return f"rendering ended with {children.how_it_ended(child.returncode)}: {reason[:200]}"


def write_overview(run: RunResults, pictures: dict[tuple[str, str, str], Path], path: Path) -> None:
    """Combine pictures over time and alloys with the strength curve in one PNG, for print.

    pictures: PNG files by alloy, label of the immersion time and cut, of which those with a quarter
    cut out are shown.  A picture that is not there leaves its place empty; without a tensile test
    there is no curve.
    """
    from matplotlib import image as images
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    from pipeline.report.drawing import ALLOY_COLOURS
    from pipeline.report.plots import draw_strength, name_lines
    from pipeline.report.wording import duration
    from pipeline.scene.holding import HOLDINGS
    from pipeline.scene.loads import LOADS
    from pipeline.scene.units import parse_time

    labels = sorted({label for _, label, _ in pictures}, key=lambda text: parse_time(text).seconds)
    rows, columns = len(run.alloys), len(labels)
    tested = any(i.strength_ratio is not None for a in run.alloys for i in a.immersions)
    widths = [max(1.2 * columns + 0.4, 3.4), 4.4 if tested else 0.01]
    room = 0.96
    if tested and len(run.held) > 1:  # for the names of the lines
        widths[1], room = 5.6, 0.7
    height = 1.85 * rows + 1.05
    bottom, top = 0.72 / height, 1 - 0.33 / height
    figure = Figure(figsize=(sum(widths), height), dpi=150)
    left, right = figure.subfigures(1, 2, width_ratios=widths)
    grid = left.subplots(rows, columns, squeeze=False)
    left.subplots_adjust(
        left=0.45 / widths[0], right=1.0, bottom=bottom, top=top, wspace=0.02, hspace=0.04
    )
    for axes_row, alloy, colour in zip(grid, run.alloys, cycle(ALLOY_COLOURS), strict=False):
        axes_row[0].text(
            -0.12,
            0.5,
            alloy.name,
            rotation=90,
            transform=axes_row[0].transAxes,
            ha="right",
            va="center",
            color=colour,
            fontsize=11,
            fontweight="bold",
        )
        for axes, label in zip(axes_row, labels, strict=True):
            axes.set_axis_off()
            place = pictures.get((alloy.name, label, "quarter"))
            if place is not None and place.is_file():
                axes.imshow(images.imread(place), interpolation="lanczos")
    for axes, label in zip(grid[0], labels, strict=True):
        axes.set_title(duration(parse_time(label).seconds), fontsize=10)
    scale = left.add_axes((0.25, 0.31 / height, 0.6, 0.09 / height))
    colours = ScalarMappable(
        Normalize(0.0, MAXIMUM_DAMAGE),
        LinearSegmentedColormap.from_list("corrosion", DAMAGE_COLOURS),
    )
    bar = left.colorbar(colours, cax=scale, orientation="horizontal", ticks=[0, 1 / 3, 2 / 3])
    bar.ax.set_xticklabels(["0: sound", "0.33", "0.67: carries nothing"], fontsize=8)
    bar.outline.set_visible(False)
    bar.ax.set_title("Corrosion damage; a quarter is cut out", fontsize=8.5, pad=3)
    if tested:
        axes = right.subplots()
        right.subplots_adjust(left=0.13, right=room, bottom=bottom, top=top)
        load = LOADS[run.scene.tensile.load]
        ends = []
        for n, (hold, alloys) in enumerate(run.held.items()):
            part = HOLDINGS[hold].part
            draw_strength(axes, alloys, ALLOY_COLOURS, load, way=(n, part))
            for alloy, colour in zip(alloys, cycle(ALLOY_COLOURS), strict=False):
                known = [i for i in alloy.immersions if i.strength_ratio is not None]
                if known:
                    ends.append((100 * known[-1].strength_ratio, part, colour))
        axes.set_xlim(left=0)
        axes.grid(color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        if len(run.held) > 1:
            name_lines(axes, ends, apart=5.0)
        if axes.get_legend_handles_labels()[0]:
            place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.0}
            axes.legend(frameon=False, ncols=3, **place)
    with whole_file(path) as temporary:
        FigureCanvasAgg(figure).print_png(temporary)


def write_png(image: NDArray[np.uint8], path: Path) -> None:
    """Write an RGBA picture, in one step."""
    from PIL import Image

    with whole_file(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG", optimize=True)


def _child(job: Path) -> None:
    """Render everything that one job file asks for."""
    with np.load(job) as stored:
        plan, size, most = json.loads(str(stored["plan"]))
        points, cells = stored["points"], stored["cells"]
        for entry in plan:
            damage = stored[f"damage_{entry['damage']}"]
            image = screw_picture(
                points, cells, damage, cut=entry["cut"], size=tuple(size), maximum_damage=most
            )
            write_png(image, Path(entry["path"]))


if __name__ == "__main__":
    _child(Path(sys.argv[1]))
