"""The report of a run: one HTML file that stands alone, made from whatever the run folder holds.

`write_report` renders the pictures, draws the curves and fills `templates/report.html.j2`.  What
a run has not computed is said, never filled in.
"""

import base64
import logging
import math
import platform
import re
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

import perilife_data
from pipeline import plots, provenance
from pipeline.machine import describe_machine, package_versions
from pipeline.pictures import MAXIMUM_DAMAGE, PictureRequest, render_pictures, write_overview
from pipeline.resolution import RESOLUTIONS
from pipeline.run_folder import REPORT_FILE, utc_now, write_text
from pipeline.run_results import AlloyResult, ImmersionResult, RunResults, column, read_run
from pipeline.scene import ScrewGeometry
from pipeline.units import format_bytes, format_seconds

logger = logging.getLogger(__name__)

MOST_TIMES_SHOWN = 6
PICTURES_FOLDER = "pictures"
OVERVIEW_FILE = "overview.png"
STAGE_TITLES = {
    "geometry": "Solid and mesh",
    "corrode": "Corrosion",
    "map": "Damage onto the mesh",
    "pull": "Tensile tests",
    "report": "Report",
}
STATUS_WORDS = {
    "completed": "pulled to the end",
    "past_peak": "pulled past its peak",
    "severed": "severed: carries nothing",
    "fully_corroded": "fully corroded",
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
    pictures, picture_trouble = _pictures(run)
    measured, measured_trouble = _measured(run)
    trouble = [*measured_trouble]
    if picture_trouble:
        trouble.append(f"the pictures, completely: {picture_trouble}")
    references = provenance.references(rows)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(symbol=_symbol, unit=_unit)
    page = environment.get_template("report.html.j2").render(
        title=" and ".join(a.name for a in run.alloys),
        solid=_solid_in_words(run),
        headlines=[headline(alloy) for alloy in run.alloys],
        parameter_set=_parameter_set(run),
        preset=run.scene.resolution,
        table=[_table_row(a, i) for a in run.alloys for i in a.immersions if i.summary],
        pictures=pictures,
        damage_ramp=_damage_ramp(),
        plots=_plots(run, measured),
        measured=sorted(measured),
        checks=_checks(run),
        error_estimate=_error_estimate(run),
        twice_as_sure=_twice_as_sure(run),
        omissions=_omissions(run),
        assumptions=provenance.to_be_listed(rows),
        parameters=_grouped(rows),
        kinds=[(k, v) for k, v in provenance.kinds_explained().items() if _has(rows, k)],
        mesh_quality=_mesh_quality(run),
        stages=_stage_times(run),
        versions=_versions(run),
        machine=_machine(),
        references=references,
        numbers={key: n for n, key in enumerate(references, start=1)},
        missing=[*run.missing, *trouble],
        created=utc_now().replace("T", " ").replace("Z", " UTC"),
        folder=run.folder.resolve().name,
    )
    path = run.folder / REPORT_FILE
    write_text(path, page)
    return path


# ---------------------------------------------------------------- words


def headline(alloy: AlloyResult) -> str:
    """The answer for one alloy in one sentence, from what was tested."""
    tested = [i for i in alloy.immersions if i.strength_ratio is not None]
    immersed = [i for i in tested if i.seconds > 0]
    if not immersed:
        intact = [i for i in tested if i.seconds == 0]
        if intact and intact[0].summary:
            force = intact[0].summary.peak_force_N
            return (
                f"{alloy.name} was tested only before immersion; the intact solid carries "
                f"{_force(force)}."
            )
        return f"No tensile test of {alloy.name} is in this run."
    last = immersed[-1]
    halfway = [i for i in immersed[:-1] if i.strength_ratio > 0.0]
    parts = []
    if halfway:
        middle = min(halfway, key=lambda i: abs(math.log(i.seconds / (last.seconds / 3.0))))
        kept = percent(middle.strength_ratio)
        parts.append(f"{kept} of its strength after {duration(middle.seconds)}")
    gone = [i for i in immersed if i.strength_ratio == 0.0]
    if gone:
        ending = f"none after {duration(gone[0].seconds)}, when it no longer holds together"
    else:
        share = "" if parts else " of its strength"
        ending = f"{percent(last.strength_ratio)}{share} after {duration(last.seconds)}"
    parts.append(ending)
    sentence = f"{alloy.name} keeps " + " and ".join(parts)
    half = half_strength_time(alloy)
    if half is not None:
        sentence += f"; half of it is gone after about {duration(half, rough=True)}"
    return sentence + "."


def half_strength_time(alloy: AlloyResult) -> float | None:
    """Time (s) at which the strength ratio passes one half, linear between computed times."""
    known = [i for i in alloy.immersions if i.strength_ratio is not None]
    tested = [(i.seconds, i.strength_ratio) for i in known]
    for (t0, r0), (t1, r1) in zip(tested, tested[1:], strict=False):
        if r0 > 0.5 >= r1:
            return t0 + (r0 - 0.5) / (r0 - r1) * (t1 - t0)
    return None


def duration(seconds: float, rough: bool = False) -> str:
    """A time in words in the unit in which it is a whole number; `rough` rounds it."""
    if seconds == 0:
        return "0 weeks"
    for name, unit in (("week", 604800.0), ("day", 86400.0), ("hour", 3600.0)):
        count = seconds / unit
        whole = abs(count - round(count)) < 1e-6
        if whole or (rough and count >= 2):
            return f"{round(count)} {name}{'' if round(count) == 1 else 's'}"
    return f"{seconds:.4g} seconds"


def percent(fraction: float, digits: int = 0) -> str:
    """A fraction in per cent, with more digits where it would otherwise read as none or all."""
    value = 100.0 * fraction
    if digits == 0 and (0.0 < abs(value) < 0.95 or 99.5 <= value < 100.0 - 1e-6):
        digits = 2 if abs(value) < 0.095 else 1
    return f"{value:.{digits}f} %"


def _force(newton: float) -> str:
    return f"{newton:.0f} N" if newton >= 10 else f"{newton:.2g} N"


def _status(text: str) -> str:
    return STATUS_WORDS.get(text, text.replace("_", " "))


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


def _table_row(alloy: AlloyResult, item: ImmersionResult) -> dict[str, object]:
    row = item.summary
    ratio = item.strength_ratio
    return {
        "alloy": alloy.name,
        "first": item is next(i for i in alloy.immersions if i.summary),
        "rows": sum(1 for i in alloy.immersions if i.summary),
        "time": duration(item.seconds),
        "volume_loss": _or_dash(row.volume_loss, lambda v: percent(v, 1)),
        "damage": _or_dash(row.mean_corrosion_damage, lambda v: f"{v:.3f}"),
        "force": _or_dash(row.peak_force_N, _force),
        "ratio": _or_dash(row.strength_ratio, percent),
        "bar": 0.0 if ratio is None else 100.0 * min(max(ratio, 0.0), 1.0),
        "elongation": _or_dash(row.elongation_at_peak, lambda v: percent(v, 1)) if ratio else "–",
        "status": _status(row.status),
    }


def _symbol(text: str) -> Markup:
    """`D_int` with int as an index; `q1` likewise."""
    match = re.fullmatch(r"(\w)_?(\w+)", text)
    return Markup("<i>{}</i><sub>{}</sub>").format(*match.groups()) if match else _italic(text)


def _italic(text: str) -> Markup:
    return Markup("<i>{}</i>").format(text)


def _unit(text: str) -> str:
    """`mol/m^3` with a raised 3, `1e-5` left alone."""
    raised = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
    return re.sub(r"\^(-?\d+)", lambda match: match.group(1).translate(raised), text)


def _or_dash(value: float, write) -> str:
    return write(value) if math.isfinite(value) else "–"


def times_shown(alloy: AlloyResult) -> list[ImmersionResult]:
    """The times that pictures show: all that have a damage map, thinned out to six."""
    mapped = [item for item in alloy.immersions if item.damage is not None]
    if len(mapped) <= MOST_TIMES_SHOWN:
        return mapped
    picks = np.linspace(0, len(mapped) - 1, MOST_TIMES_SHOWN).round().astype(int)
    return [mapped[n] for n in picks]


def _pictures(run: RunResults) -> tuple[list[tuple[str, list[PictureColumn]]], str]:
    """Render the pictures; return them by alloy, and "" or what went wrong."""
    folder = run.folder / PICTURES_FOLDER
    requests, places = [], {}
    if run.points is not None:
        for alloy in run.alloys:
            for item in times_shown(alloy):
                for cut in (False, True):
                    path = folder / f"{alloy.name}_{item.label}_{'cut' if cut else 'whole'}.png"
                    path.unlink(missing_ok=True)
                    places[alloy.name, item.label, cut] = path
                    if item.damage.shape[0] == len(run.cells):
                        requests.append(PictureRequest(item.damage, path, cut))
    trouble = render_pictures(run.points, run.cells, requests)
    result = []
    for alloy in run.alloys:
        columns = []
        for item in times_shown(alloy) if places else []:
            ratio = item.strength_ratio
            caption = "" if ratio is None else f"{percent(ratio)} left"
            if ratio == 0.0 and item.summary:
                caption = _status(item.summary.status)
            views = [_embed(places[alloy.name, item.label, c], alloy, item, c) for c in (0, 1)]
            if any(views):
                columns.append(PictureColumn(duration(item.seconds), caption, *views))
        if columns:
            result.append((alloy.name, columns))
    if result:
        write_overview(run, places, run.folder / OVERVIEW_FILE)
    return result, trouble


def _embed(path: Path, alloy: AlloyResult, item: ImmersionResult, cut: bool) -> Picture | None:
    try:
        content = base64.b64encode(path.read_bytes()).decode()
    except OSError:
        return None
    view = "cut in half" if cut else "whole"
    text = f"{alloy.name} after {duration(item.seconds)}, {view}, coloured by corrosion damage"
    return Picture(f"data:image/png;base64,{content}", text)


def _damage_ramp() -> dict[str, object]:
    from pipeline.pictures import DAMAGE_COLOURS

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


def _plots(run: RunResults, measured: dict) -> dict[str, object]:
    tested = [a for a in run.alloys if any(i.force is not None for i in a.immersions)]
    forces = [i.force for a in run.alloys for i in a.immersions if i.force is not None]
    most = max((float(np.nanmax(f)) for f in forces if len(f)), default=0.0)
    corroded = [a for a in run.alloys if a.history or any(i.summary for i in a.immersions)]
    ratios = [i for a in run.alloys for i in a.immersions if i.strength_ratio is not None]
    return {
        "strength": Markup(plots.strength_plot(run.alloys)) if ratios else "",
        "volume_loss": Markup(plots.volume_loss_plot(run.alloys, measured)) if corroded else "",
        "curves": [
            (a.name, Markup(plots.force_elongation_plot(a, f"{n}", most or 1.0)))
            for n, a in enumerate(tested)
        ],
    }


# ---------------------------------------------------------------- how sure, at what cost


def _checks(run: RunResults) -> list[dict[str, str]]:
    """Measured checks of this run: what, how large, what it means."""
    checks = []
    for alloy in run.alloys:
        error = column(alloy.history, "balance_error")
        if error is not None and len(error):
            checks.append(
                {
                    "what": f"Mass balance of the corrosion of {alloy.name}",
                    "value": f"{np.nanmax(np.abs(error)):.1e}",
                    "meaning": "largest part of the metal's amount that appears or vanishes in "
                    "the computation; round-off is about 1e-12",
                }
            )
    checks += _map_checks(run)
    return checks


def _map_checks(run: RunResults) -> list[dict[str, str]]:
    found = []
    for alloy in run.alloys:
        differences = [
            (abs(value), item)
            for item in alloy.immersions
            for key, value in item.map_numbers.items()
            if "difference" in key and isinstance(value, int | float) and math.isfinite(value)
        ]
        if differences:
            worst, item = max(differences, key=lambda pair: pair[0])
            found.append(
                {
                    "what": f"Lost mass of {alloy.name} on the mesh against the lattice",
                    "value": percent(worst, 2),
                    "meaning": f"largest difference, after {duration(item.seconds)}; what the "
                    "change from lattice to mesh does to the damage",
                }
            )
    return found


def _error_estimate(run: RunResults) -> str:
    """The measured error of the preset where the scene carries one, else that there is none."""
    estimate = run.scene_extras.get("error_estimate")
    if estimate:
        return str(estimate)
    name = run.scene.resolution
    preset = f"the preset “{name}”" if name in RESOLUTIONS else "these settings"
    return (
        f"The discretisation error of {preset} in the strength left has not been measured yet. "
        "Until it is, read the numbers as a comparison of alloys and times, not as a prediction."
    )


def _twice_as_sure(run: RunResults) -> str:
    """What halving the discretisation error would cost, from the run's own times."""
    seconds = {}
    for _, record in run.records:
        seconds[record.stage] = seconds.get(record.stage, 0.0) + record.seconds
    corrosion, pulls = seconds.get("corrode"), seconds.get("pull")
    if not corrosion or not pulls:
        return "The run times needed for an estimate are not in this run."
    return (
        "Halving the spacing of the lattice, the edge length of the mesh and the time step means "
        "8 times the nodes and cells and twice the steps. From the times of this run: corrosion "
        f"{format_seconds(corrosion)} → about {format_seconds(16 * corrosion)}, tensile tests "
        f"{format_seconds(pulls)} → about {format_seconds(8 * pulls)} or more. That halves the "
        "error if it falls in proportion to the spacing, an assumption which this run does not "
        "test. No computation makes the assumed strengths of the alloys below any surer: that "
        "takes a tensile test of the bar the screw is cut from."
    )


def _omissions(run: RunResults) -> list[dict[str, str]]:
    """What the plan left out, with its bound, from the records of the corrosion stage."""
    found = []
    for alloy in run.alloys:
        entries = alloy.corrosion_numbers.get("omissions", [])
        for entry in entries if isinstance(entries, list) else []:
            if isinstance(entry, dict):
                found.append({"alloy": alloy.name, **{k: str(v) for k, v in entry.items()}})
    return found


# ---------------------------------------------------------------- what it was made with


def _grouped(rows: list[provenance.ParameterRow]) -> list[tuple[str, list]]:
    groups: dict[str, list] = {}
    for row in rows:
        groups.setdefault(row.group, []).append(row)
    return list(groups.items())


def _has(rows: list[provenance.ParameterRow], kind: str) -> bool:
    return any(row.kind == kind for row in rows)


def _mesh_quality(run: RunResults) -> list[tuple[str, str]]:
    """Counts and everything that the geometry stage measured, as text."""
    rows = []
    if run.points is not None:
        rows += [("Mesh points", f"{len(run.points):,}"), ("Tetrahedra", f"{len(run.cells):,}")]
    return rows + list(_flat("", run.geometry))


def _flat(prefix: str, content: dict):
    for key, value in content.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, dict):
            yield from _flat(f"{name}: ", value)
        elif isinstance(value, float):
            yield name, f"{value:.5g}"
        elif isinstance(value, int | str):
            yield name, str(value)


def _stage_times(run: RunResults) -> list[tuple[str, str, str]]:
    rows = []
    for stage, title in STAGE_TITLES.items():
        seconds = [record.seconds for _, record in run.records if record.stage == stage]
        if seconds:
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
