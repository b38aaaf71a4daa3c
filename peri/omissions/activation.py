"""No transport under activation control: the metal alone, its liquid left out.

Metal that dissolves by Faraday's law does not look at its liquid while that stays below C_sat, but
for laws of the rate that do.  With C at most c everywhere, no rate is further from that in clean
liquid than max over 0..c of |g(C) / g(0) - 1|, nor is the current, so that is the bound of what is
lost; it is 0 for laws that do not read the concentration.

Before the march C is estimated by the flux through a column as long as the front gets and two
horizons of liquid, C = flux length / D.  After it C is that of the liquid at rest around the metal
of each output time, with the currents of clean liquid (an upper bound for that metal, as the
liquid's matrix is an M-matrix); metal that went between two output times may have left more.  The
bound is therefore stated for c = C_sat / 2, and C may reach half of that: beyond, the scene is
marched again with its liquid.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import DEFAULT_TOLERANCE, Omission, check_request
from peri.engine.solvers import ConvergenceError, DiffusionSystem

log = logging.getLogger(__name__)

TRANSPORT = "transport"
_HIGHEST = 0.5
"""Share of C_sat that bounds are stated for; liquid may be found at half of it."""
_READS = frozenset({"concentration", "phase"})
"""What laws may look at: with the liquid's concentration their rates are known."""


def deviation(scene: CorrosionScene, concentration: float) -> float:
    """How far rates are from those in clean liquid with up to a concentration (mol/m^3).

    Infinite for laws that look at more than that (and for such as begin at no rate).
    """
    worst = 0.0
    seen = np.linspace(0.0, concentration, 129)
    for number, solid in enumerate(scene.solids, 1):
        law = scene.law_of(solid)
        if not law.needs <= _READS:
            return np.inf
        if "concentration" not in law.needs:
            continue
        at = Exposed(concentration=seen, phase=np.full(seen.shape, number, np.uint8))
        rate = np.broadcast_to(law.rate(at), seen.shape)
        off = float(np.abs(rate - rate[0]).max())
        worst = max(worst, off / rate[0] if rate[0] > 0 else np.inf if off else 0.0)
    return worst


def estimated_liquid(scene: CorrosionScene, end: float) -> float:
    """Highest concentration at a time (s) by the flux through a column, mol/m^3."""
    flux = scene.dissolution_flux
    assert flux is not None
    lattice = scene.lattice
    thick = lattice.shape[-1] * lattice.spacing[-1]
    depth = min(flux * end / scene.solid_concentration, thick)
    return flux * (depth + 2.0 * float(np.max(scene.horizon))) / scene.liquid_diffusivity


def resting_liquid(scene: CorrosionScene, metal: np.ndarray) -> float:
    """Highest concentration of the liquid at rest around metal nodes, mol/m^3.

    metal : bool, of the scene's metal.  The interface carries what it does in clean liquid, and
    liquid is held where the scene holds it.  Infinite where some liquid is closed.
    """
    phase = np.where(metal, scene.phases(), 0).astype(np.uint8)
    held = scene.refreshed() if scene.boundary == "refreshed" else None
    problem = BiMaterial(replace(scene, metal=metal, phase=phase, liquid=None, renewed=held))
    if problem.box is None or not problem.box_metal.any():
        return 0.0
    if not problem.fixed.any():
        return np.inf
    rate, local = problem.interface_rate(0.0)
    carried = problem.box(problem.box_metal_volume * local)
    inflow = problem.put(rate * scene.solid_concentration * problem.box_free_volume * carried)
    weight = np.where(problem.free, problem.capacity, 0.0)
    diagonal = scene.liquid_diffusivity * problem.neighbour_liquid
    to_held = problem.sum(np.where(problem.fixed, problem.capacity, 0.0))
    sink = weight * scene.liquid_diffusivity * to_held
    system = DiffusionSystem(problem.sum, weight, diagonal, scene.liquid_diffusivity, sink)
    steady = np.zeros(problem.sum.padded_shape)
    try:
        system.solve(steady, inflow, 1e-8 * float(np.linalg.norm(inflow)))
    except ConvergenceError as error:
        log.info("no bound for the liquid: %s", error)
        return np.inf
    return 1.0001 * float(steady.max(initial=0.0))


def activation(
    scene: CorrosionScene,
    end: float,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
) -> Omission:
    """Whether the metal can be marched alone to a time (s) within `tolerance` of its loss.

    Raises ValueError for a tolerance outside [0, 1) or an unknown name in `refused`.
    """
    check_request(tolerance, refused, (TRANSPORT,))
    clean = scene.liquid is None or not scene.liquid.any()
    if scene.dissolution_flux is None or scene.dissolution.reduces or not clean:
        reason = "needed: the liquid holds something, or bonds follow their metal's content"
        return Omission(TRANSPORT, reason, np.inf, False, "what is lost")
    most = estimated_liquid(scene, end)
    share = most / scene.saturation_concentration
    if not share < 0.5 * _HIGHEST:
        reason = f"needed: flux x depth / D is {share:.2g} C_sat, diffusion holds the metal back"
        return Omission(TRANSPORT, reason, np.inf, False, "what is lost")
    bound = deviation(scene, _HIGHEST * scene.saturation_concentration)
    reason = (
        f"C is about {share:.2g} C_sat (flux x depth / D), so the metal is marched alone; C is "
        f"computed at the end, and more than {0.5 * _HIGHEST:g} C_sat marches it again"
    )
    if not bound <= tolerance:
        reason = "needed: a law of the rate looks at the liquid, or at what is lost"
    applied = bound <= tolerance and TRANSPORT not in refused
    return Omission(TRANSPORT, reason, bound, applied, "what is lost")


def corrode_activated(
    scene: CorrosionScene,
    times: Sequence[float],
    stepping: TimeStepping | None = None,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
    march_by: Callable[..., CorrosionResult] = corrode,
    **march: Any,
) -> tuple[CorrosionResult, Omission]:
    """`corrode` without the liquid where the metal does not look at it; also what was decided.

    march_by : what marches, `corrode` or a function that takes the same (`ranks.corrode`).  march :
    as `corrode` takes it.  Liquid that was left out has no concentration (0).
    """
    omission = activation(scene, float(np.max(times)), tolerance, refused)
    if not omission.applied:
        return march_by(scene, times, stepping, **march), omission
    result = march_by(replace(scene, saturation="none"), times, stepping, alone=True, **march)
    most = max(resting_liquid(scene, metal) for metal in result.metal)
    share = most / scene.saturation_concentration
    if share < 0.5 * _HIGHEST:
        reason = f"the liquid at rest around the metal of each output has at most {share:.2g} C_sat"
        return replace(result, scene=scene), replace(omission, reason=reason)
    log.info("the liquid reaches %.2g of saturation: marched again", share)
    march.pop("checkpoint", None)
    march.pop("resume", None)
    reason = f"needed: the liquid at rest has {share:.2g} C_sat at one of the output times"
    result = march_by(scene, times, stepping, **march)
    return result, replace(omission, reason=reason, bound=np.inf, applied=False)
