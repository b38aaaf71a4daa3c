"""`perilife calibrate`: from a file of measured volume losses to a parameter set with its doubts.

Which constants are free, which model is needed, which of them the data determine, what is open.
"""

from __future__ import annotations

import hashlib
import time as clock
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import perilife_data
from pipeline.calibration.fit import (
    STARTS,
    CalibrationError,
    Fit,
    Measurements,
    Parameter,
    fit,
)
from pipeline.calibration.identifiability import Direction, Identifiability, identify
from pipeline.calibration.models import (
    SEARCHED,
    Implant,
    MarchModel,
    ReducedModel,
    constants,
    liquid_omission,
    marching_executor,
    with_constants,
)
from pipeline.calibration.posterior import Posterior, gaussian, posterior
from pipeline.scene.scene import Scene

Array = NDArray[np.float64]

SAMPLES = 400
"""Samples of the posterior that a parameter set carries."""

ASSUMED_SCATTER = 0.01
"""Standard deviation of V_L by which constants are judged before a fit has estimated one."""


@dataclass(frozen=True)
class Calibrated:
    """A fit of one alloy.

    scene: with the fitted constants; result: of the determined constants; held: the others by
    name (SI); without_effect: those of them that clean liquid does not know; unseen: the other
    held ones with the direction that says why; identified: at the optimum; posterior: of the
    determined constants; clean: the bound of leaving the liquid out at the optimum, None for
    marches; model: of the determined constants, the others held.
    """

    scene: Scene
    alloy: str
    result: Fit
    held: dict[str, float]
    given: tuple[str, ...]
    without_effect: tuple[str, ...]
    unseen: dict[str, Direction]
    identified: Identifiability
    posterior: Posterior | None
    clean: float | None
    model: ReducedModel | MarchModel = field(repr=False)
    seconds: float = 0.0
    marches: int = 0

    def sentences(self) -> list[str]:
        """What the data do not see, in words."""
        symbols = {name: searched.symbol for name, searched in SEARCHED.items()}
        said = [d.in_words(symbols) for d in self.unseen.values()]
        if self.without_effect:
            names = " and ".join(symbols[name] for name in self.without_effect)
            verb = "have" if len(self.without_effect) > 1 else "has"
            bound = f"{100 * (self.clean or 0.0):.2g} %"
            said.append(
                f"{names} {verb} no effect in clean liquid (less than {bound} of the volume loss)"
            )
        return list(dict.fromkeys(said))


def measurements_of(path: Path | str) -> tuple[Measurements, str]:
    """The measurements of a file, without those at time zero, and the file's SHA-256."""
    data = perilife_data.read_volume_loss_csv(path)
    later = data.times > 0
    deviations = data.standard_deviation
    if not later.any():
        raise CalibrationError(f"{path}: every measurement is at time 0; one later is needed")
    try:
        found = Measurements(
            data.times[later],
            data.volume_loss[later],
            None if deviations is None else deviations[later],
        )
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None
    return found, hashlib.sha256(Path(path).read_bytes()).hexdigest()


def free_and_held(
    scene: Scene, alloy: str, free: Sequence[str] | None, fix: dict[str, float]
) -> tuple[list[Parameter], dict[str, float]]:
    """The constants to search, begun at the scene's values, and those held (SI)."""
    values = constants(scene, alloy)
    for name in [*(free or ()), *fix]:
        if name not in values:
            raise CalibrationError(
                f"parameter '{name}' is not known; it must be one of {', '.join(values)}"
            )
    both = set(free or ()) & set(fix)
    if both:
        raise CalibrationError(f"parameter {sorted(both)[0]} is both free and fixed")
    chosen = [n for n in values if n not in fix and (free is None or n in free)]
    solid = scene.alloy(alloy).corrosion.solid_concentration
    parameters = []
    for name in chosen:
        lower, upper = SEARCHED[name].bounds(solid)
        begin = float(np.clip(values[name], lower, upper))
        parameters.append(Parameter(name, begin, lower, upper, SEARCHED[name].unit))
    return parameters, {n: fix.get(n, v) for n, v in values.items() if n not in chosen}


def calibrate(
    scene: Scene,
    alloy: str,
    measurements: Measurements,
    *,
    free: Sequence[str] | None = None,
    fix: dict[str, float] | None = None,
    implant: Implant | None = None,
    starts: int = STARTS,
    workers: int | None = None,
    executor: Executor | None = None,
) -> Calibrated:
    """Fit an alloy's constants in a scene.

    free: names to search, None for all that are not fixed; fix: values of held ones (SI); starts:
    of the search with the reduced model, a march begins once; executor: where marches run, so that
    the model goes on working afterwards (`marching_executor`), otherwise `workers` of its own.

    Raises
    ------
    CalibrationError
        Where the data allow no fit (see `fit`), or no constant asked for acts.
    """
    begun = clock.perf_counter()
    fix = fix or {}
    parameters, held = free_and_held(scene, alloy, free, fix)
    if not parameters:
        raise CalibrationError("no parameter is free; at least one must be")
    scene = with_constants(scene, alloy, held)
    implant = implant or Implant(scene)
    refuse = scene.corrosion.dissolution != "proportional"
    omission = liquid_omission(scene, alloy, implant, measurements.times)
    names = [p.name for p in parameters]
    with ExitStack() as stack:
        clean = omission.applied and not refuse
        if clean:
            found = _fitted(
                ReducedModel(scene, alloy, implant, names), scene, alloy, measurements, parameters,
                starts,
            )  # fmt: skip
            omission = liquid_omission(found.scene, alloy, implant, measurements.times)
            clean = omission.applied
        if not clean:
            executor = executor or stack.enter_context(marching_executor(workers, implant.folder))
            model = MarchModel(scene, alloy, names, executor)
            found = _fitted(model, scene, alloy, measurements, parameters, 1)
    return Calibrated(
        **{
            **found.__dict__,
            "given": tuple(fix),
            "clean": omission.bound if clean else None,
            "held": {**held, **found.held},
            "seconds": clock.perf_counter() - begun,
        }
    )


def _fitted(
    model: ReducedModel | MarchModel,
    scene: Scene,
    alloy: str,
    measurements: Measurements,
    parameters: list[Parameter],
    starts: int,
) -> Calibrated:
    """Fit what acts; hold what the data do not determine; fit the rest again."""
    acting = model.acting()
    without = tuple(p.name for p in parameters if p.name not in acting)
    if not acting:
        raise CalibrationError(
            f"parameter {', '.join(without)} does not act on the volume loss of this scene, and no "
            "other is free"
        )
    # As given, even where that is outside of the range of the search.
    held = {name: value for name, value in constants(scene, alloy).items() if name in without}
    chosen = [p for p in parameters if p.name in acting]
    marching = isinstance(model, MarchModel)
    unseen: dict[str, Direction] = {}
    deviations = measurements.deviations
    if marching:  # a fit of what the data do not see would walk along it for ever
        part = model.keeping([p.name for p in chosen], held)
        logs = np.log([p.value for p in chosen])
        _, jacobian = part(measurements.times, logs)
        scaled = jacobian / (ASSUMED_SCATTER if deviations is None else deviations[:, None])
        unseen |= identify(part.names, scaled.T @ scaled).fixed
    while True:
        held |= {p.name: p.value for p in chosen if p.name in unseen}
        chosen = [p for p in chosen if p.name not in unseen]
        if not chosen:
            raise CalibrationError(
                "the measurements determine none of the free parameters: "
                + "; ".join(d.in_words() for d in unseen.values())
            )
        part = model.keeping([p.name for p in chosen], held)
        result = fit(part, measurements, chosen, starts=starts)
        identified = identify(result.names, result.fisher())
        if not identified.fixed:
            break
        unseen |= identified.fixed
    fitted = with_constants(scene, alloy, {**held, **result.values})
    sampled = None if marching else posterior(part, result)
    return Calibrated(
        scene=fitted,
        alloy=alloy,
        result=result,
        held=held,
        given=(),
        without_effect=without,
        unseen=unseen,
        identified=identified,
        # a grid of marches takes days
        posterior=sampled or gaussian(result, identified.covariance, 10 * SAMPLES),
        clean=None,
        model=part,
        marches=getattr(model, "marches", 0) + (getattr(part, "marches", 0)),
    )
