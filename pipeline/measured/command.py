"""The command `perilife compare-image`: measured beside computed loss of a run, place by place."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

from pipeline.record.whole_file import whole_file
from pipeline.scene.image import add_image_options, image_from_options

TABLE_FILE, FIELD_FILE = "loss.csv", "loss.vti"


def add_compare_image_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife compare-image`."""
    parser.add_argument("run", metavar="RUN", help="the run folder, corroded")
    add_image_options(parser)
    parser.add_argument("--time", required=True, metavar="T", help="when the scan was made: 8w")
    parser.add_argument("--alloy", metavar="A", help="where the run has several")
    parser.add_argument("--out", metavar="DIR", help="folder for the files (RUN/measured)")


def compare_image(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Write table and field and print the table; ValueError or OSError with one sentence."""
    import numpy as np

    from peri.corrosion.results import read_corrosion
    from pipeline.export.state import read_march
    from pipeline.geometry.image_files import read_image
    from pipeline.geometry.scans import metal_of_image
    from pipeline.measured.loss import loss_by_place
    from pipeline.stages.geometry import read_surface

    source = image_from_options(options)
    if source is None:
        raise ValueError("compare-image needs the scan; give it with --image")
    scene, geometry, march, moment = read_march(options.run, options.time, options.alloy)
    path = Path(source.path)
    scan, _ = metal_of_image(read_image(path, source.voxel), source, path.name)
    fields = read_corrosion(march)
    number = int(np.flatnonzero(fields["times"] == moment.seconds)[0])
    found = loss_by_place(
        read_surface(geometry), scan, fields, number, scene.lattice.horizon, path.name
    )
    folder = Path(options.out) if options.out else Path(options.run) / "measured"
    folder.mkdir(parents=True, exist_ok=True)
    rows = found.table()
    with (
        whole_file(folder / TABLE_FILE) as temporary,
        open(temporary, "w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["place", "metal_before_m3", "measured_loss", "computed_loss"])
        writer.writerows((name, *(f"{value:.8g}" for value in values)) for name, *values in rows)
    write_field(folder / FIELD_FILE, found)
    _print_table(rows, moment.label)
    say(
        f"in boxes of {1e6 * found.width:.0f} um the losses differ by "
        f"{100 * found.disagreement():.2g} % of the box (root mean square)"
    )
    say(_lie_in_words(found.shift(), found.spacing))
    for name in (TABLE_FILE, FIELD_FILE):
        say(str(folder / name))


def _lie_in_words(shift, spacing) -> str:
    """Whether scan and run lie on each other, as far as the lattice can tell."""
    if (abs(shift) <= 0.25 * spacing).all():
        far = 1e6 * float(max(abs(shift)))
        return f"the scan lies where the computed metal does, to {far:.0f} um (not moved)"
    along = ", ".join(f"{name} {1e6 * by:+.0f} um" for name, by in zip("xyz", shift, strict=True))
    return (
        f"the scan would fit the computed metal best if it were moved along {along}; it was not, "
        "so that the table holds this shift, unless the metal is lost on one side"
    )


def _print_table(rows: list[tuple[str, float, float, float]], label: str) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"Metal lost after {label} [%]")
    for column in ("place", "before [mm^3]", "measured", "computed"):
        table.add_column(column, justify="left" if column == "place" else "right")
    for name, metal, measured, computed in rows:
        table.add_row(name, f"{1e9 * metal:.4g}", f"{100 * measured:.1f}", f"{100 * computed:.1f}")
    Console(width=None if Console().is_terminal else 120).print(table)


def write_field(path: Path, found) -> None:
    """The shares of metal and the difference on the lattice, for ParaView (lengths in m)."""
    import pyvista

    grid = pyvista.ImageData(
        dimensions=found.before.shape, spacing=found.spacing, origin=found.origin
    )
    for name, values in (
        ("metal_share_before", found.before),
        ("metal_share_measured", found.measured),
        ("metal_share_computed", found.computed),
        ("measured_less_computed_loss_in_boxes", found.difference()),
    ):
        grid.point_data[name] = values.ravel(order="F")
    with whole_file(path) as temporary:
        grid.save(temporary)
