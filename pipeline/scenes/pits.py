"""Scenes of pits in stainless steel: the pencil electrode."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from peri.corrosion.metal.salt_film import SaltFilm
from peri.corrosion.nodes.problem import COLUMNS
from peri.corrosion.run import CorrosionResult
from peri.corrosion.scene import CorrosionScene
from peri.engine.constants import FARADAY
from peri.engine.lattice import box_lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import Omission
from peri.engine.results import Field, axes_of
from peri.omissions.activation import corrode_activated
from pipeline.scenes.outcome import HERE, Curve, Marchers, Outcome, Panel
from pipeline.scenes.salt import film_fields

STEEL_304 = {
    "solid_concentration": 142_900.0,
    "saturation_concentration": 4_600.0,
    "liquid_diffusivity": 8.6e-10,
}
CHARGE_NUMBER, CURRENT = 2.19, 5_100.0
UNITS = {"time": "s", "step": "s", **COLUMNS, "iterations": "1"}


def pencil_scene(
    spacing: float,
    ratio: int = 2,
    current: float = CURRENT,
    depth: float = 400e-6,
    charge: float = CHARGE_NUMBER,
    metal: Mapping[str, float] = STEEL_304,
) -> CorrosionScene:
    """A wire in resin that dissolves from its end; clean liquid at the mouth of the pit.

    ratio : horizon over spacing.  metal : as STEEL_304.
    """
    horizon = ratio * spacing
    lattice = box_lattice((-horizon,), (depth,), spacing)
    return CorrosionScene(
        lattice,
        horizon,
        lattice.axis(0) > 0,
        dissolution_flux=current / (charge * FARADAY),
        flux_calibration="axis",
        dissolution="faradaic",
        **metal,
    )


def front_depth(scene: CorrosionScene, history: dict[str, np.ndarray]) -> np.ndarray:
    """Metal lost over its C_solid: m in 1D, m2 in 2D, m3 in 3D."""
    amount = history["metal_amount"]
    return (amount[0] - amount) / scene.solid_concentration


def unfilled_step(scene: CorrosionScene) -> float:
    """The longest step, s, in which the flux does not fill a node that it has just emptied.

    In longer steps what such a node cannot hold passes on to the liquid beside it, by an estimate.
    """
    flux = scene.dissolution_flux
    assert flux is not None
    return scene.saturation_concentration * min(scene.lattice.spacing) / flux


def mean_current(
    scene: CorrosionScene, history: dict[str, np.ndarray], charge: float = CHARGE_NUMBER
) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and current density of a flat front (A/m^2), each over the travel of a spacing."""
    flux = scene.dissolution_flux
    assert flux is not None
    depth, time = front_depth(scene, history), history["time"]
    span = scene.lattice.spacing[0] * scene.solid_concentration / flux
    inside = time + span <= time[-1]
    speed = (np.interp(time + span, time, depth) - depth)[inside] / span
    current = charge * FARADAY * scene.solid_concentration * speed
    return time[inside] + 0.5 * span, current


def onset(scene: CorrosionScene, history: dict[str, np.ndarray]) -> tuple[float, float]:
    """Time (s) and depth (m) at which a salt layer begins to hold the current back.

    The mean current falls below 99 % of the one without a layer, for good; infinite if never.
    """
    time, current = mean_current(scene, history)
    assert scene.dissolution_flux is not None
    full = current >= 0.99 * CHARGE_NUMBER * FARADAY * scene.dissolution_flux
    if not full.any() or full[-1]:
        return np.inf, np.inf
    moment = float(time[np.flatnonzero(full)[-1]])
    return moment, float(np.interp(moment, history["time"], front_depth(scene, history)))


def march_pencil(
    scene: CorrosionScene,
    stepping: TimeStepping,
    charge: float,
    times: Sequence[float],
    *,
    kept: Collection[str] = (),
    salt: SaltFilm | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
    by: Marchers = HERE,
) -> Outcome:
    """March a pencil electrode, and when a salt layer begins to hold it back.

    kept : what is not left out (omissions.activation).  salt : the film that the current has.
    """
    result, transport = corrode_activated(
        scene, times, stepping, refused=kept, checkpoint=checkpoint, resume=resume,
        progress=progress, march_by=by.metal,
    )  # fmt: skip
    history = result.history
    depth = front_depth(scene, history)
    moment, place = onset(scene, history)
    x = 1e6 * scene.lattice.axis(0)
    profiles = [
        Curve(f"{t:.4g} s", x[~metal], c[~metal])
        for t, c, metal in zip(result.times, result.concentration, result.metal, strict=True)
    ]
    summary = {
        "depth at the end": (float(depth[-1]), "m"),
        "onset of the salt layer": (moment, "s"),
        "depth at that time": (place, "m"),
        **closing(result, transport),
    }
    panels = [
        Panel("Depth of the pit", "time / s", "depth / um",
              [Curve("pit", history["time"], 1e6 * depth)]),
        Panel("Current", "time / s", "i / (A/m²)",
              [Curve("pit", *mean_current(scene, history, charge))]),
        Panel("Metal ions in the pit", "from the mouth / um", "C / (mol/m³)", profiles),
    ]  # fmt: skip
    if salt is not None:
        bare = charge * FARADAY * (scene.dissolution_flux or 0.0)
        when, current = mean_current(scene, history, charge)
        held = (when > moment) & (current < bare)
        thick = np.where(held, salt.thickness(np.where(held, current, bare), bare), 0.0)
        panels.append(
            Panel("Salt film", "time / s", "thickness / um", [Curve("film", when, 1e6 * thick)])
        )
        if held.any():
            last = current[held][-1]
            summary["thickness of the salt film at the end"] = (float(thick[held][-1]), "m")
            summary["potential over the salt film"] = (float(salt.drop(last, bare)), "V")
            summary["the film follows its current within"] = (float(salt.settling(last, bare)), "s")
    return outcome_of(result, summary, panels, {} if salt is None else film_fields(result, salt))


def closing(result: CorrosionResult, transport: Omission) -> dict[str, tuple[float, str]]:
    """What every march of corrosion says at its end, and whether its liquid was left out."""
    history = result.history
    left = (transport.bound, f"of {transport.of}")
    return {
        **({f"left out: {transport.name}, bound": left} if transport.applied else {}),
        "share of the metal lost": (float(result.volume_loss[-1]), "1"),
        "nodes held at saturation": (float(history["saturated_nodes"][-1]), "1"),
        "balance left open, largest": (float(np.abs(history["balance_error"]).max()), "1"),
    }


def outcome_of(
    result: CorrosionResult,
    summary: dict[str, tuple[float, str]],
    panels: list[Panel],
    more: Mapping[str, Field],
) -> Outcome:
    """The outcome of a march of corrosion; more : fields beside its own."""
    lattice = result.scene.lattice
    over = ("time", *axes_of(lattice))
    fields = {
        "concentration": Field(result.concentration, "mol/m3", over),
        "metal": Field(result.metal, "", over),
        "phase": Field(result.scene.phases(), "", axes_of(lattice)),
        **more,
    }
    if result.theta is not None:
        fields["theta"] = Field(result.theta, "1", over)
    return Outcome(
        lattice, result.times, fields, result.history, UNITS, summary, panels, result.wall_time
    )
