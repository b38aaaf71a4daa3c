"""What the metals of a couple are made of: alloy, polarization, self-corrosion; and the liquid."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from peri.corrosion.kinetics import ConstantRate, Kinetics, VolumeLossLaw
from peri.corrosion.polarization import ButlerVolmerCurve, TafelCurve
from peri.coupled.galvanic import Metal
from peri.coupled.galvanic_ions import Ions
from peri.engine.constants import FARADAY, GAS_CONSTANT
from peri.engine.lattice import Lattice
from peri.transport.potential.conductivity import (
    ConductivityLaw,
    IonConductivity,
    TabulatedConductivity,
)
from peri.transport.potential.polarization import Insulated, LinearPolarization, Polarization
from perilife_data import (
    Alloy,
    Electrode,
    common_reference,
    load_alloy,
    load_electrode,
    load_medium,
    load_reaction_set,
)
from perilife_data.schema import Record
from perilife_data.units import UNITS
from pipeline.scene.laws.polarization import polarization_law
from pipeline.scene.resolve import corrosion_parameters, fit_of
from pipeline.scenes.bodies import BODY_KEYS
from pipeline.scenes.keys import TEXT, Given, Key, positive
from pipeline.scenes.outcome import Value
from pipeline.stages.corrosion import dissolution_flux

T = TypeVar("T")
OWN = "own"
"""Parameters of a metal: those of its alloy's own file."""
CONSTANTS = ("solid_concentration", "charge_number", "self_corrosion", "volume_loss_scale")
"""What a metal that dissolves may be given in place of its alloy's or its set's."""
COMPOSITION = ("mass_fractions", "elements", "density", "solid_concentration")
"""Of an alloy: C_solid and what that is computed from."""
LAWS = ("linear", "tafel", "butler-volmer", "insulated")
METAL_KEYS: dict[str, Key] = {
    **BODY_KEYS,
    "electrode": Key(TEXT, "name of a shipped electrode, or a TOML file like one", "AE44"),
    "law": Key(TEXT, "polarization in place of an electrode's", "tafel", allowed=LAWS),
    "rest_potential": Key("electric potential", "of law linear or butler-volmer", "-1.5V"),
    "resistance": positive("resistance of a surface", "of law linear", "0.1 ohm m^2"),
    "exchange_current_density": positive("current density", "of butler-volmer", "0.01 A/m^2"),
    "current_density": positive("current density", "of tafel, at its potential", "0.1 A/m^2"),
    "tafel_slope": Key("electric potential", "a decade; negative: cathodic", "-0.15V"),
    "standard_potential": Key("electric potential", "of law tafel", "-1.5V"),
    "potential": Key("electric potential", "of the metal (0 V: all are joined by a wire)", "0V"),
    "dissolves": Key(TEXT, "whether it does (no)", "yes", allowed=("yes", "no")),
    "alloy": Key(TEXT, "name of a shipped alloy, or a TOML file like one", "Mg-5Gd"),
    "parameters": Key(
        TEXT,
        "gives its alloy solid_concentration, self_corrosion (by D_int) and volume_loss_scale as "
        "in a life cycle: a parameter set, TOML file of one (of a fit), or own: the alloy's file",
        "fits/mine/parameters.toml",
    ),
    "solid_concentration": positive(
        "concentration", "in place of the alloy's or the set's", "67860 mol/m^3"
    ),
    "charge_number": positive("dimensionless", "of the ion, in place of the alloy's", 2),
    "self_corrosion": Key(
        "surface reaction rate", "of a fresh surface, without a couple", "1e-6 mol/(m^2 s)",
        at_least=0.0,
    ),
    "volume_loss_scale": positive("dimensionless", "l by which self-corrosion slows", 0.1),
}  # fmt: skip
LIQUID_KEYS: dict[str, Key] = {
    "conductivity": positive("conductivity", "kappa", "2.5 S/m"),
    "medium": Key(
        TEXT, "in place of it: kappa of a medium's ions, undisturbed", "sodium-chloride-142"
    ),
}
ION_KEYS: dict[str, Key] = {
    "diffusivity": positive(
        "diffusivity", "of the metals' ions; left out: none are followed", "7.1e-10 m^2/s"
    ),
    "saturation_concentration": positive(
        "concentration", "above which they are salt; left out: they never are", "0.21 mol/m^3"
    ),
    "renewed": Key(
        TEXT,
        "where liquid is renewed, a horizon wide: nowhere (left out), top (of the last axis) or "
        "edges",
        "top",
        allowed=("nowhere", "top", "edges"),
    ),
    "counter_diffusivity": positive(
        "diffusivity", "of their counter-ions of charge 1 (chloride)", "2.03e-9 m^2/s"
    ),
    "temperature": positive("temperature", "of the conductivity's law (25 degC)", "25 degC"),
    "concentrations": Key(
        "concentration", "points of a measured conductivity in its place, from 0 on",
        ["0 mol/m^3", "100 mol/m^3"], at_least=0.0, several=True,
    ),
    "conductivities": positive(
        "conductivity", "at these points, the first that of the clean liquid",
        ["2.5 S/m", "3.6 S/m"], several=True,
    ),
}  # fmt: skip


@dataclass
class Beside:
    """Values of data files that a scene uses, for its record."""

    values: dict[str, Value] = field(default_factory=dict)

    def add(self, name: str, data: Record, used: Collection[str]) -> None:
        """The quantities of a record that are used, by their names or by the first part of these.

        name : that the record is listed by.
        """
        for quantity, q in data.quantities().items():
            if quantity in used or quantity.split(".")[0] in used:
                where = f"{q.where} ({q.conditions})" if q.conditions else q.where
                unit = next(iter(UNITS[q.dimension]))
                self.values[f"{name}: {quantity}"] = Value(q.si, unit, q.source, where, q.kind)

    def add_electrode(self, electrode: Electrode) -> None:
        """What the law of an electrode uses (pipeline.scene.laws.polarization)."""
        names = {n for n in electrode.quantities() if not n.endswith("published_tafel_slope")}
        if electrode.butler_volmer is None:
            names.discard("temperature")
        self.add(electrode.name, electrode, names)
        if electrode.curve is not None:
            points, unit = list(electrode.curve.currents), "A/m^2"
            about = (electrode.curve.source, electrode.curve.where, electrode.curve.kind)
            self.values[f"{electrode.name}: curve"] = Value(points, unit, *about)


def conductivity(given: Given, beside: Beside) -> float:
    """kappa of the liquid, S/m; of a medium F^2/(RT) sum z^2 D C of its ions."""
    if ("liquid.conductivity" in given) == ("liquid.medium" in given):
        raise ValueError(f"{given.file}: give one of liquid.conductivity and liquid.medium")
    if "liquid.conductivity" in given:
        return given.number("liquid.conductivity")
    medium = load_medium(given.text("liquid.medium"))
    if not medium.reactions:
        raise ValueError(f"{given.file}: liquid.medium is '{medium.name}', which names no ions")
    temperature = medium.temperature.si
    reactions = load_reaction_set(medium.reactions)
    mobile = reactions.at(temperature).diffusivity
    ions = {n: species for n, species in medium.species.items() if n in mobile}
    total = sum(
        ion.charge_number.si**2 * mobile[n] * ion.total_concentration.si for n, ion in ions.items()
    )
    of_ions = [n for n in medium.quantities() if n.split(".")[1:2] and n.split(".")[1] in ions]
    beside.add(medium.name, medium, ["temperature", *of_ions])
    for name in ions:
        beside.add(f"{reactions.name}: {name}", reactions.species[name], ["diffusivity"])
    kappa = FARADAY**2 / (GAS_CONSTANT * temperature) * total
    beside.values[f"{medium.name}: conductivity"] = Value(
        kappa, "S/m", "", "F^2/(RT) sum z^2 D C of the ions as listed, dilute", "derived"
    )
    return kappa


def ions_of(
    given: Given, metals: tuple[Metal, ...], lattice: Lattice, horizon: float, clean: float
) -> Ions | None:
    """The ions that a file follows in its liquid, which conducts `clean` (S/m) without them.

    Raises ValueError for what does not fit.
    """
    if "ions.diffusivity" not in given:
        return None
    diffusivity = given.number("ions.diffusivity")
    charges = {metal.charge_number for metal in metals if metal.solid_concentration}
    if not charges:
        raise ValueError(f"{given.file}: ions.diffusivity is given, but no metal dissolves")
    law: ConductivityLaw
    if "ions.concentrations" in given or "ions.conductivities" in given:
        points = [given[f"ions.{name}"] for name in ("concentrations", "conductivities")]
        law = _named(given, TabulatedConductivity, *(tuple(p) for p in points))  # type: ignore[arg-type]
    else:
        if len(charges) > 1:
            raise ValueError(
                f"{given.file}: charge_number is {', '.join(f'{z:g}' for z in sorted(charges))}; "  # type: ignore[type-var]
                "with ions it must be one, or give ions.concentrations and ions.conductivities"
            )
        counter = given.otherwise("ions.counter_diffusivity", 2.03e-9, "m^2/s", "of chloride")
        temperature = given.otherwise("ions.temperature", 298.15, "K", "25 degC")
        law = IonConductivity(clean, charges.pop(), diffusivity, counter, temperature)  # type: ignore[arg-type]
    most = (
        given.number("ions.saturation_concentration")
        if "ions.saturation_concentration" in given
        else None
    )
    where = given.text("ions.renewed") if "ions.renewed" in given else "nowhere"
    ions = Ions(diffusivity, law, most, _renewed(lattice, horizon, where))
    _named(given, ions.check, lattice.shape, clean)
    return ions


def _named(given: Given, make: Callable[..., T], *values: object) -> T:
    """What `make` gives; its refusal names the file."""
    try:
        return make(*values)
    except ValueError as error:
        raise ValueError(f"{given.file}: [ions] {error}") from None


def _renewed(lattice: Lattice, horizon: float, where: str) -> np.ndarray | None:
    """Nodes within a horizon of the upper edge of the last axis, or of every edge."""
    if where == "nowhere":
        return None
    out = np.zeros(lattice.shape, bool)
    for a in range(lattice.dimension):
        if where == "top" and a < lattice.dimension - 1:
            continue
        wide = round(horizon / lattice.spacing[a])
        plane = np.moveaxis(out, a, 0)
        plane[-wide:] = True
        if where == "edges":
            plane[:wide] = True
    return out


def metals_of(
    given: Given, nodes: dict[str, np.ndarray], beside: Beside
) -> tuple[tuple[Metal, ...], dict[str, Electrode]]:
    """The metals by the tables of [metals], and the electrodes that some of them name.

    Raises ValueError for what is missing or does not fit, and for electrodes against different
    reference electrodes.
    """
    electrodes: dict[str, Electrode] = {}
    metals = []
    for name, place in nodes.items():
        table = f"metals.{name}"
        if (f"{table}.electrode" in given) == (f"{table}.law" in given):
            raise ValueError(f"{given.file}: give one of {table}.electrode and {table}.law")
        law: Polarization
        if f"{table}.electrode" in given:
            electrode = load_electrode(given.text(f"{table}.electrode"))
            beside.add_electrode(electrode)
            electrodes[name], law = electrode, polarization_law(electrode)
        else:
            law = _own_law(given, table)
        metals.append(Metal(name, place, law, **_dissolving(given, table, beside)))
    if electrodes:
        common_reference(electrodes.values())
    return tuple(metals), electrodes


def _own_law(given: Given, table: str) -> Polarization:
    law = given.text(f"{table}.law")
    if law == "insulated":
        return Insulated()
    try:
        if law == "linear":
            return LinearPolarization(
                given.number(f"{table}.rest_potential"), given.number(f"{table}.resistance")
            )
        if law == "butler-volmer":
            return ButlerVolmerCurve(
                given.number(f"{table}.exchange_current_density"),
                given.number(f"{table}.rest_potential"),
            )
        return TafelCurve(
            given.number(f"{table}.current_density"),
            given.number(f"{table}.tafel_slope"),
            given.number(f"{table}.standard_potential"),
        )
    except ValueError as error:
        text = str(error)
        raise ValueError(text if given.file in text else f"{given.file}: {table}.{text}") from None


def _dissolving(given: Given, table: str, beside: Beside) -> dict:
    """What a metal that dissolves has beside its law."""
    out: dict = {}
    if f"{table}.potential" in given:
        out["potential"] = given.number(f"{table}.potential")
    dissolves = f"{table}.dissolves" in given and given.text(f"{table}.dissolves") == "yes"
    if not dissolves:
        return out
    without = {name for name in CONSTANTS if f"{table}.{name}" in given}
    known: dict[str, float] = {}
    if f"{table}.alloy" in given or f"{table}.parameters" in given:
        alloy = load_alloy(given.text(f"{table}.alloy"))
        known = {
            "solid_concentration": alloy.solid_concentration.si,
            "charge_number": alloy.charge_number.si,
        }
        used = ["charge_number"] if "charge_number" not in without else []
        if f"{table}.parameters" in given:
            known |= _of_a_set(given.text(f"{table}.parameters"), alloy, beside, without)
        elif "solid_concentration" not in without:
            used += COMPOSITION
        beside.add(alloy.name, alloy, used)
    known |= {n: given.number(f"{table}.{n}") for n in without - {"volume_loss_scale"}}
    for name in ("solid_concentration", "charge_number"):
        if name not in known:
            raise ValueError(f"{given.file}: {table}.{name} is missing; a metal that dissolves "
                             "needs it, or an alloy")  # fmt: skip
        out[name] = known[name]
    law: Kinetics = ConstantRate()
    if known.get("self_corrosion"):
        out["self_corrosion"] = out["charge_number"] * FARADAY * known["self_corrosion"]
        if "volume_loss_scale" in without:
            known["volume_loss_scale"] = given.number(f"{table}.volume_loss_scale")
        if "volume_loss_scale" in known:
            law = VolumeLossLaw(known["volume_loss_scale"])
    return {**out, "kinetics": law}


def _of_a_set(
    name: str, alloy: Alloy, beside: Beside, without: Collection[str]
) -> dict[str, float]:
    """What a parameter set says of an alloy that corrodes by itself in clean liquid, SI.

    name : of a set, a TOML file, or OWN: the constants of the alloy's own file.  without : those
    that the scene gives itself.
    """
    fit = fit_of(alloy, None if name == OWN else name)
    if fit is None:
        raise ValueError(
            f"parameters is '{OWN}', but the file of alloy '{alloy.name}' has no [corrosion]; it "
            "must be a parameter set, as `perilife calibrate` writes it"
        )
    constants = corrosion_parameters(alloy, fit)
    assert constants.volume_loss_scale is not None
    flux = dissolution_flux(constants, float(fit.parameters.kernel_exponent))
    called = f"{alloy.name}, parameters"
    used = {"solid_concentration", "volume_loss_scale"} - set(without)
    if "self_corrosion" not in without:
        used |= {"solid_concentration", "interface_diffusivity", "kernel_exponent"}
        beside.add(called, fit.scene, ["spacing", "horizon_ratio"])
        beside.values[f"{called}: self_corrosion"] = Value(
            flux, "mol/(m^2 s)", "", "D_int C_solid S of the lattice that the set is for", "derived"
        )
    beside.add(called, fit.parameters, used)
    if "solid_concentration" in used and fit.parameters.solid_concentration.kind == "derived":
        beside.add(alloy.name, alloy, COMPOSITION)
    return {
        "solid_concentration": constants.solid_concentration,
        "self_corrosion": flux,
        "volume_loss_scale": constants.volume_loss_scale,
    }
