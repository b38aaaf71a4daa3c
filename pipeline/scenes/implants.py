"""An implant and what it touches, from files or presets: what coupling costs, and in strength."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from peri.coupled.galvanic import (
    GalvanicResult,
    GalvanicScene,
    Renewal,
    potential,
)
from peri.coupled.wagner import corrode_lean, couple_omissions
from peri.engine.omission import Omission
from peri.engine.results import Field, axes_of
from perilife_data import Alloy, load_alloy
from pipeline.scene.units import format_length
from pipeline.scenes import couples
from pipeline.scenes.keys import TEXT, Given, Key, positive
from pipeline.scenes.outcome import HERE, Curve, Marchers, Outcome, Panel, Prepared

if TYPE_CHECKING:
    from pipeline.geometry.surface import Solid

WEEK = 604800.0
KEYS: dict[str, Key] = {
    **{name: key for name, key in couples.KEYS.items() if name != "potential.robin"},
    "strength.metal": Key(TEXT, "which metal is pulled; left out: none", "screw"),
    "strength.alloy": Key(TEXT, "its mechanics: a shipped alloy, or a TOML file", "Mg-5Gd"),
    "strength.mesh_size": positive("length", "of its cells (0.3 mm)", "0.3mm"),
    "strength.mesh_size_fine": positive("length", "at its surface (0.2 mm)", "0.2mm"),
    "strength.grip": positive("length", "held at both ends (0.7 mm)", "0.7mm"),
}
"""Keys of an implant's file."""

MECHANICS = (
    "young_modulus", "poisson_ratio", "yield_stress", "ultimate_tensile_strength", "uniform_strain",
    "q1",
)  # fmt: skip
"""Of an alloy: what a pull uses."""
OF_INTACT = "of the intact implant (damage between the nodes, which have one rate each)"


@dataclass(frozen=True)
class Joint:
    """An implant beside other metals on one lattice.

    coupled, insulated : the same metals with and without contact.  implant : the number of the one
    that dissolves.
    """

    coupled: GalvanicScene
    insulated: GalvanicScene
    implant: int

    def beside(self) -> np.ndarray:
        """Nodes of the implant at the heights of the others, a horizon more on both sides; bool."""
        scene = self.coupled
        z = np.broadcast_to(scene.lattice.coordinates()[2], scene.lattice.shape)
        own = scene.metals[self.implant].nodes
        others = scene.metal() & ~own
        reach = float(np.max(scene.horizon)) + 0.5 * scene.lattice.spacing[2]
        return own & (z > z[others].min() - reach) & (z < z[others].max() + reach)


@dataclass(frozen=True)
class Pull:
    """A tensile test: solid, where its origin is, its alloy, sizes of cells and held ends, m."""

    solid: Solid
    at: tuple[float, ...]
    alloy: Alloy
    mesh_size: float
    mesh_size_fine: float
    grip: float


def prepare(given: Given) -> Prepared:
    """An implant and its neighbours in a file, ready to run.

    Raises ValueError for what does not fit, metals that overlap among it.
    """
    coupled, solids, beside = couples.build(given)
    if coupled.lattice.dimension != 3:
        raise ValueError(
            f"{given.file}: lattice.low has {coupled.lattice.dimension} entries; an implant has 3"
        )
    dissolving = [n for n, metal in enumerate(coupled.metals) if metal.solid_concentration]
    if len(dissolving) != 1 or len(coupled.metals) < 2:
        raise ValueError(
            f"{given.file}: {len(dissolving)} of {len(coupled.metals)} metals dissolve; it must be "
            "one, beside others that do not"
        )
    made = Joint(coupled, couples.build(given, insulated=True)[0], dissolving[0])
    pull = _pull(given, coupled.metals[dissolving[0]].name, solids, beside)
    gap = couples.check_gaps(given, coupled)
    renewal, lean = couples.renewal_of(given), couples.reductions_of(given)
    sensitivities = sensitivities_of(given)
    given.left_over()
    march = functools.partial(_march, made, pull, renewal, lean, sensitivities)
    size = (
        f"{coupled.metal().size:,} nodes, twice; narrowest gap {format_length(gap)}, horizon "
        f"{format_length(float(np.max(coupled.horizon)))}"
    )

    def reductions(end: float) -> list[Omission]:
        return couple_omissions(coupled, renewal, *lean, end=end)

    nodes = coupled.metal().size
    return Prepared(given.values, march, beside.values, reductions, size, nodes=nodes)


def _pull(given: Given, implant: str, solids: dict[str, Solid], beside) -> Pull | None:
    """The tensile test that a file asks for."""
    if "strength.metal" not in given:
        return None
    name = given.text("strength.metal")
    if name != implant or name not in solids:
        raise ValueError(
            f"{given.file}: strength.metal is '{name}'; it must be the metal that dissolves, "
            f"'{implant}', as a screw or a file"
        )
    alloy = load_alloy(given.text("strength.alloy"))
    beside.add(alloy.name, alloy, MECHANICS)
    sizes = [
        given.otherwise(f"strength.{key}", value, "m", "quick mesh of the life cycle")
        for key, value in (("mesh_size", 0.3e-3), ("mesh_size_fine", 0.2e-3), ("grip", 0.7e-3))
    ]
    at = given.vector(f"metals.{name}.at", 3) if f"metals.{name}.at" in given else (0.0,) * 3
    return Pull(solids[name], at, alloy, *sizes)  # type: ignore[arg-type]


def sensitivities_of(given: Given) -> dict[str, Callable[[], GalvanicScene]]:
    """What else the first current is computed for, in words."""

    def scaled(factor: float) -> Callable[[], GalvanicScene]:
        return lambda: couples.build(given, cathodes=factor)[0]

    def other(**values: object) -> Callable[[], GalvanicScene]:
        changed = dict(given.values)
        for name, value in values.items():
            changed[f"{table}.{name}"] = replace(changed[f"{table}.{name}"], value=value)
        return lambda: couples.build(Given(changed, given.file))[0]

    found = {f"cathode {factor:g} times": scaled(factor) for factor in (0.1, 10.0)}
    for name in given.names("metals"):
        table = f"metals.{name}"
        if given.text(f"{table}.shape") != "plate":
            continue
        hole = given.number(f"{table}.hole_radius")
        further = hole + 0.4e-3
        found[f"hole of radius {format_length(further)}"] = other(hole_radius=further)
        if f"{table}.radius" in given and hole < 2e-3 < given.number(f"{table}.radius"):
            found["plate of radius 2 mm"] = other(radius=2e-3)
        elif f"{table}.low" in given:
            low, high = (np.array(given.vector(f"{table}.{n}", 3)) for n in ("low", "high"))
            half = 0.5 * np.where(high - low > (high - low).min(), 0.5**0.5, 1.0) * (high - low)
            if half.max() > hole:
                middle = 0.5 * (low + high)
                less = {"low": list(middle - half), "high": list(middle + half)}
                found["plate of half its area"] = other(**less)
    return found


def strengths(made: Joint, pull: Pull, results: Sequence[GalvanicResult]) -> list[float]:
    """Peak force (N) of the intact implant and after each march's end, held by its ends.

    Ten-node cells, to 10 % elongation.  The damage is interpolated between the lattice's nodes,
    which have one rate each; the mesh loses the share of its metal that the lattice lost, whose
    nodes each stand for one part of the implant's volume.
    """
    from mpi4py.MPI import COMM_SELF as alone  # marches may have other ranks

    from fem.constitutive import Material, fit_voce
    from fem.solid import Grips
    from fem.strength import TensileSettings, tensile_test
    from pipeline.geometry.mesh import cell_volumes
    from pipeline.geometry.solids import tetrahedral_mesh
    from pipeline.stages.mapping import Lost, map_lost, points_of

    mesh = tetrahedral_mesh(pull.solid, pull.mesh_size, pull.mesh_size_fine)
    volume = cell_volumes(mesh.points, mesh.cells).sum()
    lattice, implant = made.coupled.lattice, made.coupled.metals[made.implant]
    part = volume / (implant.nodes.sum() * np.prod(lattice.spacing))  # of a lattice cell
    alloy = pull.alloy
    hardening = fit_voce(
        alloy.yield_stress.si, alloy.ultimate_tensile_strength.si, alloy.uniform_strain.si
    )
    material = Material(alloy.young_modulus.si, alloy.poisson_ratio.si, hardening, alloy.q1.si)
    settings = TensileSettings("P2-Fbar", peak_drop=0.05, grips=Grips(pull.grip, pull.grip))
    damages = [np.zeros(len(mesh.cells))]
    for result in results:
        lost = Lost(
            np.subtract(lattice.origin, pull.at), np.asarray(lattice.spacing),
            result.fields["concentration"][-1], implant.nodes, part * implant.nodes,
            implant.solid_concentration,
        )  # fmt: skip
        mapped = map_lost(mesh.points, mesh.cells, lost)
        count = points_of(settings.element, settings.damage)
        damages.append(mapped.at_points(1.0 / material.q1, count))
    return [
        float(tensile_test(mesh.points, mesh.cells, damage, material, settings, alone).peak_force)
        for damage in damages
    ]


def losses(made: Joint, result: GalvanicResult) -> dict[str, np.ndarray]:
    """Lost share of the whole implant, of what is beside the others and of the rest, by time."""
    implant, near = made.coupled.metals[made.implant], made.beside()
    share = 1.0 - result.fields["concentration"] / implant.solid_concentration
    parts = {"whole": implant.nodes, "beside": near, "rest": implant.nodes & ~near}
    return {name: share[:, part].mean(axis=1) for name, part in parts.items() if part.any()}


def _march(
    made: Joint,
    pull: Pull | None,
    renewal: Renewal,
    lean: tuple[float, list[str]],
    sensitivities: dict[str, Callable[[], GalvanicScene]],
    times: Sequence[float],
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[float, str], None] | None = None,
    by: Marchers = HERE,
) -> Outcome:
    """Coupled and insulated marches, both pulled, and what the first current depends on."""
    results = []
    for number, scene in enumerate((made.coupled, made.insulated)):

        def so_far(share: float, text: str, number: int = number) -> None:
            if progress is not None:
                progress(0.4 * (number + share), text)

        file = None if checkpoint is None else checkpoint.with_name(f"march{number}.h5")
        limited = replace(renewal, longest=min(renewal.longest, max(times) / 16))
        result, _ = corrode_lean(
            scene, times, limited, tolerance=lean[0], refused=lean[1], checkpoint=file,
            resume=resume, progress=so_far, march_by=by.couple,
        )  # fmt: skip
        results.append(result)
    together, apart = results
    forces = None if pull is None else strengths(made, pull, results)
    for number in range(2):
        if checkpoint is not None:
            checkpoint.with_name(f"march{number}.h5").unlink(missing_ok=True)
    lost = [losses(made, result) for result in results]
    implant = made.coupled.metals[made.implant]
    first = together.history[f"current_{implant.name}"][0]
    summary = {}
    for number, name in enumerate(("coupled", "insulated")):
        summary |= {f"{p} lost, {name}": (float(v[-1]), "1") for p, v in lost[number].items()}
        if forces is not None:
            left = forces[number + 1] / forces[0]
            summary[f"strength left, {name}"] = (left, OF_INTACT)
    if forces is not None:
        summary["peak force of the intact implant"] = (forces[0], "N")
    summary["current of the couple at the start"] = (float(first), "A")
    for text, scene_of in sensitivities.items():
        found = potential(scene_of()).current(made.implant)
        summary[f"the same, {text}"] = (float(found), "A")
    summary["Faraday's law left open, largest"] = (
        float(np.abs(together.history["faraday_error"]).max()), "of the metal",
    )  # fmt: skip
    lattice = made.coupled.lattice
    over = ("time", *axes_of(lattice))
    fields = {n: Field(v, couples.FIELD_UNITS[n], over) for n, v in together.fields.items()}
    fields["concentration_insulated"] = Field(apart.fields["concentration"], "mol/m3", over)
    fields["phase"] = Field(made.coupled.phases(), "", axes_of(lattice))
    weeks = together.times / WEEK
    z = 1e3 * lattice.axis(2)
    profiles = []
    for name, scene, result in zip(
        ("coupled", "insulated"), (made.coupled, made.insulated), results, strict=True
    ):
        nodes = scene.metals[made.implant].nodes
        layers = nodes.any(axis=(0, 1))
        solid = implant.solid_concentration
        left = result.fields["concentration"][-1].sum(axis=(0, 1))[layers]
        whole = solid * nodes.sum(axis=(0, 1))[layers]
        profiles.append(Curve(name, z[layers], 100 * (1 - left / whole)))
    panels = [
        Panel(
            "Volume loss", "time / weeks", "lost / %",
            [
                Curve(f"{part}, {name}", weeks, 100 * values[part])
                for name, values in zip(("coupled", "insulated"), lost, strict=True)
                for part in ("beside", "rest")
                if part in values
            ],
        ),
        Panel("Where it is lost, at the end", "height / mm", "lost / %", profiles),
        Panel(
            "Current of the couple", "time / weeks", "I / uA",
            [Curve(implant.name, together.history["time"] / WEEK,
                   1e6 * together.history[f"current_{implant.name}"])],
        ),
    ]  # fmt: skip
    if forces is not None:
        ends = np.array([0.0, weeks[-1]])
        panels.append(
            Panel(
                "Strength, before and at the end", "time / weeks", "left / %",
                [
                    Curve(name, ends, 100 * np.array([1.0, force / forces[0]]))
                    for name, force in zip(("coupled", "insulated"), forces[1:], strict=True)
                ],
            )
        )  # fmt: skip
    return Outcome(
        lattice, together.times, fields, together.history, together.columns, summary, panels,
        together.wall_time + apart.wall_time,
    )  # fmt: skip
