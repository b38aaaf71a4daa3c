"""What a scene need not compute, with a bound on the error of leaving it out.

Every decision is taken from the scene alone, before the march.  A bound is relative to V_L and
holds for the discrete scene as stated; tests/peri/omissions/test_planning.py compares the true
errors with it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from peri.corrosion.classes.cells import Cells
from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import DEFAULT_TOLERANCE, Omission, check_request
from peri.engine.solvers import ConvergenceError, DiffusionSystem
from peri.omissions.bounds import (
    arrival_bound,
    dissolving_bound,
    front_depth,
    least_loss,
    metal_at_risk,
)
from peri.omissions.held_back import held_back
from peri.omissions.names import COARSE_LIQUID, FAR_LIQUID, LIQUID, OMITTABLE, SOLID_CORE
from peri.omissions.reduced import ReducedCorrosion
from peri.omissions.well_stirred import well_stirred

log = logging.getLogger(__name__)

Discrete = BiMaterial | Cells

_HOPELESS = 5.0
"""Of C_sat: liquid that would rise beyond it stays saturated until so much is held back that the
liquid counts; it is not looked at how much (tenths of V_L, where it was)."""


def _discrete(scene: CorrosionScene) -> Discrete:
    """The scene's discrete equations: by nodes, or by rate classes where it has them."""
    return BiMaterial(scene) if scene.exposure is None else Cells(scene)


def liquid_bound(scene: CorrosionScene, problem: Discrete | None = None) -> np.ndarray:
    """An upper bound of the liquid's concentration at every node and time, mol/m^3.

    The interface inflow never exceeds its first value into clean liquid (the metal only loses,
    the kinetics only slows), and the liquid's matrix is an M-matrix, so the steady state of that
    first inflow bounds the march, saturation left aside.  One linear solution.  `problem`: the
    scene's, where the caller has it.

    Returns
    -------
    array of the lattice's shape; infinite where liquid cannot reach refreshed medium.
    """
    problem = problem or _discrete(scene)
    if isinstance(problem, Cells):
        try:
            steady = problem.steady_bound()
        except ConvergenceError as error:
            log.info("no bound for the liquid: %s", error)
            steady = None
        liquid = problem.sum.crop(problem.free) > 0
        return np.where(liquid, np.inf, 0.0) if steady is None else 1.0001 * steady
    out = np.zeros(scene.lattice.shape)
    if problem.box is None:
        return out
    unbounded = np.where(problem.sum.crop(problem.free.astype(float)) > 0, np.inf, 0.0)
    rate = problem.base_diffusivity * scene.kinetics.rate(Exposed(0.0))
    if rate == 0:
        return out
    if not problem.fixed.any():
        return unbounded
    seen = problem.box(problem.box_metal_volume)
    inflow = np.zeros(problem.sum.padded_shape)
    inflow[problem.window] = (problem.box_free_volume * rate * scene.solid_concentration * seen)[
        problem.box.interior
    ]
    weight = np.where(problem.free, problem.capacity, 0.0)
    diagonal = scene.liquid_diffusivity * problem.neighbour_liquid
    fixed_share = problem.sum(np.where(problem.fixed, problem.capacity, 0.0))
    sink = weight * scene.liquid_diffusivity * fixed_share
    system = DiffusionSystem(problem.sum, weight, diagonal, scene.liquid_diffusivity, sink)
    steady = np.zeros(problem.sum.padded_shape)
    norm = float(np.linalg.norm(inflow))
    try:
        system.solve(steady, inflow, 1e-8 * norm)
    except ConvergenceError as error:
        log.info("no bound for the liquid: %s", error)
        return unbounded
    # The factor covers the linear solver's tolerance.
    return 1.0001 * np.maximum(problem.sum.crop(steady), 0.0)


@dataclass(frozen=True)
class _Asked:
    """What a plan is for: a scene, the times at which V_L is wanted (s), and what is allowed."""

    scene: CorrosionScene
    problem: Discrete
    times: NDArray[np.float64]
    tolerance: float
    refused: Collection[str]

    @property
    def end(self) -> float:
        """The last time, s."""
        return float(self.times.max())

    @cached_property
    def reduced(self) -> ReducedCorrosion:
        """The scene in clean liquid."""
        nodes = None if isinstance(self.problem, Cells) else self.problem
        return ReducedCorrosion.of(self.scene, nodes)


def plan_omissions(
    scene: CorrosionScene,
    times: ArrayLike,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
) -> list[Omission]:
    """What the march to the last of `times` (s) can leave out within `tolerance` of V_L at each.

    Raises
    ------
    ValueError
        For a tolerance outside [0, 1) or an unknown name in `refused`.
    """
    return _plan(_asked(scene, times, tolerance, refused))[0]


def _asked(
    scene: CorrosionScene, times: ArrayLike, tolerance: float, refused: Collection[str]
) -> _Asked:
    check_request(tolerance, refused, OMITTABLE)
    wanted = np.atleast_1d(np.asarray(times, float))
    return _Asked(scene, _discrete(scene), wanted, tolerance, refused)


def _plan(asked: _Asked) -> tuple[list[Omission], np.ndarray]:
    """The omissions, and the domain without the liquid that they leave out."""
    scene = asked.scene
    distance = distance_transform_edt(~scene.metal, sampling=scene.lattice.spacing)
    far, domain = _far_liquid(asked, distance)
    omissions = [
        _solid_core(scene, asked.end), _liquid(asked), far, _coarse_liquid(scene, distance)
    ]  # fmt: skip
    return omissions, domain


def _solid_core(scene: CorrosionScene, end_time: float) -> Omission:
    count = int(scene.metal.sum())
    reason = (
        f"diffusion between the {count} metal nodes is not part of the model, so each one is "
        "eliminated exactly and takes no unknown"
    )
    if scene.exposure is None and scene.never_speeds_up:
        risk = int(metal_at_risk(scene, end_time).sum())
        depth = 1e6 * front_depth(scene, end_time)
        reason += (
            f"; {count - risk} of them cannot lose anything by the end, when dissolution has "
            f"reached at most {depth:.3g} um deep"
        )
    return Omission(SOLID_CORE, reason, 0.0, True)


def _coarse_liquid(scene: CorrosionScene, distance: np.ndarray) -> Omission:
    """Never left out; says what a lattice of two spacings would save."""
    reason = "not offered: there are no lattices of two spacings, liquid is as fine as the metal"
    if scene.metal.any():
        away = scene.domain & (distance > 2.0 * float(np.max(scene.horizon)))
        nodes, count = int(scene.domain.sum()), int(away.sum())
        left = 1.0 - count / nodes * (1.0 - 0.5**scene.lattice.dimension)
        reason += (
            f"; {count} nodes are liquid farther than two horizons from the metal, and twice as "
            f"coarse there it would have {100 * left:.0f} % of its nodes"
        )
    return Omission(COARSE_LIQUID, reason, math.inf, False)


def _far_liquid(asked: _Asked, distance: np.ndarray) -> tuple[Omission, np.ndarray]:
    """Liquid that too little solute reaches by the end; also the domain without it.

    Cutting at a distance a changes the amounts by at most what gets there: with C the highest
    concentration in the liquid and p = arrival_bound(a), C p (t D sum w per node next to the cut
    + 1 per node beyond it), relative to the least that the metal loses.
    """
    scene, end_time = asked.scene, asked.end
    if scene.boundary != "refreshed":
        return _far_needed("a closed edge sends solute back, and there is no bound"), scene.domain
    liquid = scene.domain & ~scene.metal
    highest = scene.saturation_concentration
    if scene.saturation != "complementarity":
        highest = scene.solid_concentration
    least = 0.0
    if scene.never_speeds_up:
        least = least_loss(scene, end_time, asked.problem)
    reach = float(np.max(np.multiply(scene.stencil.reach, scene.stencil.spacing)))
    if not least > 0 or not liquid.any() or not scene.metal.any():
        return _far_needed("there is no bound of what the metal loses at least"), scene.domain
    volume = scene.capacity()
    scale = least * float(volume[scene.metal].sum()) * scene.solid_concentration
    shell = np.ceil(distance[liquid] / reach - 1e-9).astype(np.int64)
    contents_of = np.bincount(shell, weights=volume[liquid])
    exchange = end_time * scene.liquid_diffusivity * scene.stencil.total
    bound = math.inf
    for n in range(3, int(distance[liquid].max() // reach)):
        cut = n * reach
        # Sources end a horizon from the metal (and one more for cells that hold more than one
        # volume); the nodes of the new edge begin a horizon before it.
        share = arrival_bound(scene, cut - 3.0 * reach, end_time)
        contents = float(contents_of[n + 1 :].sum() + exchange * contents_of[n])
        bound = highest * share * contents / scale
        if bound <= asked.tolerance:
            beyond = np.zeros_like(liquid)
            beyond[liquid] = shell > n
            omission = Omission(
                FAR_LIQUID,
                f"{int(beyond.sum())} of {int(liquid.sum())} liquid nodes are farther than "
                f"{1e6 * cut:.3g} um from the metal, where at most {share:.1e} of the highest "
                "concentration arrives by the end: what lies there, refreshed or not, is left out",
                bound,
                FAR_LIQUID not in asked.refused,
            )
            return omission, scene.domain & ~beyond
    reason = "solute may reach the domain's edge by the end"
    return _far_needed(reason), scene.domain


def _far_needed(reason: str) -> Omission:
    return Omission(FAR_LIQUID, f"needed: {reason}", math.inf, False)


def _liquid(asked: _Asked) -> Omission:
    """Clean liquid instead of a computed one.

    In stretched time ds = g dt, C_i' = -lambda_i (C_i - mean of C_liquid), so with
    eps = max C_liquid / C_solid each node's loss differs by at most the share eps; a kinetics
    that only slows with V_L keeps V_L(t) within eps / (1 - eps) of the clean-liquid value.  What
    saturated liquid holds back (of rate classes: held_back) and what dissolves comes on top.
    """
    scene, problem = asked.scene, asked.problem
    if not scene.dissolution.reduces:
        return _liquid_needed("a front that moves at a given flux is marched")
    if not scene.never_speeds_up:
        return _liquid_needed("the kinetics may speed up, or differs from place to place")
    by_classes, saturated = isinstance(problem, Cells), scene.saturation_concentration
    bound = liquid_bound(scene, problem)
    liquid = scene.domain if by_classes else scene.domain & ~scene.metal
    reach = bound[liquid].max(initial=0.0)
    if not np.isfinite(reach):
        return _liquid_needed("some liquid cannot reach refreshed medium and fills up")
    saturates = reach >= saturated and scene.saturation != "none"
    may_reach = f"its concentration may reach {reach:.3g} mol/m3, "
    if saturates and not (by_classes and reach <= _HOPELESS * saturated):
        return _liquid_needed(f"{may_reach}at or above saturation ({saturated:.3g})")
    epsilon = min(reach, saturated) / scene.solid_concentration
    error = epsilon / (1.0 - epsilon) if epsilon < 1 else math.inf
    if isinstance(problem, Cells):
        lost, moved = dissolving_bound(scene, asked.end, problem, asked.reduced)
    else:
        reduced = well_stirred(scene, [asked.end], problem=problem, reduced=asked.reduced)
        lost = int((scene.metal & ~reduced.metal[-1]).sum())
        moved = math.inf if lost else 0.0
    parts = "rate classes" if by_classes else "metal nodes"
    if lost and moved > asked.tolerance:
        known = f", which changes the volume loss by up to {moved:.1e}" if moved < 1 else ""
        return _liquid_needed(f"{lost} {parts} turn liquid by the end and expose others{known}")
    solid = f"what {lost} {parts} that dissolve expose changes it by {moved:.1e} at most"
    stays = (
        f"its concentration stays below {reach:.3g} mol/m3, {epsilon:.1e} of the solid's and "
        f"below saturation ({saturated:.3g})"
    )
    if saturates and isinstance(problem, Cells):
        later = asked.times[asked.times > 0]
        held = held_back(problem, asked.reduced, later, asked.tolerance)
        if not held.share <= asked.tolerance:
            return _liquid_needed(
                f"{may_reach}beyond saturation ({saturated:.3g}), which may hold back more than "
                f"{asked.tolerance:.1e} of the volume loss"
            )
        moved += held.share
        stays = (
            f"at most {held.cells} cells of it are saturated, until {held.until / 3600:.3g} h of "
            f"bare metal at the latest, which holds back {held.share:.1e} of the loss at most"
        )
    return Omission(
        LIQUID,
        f"{stays}, and {solid if lost else 'no metal node dissolves'}: clean liquid, one scalar "
        "equation",
        error + moved,
        error + moved <= asked.tolerance and LIQUID not in asked.refused,
    )


def _liquid_needed(reason: str) -> Omission:
    return Omission(LIQUID, f"needed: {reason}", math.inf, False)


def corrode_lean(
    scene: CorrosionScene,
    times: Sequence[float],
    stepping: TimeStepping | None = None,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
    progress: Callable[[float, str], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    march_by: Callable[..., CorrosionResult] = corrode,
    **march,
) -> tuple[CorrosionResult, list[Omission]]:
    """`corrode` without what the scene does not need; also returns what was left out.

    march_by: what marches, `corrode` or a function that takes the same (`ranks.corrode`).
    """
    asked = _asked(scene, times, tolerance, refused)
    omissions, domain = _plan(asked)
    if any(o.name == LIQUID and o.applied for o in omissions):
        nodes = None if isinstance(asked.problem, Cells) else asked.problem
        return well_stirred(scene, times, problem=nodes, reduced=asked.reduced), omissions
    del asked  # its arrays; the march has its own
    marched = scene
    if any(o.name == FAR_LIQUID and o.applied for o in omissions):
        marched = replace(scene, domain=domain)
    result = march_by(
        marched, times, stepping, progress=progress, checkpoint=checkpoint, resume=resume, **march
    )
    return replace(result, scene=scene), omissions
