"""How a run was held and how sure its numbers are: for a program, and in a line for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.record.run_results import RunResults
from pipeline.report.doubts import own_errors
from pipeline.report.wording import percent
from pipeline.scene.errors import corrosion_error, tensile_error
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.scene import HoldScene, Scene
from pipeline.scene.units import format_length

NOT_MEASURED = (
    "not measured for this solid and these settings; a run with half of --spacing and --mesh-size "
    "shows it"
)
OWN_CHECK = "found by the run itself, of the sampling of its surface alone"


@dataclass(frozen=True)
class Sure:
    """How sure a quantity is, as far as it was measured: what the report's sentence says.

    quantity: volume_loss or strength_left; alloy: of the run; hold: way of holding, None of the
    volume loss; relative_error: of the value, by lattice and time steps or by mesh and increments,
    None where it was not measured; source: the command that measured it, or why there is none;
    measured_of: alloys of the reference screw that it was measured of, none where of this run;
    settings: what it was measured with in place of the run's, in words.
    """

    quantity: str
    alloy: str
    hold: str | None
    relative_error: float | None
    source: str
    measured_of: tuple[str, ...] = ()
    settings: str = ""


def held(scene: Scene) -> list[dict[str, object]]:
    """Each way of holding: what it tests, its question, and what the grips hold, m."""
    return [
        {
            "name": hold.name,
            "part": HOLDINGS[hold.name].part,
            "question": HOLDINGS[hold.name].question,
            "grips": in_grips(hold),
            "bottom_grip": hold.tensile.bottom_grip,
            "top_grip": hold.tensile.top_grip,
        }
        for hold in scene.holds
    ]


def in_grips(hold: HoldScene) -> str:
    """What the grips hold, with their depths, in words."""
    depths = (_depth(hold.tensile.bottom_grip), _depth(hold.tensile.top_grip))
    return f"{HOLDINGS[hold.name].grips} (bottom {depths[0]}, top {depths[1]})"


def _depth(length: float) -> str:
    return format_length(length).replace("um", "µm") if length > 0 else "its face"


def how_sure(run: RunResults) -> list[Sure]:
    """The errors of volume loss and strength left of each alloy, the latter in each way of holding.

    None of a run that has no immersion: nothing is lost, and all is left.
    """
    if not run.scene.immersion[-1].seconds > 0:
        return []
    return [*_of_volume_loss(run), *(row for hold in run.scene.holds for row in _of(run, hold))]


def _of_volume_loss(run: RunResults) -> Iterator[Sure]:
    own, known = own_errors(run), corrosion_error(run.scene)
    for alloy in run.scene.alloys:
        named = ("volume_loss", alloy.name, None)
        if alloy.name in own:
            yield Sure(*named, own[alloy.name], OWN_CHECK)
        if known is not None:
            yield Sure(*named, known.of(alloy.name), known.command, tuple(known.time))
        if known is None and alloy.name not in own:
            yield Sure(*named, None, NOT_MEASURED)


def _of(run: RunResults, hold: HoldScene) -> Iterator[Sure]:
    known = tensile_error(run.scene, hold)
    for alloy in run.scene.alloys:
        named = ("strength_left", alloy.name, hold.name)
        if known is None:
            yield Sure(*named, None, NOT_MEASURED)
        else:
            error = known.of(alloy.name)
            yield Sure(*named, error, known.command, known.alloys, known.settings)


def in_lines(run: RunResults) -> dict[str | None, str]:
    """How sure the strength left is by way of holding, and the volume loss by None; a line each."""
    sources: dict[str | None, dict[str, list[Sure]]] = {}
    for row in how_sure(run):
        sources.setdefault(row.hold, {}).setdefault(_source(row), []).append(row)
    return {
        hold: "; ".join(_errors(rows) + source for source, rows in by_source.items())
        for hold, by_source in sources.items()
    }


def _errors(rows: list[Sure]) -> str:
    """The errors of several alloys from one source."""
    errors = [
        f"{percent(row.relative_error, 1 if row.relative_error >= 1e-3 else 2)} ({row.alloy})"
        for row in rows
        if row.relative_error is not None
    ]
    bound = "within" if rows[0].measured_of else "off by about"
    return f"{bound} {', '.join(errors)} of its value, " if errors else ""


def _source(row: Sure) -> str:
    """Where an error is from, for a reader."""
    if not row.measured_of:
        return row.source
    there = "" if row.alloy in row.measured_of else f" of {' and '.join(row.measured_of)}"
    by = f" by {row.settings}" if row.settings else ""
    return f"measured on the reference screw{there}{by}"


def in_words(run: RunResults) -> list[str]:
    """What the strength left is of, how the solid was held, and how sure each number is; lines."""
    sure, lines = in_lines(run), []
    for hold in run.scene.holds:
        lines.append(f"{hold.name}: {HOLDINGS[hold.name].part}, held at {in_grips(hold)}")
        if hold.name in sure:
            lines.append(f"  how sure: strength left {sure[hold.name]}")
    lines.append("strength left: of the same solid, held alike, before immersion")
    if None in sure:
        lines.append(f"volume loss: {sure[None]}")
    return lines
