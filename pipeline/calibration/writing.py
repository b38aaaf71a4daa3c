"""A calibration in words, in a parameter set, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

import perilife_data
from pipeline.calibration.calibrate import SAMPLES, Calibrated
from pipeline.calibration.identifiability import profile, what_to_measure_next
from pipeline.calibration.models import SEARCHED, Implant
from pipeline.calibration.parameter_file import (
    BIBLIOGRAPHY_FILE,
    FittedAlloy,
    FittedConstant,
    FittedScene,
    write_parameter_set,
)
from pipeline.calibration.posterior import band
from pipeline.record.run_folder import write_json
from pipeline.scene.resolve import OWN_PARAMETERS
from pipeline.scene.scene import Scene, ScrewGeometry
from pipeline.scene.units import format_length

JSON_FILE = "calibration.json"
_DAY = 86400.0


def lines_of(found: Calibrated) -> list[str]:
    """What the fit found, for a person."""
    result = found.result
    how = (
        f"estimated from the residuals, {100 * result.deviations.mean():.2g} %-points "
        f"({_known_within(len(result.residuals) - len(result.logs))})"
    )
    if not result.scatter_estimated:
        how = f"as given, {100 * result.deviations.mean():.2g} %-points on average"
    model = "marches"
    if found.clean is not None:
        model = f"clean liquid (bound {100 * found.clean:.2g} % of the volume loss)"
    rates = found.scene.corrosion.classes
    lattice = format_length(found.scene.lattice.spacing)
    lines = [
        f"{found.alloy}: {len(result.residuals)} measurements, scatter {how}; {model}, on a "
        f"lattice of {lattice} with {f'{rates} rate classes' if rates else 'one rate per node'}",
        f"loss {result.loss:.4g} with {len(result.logs)} constants; {result.reached} of "
        f"{result.starts} searches ended there, {result.evaluations} evaluations, "
        f"{found.seconds:.1f} s",
    ]
    low, _, high = np.exp(band(found.posterior.logs, found.posterior.weights))
    for n, name in enumerate(result.names):
        searched, value = SEARCHED[name], result.values[name]
        unit = "" if searched.unit == "1" else f" {searched.unit}"
        at = "; the end of the range searched" if name in result.at_bound else ""
        lines.append(
            f"  {searched.symbol:6s} {value:.4g}{unit} (5 to 95 %: {low[n]:.3g} to {high[n]:.3g}; "
            f"sd of ln {found.identified.deviations[n]:.2g}){at}"
        )
    correlations = found.identified.correlations
    for i in range(len(result.names)):
        for j in range(i):
            symbols = [SEARCHED[result.names[k]].symbol for k in (j, i)]
            lines.append(f"  correlation of {' and '.join(symbols)}: {correlations[i, j]:.2f}")
    for name, value in found.held.items():
        kind = "fixed" if _kind(found, name) != "not_identified" else "not identified, fixed"
        unit = "" if SEARCHED[name].unit == "1" else f" {SEARCHED[name].unit}"
        lines.append(f"  {SEARCHED[name].symbol:6s} {kind} at {value:.4g}{unit}")
    return lines + [f"  {sentence}" for sentence in found.sentences()]


def _known_within(freedom: int) -> str:
    """How well a scatter is known that was estimated with so many degrees of freedom."""
    low, high = np.sqrt(freedom / (2.0 * gammaincinv(0.5 * freedom, [0.95, 0.05])))
    return f"the true one is {low:.2g} to {high:.2g} times that, 5 to 95 %"


def next_lines(
    found: Calibrated, candidates: NDArray[np.float64], wanted: float, label: str
) -> list[str]:
    """The table `what to measure next`."""
    deviation = float(found.result.deviations.mean())
    now, after = what_to_measure_next(
        found.model, found.result.logs, found.result.fisher(), candidates, wanted, deviation
    )
    loss = float(found.model(np.array([wanted]), found.result.logs)[0][0])
    last = found.result.measurements.times.max()
    beyond = ""
    if wanted > last:
        beyond = f", later than the last measurement ({last / _DAY / 7:.3g} weeks): the law's alone"
    lines = [
        f"volume loss at {label}: {100 * loss:.1f} %{beyond}; standard deviation, of the scatter "
        f"alone, {100 * now:.2f} %-points; with one more measurement of the same scatter"
    ]
    for item in after:
        weeks = item.time / _DAY / 7
        lines.append(f"  after {weeks:4.3g} weeks: {100 * item.deviation:.2f} %-points")
    return lines


def profile_lines(found: Calibrated, name: str) -> list[str]:
    """The profile likelihood of one constant over three standard deviations either side."""
    result = found.result
    if name not in result.names:
        return [f"profile of {SEARCHED[name].symbol}: not identified, so flat"]
    index = result.names.index(name)
    deviation = found.identified.deviations[index]
    parameter = result.parameters[index]
    steps = np.linspace(-3, 3, 13)
    values = np.clip(
        np.exp(result.logs[index] + steps * deviation), parameter.lower, parameter.upper
    )
    data = replace(result.measurements, deviations=result.deviations)
    losses = profile(found.model, data, result.parameters, name, list(values))
    lines = [f"profile of {SEARCHED[name].symbol}: loss above its least (90 %: below 2.71)"]
    return lines + [
        f"  {value:.4g}: {loss - result.loss:.3f}"
        for value, loss in zip(values, losses, strict=True)
    ]


def begun_from(scene: Scene, parameters: str | None = None) -> perilife_data.ParameterSet:
    """The set that a fit begins from: the one named, else the alloy's own or the shipped one."""
    if parameters is not None or scene.parameter_set != OWN_PARAMETERS:
        return perilife_data.load_parameter_set(parameters or scene.parameter_set)
    alloy = perilife_data.load_alloy(scene.alloys[0].source)
    own = alloy.corrosion
    return perilife_data.ParameterSet(
        OWN_PARAMETERS, alloy.title, own.medium, own.scene, {alloy.name: own.parameters}
    )


def write_calibration(
    out: Path,
    base: perilife_data.ParameterSet,
    found: Calibrated,
    implant: Implant,
    data: Path,
    digest: str,
) -> Sequence[Path]:
    """Write the parameter set, its bibliography and calibration.json; returns their paths.

    base: the set that the fit began from.
    """
    scene = found.scene
    geometry = scene.geometry
    solid = "solid from a file"
    if isinstance(geometry, ScrewGeometry):
        size = geometry.parameters
        solid = f"screw {1e3 * size.diameter:g} mm x {1e3 * size.length:g} mm"
    written = write_parameter_set(
        out,
        base,
        FittedScene(
            solid=solid,
            domain=implant.domain.shape,
            nodes=int((implant.inside | implant.metal).sum()),
            diameter=2 * implant.domain.radius,
            height=implant.domain.height,
            saturation=scene.corrosion.saturation,
            boundary=scene.domain.boundary,
        ),
        FittedAlloy(
            found.alloy, _constants(found), _calibration(found, data, digest), _samples(found)
        ),
    )
    write_json(out / JSON_FILE, _as_json(found, data, digest))
    return written, out / BIBLIOGRAPHY_FILE, out / JSON_FILE


def _kind(found: Calibrated, name: str) -> str:
    if name in found.result.names:
        return "fitted"
    seen = name not in found.unseen and name not in found.without_effect
    return "assumed" if name in found.given or seen else "not_identified"


def _constants(found: Calibrated) -> dict[str, FittedConstant]:
    constants = {}
    for n, name in enumerate(found.result.names):
        note = f"standard deviation of its logarithm {found.identified.deviations[n]:.3g}"
        if name in found.result.at_bound:
            note += "; the optimum is an end of the range searched"
        constants[name] = FittedConstant(found.result.values[name], "fitted", note)
    for name, value in found.held.items():
        if _kind(found, name) == "not_identified":
            note = "the data do not determine it; held at this value"
            constants[name] = FittedConstant(value, "not_identified", note)
        elif name in found.given:
            constants[name] = FittedConstant(value, "assumed", "held at this value on request")
    return constants


def _samples(found: Calibrated) -> NDArray[np.float64]:
    return np.exp(found.posterior.draw(SAMPLES))


def _calibration(found: Calibrated, data: Path, digest: str) -> dict[str, object]:
    result = found.result
    fields: dict[str, object] = {
        "data": data.name,
        "sha256": digest,
        "measurements": len(result.residuals),
        "loss": result.loss,
        "scatter": float(result.deviations.mean()),
        "scatter_is": "estimated" if result.scatter_estimated else "given",
        "parameters": list(result.names),
    }
    if found.sentences():
        fields["not_seen"] = found.sentences()
    return fields


def _as_json(found: Calibrated, data: Path, digest: str) -> dict[str, object]:
    result = found.result
    return {
        **_calibration(found, data, digest),
        "alloy": found.alloy,
        "model": "marches" if found.clean is None else "clean liquid",
        "bound_of_clean_liquid": found.clean,
        "constants": {n: {"value": v, "kind": "fitted"} for n, v in result.values.items()}
        | {
            n: "not identified"
            if _kind(found, n) == "not_identified"
            else {"value": v, "kind": "held"}
            for n, v in found.held.items()
        },
        "held_at": found.held,
        "at_bound": list(result.at_bound),
        "times_s": result.measurements.times.tolist(),
        "measured": result.measurements.values.tolist(),
        "standard_deviations": result.deviations.tolist(),
        "residuals": result.residuals.tolist(),
        "standard_deviations_of_logarithms": found.identified.deviations.tolist(),
        "correlations": found.identified.correlations.tolist(),
        "effective_samples": found.posterior.effective,
        "posterior": "grid" if found.clean is not None else "Gaussian in the logarithms",
        "evaluations": result.evaluations,
        "searches": {"reached": result.reached, "of": result.starts},
        "scene": found.scene.to_json(),
        "seconds": found.seconds,
    }
