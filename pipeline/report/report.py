"""The report of a run: one HTML file that stands alone, made from whatever the run folder holds.

`write_report` renders the pictures, draws the curves and fills `templates/report.html.j2`.  What
a run has not computed is said, never filled in.
"""

import base64
import io
import logging
import math
import platform
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import numpy as np
from markupsafe import Markup
from PIL import Image, features

import perilife_data
from pipeline.record.bands import BANDS_FILE, BandRow, read_bands
from pipeline.record.doubts import DOUBTS_FILE, read_doubts
from pipeline.record.machine import describe_machine, package_versions
from pipeline.record.run_folder import REPORT_FILE, write_text
from pipeline.record.run_results import AlloyResult, ImmersionResult, RunResults, read_run
from pipeline.record.summary import SummaryRow
from pipeline.record.until import UNTIL_FILE, read_until
from pipeline.report import doubts, plots, provenance
from pipeline.report.downloads import downloads
from pipeline.report.image import image_rows
from pipeline.report.ions import ion_section
from pipeline.report.picture_set import PictureSet, make_pictures, times_shown
from pipeline.report.pictures import DAMAGE_COLOURS, MAXIMUM_DAMAGE, SIZE, write_overview
from pipeline.report.shares import share_tables
from pipeline.report.solid_view import solid_view
from pipeline.report.sure import held
from pipeline.report.templating import environment, script
from pipeline.report.wording import (
    caption,
    duration,
    elsewhere,
    gathered,
    headline,
    percent,
    status_in_words,
    until_it_gives_way,
)
from pipeline.scene import published
from pipeline.scene.errors import strength_error
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.loads import LOADS, LoadNames
from pipeline.scene.resolve import NO_PARAMETERS
from pipeline.scene.scene import ScrewGeometry
from pipeline.scene.units import format_bytes, format_length, format_seconds

logger = logging.getLogger(__name__)

OVERVIEW_FILE = "overview.png"
STAGE_TITLES = {
    "geometry": "Solid and mesh",
    "corrode": "Corrosion",
    "map": "Damage onto the mesh",
    "pull": "{test}s",
    "report": "Report",
}


@dataclass(frozen=True)
class Picture:
    """One picture in the page: a data address and what it shows in words."""

    address: str
    text: str


@dataclass(frozen=True)
class PictureColumn:
    """The pictures of one alloy after one time, and their caption."""

    title: str
    caption: str
    whole: Picture | None
    cut: Picture | None


def write_report(run_folder: Path | str) -> Path:
    """Write `report.html` and `overview.png` into the run folder and return the report's path.

    Raises FileNotFoundError where the folder holds no scene, ValueError where the scene cannot
    be read, OSError where the report cannot be written.  Missing parts are named in the report.
    """
    run = read_run(run_folder)
    rows = provenance.parameter_rows(run.scene)
    pictures = make_pictures(run)
    assumed = provenance.to_be_listed(rows)
    names = [alloy.name for alloy in run.alloys]
    load = LOADS[run.scene.tensile.load]
    measured, measured_trouble = _measured(run)
    banded = read_bands(run.folder / BANDS_FILE)
    trouble = [*measured_trouble]
    if pictures.trouble:
        trouble.append(f"pictures, all or some: {pictures.trouble}")
    if pictures.paths:
        write_overview(run, pictures.paths, run.folder / OVERVIEW_FILE)
    references = provenance.references(rows, run.scene)
    page = (
        environment()
        .get_template("report.html.j2")
        .render(
            title=f"Strength left: {' and '.join(names)}",
            solid=_solid_in_words(run),
            load=load,
            final_strain=percent(run.scene.tensile.final_strain),
            deed=load.deed + until_it_gives_way(a for alloys in run.held.values() for a in alloys),
            headlines=[_answer(run, alloy, load) for alloy in run.alloys],
            holds=_holds(run),
            published=_published(run),
            hold_times=[duration(t.seconds) for t in run.scene.immersion if t.seconds > 0],
            parameter_set=_parameter_set(run),
            no_parameters=NO_PARAMETERS,
            preset=doubts.settings_name(run.scene),
            tables=[
                (HOLDINGS[name], found)
                for name, alloys in run.held.items()
                if (found := [_table_row(a, i) for a in alloys for i in _tested(a)])
            ],
            pictures=_pictures(run, pictures),
            solid_view=solid_view(run),
            scripts={name: script(name) for name in ("viewer.js", "page.js")},
            downloads=downloads(run),
            picture_size=SIZE,
            damage_ramp=_damage_ramp(),
            plots=_plots(run, measured, load, banded),
            bands=[_band_row(row) for row in banded],
            until=[row.in_words() for row in read_until(run.folder / UNTIL_FILE)],
            shares=share_tables(run, read_doubts(run.folder / DOUBTS_FILE)),
            measured=sorted(measured),
            checks=doubts.checks(run),
            error_estimate=doubts.error_estimate(run),
            in_short=doubts.in_short(run, len(assumed)),
            twice_as_sure=doubts.twice_as_sure(run),
            omissions=doubts.omissions(run),
            ions=ion_section(run),
            alloys=names,
            assumed_count=len(assumed),
            assumptions=provenance.side_by_side(assumed, names),
            parameters=provenance.side_by_side([row for row in rows if row not in assumed], names),
            settings=provenance.settings(run.scene),
            kinds=[(k, v) for k, v in provenance.kinds_explained().items() if _has(rows, k)],
            solid_rows=_solid_rows(run),
            stages=_stage_times(run),
            versions=_versions(run),
            machine=_machine(),
            references=references,
            numbers={key: n for n, key in enumerate(references, start=1)},
            missing=[*gathered(run.missing), *trouble],
            created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            folder=run.folder.resolve().name,
        )
    )
    path = run.folder / REPORT_FILE
    write_text(path, page)
    return path


def _answer(run: RunResults, alloy: AlloyResult, load: LoadNames) -> str:
    others = [a for alloys in run.held.values() for a in alloys if a.name == alloy.name]
    return f"{headline(alloy, load)} {elsewhere(a for a in others if a is not alloy)}".strip()


def _holds(run: RunResults) -> list[dict[str, object]]:
    """Each way of holding: its question, its grips, and what each alloy keeps by time."""
    return [
        {
            **words,
            "alloys": [
                (
                    alloy.name,
                    [
                        percent(item.strength_ratio) if item.strength_ratio is not None else "–"
                        for item in alloy.immersions
                        if item.seconds > 0
                    ],
                )
                for alloy in run.held[hold.name]
            ],
        }
        for hold, words in zip(run.scene.holds, held(run.scene), strict=True)
    ]


def _published(run: RunResults) -> dict[str, object] | None:
    """What is known of the published tests, where a run pulls the end faces of the screw, too."""
    pulled = any(hold.name == "faces" for hold in run.scene.holds)
    theirs = any(alloy.name in published.ALLOYS for alloy in run.scene.alloys)
    axial = run.scene.tensile.load == "axial"
    if not (pulled and theirs and axial and isinstance(run.scene.geometry, ScrewGeometry)):
        return None
    return {
        "outcome": published.OUTCOME,
        "known": published.KNOWN,
        "inferred": published.INFERRED,
        "unsaid": published.UNDECIDED,
    }


def _solid_in_words(run: RunResults) -> str:
    geometry = run.scene.geometry
    if not isinstance(geometry, ScrewGeometry):
        return f"the solid of {Path(geometry.path).name}"
    screw = geometry.parameters
    size = f"M{1e3 * screw.diameter:g} × {1e3 * screw.length:g} mm"
    return f"a plain pin, {size[1:]}" if screw.thread == "none" else f"an {size} screw"


def _parameter_set(run: RunResults) -> dict[str, str]:
    name = run.scene.parameter_set
    try:
        known = perilife_data.load_parameter_set(name)
    except (ValueError, OSError):
        return {"name": name, "title": "", "note": "", "medium": ""}
    try:
        medium = perilife_data.load_medium(known.medium).title
    except (ValueError, OSError):
        medium = known.medium
    return {"name": name, "title": known.title, "note": known.note, "medium": medium}


# ---------------------------------------------------------------- table, pictures, curves


def _tested(alloy: AlloyResult) -> list[ImmersionResult]:
    """What the table of results has a row for: the intact solid, too, where it was only pulled."""
    if not any(item.summary for item in alloy.immersions):
        return []
    return [i for i in alloy.immersions if i.summary or i.strength_ratio is not None]


def _table_row(alloy: AlloyResult, item: ImmersionResult) -> dict[str, object]:
    row, rows = item.summary, _tested(alloy)
    ratio = item.strength_ratio
    if row is None:  # before immersion nothing is lost, and the test is known by its own file
        peak = item.tensile.get(f"peak_{item.names.reaction}", math.nan)
        strain = item.tensile.get(item.names.strain_at_peak, math.nan)
        status = str(item.tensile.get("status", ""))
        row = SummaryRow(alloy.name, alloy.hold, 0.0, 0.0, 0.0, peak, 1.0, strain, status)
    return {
        "alloy": alloy.name,
        "first": item is rows[0],
        "rows": len(rows),
        "time": duration(item.seconds),
        "volume_loss": _or_dash(row.volume_loss, lambda v: percent(v, 1)),
        "rate": "–" if row.degradation_rate is None else f"{row.degradation_rate:.2f} mm/year",
        "damage": _or_dash(row.mean_corrosion_damage, lambda v: f"{v:.3f}"),
        "peak": _or_dash(row.peak_reaction, item.names.shown),
        "ratio": _or_dash(row.strength_ratio, percent),
        "bar": 0.0 if ratio is None else 100.0 * min(max(ratio, 0.0), 1.0),
        "strain": _or_dash(row.strain_at_peak, lambda v: percent(v, 1)) if ratio else "–",
        "status": status_in_words(row.status, item.names),
    }


def _or_dash(value: float, write) -> str:
    return write(value) if math.isfinite(value) else "–"


def _pictures(run: RunResults, made: PictureSet) -> list[tuple[str, list[PictureColumn]]]:
    """The pictures of each alloy in columns, one per time."""
    result = []
    for alloy in run.alloys:
        columns = []
        for item in times_shown(alloy):
            paths = [made.paths.get((alloy.name, item.label, cut)) for cut in ("whole", "half")]
            views = [_embed(path, alloy, item) if path else None for path in paths]
            if any(views):
                columns.append(PictureColumn(duration(item.seconds), caption(item), *views))
        if columns:
            result.append((alloy.name, columns))
    return result


def _embed(path: Path, alloy: AlloyResult, item: ImmersionResult) -> Picture:
    """The picture as a data address, as WebP (a tenth of the bytes) where that can be written."""
    content, kind = path.read_bytes(), "png"
    if features.check("webp"):
        with Image.open(path) as picture, io.BytesIO() as buffer:
            picture.save(buffer, format="WEBP", quality=90, method=4)
            content, kind = buffer.getvalue(), "webp"
    view = "whole" if path.stem.endswith("whole") else "cut in half"
    text = f"{alloy.name} after {duration(item.seconds)}, {view}, coloured by corrosion damage"
    return Picture(f"data:image/{kind};base64,{base64.b64encode(content).decode()}", text)


def _damage_ramp() -> dict[str, object]:
    return {"colours": ", ".join(DAMAGE_COLOURS), "most": f"{MAXIMUM_DAMAGE:.2f}"}


def _measured(run: RunResults) -> tuple[dict, list[str]]:
    """Measured volume loss by alloy, from the person's own files, and what could not be read."""
    found, trouble = {}, []
    for name, path in run.scene.measured_volume_loss.items():
        try:
            data = perilife_data.read_volume_loss_csv(path)
        except (ValueError, OSError) as error:
            trouble.append(f"the measured volume loss of {name}: {error}")
            continue
        found[name] = data
    return found, trouble


def _band_row(row: BandRow) -> dict[str, str]:
    """One row of the table of bands, in per cent."""

    def between(values: tuple[float, float, float]) -> str:
        return f"{percent(values[0])} to {percent(values[2])}, middle {percent(values[1])}"

    return {
        "alloy": row.alloy,
        "hold": HOLDINGS[row.hold].part,
        "time": f"{row.immersion_days / 7:.4g} weeks",
        "rate": "{0:.3f} to {2:.3f}".format(*row.degradation_rate),
        "loss": between(row.volume_loss),
        "ratio": between(row.strength_ratio),
        "samples": f"{row.samples}",
        "error": percent(row.strength_curve_error),
    }


def _plots(
    run: RunResults, measured: dict, load: LoadNames, banded: list[BandRow]
) -> dict[str, object]:
    everything = [a for alloys in run.held.values() for a in alloys]
    tested = [a for a in everything if any(i.reaction is not None for i in a.immersions)]
    forces = [i.reaction for a in everything for i in a.immersions if i.reaction is not None]
    most = max((float(np.nanmax(f)) for f in forces if len(f)), default=0.0)
    corroded = [a for a in run.alloys if a.history or any(i.summary for i in a.immersions)]
    ratios = {
        name: alloys
        for name, alloys in run.held.items()
        if any(i.strength_ratio is not None for a in alloys for i in a.immersions)
    }
    first = [b for b in banded if b.hold == run.scene.holds[0].name]  # volume loss is alike in all
    errors = {hold.name: strength_error(run.scene, hold) for hold in run.scene.holds}
    return {
        "strength": [
            (
                HOLDINGS[name].part,
                Markup(
                    plots.strength_plot(
                        alloys, load, [b for b in banded if b.hold == name], name, errors[name]
                    )
                ),
                "" if errors[name] is None else percent(errors[name], 1),
            )
            for name, alloys in ratios.items()
        ],
        "volume_loss": Markup(plots.volume_loss_plot(run.alloys, measured, first))
        if corroded
        else "",
        "curves": [
            (f"{a.name}, {HOLDINGS[a.hold].part}", Markup(plots.load_plot(a, f"{n}", most, load)))
            for n, a in enumerate(tested)
        ],
    }


# ---------------------------------------------------------------- what it was made with


def _has(rows: list[provenance.ParameterRow], kind: str) -> bool:
    return any(row.kind == kind for row in rows)


def _solid_rows(run: RunResults) -> list[tuple[str, str]]:
    """Volume and area of solid and mesh with their differences, and the mesh's quality."""
    geometry, rows = run.geometry, []
    mesh = geometry.get("mesh", {})
    volume, area = geometry.get("volume"), geometry.get("area")
    if volume:
        rows.append(("Volume of the solid", f"{1e9 * volume:.4g} mm³"))
        against = "voxels" if "image" in geometry else "parameters"
        rows += _difference(f"… against its {against}", volume, geometry.get("reference_volume"))
        rows += _difference("… of the mesh against the solid", mesh.get("volume"), volume)
    if area:
        rows.append(("Surface of the solid", f"{1e6 * area:.4g} mm²"))
        if "image" not in geometry:  # an image has no other area
            rows += _difference("… against its parameters", area, geometry.get("reference_area"))
    if geometry.get("smallest_feature"):
        rows.append(("Smallest feature", format_length(geometry["smallest_feature"])))
    rows += image_rows(geometry.get("image"))
    if run.points is not None:
        rows += [("Mesh points", f"{len(run.points):,}"), ("Tetrahedra", f"{len(run.cells):,}")]
    for key, title, scale, unit in (
        ("min_shape", "Worst shape (1 regular, 0 flat)", 1.0, ""),
        ("mean_shape", "Mean shape", 1.0, ""),
        ("min_dihedral_angle", "Smallest dihedral angle", 1.0, "°"),
        ("max_dihedral_angle", "Largest dihedral angle", 1.0, "°"),
        ("mean_edge", "Mean edge", 1e6, " µm"),
    ):
        if isinstance(mesh.get(key), int | float):
            rows.append((title, f"{scale * mesh[key]:.3g}{unit}"))
    return rows


def _difference(title: str, value: object, reference: object) -> list[tuple[str, str]]:
    if not (isinstance(value, float) and isinstance(reference, float) and reference > 0):
        return []
    return [(title, f"{round(100 * (value / reference - 1), 2) + 0.0:+.2f} %")]


def _stage_times(run: RunResults) -> list[tuple[str, str, str]]:
    rows, load = [], LOADS[run.scene.tensile.load]
    for stage, title in STAGE_TITLES.items():
        seconds = [record.seconds for _, record in run.records if record.stage == stage]
        if seconds:
            title = title.format(test=load.test.capitalize())
            rows.append((title, str(len(seconds)), format_seconds(sum(seconds))))
    total = sum(record.seconds for _, record in run.records)
    return [*rows, ("Sum", "", format_seconds(total))] if rows else []


def _versions(run: RunResults) -> list[tuple[str, str]]:
    versions: dict[str, str] = {}
    for _, record in run.records:
        versions.update(record.versions)
    versions = versions or package_versions()
    for name in ("matplotlib", "pyvista", "vtk"):
        try:
            versions.setdefault(name, metadata.version(name))
        except metadata.PackageNotFoundError:
            continue
    return sorted(versions.items(), key=lambda item: (item[0] != "perilife", item[0].lower()))


def _machine() -> str:
    machine = describe_machine()
    return (
        f"{machine['processor']}, {machine['cores']} cores, "
        f"{format_bytes(machine['memory_bytes'])} memory, {platform.system()}"
    )
