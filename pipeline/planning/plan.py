"""What a run would compute, what it leaves out and why, how long it takes, how much it needs.

Everything here follows from the scene and its solid alone; nothing is computed or written.
"""

from dataclasses import asdict, dataclass

import numpy as np

from fem.quadrature import ELEMENTS
from peri.engine.influence import diffusion_stencil
from peri.engine.omission import Omission
from peri.omissions.names import OMITTABLE
from pipeline.geometry.surface import Solid
from pipeline.planning.beside import Task, saved
from pipeline.planning.ion_memory import ion_memory
from pipeline.planning.locking import locking
from pipeline.planning.rank_memory import rank_memory
from pipeline.planning.sizes import check_screw, check_sizes
from pipeline.record import machine
from pipeline.scene.classes import one_rate_because
from pipeline.scene.loads import LOADS
from pipeline.scene.mapping import by_nodes_because
from pipeline.scene.scene import HoldScene, Scene, ScrewGeometry
from pipeline.scene.units import format_bytes, format_length, format_seconds
from pipeline.stages.corrosion import domain_lattice, liquid_domain, march_omissions

BASE_MEMORY = 400e6
"""Bytes of an idle process with the libraries loaded (measured)."""


@dataclass(frozen=True)
class LeftOut:
    """Something that is not computed, why, and the error of leaving it out, all in words."""

    what: str
    reason: str
    error: str


@dataclass(frozen=True)
class Plan:
    """Tasks in their order, omissions, and the totals.

    seconds: of all together, less than their sum where tests run beside marches.
    """

    tasks: tuple[Task, ...]
    omissions: tuple[LeftOut, ...]
    nodes: int
    unknowns: int
    seconds: float
    memory: float
    disk: float

    def to_json(self) -> dict:
        """Plain mapping of the plan."""
        return asdict(self)


@dataclass(frozen=True)
class Cost:
    """Measured on two cores at 2.6 GHz: what a plan multiplies its counts with.

    corrosion: seconds and bytes per node and march; surface: seconds per triangle and per lattice
    cell's face of the surface; tensile: seconds per unknown and increment of ten-node and of
    four-node cells, and bytes per unknown of one process; parting: how many times that where the
    metal parts between the grips, with smaller increments and more iterations; picture: seconds of
    one in the report; report: of the rest of it; ions: seconds per node and solution of the liquid,
    solutions of a march that follows minerals; mesh: seconds per cell; disk: bytes per node and
    time.
    """

    corrosion_seconds_per_node: float = 1.1e-4
    corrosion_bytes_per_node: float = 600.0
    surface_seconds_per_triangle: float = 0.5e-4
    surface_seconds_per_face: float = 1.15e-3
    tensile_seconds_per_unknown: float = 1.65e-5
    four_node_seconds_per_unknown: float = 2.0e-5
    parting: float = 2.7
    picture_seconds: float = 0.4
    report_seconds: float = 8.0
    tensile_bytes_per_unknown: float = 1.0e4
    ion_seconds_per_node: float = 5.0e-5
    ion_solutions: int = 60
    mesh_seconds_per_cell: float = 5.0e-5
    solid_seconds: float = 5.0
    map_seconds_per_cell: float = 2.0e-5
    disk_bytes_per_node: float = 24.0
    disk_bytes_per_unknown: float = 200.0


COST = Cost()

PARTING = ("slot", "faces")
"""Ways of holding in which the metal parts before the end of the test."""

_VIEWS, _MOST_TIMES = 3, 6
"""Pictures of a state in the report, and times that it shows (pipeline.report.picture_set)."""


def make_plan(
    scene: Scene,
    solid: Solid | None = None,
    workers: int | None = None,
    with_march: bool = False,
    ranks: int = 1,
    march_ranks: int = 1,
) -> Plan:
    """Plan a scene; builds the solid when it is not given.

    workers: pulls at a time, None as many as the cores allow; ranks: MPI ranks per pull;
    march_ranks: of each march.
    with_march: also find out what each march can leave out and with which bound; this solves for
    the bound of the liquid's concentration once per alloy.

    Raises ValueError with one sentence when the lattice is too coarse for the solid.
    """
    check_screw(scene)
    if solid is None:
        from pipeline.stages.geometry import build_solid

        solid = build_solid(scene)
    check_sizes(scene, solid)
    nodes, metal, bonds = _lattice_counts(scene, solid)
    counts = [mesh_counts(scene, solid, hold) for hold in scene.holds]
    cells, unknowns, quadrature = (max(numbers) for numbers in zip(*counts, strict=True))
    workers = workers or max(1, machine.processor_cores() // ranks)
    times = scene.with_intact()
    pulls = len(scene.alloys) * len(times)  # in each way of holding
    tasks = [
        Task(
            "geometry",
            solid.name,
            f"about {cells:,} tetrahedra of {format_length(_smallest(scene))} to "
            f"{format_length(scene.mesh.size)}",
            COST.solid_seconds + COST.mesh_seconds_per_cell * cells,
            BASE_MEMORY + 2e3 * cells,
            2e6 + 200.0 * cells,
        )
    ]
    labels = ", ".join(time.label for time in times)
    marches = with_march and times[-1].seconds > 0
    ion_seconds, ion_disk = _ion_cost(scene, len(times))
    march_memory = COST.corrosion_bytes_per_node * nodes
    if scene.ions is not None:
        domain = liquid_domain(scene, solid.points)
        march_memory = ion_memory(scene, domain, nodes, metal, len(times))
    on_ranks = rank_memory(nodes, march_memory, BASE_MEMORY, march_ranks)
    if scene.corrosion.classes:
        triangles, faces = len(solid.triangles), solid.area / scene.lattice.spacing**2
        tasks.append(
            Task(
                "corrode",
                "surface",
                f"{triangles:,} triangles, {scene.corrosion.classes} rate classes per cell; once "
                "for a solid and a lattice",
                COST.surface_seconds_per_triangle * triangles
                + COST.surface_seconds_per_face * faces,
                BASE_MEMORY + COST.corrosion_bytes_per_node * nodes,
                1e3 * faces,
            )
        )
    for alloy in scene.alloys:
        tasks.append(
            Task(
                "corrode",
                alloy.name,
                f"{nodes:,} nodes ({metal:,} metal), {bonds} bonds each, {labels}"
                + "; ".join(("", *filter(None, (_ions_in_words(scene), on_ranks.in_words())))),
                (COST.corrosion_seconds_per_node + ion_seconds) * nodes,
                on_ranks.all,
                (COST.disk_bytes_per_node + ion_disk) * nodes * len(times),
            )
        )
    tasks.append(
        Task(
            "map",
            _many(pulls * len(counts), "damage map"),
            f"{quadrature:,} quadrature points each",
            COST.map_seconds_per_cell * sum(count[0] for count in counts) * pulls,
            BASE_MEMORY + 100.0 * quadrature,
            8.0 * sum(count[2] for count in counts) * pulls,
        )
    )
    at_once = min(workers, pulls)
    for hold, (_, each, _) in zip(scene.holds, counts, strict=True):
        test = hold.tensile
        tasks.append(
            Task(
                "pull",
                f"{_many(pulls, LOADS[test.load].test)} ({hold.name}), {at_once} at a time",
                f"{each:,} unknowns each ({test.element})",
                seconds_of_test(hold, each) * pulls / at_once,
                at_once * (ranks * BASE_MEMORY + COST.tensile_bytes_per_unknown * each),
                COST.disk_bytes_per_unknown * each * pulls,
                at_once,
            )
        )
    pictures = _VIEWS * len(scene.alloys) * min(len(times), _MOST_TIMES)
    tasks.append(
        Task(
            "report",
            "page",
            f"{pictures} pictures",
            COST.report_seconds + COST.picture_seconds * pictures / machine.processor_cores(),
            2.0 * BASE_MEMORY,
            3e6,
        )
    )
    overlap = saved(tasks, workers, len(scene.alloys), len(times)) if ranks == 1 else 0.0
    return Plan(
        tasks=tuple(tasks),
        omissions=tuple(
            scene_omissions(scene) + (_march_omissions(scene, solid) if marches else [])
        ),
        nodes=nodes,
        unknowns=unknowns,
        seconds=sum(task.seconds for task in tasks) - overlap,
        memory=max(task.memory for task in tasks),
        disk=sum(task.disk for task in tasks),
    )


def seconds_of_test(hold: HoldScene, unknowns: int) -> float:
    """How long one test of so many unknowns is expected to take, s."""
    test = hold.tensile
    increments = 4 + test.final_strain / test.increment  # the first are smaller
    if ELEMENTS[test.element].order == 1:
        each_costs = COST.four_node_seconds_per_unknown
    else:
        each_costs = COST.tensile_seconds_per_unknown
        each_costs *= COST.parting if hold.name in PARTING else 1.0
    return each_costs * unknowns * increments


def _ion_cost(scene: Scene, times: int) -> tuple[float, float]:
    """Seconds per node of the ions' part of a march, bytes on disk per node and time."""
    if scene.ions is None:
        return 0.0, 0.0
    fields = len(scene.ions.chemistry["charge_number"]) + len(scene.ions.minerals) + 2
    solutions = times if not scene.ions.minerals else COST.ion_solutions
    return COST.ion_seconds_per_node * solutions, 8.0 * fields


def _ions_in_words(scene: Scene) -> str:
    if scene.ions is None:
        return ""
    species = len(scene.ions.chemistry["charge_number"])
    minerals = ", ".join(scene.ions.minerals) or "no minerals"
    return f"{species} species of {scene.ions.medium}, {minerals}"


def print_plan(plan: Plan) -> None:
    """Print the plan for a reader."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if Console().is_terminal else 120)
    table = Table(title="What would be computed")
    for column in ("stage", "what", "size", "time", "memory"):
        table.add_column(column, justify="right" if column in ("time", "memory") else "left")
    for task in plan.tasks:
        table.add_row(
            task.stage,
            task.what,
            task.size,
            format_seconds(task.seconds),
            format_bytes(task.memory),
        )
    console.print(table)
    table = Table(title="What is left out")
    for column in ("what", "why", "error"):
        table.add_column(column)
    for omission in plan.omissions:
        table.add_row(omission.what, omission.reason, omission.error)
    console.print(table)
    console.print(
        f"nodes {plan.nodes:,}, unknowns {plan.unknowns:,}, about "
        f"{format_seconds(plan.seconds)} (the first run half a minute more, to compile), "
        f"memory {format_bytes(plan.memory)}, disk {format_bytes(plan.disk)}"
    )


def _lattice_counts(scene: Scene, solid: Solid) -> tuple[int, int, int]:
    """Nodes of the domain, metal nodes (from the volume), bonds of a node."""
    domain = liquid_domain(scene, solid.points)
    box = np.prod((np.subtract(domain.upper, domain.lower)) / scene.lattice.spacing)
    if box > 1e8:
        # too many to list one by one: the volume of the region says how many there are
        share = np.pi / 6 if domain.shape == "ball" else np.pi / 4
        nodes = int(box * share)
    else:
        nodes = int(domain_lattice(scene, domain)[1].sum())
    lattice = domain_lattice(scene, domain)[0] if box <= 1e8 else None
    metal = round(solid.volume / scene.lattice.spacing**3)
    if lattice is None:
        ratio = scene.lattice.horizon / scene.lattice.spacing
        return nodes, metal, round(4 / 3 * np.pi * (ratio + 0.5) ** 3)
    settings = scene.corrosion
    stencil = diffusion_stencil(
        lattice,
        scene.lattice.horizon,
        settings.kernel_exponent,
        settings.influence,
        settings.calibration,
    )
    return nodes, metal, stencil.bonds


def _smallest(scene: Scene) -> float:
    """The smallest edge length of all meshes (m)."""
    return min(
        size
        for mesh in scene.meshes().values()
        for size in (mesh.size_fine, *mesh.size_ends)
        if size is not None
    )


def mesh_counts(scene: Scene, solid: Solid, hold: HoldScene) -> tuple[int, int, int]:
    """Cells, displacement unknowns and quadrature points that the mesh sizes will give.

    Fitted to the meshes of `perilife study tensile` and `perilife bench tensile-published`, 2,536
    to 767,631 cells: cells and unknowns to 8 %.  A thread needs some cells at any size; an end face
    with cells of its own edge length e needs 11 of them for each e^2 of the mean section.
    """
    geometry = scene.geometry
    threaded = isinstance(geometry, ScrewGeometry) and geometry.parameters.thread != "none"
    mesh = hold.mesh
    surface, bulk = solid.area / mesh.size_fine**2, solid.volume / mesh.size**3
    section = solid.volume / float(np.ptp(solid.points[:, 2]))
    ends = sum(11.0 * section / size**2 for size in mesh.size_ends if size is not None)
    cells = max(12, round(970 * threaded + 5.0 * surface + 3.0 * bulk + ends))
    element = ELEMENTS[hold.tensile.element]
    points = 0.95 * cells**0.883 if element.order == 1 else 3.65 * cells**0.931
    return cells, 3 * round(points), cells * element.points


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _march_omissions(scene: Scene, solid: Solid) -> list[LeftOut]:
    return [_in_words(alloy, omission) for alloy, omission in march_omissions(scene, solid)]


def _in_words(alloy: str, omission: Omission) -> LeftOut:
    """An omission of a march, by the name that --keep takes where it is offered."""
    if omission.applied:
        measure = "V_L" if omission.of == "the volume loss" else omission.of
        error = f"at most {100 * omission.bound:.2g} % of {measure}"
    elif np.isfinite(omission.bound):
        error = f"kept; leaving it out would cost up to {100 * omission.bound:.2g} % of V_L"
    else:
        error = "kept"
    name = omission.name
    if name not in OMITTABLE:
        name = f"{name.replace('_', ' ')} (not offered to --keep)"
    return LeftOut(f"{alloy}: {name}", omission.reason, error)


def scene_omissions(scene: Scene) -> list[LeftOut]:
    """What the model and the scene leave out; it follows from the settings alone."""
    found = [
        LeftOut(
            "diffusion within the metal",
            "D_sol is 0 in the bi-material model (dissertation 2.3.3)",
            "part of the model",
        ),
        LeftOut(
            "liquid beyond the domain",
            "the published parameters belong to this domain; its outermost layer, one horizon "
            "wide, holds refreshed medium"
            if scene.domain.boundary == "refreshed"
            else "nothing crosses the edge of the domain",
            "part of the scene",
        ),
    ]
    reason = one_rate_because(scene)
    if reason:
        found.append(
            LeftOut(
                "the spread of the rate within a cell",
                f"each node has one rate ({reason})",
                "most of the lattice's error (pipeline/README.md)",
            )
        )
    reasons = {by_nodes_because(scene, hold.tensile): None for hold in scene.holds}
    if scene.immersion[-1].seconds > 0:
        found += [interpolated(because) for because in reasons if because]
    if scene.corrosion.kinetics != "volume_loss":
        found.append(
            LeftOut(
                "the published kinetics",
                f"the rate follows {scene.corrosion.kinetics} (--kinetics); published, and fitted "
                "with the parameter set, is volume_loss with the l of that set",
                "an assumption (peri/README.md)",
            )
        )
    if scene.corrosion.coating is not None:
        found.append(
            LeftOut(
                "what a coating does on its way",
                f"it lets {scene.corrosion.coating} through (--coating), everywhere alike, and is "
                "then gone",
                "an assumption",
            )
        )
    if scene.corrosion.dissolution == "faradaic":
        found.append(
            LeftOut(
                "the published law of a bond",
                "a bond carries the whole flux until its metal node is empty (--dissolution "
                "faradaic); published, and fitted with the parameter set, is a flux in proportion "
                "to what the node still holds",
                "an assumption (peri/README.md)",
            )
        )
    if scene.immersion[0].seconds == 0 and len(scene.immersion) == 1:
        found.append(LeftOut("corrosion", "only time zero is asked for", "none"))
    found += _tensile_departures(scene)
    drop = scene.tensile.peak_drop
    if drop < 1:
        names = LOADS[scene.tensile.load]
        found.append(
            LeftOut(
                f"the end of a {names.reaction}-{names.abscissa} curve",
                f"a test ends once the {names.reaction} is {100 * drop:g} % below its peak "
                "(--peak-drop)",
                f"none in the peak {names.reaction}",
            )
        )
    return found


def interpolated(because: str) -> LeftOut:
    """What the map loses that takes the damage from the lattice's nodes, and why it is that one."""
    return LeftOut(
        "the profile of the damage between the lattice's nodes",
        f"on the mesh it is interpolated between them ({because})",
        "up to 2 % of what the weakest section of the reference screw carries after 24 weeks, a "
        "fifth of its outermost layer (pipeline/MEASURED.md)",
    )


def _tensile_departures(scene: Scene) -> list[LeftOut]:
    """Where the tensile test does less than the source, or something else."""
    test = scene.tensile
    found = [
        LeftOut(
            "the full moduli of corroded metal",
            "the moduli fall with f as the strength does, by 1 - q1 f; the source keeps them",
            "an assumption (fem/README.md)",
        )
    ]
    names = LOADS[test.load]
    of_what = "elongation" if test.load == "axial" else "angle times radius"
    found.append(
        LeftOut(
            f"{names.test} beyond a nominal strain of {100 * test.final_strain:g} %",
            f"{of_what} over the length between the grips; further with --final-strain",
            f"a {names.reaction} that still rises then counts as the peak",
        )
    )
    found += [LeftOut(*words) for words in locking(test)]
    for hold in scene.holds:
        bottom, top = hold.tensile.bottom_grip, hold.tensile.top_grip
        if bottom > 0 or top > 0:
            found.append(
                LeftOut(
                    f"the metal within the grips ({hold.name})",
                    f"the outer {format_length(bottom)} and {format_length(top)} are held and not "
                    "strained; other ways of holding: --hold"
                    + ("" if isinstance(scene.geometry, ScrewGeometry) else "; no slot is known"),
                    "part of the scene (pipeline/MEASURED.md: how long the grips are)",
                )
            )
    if test.damage != "implicit":
        each = "cell" if test.damage == "cell" else "quadrature point"
        found.append(
            LeftOut(
                "growth of f within an increment",
                f"f is one per {each}; in an increment that acts which it ends with if it grows on "
                "as in the last one (within: --damage implicit)",
                "0.15 % of the force or shorter increments (lag_at_peak of tensile.json)",
            )
        )
    return found
