"""Scenes of galvanic couples: AE44 beside steel or AA6063, and plates with a growing gap."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from peri.corrosion.polarization import PolarizationLaw
from peri.coupled.galvanic import GalvanicResult, GalvanicScene, Metal, Renewal, corrode
from peri.engine.lattice import Lattice
from peri.engine.results import Field, axes_of
from peri.transport.potential.polarization import LinearPolarization
from perilife_data import common_reference, load_electrode
from pipeline.scene.laws.polarization import polarization_law
from pipeline.scenes.outcome import Curve, Outcome, Panel, Prepared, Value

CONDUCTIVITY = 2.5
ANODE_CONCENTRATION = 67860.0
CHARGE_NUMBER = 2.0
HORIZON = 0.4e-3
_FIELD_UNITS = {
    "concentration": "mol/m3",
    "metal": "",
    "potential": "V",
    "current_density": "A/m2",
    "electrode_potential": "V",
}


def ae44_scene(
    cathode: str,
    spacing: float = 0.1e-3,
    horizon: float = HORIZON,
    as_published: bool = False,
) -> GalvanicScene:
    """AE44 beside a cathode, both 10 mm wide and 5 mm thick, under 10 mm of brine.

    Zhao et al. 2021, 4: a cell of 20 x 10 mm, the joint in the middle of its lower side.

    cathode : name of an electrode.  horizon : m; at least two spacings.
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
    return GalvanicScene(lattice, horizon, metals, CONDUCTIVITY)


def ae44(cathode: str, spacing: float | None) -> Prepared:
    """The scene, ready to run."""
    spacing = spacing or 0.1e-3
    horizon = max(HORIZON, 2 * spacing)
    scene = ae44_scene(cathode, spacing, horizon)
    values = {
        "lattice spacing": Value(spacing, "m", "zhao2021", "4", "published"),
        "horizon": Value(horizon, "m", "zhao2021", "4", "published"),
        "conductivity": Value(CONDUCTIVITY, "S/m", "zhao2021", "Table 4", "published"),
        "concentration of AE44": Value(
            ANODE_CONCENTRATION, "mol/m3", "zhao2021", "Table 4", "published"
        ),
        "charge number of AE44": Value(CHARGE_NUMBER, "1", "zhao2021", "Table 4", "published"),
    }
    for name in ("AE44", cathode):
        for quantity, q in load_electrode(name).quantities().items():
            where = f"{q.where} ({q.conditions})" if q.conditions else q.where
            values[f"{name}: {quantity}"] = Value(q.si, "SI", q.source, where, q.kind)
    return Prepared(values, functools.partial(_march, scene, 1))


def slab(spacing: float | None) -> Prepared:
    """Plates 0.1 m apart, one of which dissolves (Zhao et al. 2021, 3.1)."""
    spacing = spacing or 1e-3
    horizon = max(4e-3, 2 * spacing)
    reach = round(horizon / spacing)
    anode, liquid = round(20e-3 / spacing), round(0.1 / spacing)
    x = np.arange(anode + liquid + reach + 1)
    lattice = Lattice(((0.5 - anode) * spacing,), (spacing,), x.shape)
    laws: list[PolarizationLaw | LinearPolarization] = [
        LinearPolarization(rest, 1e-12) for rest in (0.1, 0.6)
    ]
    metals = (
        Metal("anode", x < anode, laws[0], 143e3, 2.0),
        Metal("cathode", x >= anode + liquid, laws[1]),
    )
    scene = GalvanicScene(lattice, horizon, metals, CONDUCTIVITY)
    table = [
        ("lattice spacing", spacing, "m"),
        ("horizon", horizon, "m"),
        ("conductivity", CONDUCTIVITY, "S/m"),
        ("potential of the anode", 0.1, "V"),
        ("potential of the cathode", 0.6, "V"),
        ("concentration of the anode", 143e3, "mol/m3"),
        ("charge number of the anode", 2.0, "1"),
    ]
    values = {n: Value(v, u, "zhao2021", "Table 1", "published") for n, v, u in table}
    values["resistance of the plates"] = Value(
        1e-12, "ohm m2", "", "held potentials as a limit", "assumed"
    )
    return Prepared(values, functools.partial(_march, scene, 0))


def _march(
    scene: GalvanicScene,
    dissolves: int,
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Outcome:
    """March the couple; `dissolves`: number of the metal that does."""
    result = corrode(
        scene, times, Renewal(), checkpoint=checkpoint, resume=resume, progress=progress
    )
    lattice = scene.lattice
    on_lattice = ("time", *axes_of(lattice))
    fields = {"phase": Field(scene.phases(), "", axes_of(lattice))}
    for name, values in result.fields.items():
        fields[name] = Field(values, _FIELD_UNITS[name], on_lattice)
    anode = scene.metals[dissolves]
    current = result.history[f"current_{anode.name}"]
    depths = result.depths()
    across = lattice.dimension > 1
    place = lattice.axis(0) if across else np.zeros(1)
    unit = "A/m" if lattice.dimension == 2 else "A/m2"
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


def _panels(scene: GalvanicScene, result: GalvanicResult, dissolves: int) -> list[Panel]:
    day, history = 86400.0, result.history
    lines = [
        Curve(m.name, history["time"] / day, np.abs(history[f"current_{m.name}"]))
        for m in scene.metals
    ]
    unit = "A/m" if scene.lattice.dimension == 2 else "A/m²"
    panels = [Panel("Currents", "time / d", f"|I| / ({unit})", lines)]
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
