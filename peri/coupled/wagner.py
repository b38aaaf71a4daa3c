"""What a couple need not compute: the potential where it is even, the kinetics where it is fast.

With the Wagner number W = kappa / (L di/dE) large, the liquid resists little and has one potential;
with W small the kinetics resists little and each metal stands at its rest potential.  Both bounds
here follow from the couple as it is at the start, by comparison: no entry beside the diagonal of
the potential's matrix is positive and no current falls with its potential.

One potential: let d be the potential that the currents i_0 of one level make in the liquid, and
D its range.  Where u - d is largest, u draws less current than i_0, so u lies below the level
there; likewise where it is least.  So u is within D of the level everywhere, and the current of a
metal is between its values at E - D and E + D.

Rest potentials: with linear laws of almost no resistance the currents are i_p.  The true current
at the patch with the largest overpotential is at most the largest i_p, so no metal is off its rest
potential by more than eta(max i_p), and the currents of two metals change by at most the sum of
both over the difference of their rest potentials.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from peri.coupled.galvanic import GalvanicResult, corrode
from peri.coupled.galvanic_march import GalvanicProblem, Renewal
from peri.coupled.galvanic_scene import GalvanicScene
from peri.engine.omission import DEFAULT_TOLERANCE, Omission, check_request
from peri.transport.potential.polarization import LinearPolarization, Polarization

log = logging.getLogger(__name__)

POTENTIAL, KINETICS, RENEWAL = "potential", "kinetics", "renewal"
OMITTABLE = (POTENTIAL, KINETICS, RENEWAL)
"""What may be refused."""
_FARTHEST = 100.0
"""V; a law without zero current up to there has no rest potential."""
_FAST = 1e-9
"""Resistance of a law in the place of fast kinetics, over that of half a spacing of liquid."""


def couple_omissions(
    scene: GalvanicScene,
    renewal: Renewal | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
) -> list[Omission]:
    """What the march of a couple can leave out within `tolerance` of its currents.

    Raises ValueError for a tolerance outside [0, 1), an unknown name in `refused`, and as
    PotentialProblem does.
    """
    check_request(tolerance, refused, OMITTABLE)
    if scene.robin == "as_published":
        reason = "needed: the bounds are of bonds that carry the law's current, not of mirror nodes"
        return [Omission(name, reason, np.inf, False, "a current") for name in OMITTABLE]
    even, fast = _one_level(scene), _at_rest(scene)
    wanted = [
        (POTENTIAL, *even),
        (KINETICS, *(fast if not even[0] <= tolerance else (np.inf, "the potential is left out"))),
    ]
    found = [
        Omission(name, reason, bound, bound <= tolerance and name not in refused, "a current")
        for name, bound, reason in wanted
    ]
    keeps = RENEWAL not in refused and tolerance > 0
    reason = (
        "the potential is kept after a step in which no node goes and the surfaces have receded "
        "too little to change the currents by more"
    )
    return [*found, Omission(RENEWAL, reason, tolerance, keeps, "the currents' sum")]


def _one_level(scene: GalvanicScene) -> tuple[float, str]:
    """Bound of the currents' error with one potential in the liquid, and why."""
    if scene.held is not None:
        return np.inf, "needed: some of the liquid is held at a potential"
    problem = GalvanicProblem(scene)
    electric = problem.potential_problem(problem.untouched())
    assert electric is not None
    flat = electric.level()
    if not np.abs(flat.density).any():
        return np.inf, "needed: no current flows in a liquid of one potential"
    reach = electric.drop(flat.density)
    area, of = electric.patches.area, electric.patches.electrode
    worst = size = 0.0
    for number, metal in enumerate(scene.metals):
        here = of == number
        at, there = flat.surface[here], area[here]
        change = np.maximum(
            *(np.abs(metal.law.current(at + side * reach) - metal.law.current(at))
              for side in (-1.0, 1.0))
        )  # fmt: skip
        worst = max(worst, float((there * change).sum()))
        size = max(size, float((there * np.abs(flat.density[here])).sum()))
    bound = worst / size
    return bound, f"the currents of one potential make {1e3 * reach:.3g} mV in the liquid"


def rest_potential(law: Polarization) -> float | None:
    """Where a law's current vanishes, V; None for Tafel's, which has no such potential."""
    low, high = (float(law.current(np.array(side * _FARTHEST))) for side in (-1.0, 1.0))
    if not low < 0.0 < high:
        return None
    return float(brentq(lambda e: float(law.current(np.array(e))), -_FARTHEST, _FARTHEST))


def at_rest_potentials(scene: GalvanicScene) -> GalvanicScene | None:
    """The scene with laws of almost no resistance at the rest potentials, if all have one."""
    rest = [rest_potential(metal.law) for metal in scene.metals]
    if any(e is None for e in rest):
        return None
    resistance = _FAST * 0.5 * min(scene.lattice.spacing) / float(np.max(scene.conductivity))
    return replace(
        scene,
        metals=tuple(
            replace(metal, law=LinearPolarization(e, resistance))
            for metal, e in zip(scene.metals, rest, strict=True)
            if e is not None
        ),
    )


def _at_rest(scene: GalvanicScene) -> tuple[float, str]:
    """Bound of the currents' error with every metal at its rest potential, and why."""
    fast = at_rest_potentials(scene)
    if fast is None or len(scene.metals) != 2 or scene.held is not None:
        return np.inf, "needed: it takes two metals with a potential without current"
    problem = GalvanicProblem(fast)
    primary = problem.solve(problem.untouched(), None)
    off = []
    rest = [metal.law.rest - metal.potential for metal in fast.metals]  # type: ignore[attr-defined]
    for number, metal in enumerate(scene.metals):
        most = primary.density[primary.patches.electrode == number]
        extreme = float(most[np.abs(most).argmax()]) if most.size else 0.0
        level = _potential_of(metal.law, extreme)
        off.append(abs(level - metal.potential - rest[number]))
    apart = abs(rest[0] - rest[1])
    bound = sum(off) / apart if apart > 0 else np.inf
    return bound, (
        f"the metals are at most {1e3 * off[0]:.3g} and {1e3 * off[1]:.3g} mV off their rest "
        f"potentials, {1e3 * apart:.3g} mV apart"
    )


def _potential_of(law: Polarization, current: float) -> float:
    """Where a law has a current, V; infinite beyond 100 V."""

    def above(e: float) -> float:
        return float(law.current(np.array(e))) - current

    if not above(-_FARTHEST) < 0 < above(_FARTHEST):
        return np.inf
    return float(brentq(above, -_FARTHEST, _FARTHEST, xtol=1e-15))


def corrode_lean(
    scene: GalvanicScene,
    times: Sequence[float],
    renewal: Renewal | None = None,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    refused: Collection[str] = (),
    progress: Callable[[float, str], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> tuple[GalvanicResult, list[Omission]]:
    """`galvanic.corrode` without what the couple does not need; also what was left out.

    The bounds of potential and kinetics are of the couple as it is at the start; at the end the
    currents are computed whole once more, and where they are off by more than the tolerance (a gap
    that has grown, say) the couple is marched again with nothing of the two left out.
    """
    omissions = couple_omissions(scene, renewal, tolerance, refused)
    applied = {o.name for o in omissions if o.applied}
    how = renewal or Renewal()
    if RENEWAL in applied:
        how = replace(how, change=tolerance)
    marched = scene
    if KINETICS in applied:
        fast = at_rest_potentials(scene)
        assert fast is not None
        marched = fast
    result = corrode(
        marched, times, how, one_level=POTENTIAL in applied, progress=progress,
        checkpoint=checkpoint, resume=resume,
    )  # fmt: skip
    off = _off_at_end(scene, result) if applied - {RENEWAL} else 0.0
    if off <= tolerance:
        return replace(result, scene=scene), omissions
    log.info("currents are %.2g off at the end: marched again", off)
    result = corrode(scene, times, how, progress=progress)
    text = f"needed: the currents are {off:.2g} off at the end"
    return result, [
        o if o.name == RENEWAL or not o.applied else replace(o, applied=False, reason=text)
        for o in omissions
    ]


def _off_at_end(scene: GalvanicScene, result: GalvanicResult) -> float:
    """How far the last currents are from those of the whole couple, over the largest of them."""
    problem = GalvanicProblem(scene)
    concentration = result.fields["concentration"][-1]
    fields = {
        "concentration": concentration,
        "lead": problem.still_led(problem.metal(concentration)),
    }
    names = [f"current_{metal.name}" for metal in scene.metals]
    last = np.array([result.history[name][-1] for name in names])
    if not last.any():
        return 0.0
    whole = problem.solve(fields, None)
    true = np.array([whole.current(number) for number in range(len(names))])
    return float(np.abs(true - last).max() / max(np.abs(true).max(), 1e-300))
