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
