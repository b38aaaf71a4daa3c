"""Scenes of galvanic couples: AE44 beside steel or AA6063, and plates with a growing gap."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from peri.coupled.galvanic import ROBIN, GalvanicResult, GalvanicScene, Metal, Renewal
from peri.coupled.wagner import OMITTABLE, corrode_lean, couple_omissions
from peri.engine.lattice import Lattice
from peri.engine.omission import DEFAULT_TOLERANCE
from peri.engine.results import Field, axes_of
from peri.transport.potential.polarization import Insulated, Polarization
from perilife_data import common_reference, load_electrode
from pipeline.scene.laws.polarization import polarization_law
from pipeline.scene.units import format_length
from pipeline.scenes.bodies import body_solid, nodes_of, thinnest_gap
from pipeline.scenes.keys import TEXT, Given, Key, positive
from pipeline.scenes.lattices import LATTICE_KEYS, horizon_of, lattice_between
from pipeline.scenes.metals import (
    ION_KEYS,
    LIQUID_KEYS,
    METAL_KEYS,
    Beside,
    conductivity,
    ions_of,
    metals_of,
)
from pipeline.scenes.outcome import HERE, Curve, Marchers, Outcome, Panel, Prepared

if TYPE_CHECKING:
    from pipeline.geometry.surface import Solid

CONDUCTIVITY = 2.5
ANODE_CONCENTRATION = 67860.0
CHARGE_NUMBER = 2.0
HORIZON = 0.4e-3
KEYS: dict[str, Key] = {
    **LATTICE_KEYS,
    "lattice.low": Key("length", "lowest corner of the box", ["0mm", "0mm"], several=True),
    "lattice.high": Key("length", "its highest corner", ["20mm", "15mm"], several=True),
    "lattice.narrow_gaps": Key(
        TEXT,
        "gaps under two horizons: refused (left out), or accepted (between plates currents are "
        "exact down to one horizon and 7 % low at half of one)",
        "accepted",
        allowed=("refused", "accepted"),
    ),
    **{f"liquid.{name}": key for name, key in LIQUID_KEYS.items()},
    **{f"ions.{name}": key for name, key in ION_KEYS.items()},
    **{f"metals.*.{name}": key for name, key in METAL_KEYS.items()},
    "potential.robin": Key(
        TEXT,
        "how a law meets the liquid: conservative (left out), or as_published, by mirror nodes, to "
        "be compared with",
        "as_published",
        allowed=ROBIN,
    ),
    "time.travel": positive(
        "dimensionless",
        "how far the fastest surface recedes before the potential is renewed, in spacings (0.1)",
        0.1,
        at_most=1.0,
    ),
    "reduce.tolerance": Key(
        "dimensionless",
        "bound up to which something is left out (1e-3); 0: nothing",
        1e-3,
        at_least=0.0,
        at_most=0.5,
    ),
    "reduce.keep": Key(
        TEXT,
        "what is computed whatever its bound",
        ["potential", "kinetics", "ions", "renewal"],
        allowed=OMITTABLE,
        several=True,
    ),
    "time.conductivity_change": positive(
        "dimensionless", "of the liquid in a step, by its ions, over itself (0.1)", 0.1, at_most=1.0
    ),
    "time.longest_step": positive("time", "of a step (none)", "6h"),
}
"""Keys of a couple's file."""
_UNITS_OF_CURRENT = ("A/m2", "A/m", "A")
FIELD_UNITS = {
    "concentration": "mol/m3",
    "metal": "",
    "potential": "V",
    "current_density": "A/m2",
    "electrode_potential": "V",
    "ions": "mol/m3",
    "salt": "mol/m3",
    "conductivity": "S/m",
}
"""Of what a couple's march gives."""


def ae44_scene(
    cathode: str,
    spacing: float = 0.1e-3,
    horizon: float = HORIZON,
    as_published: bool = False,
    robin: str = ROBIN[0],
) -> GalvanicScene:
    """AE44 beside a cathode, both 10 mm wide and 5 mm thick, under 10 mm of brine.

    Zhao et al. 2021, 4: a cell of 20 x 10 mm, the joint in the middle of its lower side.

    cathode : name of an electrode.  horizon : m; at least two spacings.  robin : see GalvanicScene.
    """
    shape = (round(20e-3 / spacing), round(15e-3 / spacing))
    lattice = Lattice((0.5 * spacing,) * 2, (spacing,) * 2, shape)
    x, y = lattice.coordinates()
    solid = np.broadcast_to(y < 5e-3, shape)
    anode = load_electrode("AE44")
    other = load_electrode(cathode)
    common_reference([anode, other])
    law = polarization_law(anode, as_published)
    metals = (
        Metal(other.name, solid & (x < 10e-3), polarization_law(other, as_published)),
        Metal(anode.name, solid & (x > 10e-3), law, ANODE_CONCENTRATION, CHARGE_NUMBER),
    )
    return GalvanicScene(lattice, horizon, metals, CONDUCTIVITY, robin=robin)


def build(
    given: Given, insulated: bool = False, cathodes: float = 1.0
) -> tuple[GalvanicScene, dict[str, Solid], Beside]:
    """The scene that a file describes, the solids of its metals, the data that it uses.

    insulated : no current enters the liquid anywhere.  cathodes : factor of the current of metals
    that do not dissolve.

    Raises ValueError for what does not fit, metals that overlap among it.
    """
    beside = Beside()
    low = given["lattice.low"]
    assert isinstance(low, list)
    lattice = lattice_between(given, low, given.vector("lattice.high", len(low)))
    horizon = horizon_of(given)
    solids, nodes = {}, {}
    for name in given.names("metals"):
        solid = body_solid(given, f"metals.{name}", len(low))
        nodes[name] = nodes_of(given, f"metals.{name}", lattice, solid)
        if solid is not None:
            solids[name] = solid
    if not nodes:
        raise ValueError(f"{given.file}: [metals.NAME] is missing; a couple has metals")
    metals, _ = metals_of(given, nodes, beside)
    kappa = conductivity(given, beside)
    ions = None if insulated else ions_of(given, metals, lattice, float(np.max(horizon)), kappa)
    if insulated:
        metals = tuple(replace(metal, law=Insulated()) for metal in metals)
    if cathodes != 1.0:
        metals = tuple(
            metal if metal.solid_concentration else replace(metal, law=Scaled(metal.law, cathodes))
            for metal in metals
        )
    robin = given.text("potential.robin") if "potential.robin" in given else ROBIN[0]
    try:
        scene = GalvanicScene(lattice, horizon, metals, kappa, robin=robin, ions=ions)
    except ValueError as error:
        if not str(error).startswith("robin"):
            raise
        raise ValueError(f"{given.file}: potential.{error}") from None
    return scene, solids, beside


def prepare(given: Given) -> Prepared:
    """A couple in a file, ready to run."""
    scene, _, beside = build(given)
    check_gaps(given, scene)
    renewal, lean = renewal_of(given), reductions_of(given)
    given.left_over()
    return Prepared(
        given.values,
        functools.partial(_march, scene, renewal, lean),
        beside.values,
        lambda end: couple_omissions(scene, renewal, *lean, end=end),
        f"{scene.metal().size:,} nodes, {int((~scene.metal()).sum()):,} of liquid",
        "" if scene.robin == ROBIN[0] else "mirror nodes (potential.robin) have one process",
        scene.metal().size,
    )


def check_gaps(given: Given, scene: GalvanicScene) -> float:
    """The narrowest gap, m; ValueError for one under two horizons unless the file accepts it."""
    gap = thinnest_gap(~scene.metal(), scene.lattice.spacing)
    horizon = float(np.max(scene.horizon))
    key = "lattice.narrow_gaps"
    accepted = key in given and given.text(key) == "accepted"
    if gap < 2 * horizon * (1 - 1e-9) and not accepted:
        raise ValueError(
            f"{given.file}: lattice.horizon is {format_length(horizon)}, over half of the "
            f"narrowest gap of {format_length(gap)}; it must be at most "
            f"{format_length(0.5 * gap)}, or lattice.narrow_gaps 'accepted'"
        )
    return gap


def reductions_of(given: Given) -> tuple[float, list[str]]:
    """Tolerance of what is left out, and what is not."""
    tolerance = given.otherwise("reduce.tolerance", DEFAULT_TOLERANCE, "1", "of the currents")
    kept = given["reduce.keep"] if "reduce.keep" in given else []
    assert isinstance(tolerance, float) and isinstance(kept, list)
    return tolerance, kept


def renewal_of(given: Given) -> Renewal:
    """How often the potential is renewed."""
    travel = given.otherwise("time.travel", 0.1, "1", "0.1 spacings; see perilife study galvanic")
    assert isinstance(travel, float)
    longest = given.number("time.longest_step") if "time.longest_step" in given else np.inf
    most = given.number("time.conductivity_change") if "time.conductivity_change" in given else 0.1
    return Renewal(travel, longest, conductivity=most)


@dataclass(frozen=True)
class Scaled:
    """A law times a factor."""

    law: Polarization
    factor: float

    def current(self, potential: np.ndarray) -> np.ndarray:
        """A/m^2."""
        return self.factor * self.law.current(potential)

    def slope(self, potential: np.ndarray) -> np.ndarray:
        """A/(m^2 V)."""
        return self.factor * self.law.slope(potential)


def _march(
    scene: GalvanicScene,
    renewal: Renewal,
    lean: tuple[float, list[str]],
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
    by: Marchers = HERE,
) -> Outcome:
    """March the couple; the summary is of the first metal that dissolves."""
    result, omissions = corrode_lean(
        scene, times, renewal, tolerance=lean[0], refused=lean[1], checkpoint=checkpoint,
        resume=resume, progress=progress, march_by=by.couple,
    )  # fmt: skip
    dissolves = next((n for n, m in enumerate(scene.metals) if m.solid_concentration), 0)
    lattice = scene.lattice
    on_lattice = ("time", *axes_of(lattice))
    fields = {"phase": Field(scene.phases(), "", axes_of(lattice))}
    for name, values in result.fields.items():
        fields[name] = Field(values, FIELD_UNITS[name], on_lattice)
    anode = scene.metals[dissolves]
    current = result.history[f"current_{anode.name}"]
    depths = result.depths()
    across = lattice.dimension == 2
    place = lattice.axis(0) if across else np.zeros(1)
    unit = _UNITS_OF_CURRENT[lattice.dimension - 1]
    summary = {
        "current at the start": (float(current[0]), unit),
        "current at the end": (float(current[-1]), unit),
        "deepest at the end": (float(depths[-1].max()), "m"),
        "Faraday's law left open, largest": (
            float(np.abs(result.history["faraday_error"]).max()),
            "of the metal",
        ),
        "currents left open, largest": (
            float(np.abs(result.history["imbalance"]).max()),
            "of the currents",
        ),
    }
    if "balance_error" in result.history:
        summary |= _of_ions(result)
    for omission in omissions:
        if omission.applied:
            summary[f"left out: {omission.name}, bound"] = (omission.bound, f"of {omission.of}")
    for metal in scene.metals:
        if metal.solid_concentration:
            left = result.fields["concentration"][-1][metal.nodes].mean()
            summary[f"share of {metal.name} lost"] = (1 - left / metal.solid_concentration, "1")
    if across:
        worst = int(depths[-1].argmax())
        summary["place of the deepest"] = (float(place[worst]), "m")
        summary["mean depth of the anode"] = (
            float(depths[-1][scene.metals[dissolves].nodes.any(axis=1)].mean()),
            "m",
        )
    return Outcome(
        lattice,
        result.times,
        fields,
        result.history,
        {**result.columns, **{f"current_{m.name}": unit for m in scene.metals}},
        summary,
        _panels(scene, result, dissolves),
        result.wall_time,
    )


def _of_ions(result: GalvanicResult) -> dict[str, tuple[float, str]]:
    """What the ions of a couple have become, for the summary."""
    history = result.history
    held = max(float(history["ions_amount"][-1]), 1e-300)
    return {
        "most ions dissolved, at the end": (float(history["highest_ions"][-1]), "mol/m3"),
        "highest conductivity, at the end": (float(history["highest_conductivity"][-1]), "S/m"),
        "salt at the end": (float(history["salt_amount"][-1]) / held, "of the ions"),
        "metal and ions left open, largest": (
            float(np.abs(history["balance_error"]).max()),
            "of the metal",
        ),
    }


def _panels(scene: GalvanicScene, result: GalvanicResult, dissolves: int) -> list[Panel]:
    day, history = 86400.0, result.history
    lines = [
        Curve(m.name, history["time"] / day, np.abs(history[f"current_{m.name}"]))
        for m in scene.metals
    ]
    unit = _UNITS_OF_CURRENT[scene.lattice.dimension - 1].replace("2", "²")
    panels = [Panel("Currents", "time / d", f"|I| / ({unit})", lines)]
    if scene.lattice.dimension == 3:
        return panels
    if scene.lattice.dimension == 1:
        depth = 1e3 * result.depths()
        curve = Curve("depth", result.times / day, depth)
        return [*panels, Panel("Depth", "time / d", "depth / mm", [curve])]
    x = 1e3 * scene.lattice.axis(0)
    depths = [
        Curve(f"{t / day:.3g} d", x, -1e3 * d)
        for t, d in zip(result.times, result.depths(), strict=True)
    ]
    panels.append(Panel("Depth profile", "place / mm", "surface / mm", depths))
    along = []
    for moment, density in zip(result.times, result.fields["current_density"], strict=True):
        there = np.isfinite(density).any(axis=1)
        along.append(Curve(f"{moment / day:.3g} d", x[there], np.nanmean(density[there], axis=1)))
    panels.append(Panel("Current along the surface", "place / mm", "i / (A/m²)", along))
    if "conductivity" in result.fields:
        most = [
            Curve(f"{t / day:.3g} d", x, np.nanmax(kappa, axis=1))
            for t, kappa in zip(result.times, result.fields["conductivity"], strict=True)
        ]
        panels.append(
            Panel("Highest conductivity of the liquid", "place / mm", "kappa / (S/m)", most)
        )
    surface, density = (
        result.fields[name][-1] for name in ("electrode_potential", "current_density")
    )
    laws = []
    for metal in scene.metals:
        at = surface[metal.nodes & np.isfinite(surface)]
        if not at.size:
            continue
        span = np.linspace(at.min() - 0.1, at.max() + 0.1, 200)
        laws.append(Curve(f"{metal.name}, law", span, np.abs(metal.law.current(span))))
        now = np.abs(density[metal.nodes & np.isfinite(surface)])
        order = np.argsort(at)
        laws.append(Curve(f"{metal.name}, at the end", at[order], now[order], dots=True))
    title = "Polarization, and where the surface is on it"
    panels.append(Panel(title, "E / V", "|i| / (A/m²)", laws, logarithmic=True))
    return panels
