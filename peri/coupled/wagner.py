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

Ions: what the currents of the start give the liquid until the end reaches a concentration that
one solution bounds (galvanic_ions.IonTransport.highest), and saturation.  By how much of itself the
conductivity changes up to there, times the liquid's share of the resistance
(PotentialProblem.ohmic_shares), bounds the currents' change to first order.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from peri.coupled.galvanic import GalvanicResult, corrode
from peri.coupled.galvanic_ions import IonTransport
from peri.coupled.galvanic_march import GalvanicProblem
from peri.coupled.galvanic_renewal import Renewal
from peri.coupled.galvanic_scene import GalvanicScene
from peri.engine.march.problem import Fields, State
from peri.engine.omission import DEFAULT_TOLERANCE, Omission, check_request
from peri.transport.potential.polarization import LinearPolarization, Polarization

log = logging.getLogger(__name__)

POTENTIAL, KINETICS, IONS, RENEWAL = "potential", "kinetics", "ions", "renewal"
OMITTABLE = (POTENTIAL, KINETICS, IONS, RENEWAL)
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
    end: float | None = None,
) -> list[Omission]:
    """What the march of a couple can leave out within `tolerance` of its currents.

    end : of the march, s, which bounds the ions that it gives to the liquid.

    Raises ValueError for a tolerance outside [0, 1), an unknown name in `refused`, and as
    PotentialProblem does.
    """
    check_request(tolerance, refused, OMITTABLE)
    if scene.robin == "as_published":
        reason = "needed: the bounds are of bonds that carry the law's current, not of mirror nodes"
        return [Omission(name, reason, np.inf, False, "a current") for name in OMITTABLE]
    clean = replace(scene, ions=None)
    even, fast = _one_level(clean), _at_rest(clean)
    wanted = [
        (POTENTIAL, *even),
        (KINETICS, *(fast if not even[0] <= tolerance else (np.inf, "the potential is left out"))),
    ]
    found = [
        Omission(name, reason, bound, bound <= tolerance and name not in refused, "a current")
        for name, bound, reason in wanted
    ]
    follows = scene.ions is not None
    if follows:
        bound, reason = ions_bound(scene, end)
        if found[0].applied:
            bound, reason = min(bound, even[0]), "the potential is left out"
        small = bound <= tolerance and IONS not in refused
        found.append(Omission(IONS, reason, bound, small, "a current"))
        follows = not small
    if follows:
        reason = "needed: the conductivity changes with the ions in every step"
        return [*found, Omission(RENEWAL, reason, np.inf, False, "the currents' sum")]
    keeps = RENEWAL not in refused and tolerance > 0
    reason = (
        "the potential is kept after a step in which no node goes and the surfaces have receded "
        "too little to change the currents by more"
    )
    return [*found, Omission(RENEWAL, reason, tolerance, keeps, "the currents' sum")]


def ions_bound(
    scene: GalvanicScene,
    end: float | None,
    fields: Fields | None = None,
    growth: float = 1.0,
) -> tuple[float, str]:
    """Bound of the currents' error without the ions, to first order, and why.

    end : s; None: only saturation bounds the ions.  fields : of a state (by default that at the
    start).  growth : what multiplies the currents of that.
    """
    ions, problem = scene.ions, GalvanicProblem(replace(scene, ions=None))
    assert ions is not None
    state = State(0.0, problem.untouched() if fields is None else dict(fields), {})
    electric = problem.potential_problem(state.fields)
    if electric is None:
        return 0.0, "no metal touches the liquid"
    found = problem.solve(state.fields, None)
    most = ions.saturation_concentration or np.inf
    if end is not None:
        state.fields["density"] = np.abs(found.density)
        coupled, alone, _ = problem.rates(state)
        given = found.patches.shares.T @ (growth * coupled + alone)
        transport = IonTransport(ions, scene.lattice, scene.stencil)
        liquid = ~problem.metal(state.fields["concentration"])
        most = min(most, transport.highest(given, liquid, end))
    if not np.isfinite(most):
        return np.inf, "needed: nothing bounds what the liquid dissolves"
    try:
        kappa = ions.conductivity.of(np.linspace(0.0, most, 1001))
    except ValueError:
        return np.inf, f"needed: the law of the conductivity ends below {most:.3g} mol/m3"
    change = float(np.abs(kappa / kappa[0] - 1.0).max())
    share = float(electric.ohmic_shares(found).max())
    return change * share, (
        f"at most {most:.3g} mol/m3 of ions change the conductivity by {100 * change:.3g} %, and "
        f"the liquid's share of the resistance is at most {share:.2g}"
    )


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
    march_by: Callable[..., GalvanicResult] = corrode,
) -> tuple[GalvanicResult, list[Omission]]:
    """`galvanic.corrode` without what the couple does not need; also what was left out.

    The bounds of potential and kinetics are of the couple as it is at the start; at the end the
    currents are computed whole once more, and where they are off by more than the tolerance (a gap
    that has grown, say) the couple is marched again with nothing of the two left out.

    march_by : what marches, `corrode` or a function that takes the same (`galvanic_ranks.corrode`).
    """
    omissions = couple_omissions(scene, renewal, tolerance, refused, float(max(times, default=0.0)))
    applied = {o.name for o in omissions if o.applied}
    how = renewal or Renewal()
    if RENEWAL in applied:
        how = replace(how, change=tolerance)
    marched = replace(scene, ions=None) if IONS in applied else scene
    if KINETICS in applied:
        fast = at_rest_potentials(marched)
        assert fast is not None
        marched = fast
    result = march_by(
        marched, times, how, one_level=POTENTIAL in applied, progress=progress,
        checkpoint=checkpoint, resume=resume,
    )  # fmt: skip
    off = _off_at_end(scene, result) if applied & {POTENTIAL, KINETICS} else 0.0
    if IONS in applied and POTENTIAL not in applied:
        off = max(off, _ions_at_end(scene, result))
    if off <= tolerance:
        return replace(result, scene=scene), omissions
    log.info("currents are %.2g off at the end: marched again", off)
    how = replace(how, change=0.0) if IONS in applied else how
    result = march_by(scene, times, how, progress=progress)
    text = f"needed: the currents are {off:.2g} off at the end"
    return result, [
        o if o.name == RENEWAL or not o.applied else replace(o, applied=False, reason=text)
        for o in omissions
    ]


def _at_end(problem: GalvanicProblem, result: GalvanicResult) -> Fields:
    """Metal and leads of the last output."""
    concentration = result.fields["concentration"][-1]
    return {
        "concentration": concentration,
        "lead": problem.still_led(problem.metal(concentration)),
    }


def _ions_at_end(scene: GalvanicScene, result: GalvanicResult) -> float:
    """The bound without ions of the couple that is left, by the largest current that there was."""
    sizes = sum(np.abs(result.history[f"current_{metal.name}"]) for metal in scene.metals)
    if not sizes[-1] > 0:
        return 0.0
    fields = _at_end(GalvanicProblem(replace(scene, ions=None)), result)
    growth = float(sizes.max() / sizes[-1])
    return ions_bound(scene, float(result.times[-1]), fields, growth)[0]


def _off_at_end(scene: GalvanicScene, result: GalvanicResult) -> float:
    """How far the last currents are from those of the whole couple, over the largest of them."""
    follows = "ions" in result.fields
    problem = GalvanicProblem(scene if follows else replace(scene, ions=None))
    fields = _at_end(problem, result)
    if follows:
        fields["ions"] = result.fields["ions"][-1] + result.fields["salt"][-1]
    names = [f"current_{metal.name}" for metal in scene.metals]
    last = np.array([result.history[name][-1] for name in names])
    if not last.any():
        return 0.0
    whole = problem.solve(fields, None)
    true = np.array([whole.current(number) for number in range(len(names))])
    return float(np.abs(true - last).max() / max(np.abs(true).max(), 1e-300))
