"""A magnesium screw in a titanium plate: what coupling costs, in metal and in strength."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.polarization import TafelCurve
from peri.coupled.galvanic import GalvanicResult, GalvanicScene, Metal, Renewal, corrode, potential
from peri.engine.constants import FARADAY
from peri.engine.lattice import box_lattice
from peri.engine.results import Field, axes_of
from peri.transport.potential.polarization import Insulated, Polarization
from perilife_data import load_alloy, load_electrode, load_parameter_set
from pipeline.scene.laws.polarization import polarization_law
from pipeline.scenes.outcome import Curve, Outcome, Panel, Prepared, Value

if TYPE_CHECKING:
    from pipeline.geometry.surface import Solid

ALLOY, PARAMETERS, CHARGE_NUMBER = "Mg-5Gd", "table-5.1", 2.0
SELF_FLUX = 1.85e-6
"""mol/(m^2 s) of a fresh surface: what the published D_int amounts to on its own lattice."""
CONDUCTIVITY, HORIZON = 1.7, 200e-6
TITANIUM = TafelCurve(0.1, -0.15, -1.5)
PLATE = (3.0e-3, 4.0e-3)
"""Lower and upper face of the plate, m; the screw reaches from 0 to 4 mm, its slot on top."""
CLEARANCE = 0.2e-3
HEAD = PLATE[0] - HORIZON
"""Height from which on metal counts as beside the plate, m."""
WEEK = 604800.0


@dataclass(frozen=True)
class Joint:
    """The screw and the plate on one lattice.

    coupled, insulated : the same metals with and without contact.  solid : the screw.
    """

    coupled: GalvanicScene
    insulated: GalvanicScene
    solid: Solid


def joint(
    spacing: float = 100e-6,
    factor: float = 1.0,
    clearance: float = CLEARANCE,
    plate_radius: float = np.inf,
) -> Joint:
    """Screw of 2 x 4 mm in a plate of 6 x 6 x 1 mm in body fluid.

    factor : of the titanium's current.  clearance : between screw and plate, m.  plate_radius :
    m, where the plate ends before the edge of the box.
    """
    from pipeline.geometry.solids import ScrewParameters, screw_solid
    from pipeline.geometry.voxels import check_resolution, metal_fraction

    solid = screw_solid(ScrewParameters(pitch=0.4e-3))
    check_resolution(solid, spacing)
    lattice = box_lattice((-3e-3, -3e-3, -0.5e-3), (3e-3, 3e-3, 5e-3), spacing)
    screw, _ = metal_fraction(solid, lattice.origin, lattice.spacing, lattice.shape)
    x, y, z = lattice.coordinates()
    radius = np.hypot(x, y)
    plate = (z > PLATE[0]) & (z < PLATE[1]) & (radius > 1e-3 + clearance)
    plate = np.ascontiguousarray(plate & (radius < plate_radius) & ~screw)
    constants = load_parameter_set(PARAMETERS).alloys[ALLOY]

    def scene(anode: Polarization, cathode: Polarization) -> GalvanicScene:
        metals = (
            Metal(
                "screw", screw, anode, constants.solid_concentration.si, CHARGE_NUMBER,
                self_corrosion=CHARGE_NUMBER * FARADAY * SELF_FLUX,
                kinetics=VolumeLossLaw(constants.volume_loss_scale.si),
            ),
            Metal("plate", plate, cathode),
        )  # fmt: skip
        return GalvanicScene(lattice, max(HORIZON, spacing), metals, CONDUCTIVITY)

    titanium = TafelCurve(
        factor * TITANIUM.current_density, TITANIUM.tafel_slope, TITANIUM.standard_potential
    )
    magnesium = polarization_law(load_electrode("AE44"))
    return Joint(scene(magnesium, titanium), scene(Insulated(), Insulated()), solid)


def screw_in_plate(spacing: float | None) -> Prepared:
    """The scene, ready to run."""
    spacing = spacing or 100e-6
    made = joint(spacing)
    table = load_parameter_set(PARAMETERS).alloys[ALLOY]
    values = {
        "concentration of the screw": Value(
            table.solid_concentration.si, "mol/m3", "hermann2024", "Table 5.1", "published"
        ),
        "l of its volume loss": Value(
            table.volume_loss_scale.si, "1", "hermann2024", "Table 5.1", "published"
        ),
        "self-corrosion of a fresh surface": Value(
            SELF_FLUX, "mol/(m2 s)", "hermann2024", "Table 5.1, D_int on its lattice", "derived"
        ),
        "polarization of the screw": Value(
            "AE44 in brine", "", "zhao2021", "Table 3; none of Mg-5Gd is known", "assumed"
        ),
        "current of titanium at -1.5 V": Value(
            TITANIUM.current_density, "A/m2", "", "no source; 0.1 to 10 times is shown", "assumed"
        ),
        "Tafel slope of titanium": Value(TITANIUM.tafel_slope, "V", "", "no source", "assumed"),
        "conductivity": Value(CONDUCTIVITY, "S/m", "", "body fluid at 37 degC", "assumed"),
        "clearance of screw and plate": Value(CLEARANCE, "m", "", "", "assumed"),
        "lattice spacing": Value(spacing, "m", "", "", "assumed"),
    }
    return Prepared(values, functools.partial(_march, made, spacing))


def strengths(made: Joint, results: Sequence[GalvanicResult]) -> list[float]:
    """Peak force (N) of the intact screw and after each march's end, held by the shank.

    The quick mesh of the life cycle: cells of 0.3 and 0.2 mm, ten nodes, to 10 % elongation.
    """
    from fem.constitutive import Material, fit_voce
    from fem.quadrature import sampling_points
    from fem.solid import Grips
    from fem.strength import TensileSettings, tensile_test
    from pipeline.geometry.solids import tetrahedral_mesh
    from pipeline.stages.damage_map import map_damage

    mesh = tetrahedral_mesh(made.solid, 0.3e-3, 0.2e-3)
    points, _ = sampling_points(mesh.points, mesh.cells)
    lattice, screw = made.coupled.lattice, made.coupled.metals[0]
    alloy = load_alloy(ALLOY)
    hardening = fit_voce(
        alloy.yield_stress.si, alloy.ultimate_tensile_strength.si, alloy.uniform_strain.si
    )
    material = Material(alloy.young_modulus.si, alloy.poisson_ratio.si, hardening)
    settings = TensileSettings("P2", peak_drop=0.05, grips=Grips(0.7e-3, 0.7e-3))
    damages = [np.zeros(len(mesh.cells))]
    for result in results:
        damages.append(
            map_damage(
                points, lattice.origin, lattice.spacing, result.fields["concentration"][-1],
                screw.nodes, screw.solid_concentration,
            ).mean(axis=1)
        )  # fmt: skip
    return [
        float(tensile_test(mesh.points, mesh.cells, damage, material, settings).peak_force)
        for damage in damages
    ]


def losses(scene: GalvanicScene, result: GalvanicResult) -> dict[str, np.ndarray]:
    """Lost share of the whole screw, of what is beside the plate and of the rest, by time."""
    nodes = scene.metals[0].nodes
    z = np.broadcast_to(scene.lattice.coordinates()[2], nodes.shape)
    share = 1.0 - result.fields["concentration"] / scene.metals[0].solid_concentration
    parts = {"whole": nodes, "head": nodes & (z > HEAD), "shank": nodes & (z <= HEAD)}
    return {name: share[:, part].mean(axis=1) for name, part in parts.items()}


def _march(
    made: Joint,
    spacing: float,
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Outcome:
    """Coupled and insulated marches, both pulled, and what the first current depends on."""
    results = []
    for number, scene in enumerate((made.coupled, made.insulated)):

        def so_far(share: float, text: str, number: int = number) -> None:
            if progress is not None:
                progress(0.4 * (number + share), text)

        file = None if checkpoint is None else checkpoint.with_name(f"march{number}.h5")
        renewal = Renewal(0.1, longest=max(times) / 16)
        results.append(
            corrode(scene, times, renewal, checkpoint=file, resume=resume, progress=so_far)
        )
    together, apart = results
    forces = strengths(made, results)
    for number in range(2):
        if checkpoint is not None:
            checkpoint.with_name(f"march{number}.h5").unlink(missing_ok=True)
    lost = [losses(scene, r) for scene, r in zip((made.coupled, made.insulated), results,
                                                strict=True)]  # fmt: skip
    first = together.history["current_screw"][0]
    summary = {}
    for name, values, force in zip(("coupled", "insulated"), lost, forces[1:], strict=True):
        summary |= {f"{part} lost, {name}": (float(v[-1]), "1") for part, v in values.items()}
        summary[f"strength left, {name}"] = (force / forces[0], "of the intact screw")
    summary["peak force of the intact screw"] = (forces[0], "N")
    summary["current of the couple at the start"] = (float(first), "A")
    for text, other in (
        ("titanium 0.1 times", {"factor": 0.1}),
        ("titanium 10 times", {"factor": 10.0}),
        ("clearance 0.6 mm", {"clearance": 0.6e-3}),
        ("plate of radius 2 mm", {"plate_radius": 2e-3}),
    ):
        found = potential(joint(spacing, **other).coupled).current(0)
        summary[f"the same, {text}"] = (float(found), "A")
    summary["Faraday's law left open, largest"] = (
        float(np.abs(together.history["faraday_error"]).max()), "of the metal",
    )  # fmt: skip
    lattice = made.coupled.lattice
    over = ("time", *axes_of(lattice))
    units = {"concentration": "mol/m3", "metal": "", "potential": "V"}
    units |= {"current_density": "A/m2", "electrode_potential": "V"}
    fields = {n: Field(v, units[n], over) for n, v in together.fields.items()}
    fields["concentration_insulated"] = Field(apart.fields["concentration"], "mol/m3", over)
    fields["phase"] = Field(made.coupled.phases(), "", axes_of(lattice))
    weeks = together.times / WEEK
    z = 1e3 * lattice.axis(2)
    profiles = []
    for name, scene, result in zip(
        ("coupled", "insulated"), (made.coupled, made.insulated), results, strict=True
    ):
        nodes = scene.metals[0].nodes
        layers = nodes.any(axis=(0, 1))
        solid = scene.metals[0].solid_concentration
        left = result.fields["concentration"][-1].sum(axis=(0, 1))[layers]
        whole = solid * nodes.sum(axis=(0, 1))[layers]
        profiles.append(Curve(name, z[layers], 100 * (1 - left / whole)))
    panels = [
        Panel(
            "Volume loss", "time / weeks", "lost / %",
            [
                Curve(f"{part}, {name}", weeks, 100 * values[part])
                for name, values in zip(("coupled", "insulated"), lost, strict=True)
                for part in ("head", "shank")
            ],
        ),
        Panel("Where it is lost, at the end", "height / mm", "lost / %", profiles),
        Panel(
            "Current of the couple", "time / weeks", "I / uA",
            [Curve("screw", together.history["time"] / WEEK,
                   1e6 * together.history["current_screw"])],
        ),
    ]  # fmt: skip
    return Outcome(
        lattice, together.times, fields, together.history, together.columns, summary, panels,
        together.wall_time + apart.wall_time,
    )  # fmt: skip
