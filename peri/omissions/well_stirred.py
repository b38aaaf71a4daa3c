"""The well-stirred limit: clean liquid, one scalar equation, exact in space.

Where the liquid stays far below C_sat and C_solid, a metal node obeys C_i' = -lambda_i g(V_L) C_i
with lambda_i its interface bond sum, so C_i = C_solid exp(-lambda_i s) and s' = g(V_L(s)): the
whole problem is one quadrature (omissions.reduced).  It serves as an oracle for every solver, and
in place of the march where a bound on the liquid's concentration allows it (corrosion.planning).
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from peri.corrosion.classes.volumes import class_bond_sums
from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import HISTORY, CorrosionResult
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.stepping import GAMMA
from peri.omissions.reduced import ReducedCorrosion, factor_of, refuse_other_laws


def well_stirred(
    scene: CorrosionScene,
    times: Sequence[float],
    problem: BiMaterial | None = None,
    reduced: ReducedCorrosion | None = None,
) -> CorrosionResult:
    """Corrode a scene as if all liquid were clean.

    Valid until the first metal node falls below C_sat; nodes that do turn liquid are treated as
    metal for the bonds of others (their own loss goes on), which `planning` bounds.

    Parameters
    ----------
    scene : CorrosionScene
        Saturation and liquid diffusivity play no part.
    times : sequence of float
        s, ascending, >= 0.
    problem : BiMaterial, optional
        The scene's, as it was before any step, where the caller has it.
    reduced : ReducedCorrosion, optional
        The scene's, likewise.

    Returns
    -------
    CorrosionResult
        Liquid concentrations are 0; history has a hundred even times and the output times.
    """
    started = clock.perf_counter()
    times = np.asarray(times, float)
    if scene.exposure is None:
        problem = problem or BiMaterial(scene)
    reduced = reduced or ReducedCorrosion.of(scene, problem)
    moments = np.union1d(np.linspace(0.0, times[-1], 101), times)
    if scene.coating is not None and scene.coating.lifetime < times[-1]:
        moments = np.union1d(moments, [scene.coating.lifetime])
    diffusivity = scene.base_interface_diffusivity()
    bare = scene.bare_time(moments)
    found = reduced.volume_loss(bare, diffusivity, factor_of(scene.kinetics))
    asked = np.searchsorted(moments, times)
    solid, saturated = scene.solid_concentration, scene.saturation_concentration
    share = np.array([_share_left(scene, problem, z) for z in found.exposure[asked]])
    metal = solid * share >= saturated
    if scene.exposure is None:
        volume = float(scene.capacity()[scene.metal].sum())
    else:
        volume = float(scene.exposure.metal.volume.sum())
        metal &= scene.exposure.metal.fraction > 0
    volume *= scene.lattice.cell_volume
    concentration = solid * share
    released = volume * solid * reduced.dissolved_at(found.exposure)
    amount = np.array([_metal_amount(scene, problem, z) for z in found.exposure])
    initial = volume * solid
    history = {name: np.zeros(moments.size) for name in HISTORY}
    history.update(
        time=moments,
        step=np.diff(moments, prepend=0.0),
        volume_loss=found.value,
        metal_amount=amount,
        released_amount=released,
        # what the nodes still hold, against what the law of all of them says has gone
        balance_error=(amount + released - initial) / initial,
    )
    return CorrosionResult(
        scene, times, concentration, metal, found.value[asked], history,
        clock.perf_counter() - started,
    )  # fmt: skip


def _share_left(scene: CorrosionScene, problem: BiMaterial | None, z: float) -> np.ndarray:
    """C / C_solid of each node's metal at an exposure z = int D_int g dt (m^2), on the lattice."""
    out = np.zeros(scene.lattice.shape)
    if scene.exposure is None:
        sums = problem.metal_bond_sums()[scene.metal]
        out[scene.metal] = np.exp(-sums * z)
        return out
    metal = scene.exposure.metal
    left = metal.volume * np.exp(-class_bond_sums(scene) * z)
    mean = np.bincount(metal.cell, left, out.size).reshape(out.shape)
    return np.divide(mean, metal.fraction, out=out, where=metal.fraction > 0)


def _metal_amount(scene: CorrosionScene, problem: BiMaterial | None, z: float) -> float:
    """Amount (mol) that the metal nodes, or rate classes, hold at an exposure z (m^2)."""
    if scene.exposure is None:
        left = np.exp(-problem.metal_bond_sums()[scene.metal] * z)
        volumes = scene.capacity()[scene.metal]
    else:
        left = np.exp(-class_bond_sums(scene) * z)
        volumes = scene.exposure.metal.volume
    return float(volumes @ left) * scene.lattice.cell_volume * scene.solid_concentration


def clean_march(
    scene: CorrosionScene, steps: Sequence[float], problem: BiMaterial | None = None
) -> np.ndarray:
    """V_L after each of the SDIRK2 steps given (s), as if all liquid were clean.

    The difference to `run.corrode` with the same steps (its history["step"]) is what the liquid
    does, free of the error in time; the difference to `well_stirred` is that error alone.
    Valid as there, and while every step of the march was of second order.
    """
    refuse_other_laws(scene)
    if scene.coating is not None:
        raise ValueError("coating: steps of a march under one are not repeated; leave it out")
    levels, weights, volumes = _levels(scene, problem)
    solid, saturated = scene.solid_concentration, scene.saturation_concentration
    total = volumes.sum() * (solid - saturated)
    never = (volumes.sum() - weights.sum()) * (solid - saturated)  # what sees no liquid

    def stage(right: np.ndarray, tau: float) -> np.ndarray:
        """Y = right - tau lambda g(V_L(Y)) Y."""

        def after(loss: float) -> np.ndarray:
            return right / (1.0 + tau * levels * scene.kinetics.rate(Exposed(loss)))

        def excess(loss: float) -> float:
            left = never + float(weights @ np.maximum(after(loss) - saturated, 0.0))
            return 1.0 - left / total - loss

        # The loss falls as V_L grows in the kinetics, so the root is the only one.
        return after(brentq(excess, 0.0, 1.0, xtol=1e-15, rtol=1e-14))

    concentration, losses = np.full(levels.size, solid), []
    for step in steps:
        first = stage(concentration, GAMMA * step)
        slope = (first - concentration) / GAMMA
        concentration = stage(concentration + (1.0 - GAMMA) * slope, GAMMA * step)
        losses.append(1.0 - (never + float(weights @ (concentration - saturated))) / total)
    return np.array(losses)


def _levels(scene: CorrosionScene, problem: BiMaterial | None):
    """Rates that differ (1/s), the volume of each, and the volumes of all metal.

    Nodes, or rate classes, of one rate are taken together, so that sums run over the rates; what
    sees no liquid has none.
    """
    if scene.exposure is None:
        rates = (problem or BiMaterial(scene)).metal_rates()[scene.metal]
        volumes = scene.capacity()[scene.metal]
    else:
        rates = scene.base_interface_diffusivity() * class_bond_sums(scene)
        volumes = scene.exposure.metal.volume
    exposed = rates > 0
    levels, member = np.unique(rates[exposed], return_inverse=True)
    return levels, np.bincount(member, volumes[exposed], levels.size), volumes
