"""The crevice of alloy 625 as a film: 72 h between washers (Jafarzadeh et al. 2022)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from peri.corrosion.acidity import AcidityLaw
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping, march
from peri.engine.results import Field
from peri.omissions.thin_gap import COLUMNS, ThinGap, ThinGapProblem
from pipeline.scenes.outcome import Curve, Outcome, Panel, Prepared, Value

LENGTH, MOST = 12.7e-3, 5600.0
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


def crevice(spacing: float | None, seed: float = 3e-3) -> Prepared:
    """The scene, ready to run."""
    spacing = spacing or 12.5e-6
    nodes = max(2, round(LENGTH / spacing))
    scene = crevice_625(seed, nodes)
    table = [
        ("length", LENGTH, "m", "published"),
        ("gap at the mouth", 25e-6, "m", "published"),
        ("gap at the closed end", 5e-6, "m", "published"),
        ("diffusivity", scene.diffusivity, "m2/s", "published"),
        ("concentration of the metal", scene.solid_concentration, "mol/m3", "published"),
        ("saturation concentration", MOST, "mol/m3", "published"),
    ]
    values = {n: Value(v, u, "Jafarzadeh et al. 2022", "5", kind) for n, v, u, kind in table}
    values |= {
        "current by concentration": Value(
            "Eqs 23 to 25, corrected", "", "Jafarzadeh et al. 2022", "5.1", "published"
        ),
        "charge number": Value(2.5, "1", "", "not printed; 2 to 3", "assumed"),
        "length of the seed": Value(seed, "m", "", "0.5 mm printed; below 2 to 3 mm none ignites",
                                    "assumed"),
        "nodes": Value(nodes, "1", "", "", "assumed"),
    }  # fmt: skip
    return Prepared(values, functools.partial(_march, scene))


def _march(
    scene: ThinGap,
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Outcome:
    done = march(
        ThinGapProblem(scene), times, TimeStepping(rate_change=0.1),
        checkpoint=checkpoint, resume=resume, progress=progress,
    )  # fmt: skip
    cell = LENGTH / scene.gap.size
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
    site = Curve("active site", history["time"] / hour, 1e3 * history["active_site"])
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
    summary = {
        "area lost": (last["lost"], "m2"),
        "deepest": (last["deepest"], "m"),
        "active site from the mouth": (last["active_site"], "m"),
        "share saturated": (last["saturated_share"], "1"),
        "unevenness across the gap, bound": (scene.bound(float(done.times[-1]) or 1.0), "1"),
        "balance left open, largest": (float(np.abs(history["balance_error"]).max()), "1"),
    }
    units = {"time": "s", "step": "s", **COLUMNS, "iterations": "1"}
    return Outcome(lattice, done.times, fields, history, units, summary, panels, done.wall_time)
