"""Whether this machine can do what a plan asks for: memory, disk, dolfinx, MPI.

Asked before the first stage, so that no run ends hours later for want of something.
"""

import math
import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.geometry.surface import Solid
from pipeline.planning.beside import Task
from pipeline.planning.plan import BASE_MEMORY, Plan, make_plan
from pipeline.planning.sizes import CELLS_PER_FEATURE, typed
from pipeline.record import children, machine
from pipeline.scene.checks import at_most
from pipeline.scene.scene import Scene
from pipeline.scene.units import format_bytes

PROBE_SECONDS = 120.0

_PROBE = """
import os
from mpi4py import MPI
from fem.compat import check_version
version = check_version()
MPI.COMM_WORLD.Barrier()
if MPI.COMM_WORLD.rank == 0:
    os.write(1, f"probed {MPI.COMM_WORLD.size} {version} \\n".encode())
"""


@dataclass(frozen=True)
class Check:
    """One thing that a run needs: what was found, and why that will not do (or "")."""

    what: str
    found: str
    problem: str = ""


def check_machine(
    scene: Scene,
    solid: Solid,
    folder: Path,
    ranks: int = 1,
    workers: int | None = None,
    stages: Iterable[str] = ("geometry", "corrode", "map", "pull"),
    march_ranks: int = 1,
) -> Plan:
    """Refuse, before anything is written, what this machine cannot do; returns the plan.

    stages: those that are to be done; dolfinx and MPI are tried for "pull" only.  Raises
    MemoryError or OSError with one sentence.
    """
    plan = make_plan(scene, solid, workers, ranks=ranks, march_ranks=march_ranks)
    stages = set(stages)
    memory, disk = (check(scene, solid, plan, folder, stages) for check in (_memory, _disk))
    if memory.problem:
        raise MemoryError(memory.problem)
    if disk.problem:
        raise OSError(disk.problem)
    if "pull" in stages:
        tools = try_tools(ranks)
        if tools.problem:
            raise OSError(tools.problem)
    return plan


def examine_machine(
    scene: Scene, solid: Solid, plan: Plan, folder: Path, ranks: int = 1
) -> tuple[Check, ...]:
    """Everything that `check_machine` looks at, whether it will do or not."""
    stages = {task.stage for task in plan.tasks}
    return (
        _memory(scene, solid, plan, folder, stages),
        _disk(scene, solid, plan, folder, stages),
        try_tools(ranks),
    )


def _memory(scene: Scene, solid: Solid, plan: Plan, folder: Path, stages: set[str]) -> Check:
    available = machine.available_memory()
    tasks = [task for task in plan.tasks if task.stage in stages]
    task = max(tasks, key=lambda item: item.memory)
    found = f"{format_bytes(task.memory)} needed ({task.stage}), {format_bytes(available)} there"
    if task.memory <= available:
        return Check("memory", found)
    return Check(
        "memory",
        found,
        f"stage {task.stage} needs about {format_bytes(task.memory)} of memory ({task.size}) and "
        f"{format_bytes(available)} are available; {_less_memory(scene, solid, task, available)}",
    )


def _less_memory(scene: Scene, solid: Solid, task: Task, available: float) -> str:
    """What to choose so that a task fits into the memory."""
    per_pull = task.memory / task.at_once
    fits = math.floor(available / per_pull)
    if fits:
        return f"choose --pulls {fits}"
    if available <= BASE_MEMORY:
        return f"even an empty process takes {format_bytes(BASE_MEMORY)}, so free some memory"
    excess = (per_pull - BASE_MEMORY) / (available - BASE_MEMORY)
    if task.stage == "corrode":
        spacing = _rounded_up(scene.lattice.spacing * excess ** (1 / 3))
        limit = min(solid.smallest_feature / CELLS_PER_FEATURE, scene.lattice.horizon)
        if at_most(spacing, limit):
            return f"choose --spacing {typed(spacing)}, or a smaller domain"
        return "choose a smaller domain (--radial-margin, --axial-margin) or horizon"
    hold = next((h for h in scene.holds if f"({h.name})" in task.what), scene.holds[0])
    if hold.mesh.size_bottom or hold.mesh.size_top:
        return (
            f"at its end faces the mesh is as fine as the lattice, so leave out --hold {hold.name}"
        )
    # cells go with the square of the edge length at least
    size, fine = (_rounded_up(s * excess**0.5) for s in (hold.mesh.size, hold.mesh.size_fine))
    return f"choose --mesh-size {typed(size)} --mesh-size-fine {typed(fine)}"


def _rounded_up(length: float) -> float:
    micrometres = length * 1e6
    digit = 10.0 ** (math.floor(math.log10(micrometres)) - 1)
    return math.ceil(micrometres / digit) * digit * 1e-6


def _disk(scene: Scene, solid: Solid, plan: Plan, folder: Path, stages: set[str]) -> Check:
    needed = sum(task.disk for task in plan.tasks if task.stage in stages)
    free = machine.free_disk(folder)
    found = f"{format_bytes(needed)} needed, {format_bytes(free)} free"
    if needed <= free:
        return Check("disk", found)
    return Check(
        "disk",
        found,
        f"the run needs about {format_bytes(needed)} on the disk that holds '{folder}' and "
        f"{format_bytes(free)} are free; choose another --out or fewer immersion times",
    )


_worked: dict[tuple, Check] = {}
"""What answered in this process, by command and place of imports; it is not asked again."""


def try_tools(ranks: int = 1) -> Check:
    """Start a process, or as many ranks, that imports dolfinx and counts the ranks."""
    what = "dolfinx" if ranks == 1 else f"dolfinx on {ranks} ranks"
    command = [sys.executable, "-c", _PROBE]
    try:
        command = command if ranks == 1 else [*machine.mpirun(ranks, f"--np {ranks}"), *command]
    except FileNotFoundError as error:
        return Check(what, "no mpirun", str(error))
    environment = machine.child_environment(ranks, 1)
    asked = (*command, environment["PYTHONPATH"])
    if asked in _worked:
        return _worked[asked]
    child = children.start(
        command,
        launcher=ranks > 1,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        printed, told = child.communicate(timeout=PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        text = f"{' '.join(command[:3])} ... did not answer within {PROBE_SECONDS:.0f} s"
        return Check(what, "no answer", f"{text}; dolfinx and MPI must work for a tensile test")
    finally:
        children.end(child)
    answers = re.findall(r"probed (\d+) (\S+)", printed)
    if child.returncode != 0 or not answers:
        said = [line.strip() for line in told.splitlines() if "Error" in line]
        reason = said[-1] if said else children.how_it_ended(child.returncode)
        return Check(
            what,
            "not usable",
            f"dolfinx or MPI cannot be used ({reason}), which a tensile test needs; install both "
            "(Debian: python3-dolfinx-real), or stop at `perilife map`, which does without",
        )
    if any(answer[0] != str(ranks) for answer in answers):
        return Check(
            what,
            f"{answers[0][0]} rank",
            f"mpirun starts {ranks} processes that do not know of one another; mpirun and mpi4py "
            "must be of the same MPI, or --np be left out",
        )
    _worked[asked] = Check(what, answers[0][1])
    return _worked[asked]


def print_checks(checks: Iterable[Check]) -> None:
    """Print what was found for a reader, and why it will not do."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if Console().is_terminal else 120)
    table = Table(title="Whether this machine can")
    for column in ("what", "found", "will it do"):
        table.add_column(column)
    for check in checks:
        table.add_row(check.what, check.found, f"no: {check.problem}" if check.problem else "yes")
    console.print(table)
