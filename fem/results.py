"""What a tensile test leaves on disk while it runs: ParaView series and checkpoints.

Observers are called on every rank after each accepted increment with an `Increment`:

    tensile_test(..., observers=[ParaviewSeries("out", every=5), Checkpoint("out/checkpoint.h5")])
    tensile_test(..., resume="out/checkpoint.h5")

Files are written by rank 0 under a temporary name and moved into place. A checkpoint is kept by the
numbers of the input (cells, vertices, edges as pairs of vertices), so it can be resumed on any
number of ranks.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fem.march import March
from fem.quadrature import EDGES
from fem.quadrature_state import Fields

SCHEMA_VERSION = 2
"""Of a checkpoint; one more whenever `Fields`, `_SCALARS` or a row of the history change names."""

_SCALARS = (
    "previous_size",
    "strain",
    "size",
    "failed_size",
    "peak",
    "work",
    "dissipated",
)  # of March


class CheckpointError(ValueError):
    """A checkpoint that is damaged or belongs to another test."""


@dataclass(frozen=True)
class Increment:
    """One accepted increment as an observer sees it; arrays are this rank's, not to be changed."""

    test: Any  # the running test: comm, discretisation, state, assembler.alive
    march: March

    @property
    def number(self) -> int:
        """1 for the first increment."""
        return len(self.march.rows) - 1

    @property
    def reaction(self) -> float:
        """Force [N], torque or moment [N m] of the top grip."""
        return self.march.rows[-1][self.test.load.reaction]

    @property
    def fields(self) -> Fields:
        """Quadrature state (nl, nq, ...) of the local cells, ghosts included."""
        return self.test.state.old


class ParaviewSeries:
    """Observer that writes `name`_0000.vtu ... and `name`.pvd; its time is the strain in per cent.

    The intact state, the one with the largest reaction, the last one, and every `every`-th
    increment between; none where nothing is left between the grips.  Points: displacement_m.
    Cells still in place (means over their quadrature points): cauchy_stress_Pa (xx, yy, zz, xy,
    yz, xz), mises_kirchhoff_Pa and mean_stress_kirchhoff_Pa (Kirchhoff's is Cauchy's times det F),
    plastic_strain, damage_variable, number of the cell in the input. Ten-node cells are shown by
    their corners.
    """

    def __init__(self, folder: str | Path, every: int = 1, name: str = "tensile") -> None:
        if every < 1:
            raise ValueError(f"every is {every}; a series takes each, each second, ... increment")
        self.folder, self.every, self.name = Path(folder), every, name
        self._entries: dict[int, str] = {}
        self._largest = -np.inf
        self._peak: _State | None = None
        self._last: _State | None = None

    def begin(self, increment: Increment) -> None:
        """Write the state before the first increment; collective."""
        self(increment)

    def __call__(self, increment: Increment) -> None:
        """Keep one state, and write it if it is due; collective."""
        self._last = _State.of(increment)
        if increment.reaction > self._largest:
            self._largest, self._peak = increment.reaction, self._last
        if increment.number % self.every == 0:
            self._show(self._last)

    def finish(self) -> None:
        """Write the state at the peak and the last one, where that has not been done; collective.

        Until then most increments are a new peak: what is shown of a state is not computed before.
        """
        for state in (self._peak, self._last):
            if state is not None and state.number not in self._entries:
                self._show(state)

    def _show(self, kept: _State) -> None:
        """Gather what is shown of a state and write it on rank 0; collective."""
        test, state, displacement = kept.test, kept.fields, kept.displacement
        d, shown = test.discretisation, kept.shown
        self._entries[kept.number] = ""
        values = {
            "cauchy_stress_Pa": cauchy_stress(d, state, displacement, shown),
            "mises_kirchhoff_Pa": state.mises[shown].mean(axis=1),
            "mean_stress_kirchhoff_Pa": state.pressure[shown].mean(axis=1),
            "plastic_strain": state.strain[shown].mean(axis=1),
            "damage_variable": state.damage[shown].mean(axis=1),
        }
        parts = test.comm.gather((d.original_cells[shown], values))
        vertex = d.mesh.input_vertices[: d.owned_nodes]
        moved = test.comm.gather((vertex[vertex >= 0], displacement[: d.owned_nodes][vertex >= 0]))
        if test.comm.rank != 0:
            return
        numbers = test.prepared.kept[np.concatenate([cells for cells, _ in parts])]
        if not numbers.size:
            return
        order = np.argsort(numbers)
        everywhere = np.zeros_like(test.prepared.points)
        for vertices, rows in moved:
            everywhere[test.vertices[vertices]] = rows
        cell_data = {
            name: np.concatenate([part[name] for _, part in parts])[order] for name in values
        }
        self._write(
            _Picture(kept.number, kept.strain, test.prepared, numbers[order], everywhere, cell_data)
        )

    def _write(self, picture: _Picture) -> None:
        import pyvista

        prepared = picture.prepared
        used, cells = np.unique(prepared.cells[picture.numbers], return_inverse=True)
        cells = cells.reshape(-1, 4)
        kinds = np.full(len(cells), pyvista.CellType.TETRA)
        grid = pyvista.UnstructuredGrid(
            np.c_[np.full(len(cells), 4), cells], kinds, prepared.points[used]
        )
        grid.point_data["displacement_m"] = picture.displacement[used]
        for name, array in picture.cell_data.items():
            grid.cell_data[name] = array
        grid.cell_data["cell"] = picture.numbers
        self.folder.mkdir(parents=True, exist_ok=True)
        name = f"{self.name}_{picture.number:04d}.vtu"
        temporary = self.folder / f".{self.name}.part.vtu"
        grid.save(temporary)
        os.replace(temporary, self.folder / name)
        self._entries[picture.number] = (
            f'<DataSet timestep="{100 * picture.strain:.9g}" file="{name}"/>'
        )
        text = "\n".join(
            ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "<Collection>"]
            + [entry for _, entry in sorted(self._entries.items()) if entry]
            + ["</Collection>", "</VTKFile>", ""]
        )
        temporary = self.folder / f".{self.name}.part.pvd"
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, self.folder / f"{self.name}.pvd")


@dataclass(frozen=True)
class _State:
    """One state of a test on this rank: copies of what the next increment changes."""

    number: int
    strain: float
    test: Any
    fields: Fields
    displacement: np.ndarray  # (n, 3) of the local nodes [m]
    shown: np.ndarray  # (nl,) bool: owned cells in place

    @classmethod
    def of(cls, increment: Increment) -> _State:
        test, march = increment.test, increment.march
        shown = test.discretisation.owned & test.assembler.alive
        fields = increment.fields.copy()
        return cls(increment.number, march.strain, test, fields, march.displacement.copy(), shown)


@dataclass(frozen=True)
class _Picture:
    """One state of a test as a series shows it (rank 0)."""

    number: int
    strain: float
    prepared: Any
    numbers: np.ndarray  # (n,) shown cells, rising
    displacement: np.ndarray  # of all vertices of the input [m]
    cell_data: dict[str, np.ndarray]


def cauchy_stress(
    discretisation: Any, state: Fields, displacement: np.ndarray, shown: np.ndarray
) -> np.ndarray:
    """Cauchy stress (n, 6) [Pa] of the shown cells: xx, yy, zz, xy, yz, xz; means over points.

    From the equivalent and the mean Kirchhoff stress of the state; the deviator has the direction
    of that of ln b_e, b_e = F Cp^-1 F^T, since elasticity is isotropic.
    """
    d = discretisation
    if not shown.any():
        return np.zeros((0, 6))
    moved = displacement[d.cells[shown]]
    gradient = np.eye(3) + np.einsum("cai,cqaj->cqij", moved, d.gradients[shown])
    plastic = state.plastic[shown][..., [0, 3, 4, 3, 1, 5, 4, 5, 2]]
    plastic = plastic.reshape(*plastic.shape[:-1], 3, 3)
    elastic = gradient @ plastic @ np.swapaxes(gradient, -1, -2)
    squares, axes = np.linalg.eigh(elastic)
    stretch = np.log(squares)
    stretch -= stretch.mean(axis=-1, keepdims=True)
    length = np.linalg.norm(stretch, axis=-1, keepdims=True)
    direction = np.divide(stretch, length, out=np.zeros_like(stretch), where=length > 0.0)
    principal = np.sqrt(2.0 / 3.0) * state.mises[shown][..., None] * direction
    principal += state.pressure[shown][..., None]
    principal /= np.linalg.det(gradient)[..., None]
    stress = np.einsum("cqik,cqk,cqjk->cqij", axes, principal, axes).mean(axis=1)
    return stress[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]


class Checkpoint:
    """Observer that keeps the last accepted state in one HDF5 file, every `every`-th increment."""

    def __init__(self, path: str | Path, every: int = 1) -> None:
        if every < 1:
            raise ValueError(f"every is {every}; a checkpoint is due each, each second, ... time")
        self.path, self.every = Path(path), every

    def __call__(self, increment: Increment) -> None:
        """Write the file; collective."""
        if increment.number % self.every:
            return
        test = increment.test
        d, mesh = test.discretisation, test.discretisation.mesh
        ends = _node_ends(test)[: mesh.owned_nodes]
        motion = {"displacement": increment.march.displacement[: mesh.owned_nodes]}
        if increment.march.previous is not None:
            motion["previous"] = increment.march.previous[: mesh.owned_nodes]
        cells = {name: values[d.owned] for name, values in vars(increment.fields).items()}
        cells["alive"] = test.assembler.alive[d.owned]
        nodes = _gather(test.comm, ends, motion)
        cells = _gather(test.comm, d.original_cells[d.owned], cells)
        if test.comm.rank != 0:
            return
        march = {name: getattr(increment.march, name) for name in _SCALARS}
        march |= {"reference": test.solver.reference}
        march |= {"lost_cells": test.lost_cells, "torn_cells": test.torn_cells}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.path.with_name(f".{self.path.name}.part")
        with h5py.File(temporary, "w") as file:
            file.attrs["schema_version"] = SCHEMA_VERSION
            file.attrs["fingerprint"] = _fingerprint(test)
            file.attrs["march"] = json.dumps({key: float(value) for key, value in march.items()})
            ends, motion = nodes
            file["nodes/ends"] = test.vertices[ends]
            for name, values in motion.items():
                file[f"nodes/{name}"] = values
            numbers, fields = cells
            file["cells/number"] = test.prepared.kept[numbers]
            for name, values in fields.items():
                file[f"cells/{name}"] = values
            for name in increment.march.rows[0]:
                file[f"history/{name}"] = np.array(
                    [row[name] for row in increment.march.rows], float
                )
        os.replace(temporary, self.path)


def restore(test: Any, path: str | Path) -> March:
    """Put a test into the state of a checkpoint and return where it stands; collective.

    Raises FileNotFoundError, or CheckpointError if the file is none of this version, mesh, damage,
    material, element, grips and load.
    """
    content, error = None, None
    if test.comm.rank == 0:
        try:
            content = _read(test, Path(path))
        except (FileNotFoundError, CheckpointError) as problem:
            error = problem
        except (OSError, KeyError, ValueError) as problem:
            error = CheckpointError(f"checkpoint {path} cannot be read ({problem})")
    error = test.comm.bcast(error)
    if error is not None:
        raise error
    march, rows, (ends, motion), (numbers, fields) = test.comm.bcast(content)
    d = test.discretisation
    at = _lookup(_keys(ends), _keys(_node_ends(test)))
    displacement = motion["displacement"][at]
    previous = motion["previous"][at] if "previous" in motion else None
    at = _lookup(numbers, d.original_cells)
    for name in Fields.__dataclass_fields__:
        getattr(test.state.old, name)[...] = fields[name][at]
        getattr(test.state.new, name)[...] = fields[name][at]
    test.state.acting = test.state.old.damage.copy()
    test.assembler.alive[:] = fields["alive"][at]
    test.fix_unused()
    test.solver.reference = march.pop("reference")
    test.lost_cells = int(march.pop("lost_cells"))
    test.torn_cells = int(march.pop("torn_cells"))
    scalars = {name: march[name] for name in _SCALARS}
    return March(displacement=displacement, previous=previous, rows=rows, **scalars)


def _read(test, path: Path) -> tuple:
    """The content of a checkpoint, by the numbers of the kept cells and vertices (rank 0)."""
    if not path.is_file():
        raise FileNotFoundError(f"checkpoint {path} does not exist")
    with h5py.File(path, "r") as file:
        if file.attrs.get("schema_version") != SCHEMA_VERSION:
            raise CheckpointError(f"checkpoint {path} was written by another version of perilife")
        if file.attrs.get("fingerprint") != _fingerprint(test):
            raise CheckpointError(
                f"checkpoint {path} belongs to another mesh, damage, material, element, grips "
                "or load"
            )
        march = json.loads(file.attrs["march"])
        history = {name: values[()] for name, values in file["history"].items()}
        motion = {name: values[()] for name, values in file["nodes"].items() if name != "ends"}
        fields = {name: values[()] for name, values in file["cells"].items() if name != "number"}
        ends = np.searchsorted(test.vertices, file["nodes/ends"][()])
        numbers = np.searchsorted(test.prepared.kept, file["cells/number"][()])
    rows = [
        {name: float(values[i]) for name, values in history.items()}
        for i in range(len(history["iterations"]))
    ]
    return march, rows, (ends, motion), (numbers, fields)


def _node_ends(test) -> np.ndarray:
    """(n, 2) vertices of the compact mesh between which a local node lies; twice its own."""
    mesh, cells = test.discretisation.mesh, test.discretisation.cells
    ends = np.repeat(mesh.input_vertices[:, None], 2, axis=1)
    for edge in range(cells.shape[1] - 4):
        pair = mesh.input_vertices[cells[:, EDGES[edge]]]
        ends[cells[:, 4 + edge]] = np.sort(pair, axis=1)
    return ends


def _keys(ends: np.ndarray) -> np.ndarray:
    return ends[:, 0] * np.int64(2**31) + ends[:, 1]


def _lookup(stored: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Positions of the wanted keys among the stored ones."""
    order = np.argsort(stored)
    at = order[np.minimum(np.searchsorted(stored, wanted, sorter=order), len(stored) - 1)]
    if not np.array_equal(stored[at], wanted):
        raise CheckpointError("checkpoint: it lacks cells or nodes of this mesh")
    return at


def _gather(comm, numbers, arrays) -> tuple | None:
    """Numbers and arrays of all ranks, one after the other, on rank 0."""
    parts = comm.gather((numbers, arrays))
    if comm.rank != 0:
        return None
    joined = {name: np.concatenate([part[name] for _, part in parts]) for name in arrays}
    return np.concatenate([number for number, _ in parts]), joined


def _fingerprint(test) -> str:
    """Hash of what must agree between a checkpoint and the test that resumes it (rank 0)."""
    prepared, digest = test.prepared, hashlib.sha256()
    for array in (prepared.points, prepared.cells, prepared.damage):
        digest.update(np.ascontiguousarray(array).tobytes())
    settings = test.settings
    materials = test.materials if len(test.materials) > 1 else test.materials[0]
    digest.update(repr((materials, settings.element, settings.grips, test.load)).encode())
    if len(test.materials) > 1:
        digest.update(prepared.laws.of_cell.tobytes())
    return digest.hexdigest()
