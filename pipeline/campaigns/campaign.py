"""`perilife campaign`: a table of scenes from one TOML file, computed stage by stage from a store.

    alloys = ["Mg-5Gd", "Mg-10Gd"]
    immersion = ["8w", "24w"]
    samples = 40                    # optional: of the constants, from a fitted set

    [options]                       # of `perilife run`; a list is a dimension of the table
    resolution = "quick"
    diameter = ["2mm", "2.4mm"]

Every combination of alloy, listed options and sample is a scene.  Equal stages of scenes are one
task: forty samples of one geometry mesh once, and the intact solid is tested once.
"""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import tomllib
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.calibration.models import with_constants
from pipeline.campaigns.banded import samples_of
from pipeline.campaigns.engines import ENGINES
from pipeline.campaigns.store import StoreFolder
from pipeline.campaigns.task import Task, do_task
from pipeline.planning.plan import make_plan
from pipeline.record.run_folder import RunFolder, write_text
from pipeline.record.stage_hashes import corrosion_hash, geometry_hash, map_hash, pull_hash
from pipeline.scene.command.arguments import arguments_of, options_of, unknown_name
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene
from pipeline.scene.units import ImmersionTime

STORE_FOLDER = "store"
CAMPAIGN_FILE = "campaign.csv"
MOST_SCENES = 100_000
_KEYS = ("alloys", "immersion", "samples", "options")


@dataclass(frozen=True)
class Case:
    """One scene of one alloy: what varies, the scene, and the one whose intact solid is its own.

    sample: of the constants, counted from 1; 0 for those of the set.
    """

    options: tuple[tuple[str, str], ...]
    sample: int
    scene: Scene
    intact: Scene

    @property
    def alloy(self) -> str:
        """The one alloy of the scene."""
        return self.scene.alloys[0].name


def read_campaign(path: Path | str) -> list[Case]:
    """The scenes of a campaign file; ValueError or FileNotFoundError with one sentence."""
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"campaign is '{path}'; there is no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a valid TOML file: {error}") from None
    unknown = sorted(set(content) - set(_KEYS))
    if unknown:
        raise ValueError(f"{path}: {unknown[0]} is not known; known are {', '.join(_KEYS)}")
    alloys, times = (_texts(path, content, key) for key in ("alloys", "immersion"))
    count = content.get("samples", 0)
    if isinstance(count, bool) or not isinstance(count, int) or count < 0:
        raise ValueError(f"{path}: samples is {count!r}; it must be a whole number, at least 0")
    options = content.get("options", {})
    if not isinstance(options, dict):
        raise ValueError(f"{path}: options is {options!r}; it must be a table")
    values = {k: v if isinstance(v, list) else [v] for k, v in options.items()}
    size = len(alloys) * max(1, count)
    for listed in values.values():
        size *= len(listed)
    if not 1 <= size <= MOST_SCENES:
        raise ValueError(f"{path}: it asks for {size} scenes; they must be 1 to {MOST_SCENES}")
    varied = [key for key, listed in values.items() if len(listed) > 1]
    parser = _OptionParser(prog=str(path), add_help=False)
    add_scene_options(parser)
    known = options_of(parser)
    wrong = unknown_name(known, values)
    if wrong:
        raise ValueError(f"{path}: key {wrong} of [options] is no option of a scene")
    cases = []
    for alloy, combination in itertools.product(alloys, itertools.product(*values.values())):
        chosen = dict(zip(values, combination, strict=True))
        try:
            arguments = arguments_of(known, {"alloy": alloy, "immersion": times, **chosen})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        scene = scene_from_options(parser.parse_args(arguments))
        labels = tuple((key, str(chosen[key])) for key in varied)
        name = scene.alloys[0].name
        if not count:
            cases.append(Case(labels, 0, scene, scene))
            continue
        samples = samples_of(scene, name, count)
        cases += [
            Case(labels, n + 1, with_constants(scene, name, samples.constants(n)), scene)
            for n in range(count)
        ]
    return cases


class _OptionParser(argparse.ArgumentParser):
    """A parser that refuses in one sentence."""

    def error(self, message: str) -> None:
        raise ValueError(f"{self.prog}: {message}")


def _texts(path: Path, content: dict, key: str) -> list[str]:
    values = content.get(key)
    good = isinstance(values, list) and values and all(isinstance(v, str) for v in values)
    if not good:
        raise ValueError(f"{path}: {key} is {values!r}; it must be a list of texts in quotes")
    return values


def stages(cases: Iterable[Case], store: Path) -> list[list[Task]]:
    """The tasks of the scenes, each once, in waves that build on one another."""
    waves: list[dict[str, Task]] = [{}, {}, {}]
    for case in cases:
        for scene, moments in _parts(case):
            folder, alloy, path = StoreFolder(store, scene), case.alloy, str(store)
            places = [("geometry", folder.geometry), ("corrode", folder.corrosion(alloy))]
            for wave, (stage, place) in zip(waves, places, strict=False):
                wave.setdefault(str(place), Task(stage, str(place), path, scene, alloy))
            for moment, hold in itertools.product(moments, scene.holds):
                place = str(folder.test(alloy, moment.label, hold.name))
                task = Task("test", place, path, scene, alloy, moment.label, hold.name)
                waves[2].setdefault(place, task)
    return [list(wave.values()) for wave in waves]


def _parts(case: Case) -> list[tuple[Scene, list[ImmersionTime]]]:
    """What is computed for a case: its scene at its times, the intact solid of its own set."""
    later = [moment for moment in case.scene.with_intact() if moment.seconds > 0]
    intact = replace(case.intact, immersion=(case.intact.with_intact()[0],))
    return [(case.scene, later), (intact, list(intact.immersion))]


def largest_task(cases: Iterable[Case]) -> tuple[float, str]:
    """Bytes of memory of the task that needs most, and the task in words.

    One plan per solid, lattice and mesh; a scene that cannot be planned says so when it is done.
    """
    needed, what, seen = 0.0, "no task", set()
    for case in cases:
        key = (geometry_hash(case.scene), repr(case.scene.lattice), repr(case.scene.domain))
        if key in seen:
            continue
        seen.add(key)
        try:
            plan = make_plan(case.scene, workers=1)
        except ValueError:
            continue
        task = max(plan.tasks, key=lambda task: task.memory / task.at_once)
        if task.memory / task.at_once > needed:
            needed, what = task.memory / task.at_once, f"a task ({task.stage}, {task.size})"
    return needed, what


def run_campaign(
    cases: list[Case],
    out: Path,
    executor: Executor,
    say: Callable[[str], None] = lambda line: None,
    threads: int = 1,
) -> tuple[Path, list[str]]:
    """Compute what the store lacks and write campaign.csv; returns its path and the failures.

    threads: of the compiled kernels of a task.  The caller holds the store's lock.  A failed task
    costs the scenes that need it, no others.
    """
    store = out / STORE_FOLDER
    failures: dict[str, str] = {}
    for wave in stages(cases, store):
        waiting = [task for task in wave if not _done(task)]
        if len(wave) > len(waiting):
            say(f"{wave[0].stage}: {len(wave) - len(waiting)} of {len(wave)} in the store, kept")
        futures = {executor.submit(do_task, task.to_json(), threads): task for task in waiting}
        for count, future in enumerate(as_completed(futures), start=1):
            task = futures[future]
            said = future.result()
            if said:
                failures[task.key] = said
            say(f"{task.stage}: {count} of {len(futures)} done" + (f"; {said}" if said else ""))
    path = out / CAMPAIGN_FILE
    write_text(path, table(cases, store))
    return path, list(dict.fromkeys(failures.values()))


def _done(task: Task) -> bool:
    """Whether the store has a stage, complete and undamaged."""
    folder = StoreFolder(task.store, task.scene)
    if task.stage == "geometry":
        return folder.complete(folder.geometry, "geometry", geometry_hash(task.scene)) is not None
    if task.stage == "corrode":
        place = folder.corrosion(task.alloy)
        inputs = corrosion_hash(task.scene, task.alloy)
        return folder.complete(place, "corrode", inputs) is not None
    moment = next(m for m in task.scene.with_intact() if m.label == task.label)
    hold = next(h for h in task.scene.holds if h.name == task.hold)
    place = folder.test(task.alloy, task.label, task.hold)
    needed = (("map", map_hash), ("pull", pull_hash))
    return all(
        folder.complete(place, stage, inputs(task.scene, task.alloy, moment, hold)) is not None
        for stage, inputs in needed
    )


def table(cases: list[Case], store: Path) -> str:
    """One row per scene and time that the store has, in the order of the campaign file."""
    varied = [key for key, _ in cases[0].options]
    reaction = LOADS[cases[0].scene.tensile.load].reaction
    header = ["alloy", *varied, "sample", "hold", "immersion_days", "volume_loss"]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([*header, f"peak_{reaction}", "strength_ratio", "status"])
    for case in cases:
        (scene, later), (intact, first) = _parts(case)
        corroded = StoreFolder(store, scene)
        record = corroded.read_record(corroded.corrosion(case.alloy), "corrode")
        for hold, (n, moment) in itertools.product(
            (h.name for h in scene.holds), enumerate(scene.with_intact())
        ):
            if moment not in scene.immersion:
                continue
            whole = _tested(store, intact, case.alloy, first[0], hold)
            found = whole
            if moment.seconds > 0:
                found = _tested(store, scene, case.alloy, moment, hold)
            lead = [case.alloy, *(value for _, value in case.options), case.sample, hold]
            if found is None or whole is None or record is None:
                writer.writerow([*lead, f"{moment.days:.10g}", "", "", "", "failed"])
                continue
            peak = found[f"peak_{reaction}"]
            numbers = (moment.days, record.numbers["volume_loss"][n], peak)
            ratio = peak / whole[f"peak_{reaction}"]
            writer.writerow([*lead, *(f"{v:.10g}" for v in (*numbers, ratio)), found["status"]])
    return buffer.getvalue()


def _tested(store: Path, scene: Scene, alloy: str, moment: ImmersionTime, hold: str) -> dict | None:
    folder = StoreFolder(store, scene)
    record = folder.read_record(folder.test(alloy, moment.label, hold), "pull")
    return None if record is None else record.numbers


def run_from_options(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    """Do what the options of `perilife campaign` ask; the exit code."""
    if options.engine not in ENGINES:
        raise ValueError(f"--engine is '{options.engine}'; it must be one of {', '.join(ENGINES)}")
    if options.workers is not None and not 1 <= options.workers <= 4096:
        raise ValueError(f"--workers is {options.workers}; it must be from 1 to 4096")
    cases = read_campaign(options.campaign)
    out = Path(options.out)
    store = RunFolder((out / STORE_FOLDER).resolve())
    with ENGINES[options.engine](options.workers, options.scheduler) as crew:
        crew.check_memory(*largest_task(cases))
        with store.lock():
            crew.check_store(store.path)
            path, failures = run_campaign(cases, out.resolve(), crew.executor, say, crew.threads)
    for failure in failures:
        say(f"failed: {failure}")
    say(f"table: {path}")
    return 1 if failures else 0
