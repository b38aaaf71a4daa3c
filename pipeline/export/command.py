"""The command `perilife export`: its options and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from perilife_data import did_you_mean

if TYPE_CHECKING:
    from pipeline.export.state import CorrodedState


@dataclass(frozen=True)
class Format:
    """A format: ending of its files, what a reader finds there, and how a state is written.

    write: of state, path and number of damage classes; returns the files.
    """

    suffix: str
    content: str
    write: Callable[[CorrodedState, Path, int], list[Path]]


def _inp(state: CorrodedState, path: Path, classes: int) -> list[Path]:
    from pipeline.export.inp import write_inp

    return write_inp(state, path, classes)


def _with(name: str) -> Callable[[CorrodedState, Path, int], list[Path]]:
    def write(state: CorrodedState, path: Path, classes: int) -> list[Path]:
        from pipeline.export import meshes

        return getattr(meshes, name)(state, path)

    return write


FORMATS = {
    "inp": Format(".inp", "the tensile test for CalculiX, a material per damage class", _inp),
    "exodus": Format(".exo", "mesh, damage and grips for Sandia's tools", _with("write_exodus")),
    "vtu": Format(".vtu", "mesh, damage and grips for ParaView", _with("write_vtu")),
    "xdmf": Format(".xdmf", "the same for FEniCS and ParaView, with HDF5", _with("write_xdmf")),
    "npz": Format(".npz", "all arrays for NumPy, lattice and curve too", _with("write_npz")),
}
"""Name of a format -> how it is written."""


def add_export_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife export`."""
    parser.add_argument("run", metavar="RUN", help="the run folder")
    parser.add_argument(
        "--to",
        required=True,
        metavar="FORMAT",
        help="; ".join(f"{name}: {form.content}" for name, form in FORMATS.items()),
    )
    parser.add_argument("--time", required=True, metavar="T", help="immersion time: 8w, 0w: intact")
    parser.add_argument("--alloy", metavar="A", help="where the run has several")
    parser.add_argument("--hold", metavar="H", help="way of holding (the run's first)")
    parser.add_argument(
        "--classes", type=int, default=20, metavar="N", help="inp: damage classes, 1 to 200 (20)"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="file to write (RUN/export/ALLOY-TIME-HOLD.ENDING)"
    )


def run_export(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Write what the options ask; ValueError or OSError with one sentence where that cannot be."""
    if options.to not in FORMATS:
        near = did_you_mean(options.to, FORMATS)
        raise ValueError(f"--to is '{options.to}'{near}; it must be one of {', '.join(FORMATS)}")
    kind = FORMATS[options.to]
    given = Path(options.out) if options.out else None
    if given is not None and given.suffix != kind.suffix:
        raise ValueError(f"--out is '{given}'; a file of format {options.to} ends in {kind.suffix}")
    if given is not None and not given.parent.is_dir():
        raise FileNotFoundError(f"--out is '{given}', whose folder does not exist")
    from pipeline.export.state import read_state

    state = read_state(options.run, options.time, options.alloy, options.hold)
    path = given
    if path is None:
        name = f"{state.alloy}-{state.time.label}-{state.hold.name}{kind.suffix}"
        path = Path(options.run) / "export" / name
        path.parent.mkdir(exist_ok=True)
    for written in kind.write(state, path, options.classes):
        say(str(written))
