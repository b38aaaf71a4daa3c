"""The ions of the corrosion stage: medium, joined march, files and numbers (`--model nnpp`)."""

import dataclasses
import logging
import math
import types
import typing
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from peri.corrosion.inhibition import Inhibited
from peri.corrosion.kinetics import Kinetics
from peri.corrosion.liquid_factors import LiquidFactors
from peri.corrosion.run import HISTORY, CorrosionResult
from peri.corrosion.scene import CorrosionScene
from peri.coupled.bath import Bath, Exchanges
from peri.coupled.charge_balance import ELECTRONS
from peri.coupled.degradation import Degradation
from peri.engine.constants import FARADAY
from peri.engine.march.marching import TimeStepping, march
from peri.engine.march.problem import State
from peri.engine.march.runge_kutta import RungeKutta
from peri.engine.omission import Omission
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.results import Field, axes_of, write_result
from peri.omissions.ions import ion_omissions
from peri.omissions.names import LIQUID
from peri.omissions.planning import corrode_lean
from peri.transport.chemistry.activity import check_strength
from peri.transport.chemistry.speciation import Solution, speciate
from peri.transport.chemistry.species import Chemistry
from peri.transport.nernst_planck import TransportOptions
from pipeline.record.run_folder import write_text
from pipeline.scene.laws.feedback import FeedbackSettings
from pipeline.scene.laws.ions import IonSettings

logger = logging.getLogger(__name__)

IONS_FILE = "ions.h5"
SERIES_FILE = "ions.pvd"
SCHEMA_VERSION = 1
_FIELDS = {"ph": "1", "potential": "V", "species": "mol/m3", "minerals": "mol/m3"}
_MOLAR_VOLUME_OF_GAS = 24.05e-3
"""m3/mol of an ideal gas at 20 degC and 1 atm, which evolved hydrogen is quoted at."""

Output = dict[str, NDArray | float]


def medium_of(ions: IonSettings) -> Solution:
    """The medium in equilibrium with itself, at one node.

    Raises ValueError for a medium beyond the activity law's range, or one whose charge only a
    strong acid or base could make up.
    """
    numbers = dict(ions.chemistry)
    numbers["components"] = tuple(numbers["components"])  # type: ignore[arg-type]
    numbers["minerals"] = {
        name: types.SimpleNamespace(
            **{
                **mineral,
                "rate_constant": math.inf
                if mineral["rate_constant"] is None
                else mineral["rate_constant"],
            }
        )
        for name, mineral in numbers["minerals"].items()  # type: ignore[attr-defined]
    }
    chemistry = Chemistry(types.SimpleNamespace(**numbers))
    law = "davies" if ions.activity == "fixed" else ions.activity
    medium = speciate(chemistry, chemistry.totals(ions.totals), law)
    strength, ph = float(medium.strength[0]), float(medium.ph[0])
    warning = check_strength(strength, ions.activity)
    if warning:
        logger.warning("medium %s: %s", ions.medium, warning)
    if not 4 <= ph <= 10:
        charges = dict(ions.chemistry["charge_number"])  # type: ignore[call-overload]
        charge = sum(charges[n] * c for n, c in ions.totals.items())
        wanted = -1 if charge > 0 else 1
        ion = max((n for n in ions.totals if charges[n] == wanted), key=ions.totals.get)
        raise ValueError(
            f"medium '{ions.medium}' carries {charge:+.4g} mol/m^3 of charge as its ions are "
            f"listed, which would make its pH {ph:.1f}; with --balance {ion} the amount of {ion} "
            "is what neutrality wants"
        )
    for mineral, index in zip(chemistry.minerals, medium.saturation_index[:, 0], strict=True):
        if index > 1e-9 and mineral.kind == "equilibrium" and mineral.region == "liquid":
            logger.warning(
                "the medium itself is supersaturated in %s (index %.2f), which would form without "
                "end where fresh medium comes in", mineral.name, index,
            )  # fmt: skip
    return medium


def bath_of(ions: IonSettings) -> Bath | None:
    """The bath around the liquid, if it is finite."""
    if ions.bath_volume is None:
        return None
    return Bath(ions.bath_volume, ions.exchange_every or math.inf, ions.open_to)


def problem_of(
    corrosion: CorrosionScene | None, ions: IonSettings, processes: OneProcess = ONE_PROCESS
) -> Degradation:
    """Metal and liquid as one problem; raises ValueError for a feedback that the law excludes.

    corrosion : on the root of the processes, elsewhere None
    """
    medium = processes.on_root(lambda: medium_of(ions))
    scene = None
    if _changes_the_law(ions):
        law = processes.on_root(lambda: _law_of(corrosion.kinetics, ions, medium))
        scene = corrosion and dataclasses.replace(corrosion, kinetics=law)
    return Degradation(
        scene or corrosion, medium, options_of(ions), bath=bath_of(ions), processes=processes
    )


def _changes_the_law(ions: IonSettings) -> bool:
    """Whether the metal has another law than the scene's, one that reads the liquid."""
    return ions.electrodes is not None or ions.feedback is not None


def _law_of(law: Kinetics, ions: IonSettings, medium: Solution) -> Kinetics:
    """The metal's law in the liquid, from the scene's."""
    if ions.electrodes is not None:
        law = ions.electrodes.law(float(medium.ph[0]), ions.temperature)
    elif ions.feedback is not None:
        law = with_feedback(law, ions.feedback, medium)
    if ions.feedback is not None and ions.feedback.inhibitor:
        held: dict[str, typing.Any] = ions.chemistry["inhibitor"]  # type: ignore[assignment]
        law = Inhibited(law, held["component"], held["adsorption_constant"], held["efficiency"])
    return law


def with_feedback(base: Kinetics, feedback: FeedbackSettings, medium: Solution) -> LiquidFactors:
    """The law times what the liquid does to it; references left out are the medium's."""
    chemistry = medium.chemistry
    given = {n: v for n, v in dataclasses.asdict(feedback).items() if v is not None}
    del given["inhibitor"]
    given.setdefault("ph_reference", float(medium.ph[0]))
    if "Cl" in chemistry.components:
        chloride = float(medium.totals[chemistry.components.index("Cl"), 0])
        given.setdefault("chloride_reference", chloride)
    elif feedback.chloride_order:
        raise ValueError("feedback: chloride_order is given, but the medium holds no chloride")
    return LiquidFactors(base, **given)


def options_of(ions: IonSettings) -> TransportOptions:
    """How the scene asks for the liquid to be solved."""
    return TransportOptions(flux_form=ions.flux_form, closure=ions.closure)


def corrode_with_ions(
    corrosion: CorrosionScene | None,
    ions: IonSettings,
    times: Sequence[float],
    stepping: TimeStepping,
    *,
    tolerance: float,
    refused: Sequence[str],
    progress: Callable[[float, str], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    processes: OneProcess = ONE_PROCESS,
    alone: Callable[..., tuple[CorrosionResult, list[Omission]]] = corrode_lean,
) -> tuple[CorrosionResult, list[Omission], list[Output], Degradation]:
    """March metal and liquid; the ions' fields at every output time.

    Where no mineral can form, the metal is marched as without ions and the liquid is computed at
    the output times (the metal's kinetics does not read it); else both go together.

    processes : who holds which block of the lattice; all of them call this alike.  The root has
        the scene (the others None) and gets the whole fields.
    alone : marches the metal alone, as planning.corrode_lean does, on all processes
    """
    problem = problem_of(corrosion, ions, processes)
    omissions = ion_omissions(problem)
    if not problem.follows_minerals:
        result, of_metal = alone(
            corrosion, times, stepping, tolerance=tolerance, refused=refused, progress=progress,
            checkpoint=checkpoint, resume=resume, checkpoint_every=checkpoint_every,
        )  # fmt: skip
        if processes.on_root(
            lambda: (
                any(o.name == LIQUID and o.applied for o in of_metal)
                or not result.history["saturated_nodes"].any()
            )
        ):
            return result, [*of_metal, *omissions], _afterwards(problem, result), problem
        # Where the metal saturates its liquid, only the march knows what each bond carries.
    method: TimeStepping | Exchanges = stepping
    if ions.exchange_every is not None:
        method = Exchanges(RungeKutta(stepping), ions.exchange_every)
    done = march(
        problem, times, method, checkpoint=checkpoint, resume=resume,
        checkpoint_every=checkpoint_every, progress=progress,
    )  # fmt: skip
    concentration, metal, loss = (
        np.array([output.pop(name) for output in done.outputs])
        for name in ("concentration", "metal", "volume_loss")
    )
    history = {name: done.history[name] for name in HISTORY}
    result = CorrosionResult(
        corrosion, done.times, concentration, metal.astype(bool), loss, history, done.wall_time
    )
    for name, values in done.history.items():
        if name not in HISTORY:
            for output, time in zip(done.outputs, done.times, strict=True):
                output[name] = float(np.interp(time, done.history["time"], values))
    if _changes_the_law(ions):
        # What the law of the scene would do by itself, to be told beside it.
        by_itself, _ = alone(corrosion, times, stepping, tolerance=tolerance, refused=refused)
        if processes.is_root:
            for output, loss in zip(done.outputs, by_itself.volume_loss, strict=True):
                output["volume_loss_alone"] = float(loss)
    return result, omissions, done.outputs, problem


def _afterwards(problem: Degradation, result: CorrosionResult) -> list[Output]:
    """The liquid at the output times of a march of the metal alone.

    result : on the root
    """
    outputs, processes, pad = [], problem.processes, problem.discrete.sum.pad
    moments = processes.on_root(lambda: list(zip(result.times, result.volume_loss, strict=True)))
    for n, (time, loss) in enumerate(moments):
        concentration, metal = (
            pad(processes.scatter(getattr(result, name)[n] if processes.is_root else None))
            for name in ("concentration", "metal")
        )
        fields = {"concentration": concentration, "metal": metal > 0}
        initial, _ = problem.discrete.amounts(problem.discrete.initial_concentration)
        numbers = {"volume_loss": float(loss), "dissolved": 0.0, "initial": initial}
        state = State(float(time), fields, {**numbers, "released": 0.0})
        problem.restore(state)
        output = problem.snapshot(state)
        for name in ("concentration", "metal", "volume_loss"):
            del output[name]  # the result has them
        outputs.append(output)
        if processes.is_root:
            amounts = result.history["metal_amount"]
            lost = np.interp(time, result.history["time"], amounts)
            output["hydrogen_amount"] = float(amounts[0] - lost)
    return outputs


def plan_ions(
    corrosion: CorrosionScene, ions: IonSettings, of_metal: list[Omission]
) -> list[Omission]:
    """What a march with these ions would leave out; solves for the first release.

    of_metal : what a march of the metal alone leaves out; one that follows the liquid computes all
    of that.
    """
    problem = problem_of(corrosion, ions)
    omissions = ion_omissions(problem)
    return omissions if problem.follows_minerals else [*of_metal, *omissions]


def write(
    out: Path,
    result: CorrosionResult,
    outputs: list[Output],
    problem: Degradation,
    ions: IonSettings,
    area: float,
) -> tuple[list[Path], dict[str, object]]:
    """Write ions.h5 and the ParaView series ions.pvd; returns them and the numbers worth keeping.

    area : surface of the solid, m2
    """
    chemistry = problem.medium.chemistry
    names, minerals = list(chemistry.names), [m.name for m in chemistry.minerals]
    scene = result.scene
    write_ions(out / IONS_FILE, scene, result.times, outputs, names, minerals)
    write_ion_images(out, scene, result.times, outputs, names, minerals)
    numbers = ion_numbers(result, outputs, problem, ions, area)
    return [out / IONS_FILE, out / SERIES_FILE], numbers


# --- files --------------------------------------------------------------------------------


def write_ions(
    path: Path,
    scene: CorrosionScene,
    times: NDArray,
    outputs: list[Output],
    names: list[str],
    minerals: list[str],
) -> None:
    """Write the liquid's fields at the output times as HDF5, with units and dimensions."""
    inner = {"species": ("species",), "minerals": ("mineral",)}
    fields = {
        "times": Field(times, "s"),
        "species_names": Field(np.array(names, "S")),
        "mineral_names": Field(np.array(minerals, "S") if minerals else np.empty(0, "S1")),
    }
    for name, unit in _FIELDS.items():
        values = np.array([output[name] for output in outputs])
        axes = ("time", *inner.get(name, ()), *axes_of(scene.lattice))
        fields[name] = Field(values, unit, axes)
    write_result(path, scene.lattice, fields, {}, {}, SCHEMA_VERSION)


def write_ion_images(
    folder: Path,
    scene: CorrosionScene,
    times: NDArray,
    outputs: list[Output],
    names: list[str],
    minerals: list[str],
) -> None:
    """Write one VTK image per output time and the ParaView series ions.pvd."""
    import pyvista

    entries = []
    for n, (time, output) in enumerate(zip(times, outputs, strict=True)):
        image = pyvista.ImageData(
            dimensions=scene.lattice.shape, spacing=scene.lattice.spacing,
            origin=scene.lattice.origin,
        )  # fmt: skip
        for name in ("ph", "potential"):
            image[name] = np.asarray(output[name]).ravel(order="F")
        for name, values in zip(names, np.asarray(output["species"]), strict=True):
            image[name] = values.ravel(order="F")
        for name, values in zip(minerals, np.asarray(output["minerals"]), strict=True):
            image[name] = values.ravel(order="F")
        file = f"ions_{n:03d}.vti"
        image.save(folder / file)
        entries.append(f'<DataSet timestep="{time:.9g}" file="{file}"/>')
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
        + "\n".join(entries)
        + "\n</Collection>\n</VTKFile>\n"
    )
    write_text(folder / SERIES_FILE, text)


# --- numbers ------------------------------------------------------------------------------


def ion_numbers(
    result: CorrosionResult,
    outputs: list[Output],
    problem: Degradation,
    ions: IonSettings,
    area: float,
) -> dict[str, object]:
    """What a report shows of the ions, per output time; area : of the solid, m2."""
    chemistry = problem.medium.chemistry
    names = list(chemistry.names)
    medium = {n: float(c) for n, c in zip(names, problem.medium.concentration[:, 0], strict=True)}
    rows = []
    for time, metal, loss, output in zip(
        result.times, result.metal, result.volume_loss, outputs, strict=True
    ):
        scene = result.scene
        liquid = scene.domain & ~metal & ~np.isnan(np.asarray(output["ph"]))
        distance = distance_transform_edt(~metal, sampling=scene.lattice.spacing)
        ph, species = np.asarray(output["ph"]), np.asarray(output["species"])
        bins = np.floor(distance[liquid] / max(scene.lattice.spacing) - 0.5).astype(int)
        near = liquid & (distance <= 1.001 * max(scene.lattice.spacing))
        count = np.bincount(bins)
        mean = np.bincount(bins, weights=ph[liquid]) / np.maximum(count, 1)
        hydrogen = float(output["hydrogen_amount"])
        charge = float(output.get("applied_charge", 0.0))
        rows.append(
            {
                "time": float(time),
                "highest_ph": float(np.nanmax(ph)),
                "ph_beside_metal": float(ph[near].mean()) if near.any() else None,
                "profile_um": [1e6 * (b + 1) * max(scene.lattice.spacing) for b in
                               np.flatnonzero(count)],
                "profile_ph": [float(v) for v in mean[count > 0]],
                "beside_metal": {
                    n: float(values[near].mean())
                    for n, values in zip(names, species, strict=True)
                } if near.any() else {},
                "largest_potential": float(output["largest_potential"]),
                "balance": float(output["balance"]),
                "net_charge": float(output["net_charge"]),
                "lowest": float(output["lowest"]),
                "fullest": float(output["fullest"]),
                "bath_ph": float(output["bath_ph"]) if "bath_ph" in output else None,
                "hydrogen_mol": hydrogen,
                "released_mol": hydrogen + charge / (ELECTRONS * FARADAY),
                "applied_charge": charge,
                "metal_potential": output.get("metal_potential"),
                "volume_loss": float(loss),
                "volume_loss_alone": output.get("volume_loss_alone"),
                "hydrogen_ml_per_cm2": 1e6 * _MOLAR_VOLUME_OF_GAS * hydrogen / (1e4 * area),
                "minerals": {
                    m.name: {
                        "amount_mol": float(output.get(f"{m.name}_amount", 0.0)),
                        "highest_index": _finite(float(output[f"index_{m.name}"])),
                    }
                    for m in chemistry.minerals
                },
                "pockets": int(output["pockets"]),
            }
        )  # fmt: skip
    return {
        "medium": ions.medium,
        "title": ions.title,
        "temperature": ions.temperature,
        "ph": float(problem.medium.ph[0]),
        "strength": float(problem.medium.strength[0]),
        "concentrations": medium,
        "reactions": ions.reactions,
        "activity": ions.activity,
        "flux_form": ions.flux_form,
        "closure": ions.closure,
        "followed": problem.follows_minerals,
        "stores": problem.stores,
        "bath": _bath_in_words(ions),
        "feedback": ions.feedback.in_words() if ions.feedback else "",
        "electrodes": ions.electrodes.in_words() if ions.electrodes else "",
        "assumed": list(ions.assumed),
        "rows": rows,
    }


def _bath_in_words(ions: IonSettings) -> str:
    if ions.bath_volume is None:
        return ""
    every = ions.exchange_every
    words = f"a stirred bath of {1e6 * ions.bath_volume:g} mL, "
    words += "never exchanged" if every is None else f"exchanged every {every / 86400:g} days"
    return words + (f", open to {', '.join(ions.open_to)}" if ions.open_to else ", closed")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
