"""All doubts of the strength left side by side: how much of its variance each source carries."""

from __future__ import annotations

import math

from pipeline.record.doubts import HoldDoubts, Source
from pipeline.record.run_results import RunResults
from pipeline.report.doubts import own_errors
from pipeline.report.wording import duration, percent
from pipeline.scene.errors import corrosion_error, tensile_error
from pipeline.scene.holding import HOLDINGS

GRIPS = "grips"
_EVEN = math.sqrt(3.0)
"""A bound over this is the standard deviation of what lies evenly within the bound."""

SYMBOLS = {
    "interface_diffusivity": "D_int",
    "liquid_diffusivity": "D_liq",
    "saturation_concentration": "C_sat",
    "volume_loss_scale": "l",
}


def share_tables(run: RunResults, found: list[HoldDoubts]) -> list[dict[str, object]]:
    """One table per alloy and way of holding: title, rows, and what to measure next."""
    return [
        {
            "title": f"{one.alloy}, {HOLDINGS[one.hold].part}: {percent(one.strength_left, 1)} "
            f"left after {duration(86400.0 * one.immersion_days)}",
            "rows": _rows(run, one),
            "constants": [
                (SYMBOLS.get(name, name), percent(share)) for name, share in one.constants.items()
            ],
            "scatter": percent(one.scatter, 2),
            "now": _deviations(one.now.volume_loss, one.now.strength_left),
            "after": [
                (duration(86400.0 * row.days), *_deviations(row.volume_loss, row.strength_left))
                for row in one.after
            ],
        }
        for one in found
    ]


def _deviations(*values: float) -> tuple[str, ...]:
    return tuple(f"{100 * value:.2f}" for value in values)


def all_sources(run: RunResults, one: HoldDoubts) -> list[Source]:
    """Sources of the file, then what presets and the other ways of holding add; grips last."""
    hold = next(h for h in run.scene.holds if h.name == one.hold)
    lattice, mesh = corrosion_error(run.scene), tensile_error(run.scene, hold)
    sources = list(one.sources)
    unknown = "not measured for these settings"
    bound = None if lattice is None else abs(one.slope) * lattice.of(one.alloy) * one.volume_loss
    basis = unknown
    if lattice is not None:
        basis = f"{percent(lattice.of(one.alloy), 1)} of the volume loss at most"
    elif one.alloy in (own := own_errors(run)):
        bound = abs(one.slope) * own[one.alloy] * one.volume_loss
        basis = f"about {percent(own[one.alloy], 2)} of the volume loss by the run's own check"
    sources.append(_bounded("lattice and time steps", bound, one.strength_left, basis))
    error = None if mesh is None else mesh.of(one.alloy)
    bound = None if error is None else error * one.strength_left
    basis = unknown if error is None else f"{percent(error, 1)} of the strength left at most"
    sources.append(_bounded("mesh and increments", bound, one.strength_left, basis))
    return [*sources, _grips(run, one)]


def _bounded(name: str, bound: float | None, value: float, basis: str) -> Source:
    if bound is None:
        return Source(name, None, None, None, basis)
    return Source(name, bound / _EVEN, value - bound, value + bound, basis)


def _grips(run: RunResults, one: HoldDoubts) -> Source:
    """What the other ways of holding of the run give for the same alloy and time."""
    kept = {
        name: item.strength_ratio
        for name, alloys in run.held.items()
        for alloy in alloys
        for item in alloy.immersions
        if alloy.name == one.alloy
        and abs(item.seconds / 86400.0 - one.immersion_days) < 1e-6
        and item.strength_ratio is not None
    }
    if len(kept) < 2:
        return Source(GRIPS, None, None, None, "one way of holding only; --hold all tests each")
    ends = min(kept.values()), max(kept.values())
    words = ", ".join(f"{name} {percent(value, 1)}" for name, value in kept.items())
    return Source(GRIPS, (ends[1] - ends[0]) / math.sqrt(12.0), *ends, words)


def _rows(run: RunResults, one: HoldDoubts) -> list[dict[str, str]]:
    """Rows for a reader; the share is that of the variance of all sources but the grips."""
    sources = all_sources(run, one)
    total = sum(s.deviation**2 for s in sources if s.deviation is not None and s.name != GRIPS)
    rows = []
    for source in sources:
        share = "–"
        if source.deviation is not None and source.name != GRIPS and total > 0:
            share = percent(source.deviation**2 / total)
        ends = "–"
        if source.low is not None:
            ends = f"{100 * source.low:.1f} to {100 * source.high:.1f} %"
        deviation = "–" if source.deviation is None else f"{100 * source.deviation:.2f}"
        rows.append(
            {
                "source": source.name,
                "ends": ends,
                "deviation": deviation,
                "share": share,
                "basis": source.basis,
            }
        )
    return rows
