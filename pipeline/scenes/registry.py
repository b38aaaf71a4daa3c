"""The scenes of localised corrosion by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from perilife_data import did_you_mean
from pipeline.scene.units import format_length
from pipeline.scenes import couples, crevices, grains, implants, pits, pits_2d
from pipeline.scenes.outcome import Prepared


@dataclass(frozen=True)
class Entry:
    """A scene.

    title : one line.  times : output times as one types them.  spacings : the finest and the
    coarsest that it takes, m.  prepare : from a spacing (m; None: the scene's own) to what can be
    run.
    """

    title: str
    times: tuple[str, ...]
    spacings: tuple[float, float]
    prepare: Callable[[float | None], Prepared]


SCENES: dict[str, Entry] = {
    "galvanic-ae44-steel": Entry(
        "magnesium AE44 beside mild steel in brine, 3 days",
        ("0s", "1d", "2d", "3d"),
        (0.02e-3, 1e-3),
        partial(couples.ae44, "mild-steel"),
    ),
    "galvanic-ae44-aa6063": Entry(
        "magnesium AE44 beside aluminium AA6063 in brine, 3 days",
        ("0s", "1d", "2d", "3d"),
        (0.02e-3, 1e-3),
        partial(couples.ae44, "AA6063"),
    ),
    "galvanic-slab": Entry(
        "plates 0.1 m apart, one dissolves: a closed form is known",
        ("0s", "10d", "30d", "100d", "365d"),
        (0.1e-3, 5e-3),
        couples.slab,
    ),
    "crevice-625": Entry(
        "crevice of alloy 625, seed of 3 mm, 72 h, as a film",
        ("0s", "1h", "4h", "12h", "24h", "30h", "48h", "72h"),
        (1e-6, 0.2e-3),
        crevices.crevice,
    ),
    "pit-pencil": Entry(
        "pencil electrode of 304 steel at 5,100 A/m2 until a salt layer holds it back",
        ("0s", "500s", "1000s", "1500s", "2000s"),
        (0.5e-6, 20e-6),
        pits.pencil,
    ),
    "pit-304": Entry(
        "304 steel under a mask with an opening of 40 um, 1e4 A/m2, 10 minutes",
        ("0s", "100s", "200s", "300s", "600s"),
        (2e-6, 10e-6),
        pits_2d.masked,
    ),
    "pit-lacy": Entry(
        "304 steel that is passive in dilute liquid: a pit under its lacy cover, 83 s",
        ("0s", "20s", "40s", "83s"),
        (1e-6, 5e-6),
        pits_2d.lacy,
    ),
    "intergranular": Entry(
        "elongated grains of aluminium: their boundaries dissolve fifty times faster, 5 h",
        ("0s", "1h", "2h", "5h"),
        (0.5e-6, 2e-6),
        grains.intergranular,
    ),
    "screw-in-titanium-plate": Entry(
        "magnesium screw in a titanium plate, coupled and insulated: metal and strength, 8 weeks",
        ("0w", "1w", "2w", "4w", "8w"),
        (50e-6, 105e-6),
        implants.screw_in_plate,
    ),
}


def entry_of(name: str) -> Entry:
    """The scene of a name; ValueError that names the known ones."""
    if name not in SCENES:
        near, known = did_you_mean(name, SCENES), ", ".join(SCENES)
        raise ValueError(f"scene '{name}' is not known{near}; it must be one of {known}")
    return SCENES[name]


def check_spacing(name: str, spacing: float | None) -> None:
    """ValueError where a scene does not take a spacing (m)."""
    finest, coarsest = entry_of(name).spacings
    if spacing is not None and not finest * (1 - 1e-9) <= spacing <= coarsest * (1 + 1e-9):
        raise ValueError(
            f"spacing is {format_length(spacing)}; scene '{name}' takes "
            f"{format_length(finest)} to {format_length(coarsest)}"
        )
