"""Files of the corrosion stage: HDF5 results, history, VTK series."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from peri.corrosion.nodes.problem import COLUMNS
from peri.corrosion.run import CorrosionResult
from peri.engine.results import Field, axes_of, read_result, write_result

SCHEMA_VERSION = 1

_UNITS = {"time": "s", "step": "s", **COLUMNS, "iterations": "1"}


def write_corrosion(path: Path, result: CorrosionResult) -> None:
    """Write a CorrosionResult as HDF5 (dimensions and units as attributes)."""
    scene = result.scene
    fields = {
        "metal": Field(scene.metal),
        "domain": Field(scene.domain),
        "capacity": Field(scene.capacity()),
        "times": Field(result.times, "s"),
        "concentration": Field(result.concentration, "mol/m3", ("time", *axes_of(scene.lattice))),
        "remaining_metal": Field(result.metal),
        "volume_loss": Field(result.volume_loss),
    }
    history = {name: Field(values, _UNITS[name]) for name, values in result.history.items()}
    attributes = {
        "solid_concentration": scene.solid_concentration,
        "saturation_concentration": scene.saturation_concentration,
        "wall_time": result.wall_time,
    }
    write_result(path, scene.lattice, fields, history, attributes, SCHEMA_VERSION)


def read_corrosion(path: Path) -> dict[str, np.ndarray]:
    """Datasets (by path) and attributes of a file of `write_corrosion`.

    Raises
    ------
    ValueError
        If the file has another schema version.
    """
    fields, attributes = read_result(path, "corrosion", SCHEMA_VERSION)
    return {name: field.values for name, field in fields.items()} | attributes


def write_history(
    path: Path, history: dict[str, np.ndarray], units: Mapping[str, str] | None = None
) -> None:
    """Write the per-step history as CSV; column names carry the units.

    units: of columns that the caller adds to those of a march.
    """
    known = {**_UNITS, **(units or {})}
    temporary = Path(path).with_name(Path(path).name + ".tmp")
    names = list(history)
    header = ",".join(n if known[n] == "1" else f"{n}_{known[n]}" for n in names)
    table = np.column_stack([history[n] for n in names])
    np.savetxt(temporary, table, delimiter=",", header=header, comments="", fmt="%.12g")
    os.replace(temporary, path)


def write_image_series(folder: Path, result: CorrosionResult) -> Path:
    """Write one VTK image (.vti) per output time and the ParaView series file corrosion.pvd.

    Each holds the nodes' concentration (mol/m^3), corrosion damage 1 - C/C_solid on the initial
    metal (NaN elsewhere) and the phase (0 none, 1 liquid, 2 metal).  Written with pyvista, which
    is needed only here.
    """
    import pyvista

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    scene = result.scene
    solid = scene.solid_concentrations()
    lead = (1,) * (3 - scene.lattice.dimension)
    entries = []
    for n, time in enumerate(result.times):
        image = pyvista.ImageData(
            dimensions=scene.lattice.shape + lead,
            spacing=scene.lattice.spacing + (1.0,) * len(lead),
            origin=scene.lattice.origin + (0.0,) * len(lead),
        )
        values = result.concentration[n]
        damage = np.full(values.shape, np.nan)
        damage[scene.metal] = 1.0 - (values / np.where(scene.metal, solid, 1.0))[scene.metal]
        phase = scene.domain.astype(np.uint8) + result.metal[n]
        image["concentration"] = values.ravel(order="F").astype(np.float32)
        image["corrosion_damage"] = damage.ravel(order="F").astype(np.float32)
        image["phase"] = phase.ravel(order="F")
        name = f"corrosion_{n:03d}.vti"
        image.save(folder / name)
        entries.append(f'<DataSet timestep="{time:.9g}" file="{name}"/>')
    series = folder / "corrosion.pvd"
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
        + "\n".join(entries)
        + "\n</Collection>\n</VTKFile>\n"
    )
    temporary = series.with_suffix(".tmp")
    temporary.write_text(text)
    os.replace(temporary, series)
    return series
