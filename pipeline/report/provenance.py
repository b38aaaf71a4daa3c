"""Where every number of a scene comes from: joins the resolved scene with the data files.

A scene holds plain numbers.  A number that equals the one in the data file that the scene names
gets that file's source and kind; one that does not is reported as set by hand.
"""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import perilife_data
from fem.constitutive.hardening import fit_voce
from perilife_data import Quantity, Reference
from perilife_data.references import read_references
from pipeline.scene.laws.rate_law import read_kinetics
from pipeline.scene.loads import LOADS
from pipeline.scene.mapping import mapping_of
from pipeline.scene.mechanics import AUTO, TensileScene
from pipeline.scene.scene import AlloyScene, Scene

logger = logging.getLogger(__name__)

SYMBOLS = {
    "interface_diffusivity": "D_int",
    "liquid_diffusivity": "D_liq",
    "saturation_concentration": "C_sat",
    "solid_concentration": "C_solid",
    "volume_loss_scale": "l",
    "kernel_exponent": "q",
    "young_modulus": "E",
    "poisson_ratio": "ν",
    "initial_yield_stress": "s0",
    "hardening_capacity": "Q",
    "hardening_rate": "b",
    "q1": "q1",
}
_UNITS = {
    "solid_concentration": "mol/m^3",
    "saturation_concentration": "mol/m^3",
    "liquid_diffusivity": "m^2/s",
    "interface_diffusivity": "m^2/s",
    "young_modulus": "Pa",
    "initial_yield_stress": "Pa",
    "hardening_capacity": "Pa",
}
_TITLES = {
    "samples": "Samples per axis and cell",
    "classes": "Rate classes per cell near the surface",
    "size": "Edge length",
    "size_fine": "Edge length at thread and slot",
    "size_bottom": "Edge length at the bottom face",
    "size_top": "Edge length at the top face",
    "kinetics": "Law of the rate",
    "coating": "Coating",
    "dissolution": "Law of a bond between metal and liquid",
    "step": "Fixed time step",
    "rate_change": "Change of rate per time step",
    "peak_drop": "Ends at this drop from the peak",
    "damage": "Growth of f",
    "mapping": "Damage from lattice to mesh by",
    "keep": "Computed though it may be left out",
    "bending_azimuth": "Axis of bending from x",
    "damage_length": "Length over which the growth of f is averaged",
}
_LENGTHS = (
    "diameter length pitch minor_diameter root_diameter slot_width slot_depth spacing horizon "
    "radial_margin axial_margin size size_fine size_bottom size_top bottom_grip "
    "top_grip damage_length"
).split()


@dataclass(frozen=True)
class ParameterRow:
    """One number of a run with its unit and its origin, ready to be shown.

    alloy: the alloy that it belongs to, empty for what holds for the whole run.
    """

    section: str
    alloy: str
    name: str
    symbol: str
    value: str
    unit: str
    kind: str
    source: str = ""
    where: str = ""
    remark: str = ""


def parameter_rows(scene: Scene) -> list[ParameterRow]:
    """Every parameter of the run that has a source: those of each alloy, then of the fit.

    Of the ions, whose sets hold hundreds of numbers, only those that `to_be_listed` takes.
    """
    rows: list[ParameterRow] = []
    for alloy in scene.alloys:
        rows += _corrosion_rows(scene, alloy)
        rows += _mechanical_rows(alloy)
    return rows + _law_rows(scene) + _ion_rows(scene) + _calibration_rows(scene)


def to_be_listed(rows: Iterable[ParameterRow]) -> list[ParameterRow]:
    """The assumed, fitted and uncorrected values among the rows."""
    return [row for row in rows if row.kind in perilife_data.TO_BE_LISTED]


def references(rows: Iterable[ParameterRow], scene: Scene) -> dict[str, str]:
    """Full reference of every source that the rows name, by key, in order of first use.

    From the shipped references.bib, or from one beside a file of one's own that the scene names.
    """
    own = _references_beside(scene)
    found: dict[str, str] = {}
    for row in rows:
        if row.source and row.source not in found:
            try:
                reference = own.get(row.source) or perilife_data.load_reference(row.source)
                found[row.source] = str(reference)
            except ValueError:
                found[row.source] = row.source
    return found


def _references_beside(scene: Scene) -> dict[str, Reference]:
    named = [scene.parameter_set]
    named += [name for alloy in scene.alloys for name in (alloy.source, alloy.hardening)]
    named += [] if scene.ions is None else scene.ions.source.values()
    found: dict[str, Reference] = {}
    for folder in {Path(name).parent for name in named if name.endswith(".toml")}:
        try:
            found |= read_references(folder / "references.bib")
        except (OSError, ValueError) as error:
            logger.info("no references beside the data of the scene: %s", error)
    return found


def kinds_explained() -> Mapping[str, str]:
    """What each kind of value means."""
    return {**perilife_data.KINDS, **_BY_HAND}


_BY_HAND = {"set by hand": "not the value of the data file that the run names"}


def _corrosion_rows(scene: Scene, alloy: AlloyScene) -> list[ParameterRow]:
    place = ("Corrosion", alloy.name)
    if not alloy.corrosion.known:
        return []
    known, corrected = _fitted_quantities(scene, alloy)
    rows = []
    for item in fields(alloy.corrosion):
        if item.name.startswith("calibration"):
            continue
        if item.name == "volume_loss_scale" and scene.corrosion.kinetics != "volume_loss":
            continue  # not in use: the law has no l, or its own
        value = getattr(alloy.corrosion, item.name)
        remark = ""
        if item.name == "solid_concentration" and corrected:
            remark = f"from the composition: {corrected:,.0f} mol/m^3".replace(",", " ")
        rows.append(_row(place, item.name, value, known.get(item.name), remark))
    return rows


def _law_rows(scene: Scene) -> list[ParameterRow]:
    """The laws of rate and bond where the parameter set was not fitted with them."""
    chosen, rows = scene.corrosion, []
    if chosen.kinetics != "volume_loss":
        remark = "D_int was fitted with a rate that falls with the volume loss (l)"
        if read_kinetics(chosen.kinetics)[0] == "volume_loss":
            remark = "D_int was fitted with the l of the parameter set; this one is given by hand"
        rows.append(("kinetics", chosen.kinetics, remark))
    if chosen.dissolution != "proportional":
        remark = (
            "a bond carries the whole flux until its metal node is empty; D_int, C_sat and l were "
            "fitted with a flux in proportion to what the node still holds"
        )
        rows.append(("dissolution", chosen.dissolution, remark))
    if chosen.coating is not None:
        remark = "no source gives it; the parameter set was fitted to bare metal"
        rows.append(("coating", str(chosen.coating), remark))
    return [
        ParameterRow("Corrosion", "", title_of(name), "", law, "", "assumed", remark=remark)
        for name, law, remark in rows
    ]


def _ion_rows(scene: Scene) -> list[ParameterRow]:
    """What the ions use that is assumed, fitted or known to be wrong: of medium, set and laws."""
    ions, place = scene.ions, ("Ions", "")
    if ions is None:
        return []
    rows = [
        ParameterRow(*place, name, "", law.in_words(), "", "assumed", remark="no source gives it")
        for name, law in (("Feedback", ions.feedback), ("Electrodes", ions.electrodes))
        if law is not None
    ]
    if ions.electrodes is not None:
        rows += [
            ParameterRow(*place, f"{name} of the electrodes", "", f"{value:g}", "SI", "assumed")
            for name, value in ions.electrodes.numbers.items()
        ]
    try:
        medium = perilife_data.load_medium(ions.source["medium"])
        reactions = perilife_data.load_reaction_set(medium.reactions)
    except (ValueError, OSError) as error:
        logger.info("data of the medium of the scene are not available: %s", error)
        return rows
    stated = {
        "temperature": ions.temperature,
        "bath_volume": ions.bath_volume,
        "refresh_interval": ions.exchange_every,
        **{f"species.{name}.total_concentration": c for name, c in ions.totals.items()},
    }
    used = {
        name: quantity
        for name, quantity in medium.quantities().items()
        if stated.get(name) is not None and _same(stated[name], quantity.si)
    }
    for name, quantity in reactions.used(ions.temperature, ions.minerals).items():
        needed = {
            "inhibitor": ions.feedback is not None and ions.feedback.inhibitor,
            "ion_size": ions.activity == "wateq",
            "strength_coefficient": ions.activity == "wateq",
        }
        if all(needed.get(part, True) for part in name.split(".")):
            used[name] = quantity
    rows += [_row(place, _of_ions(name), q.si, q) for name, q in used.items()]
    return to_be_listed(rows)


def _of_ions(name: str) -> str:
    """A quantity of a medium or reaction set by its dotted name, for a reader.

    `species.H.diffusivity.310.15` is the diffusivity of H at 37 °C.
    """
    parts = name.split(".", 3)
    if parts[0] == "inhibitor":
        return f"{parts[1]} of the inhibitor"
    if len(parts) < 3:
        return name
    at = f" at {float(parts[3]) - 273.15:g} °C" if len(parts) > 3 else ""
    return f"{parts[2].replace('log_k', 'log10 K')} of {parts[1]}{at}"


def _fitted_quantities(scene: Scene, alloy: AlloyScene) -> tuple[dict[str, Quantity], float]:
    """Quantities of the fit and, where C_solid is printed wrong, the right one.

    Those of the alloy's own file where the scene's numbers are theirs, else of the parameter set.
    """
    record = _alloy_record(alloy)
    own = record.corrosion if record else None
    if own and _same(
        own.parameters.interface_diffusivity.si, alloy.corrosion.interface_diffusivity
    ):
        return own.parameters.quantities(), 0.0
    try:
        known = perilife_data.load_parameter_set(scene.parameter_set)
        quantities = known.for_alloy(alloy.name).quantities()
    except (ValueError, OSError) as error:
        logger.info("parameter set of the scene is not available: %s", error)
        return {}, 0.0
    concentration = quantities.get("solid_concentration")
    if concentration is None or concentration.kind != "published_uncorrected":
        return quantities, 0.0
    return quantities, record.solid_concentration.si if record else 0.0


def _alloy_record(alloy: AlloyScene) -> perilife_data.Alloy | None:
    try:
        return perilife_data.load_alloy(alloy.source or alloy.name)
    except (ValueError, OSError) as error:
        logger.info("data of alloy %s are not available: %s", alloy.name, error)
        return None


def _own_hardening(alloy: AlloyScene) -> dict[str, perilife_data.Quantity]:
    """Quantities of the hardening record that the run named, none where it took the alloy's own."""
    if not alloy.hardening:
        return {}
    try:
        return perilife_data.load_hardening(alloy.hardening).quantities()
    except (ValueError, OSError):
        return {}


def _mechanical_rows(alloy: AlloyScene) -> list[ParameterRow]:
    place = ("Mechanics", alloy.name)
    material, record = alloy.material, _alloy_record(alloy)
    known = record.quantities() if record else {}
    known |= _own_hardening(alloy)
    rows = [
        _row(place, name, getattr(material, name), known.get(name))
        for name in ("young_modulus", "poisson_ratio", "q1")
    ]
    hardening = (
        material.initial_yield_stress,
        material.hardening_capacity,
        material.hardening_rate,
    )
    inputs = ("yield_stress", "ultimate_tensile_strength", "uniform_strain")
    derived = False
    if all(name in known for name in inputs):
        fit = fit_voce(*(known[name].si for name in inputs))
        derived = all(_same(a, b) for a, b in zip(hardening, (fit.s0, fit.Q, fit.b), strict=True))
    if derived:
        rows += [_row(place, name, known[name].si, known[name]) for name in inputs]
    names = ("initial_yield_stress", "hardening_capacity", "hardening_rate")
    for name, value in zip(names, hardening, strict=True):
        row = _row(place, name, value, None)
        if derived:
            remark = "Voce curve through yield stress, strength and uniform strain"
            row = ParameterRow(**{**vars(row), "kind": "derived", "remark": remark})
        rows.append(row)
    return rows


def _calibration_rows(scene: Scene) -> list[ParameterRow]:
    """The scene that the parameter set was fitted in, where it is known."""
    try:
        calibration = perilife_data.load_parameter_set(scene.parameter_set).scene
    except (ValueError, OSError):
        return []
    place = (f"Scene of the fit “{scene.parameter_set}”", "")
    return [_row(place, name, q.si, q) for name, q in calibration.quantities().items()]


def settings(scene: Scene) -> dict[str, list[tuple[str, str]]]:
    """The choices of a run by group: name and value with its unit, as a person reads them."""
    groups = {
        "Geometry": getattr(scene.geometry, "parameters", scene.geometry),
        "Lattice": scene.lattice,
        "Liquid domain": scene.domain,
        "Corrosion solver": scene.corrosion,
    }
    test = LOADS[scene.tensile.load].test.capitalize()
    for hold in scene.holds:
        which = f" ({hold.name})" if len(scene.holds) > 1 else ""
        groups |= {f"Mesh{which}": hold.mesh, f"{test}{which}": hold.tensile}
    found = {}
    for group, choices in groups.items():
        values = {item.name: getattr(choices, item.name) for item in fields(choices)}
        if isinstance(choices, TensileScene) and choices.mapping == AUTO:
            values["mapping"] = f"{mapping_of(scene, choices)} (auto)"
        found[group] = [
            (title_of(name), " ".join(filter(None, shown(name, value))))
            for name, value in values.items()
            if value is not None and name != "sha256"
        ]
    return found


@dataclass(frozen=True)
class ComparedRow:
    """One parameter with its value for each alloy, or one value for all."""

    values: tuple[str, ...]
    name: str
    symbol: str
    unit: str
    kind: str
    source: str
    where: str
    remark: str


def side_by_side(
    rows: Iterable[ParameterRow], alloys: Sequence[str]
) -> dict[str, list[ComparedRow]]:
    """The rows by section, with those that differ only in alloy, value and remark joined."""
    joined: dict[tuple, dict[str, ParameterRow]] = {}
    for row in rows:
        key = (row.section, row.name, row.symbol, row.unit, row.kind, row.source, row.where)
        joined.setdefault(key, {})[row.alloy] = row
    found: dict[str, list[ComparedRow]] = {}
    for (section, *same), by_alloy in joined.items():
        name, symbol, unit, kind, source, where = same
        if "" in by_alloy:
            values = (by_alloy[""].value,)
        else:
            values = tuple(by_alloy[a].value if a in by_alloy else "–" for a in alloys)
        remarks = {row.remark for row in by_alloy.values()}
        remark = remarks.pop() if len(remarks) == 1 else _remarks(by_alloy)
        found.setdefault(section, []).append(
            ComparedRow(values, name, symbol, unit, kind, source, where, remark)
        )
    return found


def _remarks(by_alloy: Mapping[str, ParameterRow]) -> str:
    """What differs in the remarks by alloy, then what they share."""
    parts = {alloy: row.remark.split("; ") for alloy, row in by_alloy.items()}
    shared = [p for p in next(iter(parts.values())) if all(p in other for other in parts.values())]
    own = {a: "; ".join(p for p in several if p not in shared) for a, several in parts.items()}
    return "; ".join([*(f"{a}: {text}" for a, text in own.items() if text), *shared])


def _row(
    place: tuple[str, str], name: str, value: float, known: Quantity | None, remark: str = ""
) -> ParameterRow:
    """A row with the quantity's provenance where the number is that of the quantity."""
    title, symbol = title_of(name), SYMBOLS.get(name, "")
    if known is not None and _same(value, known.si):
        notes = [remark, known.conditions, known.note]
        return ParameterRow(
            *place,
            title,
            symbol,
            f"{known.value:g}",
            "" if known.unit == "1" else known.unit,
            known.kind,
            known.source,
            known.where,
            "; ".join(note for note in notes if note),
        )
    text, unit = shown(name, value)
    if known is not None:
        remark = f"the data file has {known} ({known.source}, {known.where})"
    return ParameterRow(*place, title, symbol, text, unit, "set by hand", remark=remark)


def shown(name: str, value: object) -> tuple[str, str]:
    """Value and unit as a person reads them."""
    if isinstance(value, bool):
        return ("yes" if value else "no"), ""
    if isinstance(value, tuple):
        return ", ".join(str(entry).replace("_", " ") for entry in value) or "nothing", ""
    if not isinstance(value, int | float):
        return str(value).replace("_", " ") if name != "path" else str(value), ""
    if name in _LENGTHS and value == 0:
        return "0", ""
    if name in _LENGTHS:
        return (f"{value * 1e6:.4g}", "µm") if value < 1e-3 else (f"{value * 1e3:.4g}", "mm")
    if name in ("thread_angle", "bending_azimuth"):
        return f"{math.degrees(value):.4g}", "°"
    if name == "step":
        return f"{value / 3600:.4g}", "h"
    if name in ("final_strain", "increment", "peak_drop", "rate_change"):
        return f"{100 * value:.4g}", "%"
    unit = _UNITS.get(name, "")
    if unit == "Pa":
        big = value >= 1e9
        return f"{value / (1e9 if big else 1e6):.4g}", "GPa" if big else "MPa"
    return f"{value:.6g}", unit


def title_of(name: str) -> str:
    """What a field of a scene is called for a reader."""
    if name in _TITLES:
        return _TITLES[name]
    text = name.replace("_", " ")
    return text if name == "q1" else text[:1].upper() + text[1:]


def _same(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=1e-9, abs_tol=0.0)
