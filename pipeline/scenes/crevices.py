"""The crevice of alloy 625 as a film: 72 h between washers (Jafarzadeh et al. 2022)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from peri.corrosion.acidity import AcidityLaw
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping, march
from peri.engine.omission import Omission
from peri.engine.results import Field
from peri.omissions.thin_gap import COLUMNS, ThinGap, ThinGapProblem, potential_along
from peri.transport.potential.conductivity import IonConductivity
from pipeline.scene.units import format_length
from pipeline.scenes.keys import TEXT, Given, Key, positive
from pipeline.scenes.outcome import HERE, Curve, Marchers, Outcome, Panel, Prepared

LENGTH, MOST = 12.7e-3, 5600.0
LAWS = ("acidity-625", "constant")
MOST_UNEVEN = 0.1
"""Relative unevenness of the concentration across a gap beyond which it is no film."""
PUBLISHED_DIFFUSIVITY_FACTOR, PUBLISHED_CURRENT_FACTOR = 0.2176, 7.57
"""What the printed lattice (25:1, m = 4) makes of the diffusivity along the crevice and of the
interface's flux."""


def crevice_625(
    seed: float,
    nodes: int,
    diffusivity_factor: float = 1.0,
    current_factor: float = 1.0,
    charge_number: float = 2.5,
) -> ThinGap:
    """The washer of alloy 625 of Jafarzadeh et al. 2022: 12.7 mm, 25 um at the mouth, 5 um inside.

    seed : m from the closed end that start at 0.99 C_sat.  z is not printed; 2.5 is assumed.
    The factors stand for a lattice that does not conserve the diffusivity.
    """
    place = (np.arange(nodes) + 0.5) * LENGTH / nodes
    return ThinGap(
        LENGTH,
        gap=25e-6 - 20e-6 * place / LENGTH,
        concentration=np.where(place > LENGTH - seed, 0.99 * MOST, 0.0),
        law=AcidityLaw(MOST, factor=current_factor),
        charge_number=charge_number,
        diffusivity=7.2e-10 * diffusivity_factor,
        solid_concentration=1.4e5,
        saturation_concentration=MOST,
    )


KEYS: dict[str, Key] = {
    "lattice.spacing": positive("length", "of the film equation's nodes along the gap", "12.5um"),
    "geometry.length": positive("length", "from the mouth to the closed end", "12.7mm"),
    "geometry.gap_at_mouth": positive("length", "width of the gap", "25um"),
    "geometry.gap_at_end": positive("length", "width of the gap at the closed end", "5um"),
    "geometry.seed": Key("length", "from the closed end, liquid that starts acid", "3mm",
                         at_least=0.0),
    "geometry.seed_concentration": positive(
        "dimensionless", "of the seed, over C_sat (0.99)", 0.99, at_most=1.0
    ),
    "liquid.saturation_concentration": positive("concentration", "C_sat", "5600 mol/m^3"),
    "liquid.diffusivity": positive("diffusivity", "of the metal's ions", "7.2e-10 m^2/s"),
    "liquid.conductivity": positive(
        "conductivity", "without the metal's ions: says the drop of the potential", "5 S/m"
    ),
    "metal.solid_concentration": positive("concentration", "C_solid", "140000 mol/m^3"),
    "metal.charge_number": positive("dimensionless", "z of its ions; no source prints one", 2.5),
    "metal.law": Key(
        TEXT, "acidity-625: current by the ions' concentration of alloy 625; constant", "constant",
        allowed=LAWS,
    ),
    "metal.current_density": positive("current density", "of law constant", "1 A/m^2"),
    "metal.current_factor": positive("dimensionless", "of law acidity-625 (1)", 1.0),
}  # fmt: skip
"""Keys of a crevice's file."""


@dataclass(frozen=True)
class ConstantCurrent:
    """The same current density at any concentration, A/m^2."""

    density: float

    def current(self, concentration: np.ndarray) -> np.ndarray:
        """A/m^2."""
        return np.full(np.shape(concentration), self.density)

    def slope(self, concentration: np.ndarray) -> np.ndarray:
        """0."""
        return np.zeros(np.shape(concentration))


def _law(given: Given, most: float) -> AcidityLaw | ConstantCurrent:
    if given.text("metal.law") == "constant":
        return ConstantCurrent(given.number("metal.current_density"))
    factor = given.otherwise("metal.current_factor", 1.0, "1", "as fitted")
    try:
        return AcidityLaw(most, factor=factor)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{given.file}: liquid.{error}") from None


def prepare(given: Given) -> Prepared:
    """A crevice in a file, ready to run as a film.

    Raises ValueError for what is missing or does not fit, and for more than 1e6 nodes.
    """
    length, spacing = given.number("geometry.length"), given.number("lattice.spacing")
    if not 2 * spacing * (1 - 1e-9) <= length <= 1e6 * spacing:
        raise ValueError(
            f"{given.file}: lattice.spacing is {format_length(spacing)}; it must be from a "
            f"millionth to half of the length of {format_length(length)}"
        )
    nodes = round(length / spacing)
    place = (np.arange(nodes) + 0.5) / nodes
    mouth, end = given.number("geometry.gap_at_mouth"), given.number("geometry.gap_at_end")
    seed, most = given.number("geometry.seed"), given.number("liquid.saturation_concentration")
    if seed > length:
        raise ValueError(
            f"{given.file}: geometry.seed is {format_length(seed)}; it must be at most the length "
            f"of {format_length(length)}"
        )
    share = given.otherwise("geometry.seed_concentration", 0.99, "1", "0.99 of saturation")
    scene = ThinGap(
        length,
        gap=mouth + (end - mouth) * place,
        concentration=np.where(place * length > length - seed, share * most, 0.0),
        law=_law(given, most),
        charge_number=given.number("metal.charge_number"),
        diffusivity=given.number("liquid.diffusivity"),
        solid_concentration=given.number("metal.solid_concentration"),
        saturation_concentration=most,
    )
    uneven = scene.bound(length**2 / scene.diffusivity)
    if uneven > MOST_UNEVEN:
        raise ValueError(
            f"{given.file}: geometry.gap_at_mouth is {format_length(mouth)}, geometry.gap_at_end "
            f"{format_length(end)}: the concentration differs across the gap by up to "
            f"{100 * uneven:.2g} %, which a film leaves out; it must be {100 * MOST_UNEVEN:g} % at "
            "most (narrower, longer, or less current)"
        )
    conducts = None
    if "liquid.conductivity" in given:
        medium = given.number("liquid.conductivity")
        conducts = IonConductivity(medium, scene.charge_number, scene.diffusivity)
    given.left_over()

    def reductions(end: float) -> list[Omission]:
        text = "one equation along the gap: its concentration is even across it"
        held = "a stretch at saturation has a known concentration, its current follows from it"
        return [
            Omission("width of the gap", text, scene.bound(end), True, "the concentration"),
            Omission("saturated stretch", held, 0.0, True, "what is lost"),
        ]

    size = f"{nodes:,} nodes along the gap"
    march = functools.partial(_march, scene, conducts)
    alone = "the film equation has no lattice to share out"
    return Prepared(given.values, march, {}, reductions, size, alone)


def _march(
    scene: ThinGap,
    conducts: IonConductivity | None,
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
    by: Marchers = HERE,  # a film has no lattice to share
) -> Outcome:
    done = march(
        ThinGapProblem(scene), times, TimeStepping(rate_change=0.1),
        checkpoint=checkpoint, resume=resume, progress=progress,
    )  # fmt: skip
    cell = scene.length / scene.gap.size
    lattice = Lattice((0.5 * cell,), (cell,), scene.gap.shape)
    gap, concentration, speed = (
        np.array([out[name] for out in done.outputs]) for name in ("gap", "concentration", "speed")
    )
    over = ("time", "x")
    fields = {
        "gap": Field(gap, "m", over),
        "depth": Field(gap - scene.gap, "m", over),
        "concentration": Field(concentration, "mol/m3", over),
        "speed": Field(speed, "m/s", over),
    }
    history, hour, x = done.history, 3600.0, 1e3 * scene.places
    labels = [f"{t / hour:.3g} h" for t in done.times]
    # At first the whole seed dissolves alike, at no site.
    later = history["time"] >= 0.005 * done.times[-1]
    site = Curve("active site", history["time"][later] / hour, 1e3 * history["active_site"][later])
    panels = [
        Panel(
            "Depth", "from the mouth / mm", "depth / um",
            [Curve(n, x, 1e6 * d) for n, d in zip(labels, gap - scene.gap, strict=True)],
        ),
        Panel(
            "Metal ions", "from the mouth / mm", "C / (mol/m³)",
            [Curve(n, x, c) for n, c in zip(labels, concentration, strict=True)],
        ),
        Panel("Track of the active site", "time / h", "from the mouth / mm", [site]),
    ]  # fmt: skip
    last = {name: float(values[-1]) for name, values in history.items()}
    drops = {}
    if conducts is not None:
        out = done.outputs[-1]
        phi = potential_along(scene, out, conducts.of(out["concentration"]))
        drops["potential of the closed end above the mouth"] = (float(phi[-1]), "V")
    summary = {
        **drops,
        "area lost": (last["lost"], "m2"),
        "deepest": (last["deepest"], "m"),
        "active site from the mouth": (last["active_site"], "m"),
        "share saturated": (last["saturated_share"], "1"),
        "unevenness across the gap, bound": (scene.bound(float(done.times[-1]) or 1.0), "1"),
        "balance left open, largest": (float(np.abs(history["balance_error"]).max()), "1"),
    }
    units = {"time": "s", "step": "s", **COLUMNS, "iterations": "1"}
    return Outcome(lattice, done.times, fields, history, units, summary, panels, done.wall_time)
