"""Mesh, damage and grips as VTU, XDMF or Exodus II, and everything as NumPy arrays."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.results import read_corrosion
from pipeline.export.state import CorrodedState
from pipeline.record.whole_file import write_arrays


def cell_fields(state: CorrodedState) -> dict[str, NDArray[np.float64]]:
    """What is written for every cell (nc,), by name."""
    return {"corrosion_damage": state.corrosion_damage, "strength_left": state.strength_left}


def write_vtu(state: CorrodedState, path: Path) -> list[Path]:
    """Tetrahedra in m, fields of `cell_fields`, and the grips at the points, by meshio."""
    return _write_meshio(state, path)


def write_xdmf(state: CorrodedState, path: Path) -> list[Path]:
    """The same as XDMF; its arrays are in an HDF5 file of the same name beside it."""
    return _write_meshio(state, path)


def _write_meshio(state: CorrodedState, path: Path) -> list[Path]:
    import meshio

    mesh = meshio.Mesh(
        state.points,
        [("tetra", state.cells)],
        point_data={"grip": state.grips()},
        cell_data={name: [values] for name, values in cell_fields(state).items()},
    )
    beside = path.with_suffix(".h5")
    if path.suffix == ".xdmf" and beside.exists() and not path.exists():
        raise FileExistsError(f"'{beside}' is there and no part of an export; choose another name")
    # the XDMF file names its HDF5 file, so both get their names before they are moved
    with tempfile.TemporaryDirectory(dir=path.parent) as place:
        mesh.write(Path(place) / path.name)
        return [file.replace(path.parent / file.name) for file in sorted(Path(place).iterdir())]


def write_exodus(state: CorrodedState, path: Path) -> list[Path]:
    """Exodus II (m) by VTK: one block of tetrahedra; its one step stands at the immersion [s]."""
    import pyvista
    from vtkmodules.vtkCommonDataModel import vtkDataObject
    from vtkmodules.vtkIOExodus import vtkExodusIIWriter

    kinds = np.full(len(state.cells), pyvista.CellType.TETRA)
    corners = np.c_[np.full(len(state.cells), 4), state.cells]
    grid = pyvista.UnstructuredGrid(corners, kinds, state.points)
    for name, values in cell_fields(state).items():
        grid.cell_data[name] = values
    grid.point_data["grip"] = state.grips().astype(float)
    grid.GetInformation().Set(vtkDataObject.DATA_TIME_STEP(), state.time.seconds)
    with tempfile.TemporaryDirectory(dir=path.parent) as place:
        writer = vtkExodusIIWriter()
        writer.SetFileName(str(Path(place) / path.name))
        writer.SetStoreDoubles(1)
        writer.WriteOutBlockIdArrayOff()
        writer.WriteOutGlobalElementIdArrayOff()
        writer.WriteOutGlobalNodeIdArrayOff()
        writer.SetInputData(grid)
        writer.Write()
        return [file.replace(path.parent / file.name) for file in sorted(Path(place).iterdir())]


def write_npz(state: CorrodedState, path: Path) -> list[Path]:
    """All that is known, SI: mesh, damage, grips, material, the lattice and the curve of the test.

    `lattice_*` are concentration [mol/m^3], metal before immersion, origin and spacing [m];
    `curve_*` the columns of tensile.csv.
    """
    fields = read_corrosion(state.corrosion)
    number = int(np.flatnonzero(fields["times"] == state.time.seconds)[0])
    arrays = {
        "points": state.points,
        "cells": state.cells,
        "grip": state.grips(),
        **cell_fields(state),
        "lattice_concentration": fields["concentration"][number],
        "lattice_metal": fields["metal"],
        "lattice_origin": fields["lattice/origin"],
        "lattice_spacing": fields["lattice/spacing"],
        "solid_concentration": fields["solid_concentration"],
        "immersion_seconds": state.time.seconds,
        **{f"material_{name}": value for name, value in vars(state.material).items()},
        **{f"curve_{name}": values for name, values in state.curve.items()},
    }
    write_arrays(path, arrays, compressed=True)
    return [path]
