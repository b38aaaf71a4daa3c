"""How far a front and its solute can get by a given time: proven bounds from the scene alone."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import minimize_scalar

from peri.corrosion.classes.cells import Cells
from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.engine.cells import around
from peri.omissions.reduced import ReducedCorrosion, factor_of

_ROUNDS = 30
"""Of what goes and what then sees liquid, by turns; unsettled after them, there is no bound."""
_INTERVALS = 6
"""Of z, from when the first class begins to go; one makes the bound 5 to 6 times as large, twice as
many take a sixth off it (the ball of the tests)."""
_SETTLED = 0.01
"""Relative growth of what goes in the last round; the factor of two covers the rest."""


def front_depth(scene: CorrosionScene, end_time: float) -> float:
    """Depth below the initial surface beyond which no metal loses anything by `end_time`, m.

    A node loses only once it sees liquid, at a rate of at most lambda = D_int g(0) times its
    whole bond sum, so it turns liquid no sooner than t = ln(C_solid/C_sat) / lambda later
    (1 / lambda under Faraday's law).  Each such time moves the front by at most a horizon.
    The kinetics must not speed up (CorrosionScene.never_speeds_up).
    """
    reach = float(np.max(np.multiply(scene.stencil.reach, scene.stencil.spacing)))
    rate = scene.base_interface_diffusivity() * scene.kinetics.rate(Exposed(0.0))
    rate *= scene.stencil.total * float(scene.capacity().max(initial=1.0))
    if rate == 0 or end_time == 0:
        return reach
    needed = scene.dissolution.lifetime(scene)
    return reach * (1.0 + math.floor(end_time * rate / needed))


def metal_at_risk(scene: CorrosionScene, end_time: float) -> np.ndarray:
    """Metal nodes that may lose something by `end_time`; bool of the lattice's shape."""
    liquid = scene.domain & ~scene.metal
    if not liquid.any():
        return np.zeros_like(scene.metal)
    diagonal = math.sqrt(scene.lattice.dimension)  # reach along every axis at once
    farthest = diagonal * front_depth(scene, end_time) * (1 + 1e-9)
    # Where liquid is all around it, the metal's box and one layer hold all nearest liquid.
    window = around(scene.metal)
    if window is None or not scene.domain[window].all():
        window = (slice(None),) * scene.lattice.dimension
    distance = distance_transform_edt(~liquid[window], sampling=scene.lattice.spacing)
    risk = np.zeros_like(scene.metal)
    risk[window] = scene.metal[window] & (distance <= farthest)
    return risk


def arrival_bound(scene: CorrosionScene, distance: float, end_time: float) -> float:
    """Largest share of a source's concentration that gets `distance` (m) away by `end_time` (s).

    The concentration at a liquid node is at most that of the source times the chance that a
    walk with the bonds' rates gets from the node to the source.  For every s > 0 the chance of a
    displacement a along an axis is at most exp(-s a + t D sum w (cosh(s xi) - 1)) (Doob), and
    one of the axes has to carry distance / sqrt(d).
    """
    stencil, d = scene.stencil, scene.lattice.dimension
    along = max(distance, 0.0) / math.sqrt(d)
    share = 0.0
    for a, h in enumerate(stencil.spacing):
        offset = h * np.arange(stencil.octant.shape[a])
        weight = (stencil.multiplicity * stencil.octant).sum(
            axis=tuple(b for b in range(d) if b != a)
        )

        def exponent(s: float, offset=offset, weight=weight) -> float:
            spread = float((weight * (np.cosh(s * offset) - 1.0)).sum())
            return -s * along + end_time * scene.liquid_diffusivity * spread

        best = minimize_scalar(exponent, bounds=(0.0, 50.0 / offset[-1]), method="bounded")
        share += 2.0 * math.exp(min(0.0, best.fun))
    return min(1.0, share)


def least_loss(
    scene: CorrosionScene, end_time: float, problem: BiMaterial | Cells | None = None
) -> float:
    """A lower bound of V_L(end_time), from the first moments.

    While the fullest liquid node stays below C_sat / 2 every bond carries at least half its
    first flux; V_L does not fall afterwards.  `problem`: the scene's, where the caller has it.
    """
    first_rate = scene.kinetics.rate(Exposed(0.0))
    if isinstance(problem, Cells):
        rate = problem.interface_rate(0.0)[0]  # one for all, or the scene is refused above
        rates, volumes = rate * problem.bond_sum, problem.volume
        strongest = rate * float(problem.pull.max(initial=0.0))
    else:
        problem = problem or BiMaterial(scene)
        rate = problem.base_diffusivity * first_rate
        if problem.box is None or rate == 0:
            return 0.0
        rates, volumes = problem.metal_rates()[scene.metal], scene.capacity()[scene.metal]
        rates = rates * first_rate
        seen = problem.box(problem.box_metal_volume)
        strongest = rate * float(seen[problem.box_liquid_volume > 0].max())
    if scene.coating is not None:  # what bare metal adds after it comes on top
        rates, strongest = rates * scene.coating.factor, strongest * scene.coating.factor
        end_time = min(end_time, scene.coating.lifetime)
    if not rates.max(initial=0.0) > 0:
        return 0.0
    inflow = strongest * scene.solid_concentration
    time = min(end_time, 0.5 * scene.saturation_concentration / inflow)
    first = time * float(volumes @ rates) / float(volumes.sum())
    # The metal's own loss and the kinetics weaken the flux further, by less than a half if tiny.
    later = scene.kinetics.rate(Exposed(min(1.0, 2.0 * first)))
    steepest = later / first_rate
    left = max(0.0, 0.5 - time * float(rates.max())) * steepest
    return first * left


def left_after(problem: Cells, seen: np.ndarray) -> np.ndarray:
    """Volumes (n,) that are left of classes that have seen G z (n,) in clean liquid."""
    scene = problem.scene
    life = 1.0 - seen / scene.dissolution.lifetime(scene)
    return problem.left(scene.solid_concentration * np.exp(-seen), life)


def dissolving_bound(
    scene: CorrosionScene,
    end_time: float,
    problem: Cells,
    reduced: ReducedCorrosion | None = None,
) -> tuple[int, float]:
    """What classes that dissolve change in V_L in clean liquid, relative, and how many they are.

    Frozen rates G (`reduced`) hold until z_1, when the first class begins to go (z the integral of
    D_int g).  By some z_n the volume u of classes whose exposure G z is spent is gone, and the
    others' rates have become G'; with these others are spent, and so on, until u settles.  A class
    holds at most the share e of its exposure so far by the lower of both rates, so what is lost by
    z_n differs by at most

        d = sum (v - u) sum_m e(z_m-1) |G'_m - G| (z_m - z_m-1) + u (e + C_sat / (C_solid - C_sat)),

    and by 2 d at equal times: a kinetics that only slows makes up for what is lost too early, z
    lags by what d is worth, and the loss is concave in z.  V_L is at least that at z_n-1.  The
    state is one function of z in any case, whatever D_int and the kinetics.  `reduced`: that of
    the scene, where the caller has it.

    Returns
    -------
    int, float
        Classes that begin to go by the end; the largest 2 d / V_L(z_n-1), infinite where it does
        not settle.
    """
    reduced = reduced or ReducedCorrosion.of(scene)
    found = reduced.volume_loss(
        scene.bare_time([end_time]), scene.base_interface_diffusivity(), factor_of(scene.kinetics)
    )
    end, rates, volume = float(found.exposure[0]), problem.initial_bond_sum, problem.initial_volume
    remaining = left_after(problem, rates * end)
    count = int((remaining < volume).sum())
    if not count:
        return 0, 0.0
    early, late = 0.0, end
    for _ in range(20):
        middle = 0.5 * (early + late)
        begun = (left_after(problem, rates * middle) < volume).any()
        early, late = (early, middle) if begun else (middle, late)
    saturated = scene.saturation_concentration
    ends = saturated / (scene.solid_concentration - saturated)
    most = lowest = rates
    changed, apart, seen = np.zeros_like(rates), np.zeros_like(rates), rates * early
    bound, moments = 0.0, np.linspace(early, end, _INTERVALS + 1)
    for before, moment in zip(moments, moments[1:], strict=False):
        gone = 0.0
        for _ in range(_ROUNDS):
            remaining = left_after(problem, most * moment)
            last, gone = gone, float((volume - remaining).sum())
            later = problem.moved(remaining)
            if gone - last <= _SETTLED * gone:
                break
            most = np.maximum(most, np.where(remaining > 0, later, 0.0))
        else:
            return count, math.inf
        there = remaining > 0
        changed = np.maximum(changed, np.where(there, np.abs(later - rates), 0.0))
        apart = apart + np.exp(-seen) * changed * (moment - before)
        lowest = np.minimum(lowest, np.where(there, later, lowest))
        seen = seen + lowest * (moment - before)
        shares = remaining * apart + (volume - remaining) * (np.exp(-seen) + ends)
        least = float(reduced.loss_at([before])[0])
        if not least > 0:
            return count, math.inf
        bound = max(bound, 2.0 * float(shares.sum() / volume.sum()) / least)
    return count, bound
