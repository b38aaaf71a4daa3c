"""Scenes of pits in a section of a steel sheet: below a mask, and below a lacy cover."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.metal.bond_damage import BondDamage
from peri.corrosion.metal.salt_film import SaltFilm
from peri.corrosion.metal.solids import Solid
from peri.corrosion.passivity import Repassivation, Rupture
from peri.corrosion.scene import CorrosionScene
from peri.engine.constants import FARADAY
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.results import Field, axes_of
from peri.omissions.activation import corrode_activated
from pipeline.scenes.outcome import HERE, Curve, Marchers, Outcome, Panel, Section
from pipeline.scenes.pits import CHARGE_NUMBER, STEEL_304, closing, outcome_of
from pipeline.scenes.salt import film_fields, film_summary

RUPTURE = (0.15, 0.02)
"""Share of its metal with which a node loses its film, and over what further share (assumed)."""


def section(width: float, depth: float, liquid: float, spacing: float) -> Lattice:
    """x along the sheet, from its middle; y up from its surface; m."""
    shape = (round(width / spacing), round((depth + liquid) / spacing))
    return Lattice((0.5 * (spacing - width), 0.5 * spacing - depth), (spacing,) * 2, shape)


def masked_scene(
    spacing: float,
    current: float = 1e4,
    opening: float = 40e-6,
    ratio: float = 2,
    size: tuple[float, float] = (600e-6, 250e-6),
    charge: float = CHARGE_NUMBER,
    steel: Mapping[str, float] = STEEL_304,
) -> CorrosionScene:
    """Steel under a mask with an opening, clean liquid at the opening.

    size : width and depth of the section, m.  steel : as STEEL_304.
    """
    horizon = ratio * spacing
    mask = horizon + spacing
    lattice = section(*size, mask + horizon, spacing)
    x, y = (np.broadcast_to(a, lattice.shape) for a in lattice.coordinates())
    metal = np.ascontiguousarray(y < 0)
    return CorrosionScene(
        lattice,
        horizon,
        metal,
        domain=metal | (np.abs(x) < 0.5 * opening),
        dissolution_flux=current / (charge * FARADAY),
        dissolution="faradaic",
        **steel,
    )


def lacy_scene(
    spacing: float,
    current: float = 1e5,
    critical: float = 0.7,
    nucleus: float = 20e-6,
    passive: float = 1e-3,
    ratio: float = 2,
    size: tuple[float, float] = (300e-6, 80e-6),
    rupture: tuple[float, float] | None = RUPTURE,
    **metal: Any,
) -> CorrosionScene:
    """Steel that is passive below a critical concentration, with a nucleus that is active.

    critical : C_crit over C_sat.  nucleus : radius of a half disc at the surface, m.  passive :
    the passive current over the active one.  Liquid of two horizons lies above, its upper half
    held clean.  size : width and depth of the section, m.  rupture : the share of its metal with
    which a node loses its film and over what further share it goes; None: never.  By 0.15 the
    surface outside loses its own only after 83 s.  metal : as lacy_metal takes it.
    """
    horizon = ratio * spacing
    lattice = section(*size, 2 * horizon, spacing)
    x, y = (np.broadcast_to(a, lattice.shape) for a in lattice.coordinates())
    sheet = np.ascontiguousarray(y < 0)
    bare = sheet & (x**2 + y**2 < nucleus**2)
    return lacy_metal(
        lattice, sheet, bare, horizon, current, critical, passive, rupture=rupture, **metal
    )


def lacy_metal(
    lattice: Lattice,
    metal: np.ndarray,
    bare: np.ndarray,
    horizon: float,
    current: float = 1e5,
    critical: float = 0.7,
    passive: float = 1e-3,
    ramp: float | None = None,
    charge: float = CHARGE_NUMBER,
    steel: Mapping[str, float] = STEEL_304,
    rupture: tuple[float, float] | None = None,
) -> CorrosionScene:
    """Steel that is passive below a critical concentration but for its bare nodes.

    ramp : width of the film's ramp, mol/m^3.  steel : as STEEL_304.  rupture : as lacy_scene.
    """
    saturated, solid = steel["saturation_concentration"], steel["solid_concentration"]
    film = Repassivation(critical * saturated, saturated, passive, ramp)
    if rupture is not None:
        film = Rupture(critical * saturated, saturated, passive, ramp, *rupture)
    return CorrosionScene(
        lattice,
        horizon,
        metal,
        dissolution_flux=current / (charge * FARADAY),
        dissolution="faradaic",
        solids=(Solid(solid, kinetics=film), Solid(solid, kinetics=ConstantRate())),
        phase=metal.astype(np.uint8) + bare.astype(np.uint8),
        **steel,
    )


def shape_of(scene: CorrosionScene, metal: np.ndarray) -> tuple[float, float, float]:
    """Depth of a pit, its largest width, and how much of the surface is gone, m.

    metal : what is still there, on the lattice.
    """
    gone = scene.metal & ~metal
    h = scene.lattice.spacing
    surface = int(np.flatnonzero(scene.metal.any(axis=0))[-1])
    if not gone.any():
        return 0.0, 0.0, 0.0
    depth = surface + 1 - int(np.flatnonzero(gone.any(axis=0))[0])
    widest = int(np.ptp(np.flatnonzero(gone.any(axis=1)))) + 1
    return depth * h[1], widest * h[0], float(gone[:, surface].sum()) * h[0]


def march_section(
    scene: CorrosionScene,
    stepping: TimeStepping,
    seed: int,
    times: Sequence[float],
    *,
    kept: Collection[str] = (),
    salt: SaltFilm | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
    by: Marchers = HERE,
) -> Outcome:
    """March a section and say what its pit is like, with the bonds that are broken.

    kept : what is not left out (omissions.activation).  salt : the film that its currents have.
    """
    result, transport = corrode_activated(
        scene, times, stepping, refused=kept, checkpoint=checkpoint, resume=resume,
        progress=progress, march_by=by.metal,
    )  # fmt: skip
    lattice, history = scene.lattice, result.history
    damage = BondDamage(
        lattice, scene.horizon, scene.metal, scene.solid_concentration,
        scene.saturation_concentration, seed,
    )  # fmt: skip
    index, islands = [], 0
    for concentration, metal in zip(result.concentration, result.metal, strict=True):
        share = np.where(metal, damage.corroded(concentration), 1.0)
        index.append(damage.damage_index(share))
        islands = int(damage.detached(share).sum())
    shapes = [shape_of(scene, metal) for metal in result.metal]
    summary = {
        "depth of the attack": (shapes[-1][0], "m"),
        "its largest width": (shapes[-1][1], "m"),
        "its width at the surface": (shapes[-1][2], "m"),
        "metal cut off by broken bonds": (float(islands), "nodes"),
        **closing(result, transport),
    }
    amount = history["metal_amount"]
    lost = (amount[0] - amount) / scene.solid_concentration
    x = 1e6 * lattice.axis(0)
    surface = 1e6 * lattice.axis(1)
    unit, second = ("h", 3600.0) if result.times[-1] > 7200.0 else ("s", 1.0)
    bottoms = []
    for time, metal in zip(result.times, result.metal, strict=True):
        gone = scene.metal & ~metal
        there = gone.any(axis=1)
        lowest = np.where(there, surface[np.argmax(gone, axis=1)], 0.0)
        bottoms.append(Curve(f"{time / second:.4g} {unit}", x, lowest))
    moments, passed = np.asarray(result.times) / second, history["time"] / second
    sizes = [
        Curve(name, moments, 1e6 * np.array([s[n] for s in shapes]))
        for n, name in enumerate(("depth", "width", "width at the surface"))
    ]
    axis = f"time / {unit}"
    liquid = ~result.metal[-1] & scene.domain
    there = np.where(liquid, result.concentration[-1] / scene.saturation_concentration, np.nan)
    grey = "metal" if scene.domain.all() else "metal and mask"
    panels = [
        Section(
            f"Section after {moments[-1]:.4g} {unit}, {grey} grey",
            "along the sheet / um",
            "depth / um",
            x,
            surface,
            there,
            "metal ions over C_sat",
        ),
        Panel("Bottom of the attack", "along the sheet / um", "depth / um", bottoms),
        Panel("Size of the attack", axis, "um", sizes),
        Panel("Metal lost", axis, "mm²", [Curve("metal", passed, 1e6 * lost)]),
    ]
    if history["saturated_nodes"].any():
        held = Curve("held at saturation", passed, history["saturated_nodes"])
        panels.append(Panel("Liquid nodes under a salt layer", axis, "nodes", [held]))
    over = ("time", *axes_of(lattice))
    fields = {"damage_index": Field(np.array(index), "1", over)}
    if salt is not None:
        fields |= film_fields(result, salt)
        summary |= film_summary(result, salt)
        thick = 1e6 * fields["salt_film"].values.max(axis=2)
        curves = [Curve(f"{t:.4g} {unit}", x, s) for t, s in zip(moments, thick, strict=True)]
        panels.append(Panel("Salt film", "along the sheet / um", "thickness / um", curves))
    return outcome_of(result, summary, panels, fields)
