"""How sure the numbers of a run are, by what the run itself measured, and what less doubt costs."""

import numpy as np

from pipeline.planning.plan import interpolated, scene_omissions
from pipeline.record.run_results import AlloyResult, ImmersionResult, RunResults, column
from pipeline.report.wording import duration, percent
from pipeline.scene.errors import MEASURED, corrosion_error, tensile_error
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.loads import LOADS
from pipeline.scene.mapping import fallen_back
from pipeline.scene.mechanics import EXPOSURES, NODES
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.resolve import DEFAULT_PARAMETER_SET
from pipeline.scene.scene import (
    DomainSettings,
    HoldScene,
    Scene,
    ScrewGeometry,
)
from pipeline.scene.units import format_length, format_seconds, parse_time

_MISSED = {
    NODES: "what interpolation from the lattice to the mesh does to the damage",
    EXPOSURES: "what the points of the cells miss of the damage below the surface",
}
ENOUGH_SPACINGS = 4
"""Lattice spacings across the thinnest wall from which on no warning is given."""


def checks(run: RunResults) -> list[dict[str, str]]:
    """Measured checks of this run: what, how large, what it means, from what it was computed."""
    found = []

    def add(what: str, value: str, meaning: str, source: str) -> None:
        found.append({"what": what, "value": value, "meaning": meaning, "source": source})

    for alloy in run.alloys:
        error = column(alloy.history, "balance_error")
        if error is not None and len(error):
            add(
                f"{alloy.name}: mass balance of the corrosion",
                _small(float(np.nanmax(np.abs(error)))),
                "largest share of the metal that appears or vanishes in the computation",
                "balance_error of history.csv, each step: the metal that the nodes hold, the metal "
                "in the liquid and what has left, against the metal at the start",
            )
    everything = [alloy for alloys in run.held.values() for alloy in alloys]
    for alloy in run.alloys:
        differences = [
            (abs(item.map_numbers["relative_difference"]), item)
            for other in everything
            if other.name == alloy.name
            for item in other.immersions
            if isinstance(item.map_numbers.get("relative_difference"), int | float)
        ]
        if differences:
            worst, item = max(differences, key=lambda pair: pair[0])
            add(
                f"{alloy.name}: lost mass, mesh against lattice",
                percent(worst, 2),
                f"largest difference, after {duration(item.seconds)}: {_MISSED[item.mapping]}; the "
                "map then makes up for it",
                "corrosion.h5 and the mesh: 1 - C/C_solid summed over the nodes and, before it is "
                "cut off, over the points of the cells",
            )
    estimates = [
        (abs(left - pulled), left, pulled, _case(run, alloy, item))
        for alloy in everything
        for item in alloy.immersions
        if item.summary is not None
        and item.seconds > 0
        and _finite(left := item.map_numbers.get("net_section_left"))
        and _finite(pulled := item.summary.strength_ratio)
    ]
    if estimates and run.scene.tensile.load == "axial":
        _, left, pulled, case = max(estimates)
        add(
            "Strength left by the weakest section alone",
            f"{percent(left, 0)} against {percent(pulled, 0)}",
            f"largest difference, {case}: the metal in the weakest layer between the grips, each "
            "part of it by 1 - q1 f0, over the same before immersion; no test is computed for it",
            "corrosion.h5, layer by layer, against the tests",
        )
    torn = [
        (int(i.tensile.get("torn_cells", 0)), int(i.tensile.get("cells", 0)), _case(run, a, i))
        for a in everything
        for i in a.immersions
    ]
    if max(torn, default=(0,))[0] > 0:
        count, cells, case = max(torn)
        add(
            f"Cells let go so that a {LOADS[run.scene.tensile.load].test} could go on",
            f"{count} of {cells:,}",
            f"most in one test, {case}: drawn out to twice their length with at most "
            "5 % of their strength, or to five times, where no increment found equilibrium",
            "torn_cells of tensile.json, each test",
        )
    lags = [
        (float(i.tensile["lag_at_peak"]), _case(run, a, i))
        for a in everything
        for i in a.immersions
        if "lag_at_peak" in i.tensile
    ]
    if lags:
        worst, case = max(lags)
        add(
            f"Largest {LOADS[run.scene.tensile.load].reaction}, by its increments",
            percent(worst, 2),
            f"most at a peak, {case}: what f, foreseen from the increment before, misses there; "
            "within a factor of three it is the difference to ever smaller increments",
            "lag_at_peak of tensile.json, each test",
        )
    gaps = [(_energy_gap(i), _case(run, a, i)) for a in everything for i in a.immersions]
    known = [pair for pair in gaps if pair[0] is not None]
    if known:
        worst, case = max(known)
        add(
            f"Energy balance of the {LOADS[run.scene.tensile.load].test}s",
            percent(worst, 2),
            f"largest difference, {case}: work of the grips against what is stored and dissipated",
            "tensile.csv, each increment: the grips' force over their way, and the energies of all "
            "quadrature points",
        )
    return found


def _case(run: RunResults, alloy: AlloyResult, item: ImmersionResult) -> str:
    """Alloy, time and, where there are several ways of holding, the way, for a reader."""
    held = f" ({alloy.hold})" if len(run.held) > 1 else ""
    return f"{alloy.name} after {duration(item.seconds)}{held}"


def _energy_gap(item: ImmersionResult) -> float | None:
    """Largest |work - stored - dissipated| of a test over its work; None if unknown."""
    work, stored, dissipated = (
        column(item.curve, name) for name in ("work", "stored", "dissipated")
    )
    if work is None or stored is None or dissipated is None or not np.nanmax(work, initial=0.0) > 0:
        return None
    return float(np.nanmax(np.abs(work - stored - dissipated)) / np.nanmax(work))


def error_estimate(run: RunResults) -> str:
    """The error of the run's own settings in volume loss and strength, as far as measured."""
    estimate = run.scene_extras.get("error_estimate")
    if estimate:
        return str(estimate)
    return f"{_volume_loss_error(run)} {' '.join(_strength_error(run, h) for h in run.scene.holds)}"


def own_errors(run: RunResults) -> dict[str, float]:
    """What each alloy's march with rate classes found of its error by itself, relative, of V_L."""
    found = {alloy.name: alloy.corrosion_numbers.get("sampling_error") for alloy in run.alloys}
    return {name: float(error) for name, error in found.items() if _finite(error)}


def _with_liquid(run: RunResults) -> list[str]:
    """Names of the alloys whose liquid was computed."""
    return [
        alloy.name
        for alloy in run.alloys
        if not any(
            isinstance(o, dict) and o.get("name") == "liquid" and o.get("applied")
            for o in alloy.corrosion_numbers.get("omissions", [])
        )
    ]


def _by_itself(run: RunResults, own: dict[str, float]) -> str:
    """The errors that the run found by itself, and what they do not hold."""
    errors = ", ".join(f"{percent(error, 2)} for {name}" for name, error in own.items())
    liquid = _with_liquid(run)
    more = "time steps" + f" and the liquid of {' and '.join(liquid)}" * bool(liquid)
    return (
        f"The run itself finds the volume loss off by about {errors} of its value because the "
        "solid's surface was sampled: by the change with other parts, and with all samples "
        "instead of rate classes (of simple bodies, 0.6 to 3.5 times what they are off); "
        f"{more} come on top."
    )


def _volume_loss_error(run: RunResults) -> str:
    own = own_errors(run)
    if own:
        return _by_itself(run, own) + (" " + _studied(run) if corrosion_error(run.scene) else "")
    return _studied(run)


def _studied(run: RunResults) -> str:
    """What the study of the presets says of these settings."""
    known = corrosion_error(run.scene)
    if known is None:
        return (
            "The discretisation error of the volume loss has not been measured for this solid, "
            "lattice and time settings, only for the reference screw with those of the presets."
            + _thin_walls(run)
        )
    errors = ", ".join(
        f"{percent(known.of(alloy.name), 1)} for {alloy.name}" for alloy in run.scene.alloys
    )
    scene = run.scene
    same = (
        scene.geometry == ScrewGeometry()
        and scene.parameter_set == DEFAULT_PARAMETER_SET
        and scene.domain == DomainSettings()
        and all(alloy.name in known.time for alloy in scene.alloys)
    )
    where = "in this very scene" if same else "on the reference screw with Table 5.1, not here"
    return (
        f"The volume loss is off by at most {errors} of its value because space and time are "
        f"discrete, measured up to 8 weeks {where}."
    )


def _thin_walls(run: RunResults) -> str:
    """A warning where a wall has few nodes across it: the front then meets itself unresolved."""
    feature, spacing = run.geometry.get("smallest_feature"), run.scene.lattice.spacing
    if not feature or feature >= ENOUGH_SPACINGS * spacing * (1 - 1e-9):
        return ""
    return (
        f" Its smallest feature is {format_length(feature)}, {feature / spacing:.2g} lattice "
        f"spacings; below {ENOUGH_SPACINGS} expect errors beyond those of the presets."
    )


def _strength_error(run: RunResults, hold: HoldScene) -> str:
    known = tensile_error(run.scene, hold)
    if run.scene.tensile.load != "axial":
        return (
            "The discretisation error of the strength left has been measured of tensile tests "
            f"only, not of {LOADS[run.scene.tensile.load].test}s."
        )
    if known is None:
        return (
            f"The discretisation error of the strength left held by {hold.name} has not been "
            "measured for this solid, mesh, element, increment and map of the damage, only for the "
            f"reference screw with those of the presets ({', '.join(('shank', *MEASURED))})."
        )
    scene, part = run.scene, HOLDINGS[hold.name].part
    settings = f" with {known.settings}" if known.settings else ""
    same = all(a.name in known.alloys for a in scene.alloys)
    where = "" if same else ", not here"
    latest = duration(parse_time(known.latest).seconds)
    parts = ", ".join(
        f"{percent(sum(both), 1)} for {alloy} ({percent(both[0], 1)} by mesh, "
        f"{percent(both[1], 1)} by increments)"
        for alloy, both in known.parts.items()
    )
    return (
        f"The strength left of {part} is off by about {parts}, measured after {latest} on the "
        f"reference screw{settings}{where}: `{known.command}`."
    )


def settings_name(scene: Scene) -> str:
    """The preset of a scene by name, and whether the run departs from it."""
    preset = RESOLUTIONS.get(scene.resolution)
    own = {
        "spacing": scene.lattice.spacing,
        "horizon": scene.lattice.horizon,
        "rate_change": scene.corrosion.rate_change,
        "mesh_size": scene.mesh.size,
        "mesh_size_fine": scene.mesh.size_fine,
        "element": scene.tensile.element,
        "increment": scene.tensile.increment,
    }
    changed = preset is None or any(getattr(preset, key) != value for key, value in own.items())
    return f"“{scene.resolution}”, changed" if changed else f"“{scene.resolution}”"


def in_short(run: RunResults, assumed: int) -> str:
    """The doubts in one line, to stand right below the answer."""
    given, known = run.scene_extras.get("error_estimate"), corrosion_error(run.scene)
    error = "the discretisation error is not measured yet"
    if given:
        error = str(given)
    elif known is not None:
        most = max(known.of(alloy.name) for alloy in run.scene.alloys)
        error = f"discretisation error of the volume loss up to {percent(most, 1)}"
        error += _strength_in_short(run) or ", of the strength not measured for these settings"
    elif own := own_errors(run):
        most = max(own.values())
        error = f"discretisation error of the volume loss about {percent(most, 1)} by its own check"
        error += ", which does not look at the liquid" * bool(_with_liquid(run))
        error += _strength_in_short(run)
    values = "value is" if assumed == 1 else "values are"
    seconds = sum(record.seconds for _, record in run.records)
    cost = f" The stages took {format_seconds(seconds)} in sum." if seconds else ""
    return (
        f"Resolution {settings_name(run.scene)}; {error}, and {assumed} {values} assumed, fitted "
        f"or known to be wrong.{cost}"
    )


def _strength_in_short(run: RunResults) -> str:
    """The error of the strength left in each way of holding; nothing where none was measured."""
    if run.scene.tensile.load != "axial":
        return ""
    errors = {hold.name: tensile_error(run.scene, hold) for hold in run.scene.holds}
    if not any(errors.values()):
        return ""
    names = [alloy.name for alloy in run.scene.alloys]
    said = ", ".join(
        f"of {HOLDINGS[hold].part} "
        + ("not measured" if known is None else f"up to {percent(max(map(known.of, names)), 1)}")
        for hold, known in errors.items()
    )
    return f", of the strength left {said}"


def twice_as_sure(run: RunResults) -> str:
    """What halving the discretisation error would cost, from the run's own times."""
    seconds = {}
    for _, record in run.records:
        seconds[record.stage] = seconds.get(record.stage, 0.0) + record.seconds
    corrosion, pulls = seconds.get("corrode"), seconds.get("pull")
    if not corrosion or not pulls:
        return "The run times needed for an estimate are not in this run."
    corrode, pull = (format_seconds(value) for value in (corrosion, pulls))
    known = corrosion_error(run.scene)
    if known is None or not run.scene.corrosion.classes:
        lattice = (
            "Half the lattice spacing means 8 times the nodes and, at the same horizon, 8 times "
            f"the bonds of each node: corrosion {corrode} → {format_seconds(8 * corrosion)} to "
            f"{format_seconds(64 * corrosion)}."
        )
    else:
        source = "measured" if known.half_error_measured else "extrapolated from what was measured"
        lattice = (
            f"Half the error of the volume loss takes about {known.half_error_cost:.2g} times the "
            f"processor time ({source}): corrosion {corrode} → "
            f"{format_seconds(known.half_error_cost * corrosion)}, less where the liquid is left "
            "out."
        )
    return (
        f"{lattice} Half the edge length of the mesh means 8 times the cells: "
        f"{LOADS[run.scene.tensile.load].test}s "
        f"{pull} → {format_seconds(8 * pulls)} or more. No computation makes the assumed "
        "strengths of the alloys any surer: that takes a tensile test of the bar that the screw "
        "is cut from."
    )


def omissions(run: RunResults) -> list[dict[str, str]]:
    """What was left out, why, and the bound of the error, for the model and for each alloy.

    The corrosion stage records its own omissions with name, reason, bound (relative to the volume
    loss) and whether they were applied.
    """
    found = [
        {"alloy": "all", "what": entry.what, "reason": entry.reason, "bound": entry.error}
        for entry in scene_omissions(run.scene)
    ]
    for alloy in run.alloys:
        reasons = (_fallen_back(run, alloy.name, hold) for hold in run.scene.holds)
        because = next(filter(None, reasons), "")
        if because:
            entry = interpolated(because)
            found.append(
                {
                    "alloy": alloy.name,
                    "what": entry.what,
                    "reason": entry.reason,
                    "bound": entry.error,
                }
            )
        entries = alloy.corrosion_numbers.get("omissions", [])
        for entry in entries if isinstance(entries, list) else []:
            if isinstance(entry, dict) and entry.get("applied", True):
                bound = entry.get("bound")
                measure = str(entry.get("of", "the volume loss"))
                text = f"{100 * bound:.2g} % of {measure}" if _finite(bound) else "not known"
                name = str(entry.get("name", "")).replace("_", " ")
                reason = str(entry.get("reason", ""))
                found.append({"alloy": alloy.name, "what": name, "reason": reason, "bound": text})
    return found


def _fallen_back(run: RunResults, alloy: str, hold: HoldScene) -> str:
    """Why an alloy's damage came from the nodes where its scene has exposures; "" else."""
    items = next(a.immersions for a in run.held[hold.name] if a.name == alloy)
    times = zip(run.scene.with_intact(), items, strict=True)
    reasons = (fallen_back(run.scene, hold.tensile, time, item.map_numbers) for time, item in times)
    return next(filter(None, reasons), "")


def _small(value: float) -> str:
    """A share that is best read by its power of ten."""
    return f"{value:.0e}" if value else "0"


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value))
