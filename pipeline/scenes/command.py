"""The command `perilife scenes`, and scene files of localised corrosion in `run` and `plan`."""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.record.options import add_ranks_options

if TYPE_CHECKING:
    from peri.engine.omission import Omission
    from pipeline.planning.rank_memory import RankMemory
    from pipeline.record.run_folder import RunFolder
    from pipeline.scenes.files import SceneFile
    from pipeline.scenes.outcome import Prepared

OF_A_FILE = (
    "scene", "out", "quiet", "resume", "json", "spacing", "immersion", "ranks", "oversubscribe",
)  # fmt: skip
"""Options of `perilife run` that a scene of localised corrosion takes, too."""
KEYS_INSTEAD = {"parameters": "parameters", "alloy": "alloy", "solid": "file"}
"""Option of a life cycle -> the key of [metals.NAME] that says the same of a couple's metal."""
STAGE = "scene"
CHECKPOINT = "march.h5"
BYTES_PER_NODE = 1000.0
"""Of the lattice of a march in one process; measured 870 for pits, 540 to 900 for couples."""


def add_scenes_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife scenes`."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="the scene to run; none: list all")
    parser.add_argument("--out", metavar="DIR", help="the folder for its results")
    parser.add_argument("--spacing", metavar="L", help="lattice spacing (the scene's own)")
    parser.add_argument("--times", nargs="+", metavar="T", help="output times (the scene's own)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--resume", action="store_true", help="go on with the same scene")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_ranks_options(parser)


def run_scenes(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    from pipeline.scenes.files import read_scene
    from pipeline.scenes.registry import path_of, shipped

    if options.name is None:
        given = [n for n in ("out", "spacing", "times", "json") if getattr(options, n)]
        if given:
            raise ValueError(f"--{given[0]} is of a scene; name one, `perilife scenes` lists them")
        for name, path in shipped().items():
            say(f"{name:24s} {read_scene(path).title}")
        return
    scene = read_scene(path_of(options.name)).changed(options.spacing, options.times)
    _run_and_say(options, scene, say)


def run_file(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Run the scene file that `perilife run` was given; errors as `run_scenes`."""
    _run_and_say(options, _of_file(options), say)


def _run_and_say(options: argparse.Namespace, scene: SceneFile, say: Callable[[str], None]) -> None:
    """Run a scene; with `json` the folder, the table and what is assumed are one JSON object."""
    out = options.out or scene.out
    if out is None:
        raise ValueError(f"scene '{scene.name}' writes a folder; say where with --out DIR")
    if not options.json:
        _run(options, scene, out, say)
        return
    folder = _run(options, scene, out, lambda line: None)
    record = folder.read_record(folder.path, STAGE)
    assert record is not None
    found = {"folder": str(folder.path.absolute()), "summary": record.numbers}
    say(json.dumps({**found, "assumed": assumed_rows(scene.prepared())}, indent=2))


def plan_file(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """What a scene file would compute and what not, with the bound of each omission."""
    from rich.console import Console
    from rich.table import Table

    from pipeline.scene.units import format_bytes

    scene = _of_file(options)
    ready = scene.prepared()
    _check_ranks(options, scene.name, ready)
    omissions = ready.reductions(scene.times[-1].seconds)
    memory = march_memory(ready, options.ranks)
    if options.json:
        rows = [asdict(o) for o in omissions]
        for row in rows:
            row["bound"] = row["bound"] if row["bound"] < float("inf") else None
        told = {"kind": scene.kind, "size": ready.size, "omissions": rows}
        told["assumed"] = assumed_rows(ready)
        if memory is not None:
            told |= {"memory": asdict(memory), "seconds": None}
        say(json.dumps(told, indent=2))
        return
    say(f"{scene.name} ({scene.kind}) to {scene.times[-1].label}: {ready.size}")
    if memory is not None:
        say(f"memory: about {memory.in_words() or format_bytes(memory.all)}")
    table = Table(title="What it need not compute")
    for column in ("what", "left out", "why", "error"):
        table.add_column(column)
    for o in omissions:
        table.add_row(o.name, "yes" if o.applied else "no", o.reason, _error_of(o))
    Console(width=None if Console().is_terminal else 120).print(table)
    _say_assumed(ready, say)


def _error_of(omission: Omission) -> str:
    """What leaving it out costs, or would cost, in words."""
    if omission.bound == 0:
        return "none"
    if omission.bound >= 1:
        return "no bound" if omission.bound == float("inf") else "no bound below 100 %"
    return f"at most {100 * omission.bound:.2g} % of {omission.of}"


def init_file(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Print a scene file with every key of its kind: that of a kind, or a shipped one by name."""
    from perilife_data import did_you_mean
    from pipeline.scenes.files import read_scene, write_template
    from pipeline.scenes.registry import KINDS, path_of, shipped

    _refuse_others(options)
    kinds, name = {kind: entry.example for kind, entry in KINDS.items()}, options.kind
    if name not in kinds and name not in shipped():
        known = dict.fromkeys([*kinds, *shipped()])
        raise ValueError(
            f"--kind is '{name}'{did_you_mean(name, known)}; it must be life-cycle or one of "
            f"{', '.join(known)}"
        )
    scene = read_scene(path_of(kinds.get(name, name))).changed(options.spacing, options.immersion)
    say(write_template(scene, options.out))


def _of_file(options: argparse.Namespace) -> SceneFile:
    """The scene of `options.scene`, with what was typed; ValueError for an option it lacks."""
    from pipeline.scenes.files import read_scene

    _refuse_others(options)
    scene = read_scene(Path(options.scene))
    return scene.changed(options.spacing, getattr(options, "immersion", None))


def _refuse_others(options: argparse.Namespace) -> None:
    """Refuse what was typed and belongs to a life cycle."""
    for name, default in options.defaults.items():
        if name not in OF_A_FILE and getattr(options, name, default) != default:
            raise ValueError(
                f"--{name.replace('_', '-')} is of a life cycle; a scene of localised corrosion "
                f"takes {', '.join(f'--{n}' for n in OF_A_FILE)}{_instead(name)}"
            )


def _instead(name: str) -> str:
    """Which key of a metal says what an option says of a life cycle, where one does."""
    key = KEYS_INSTEAD.get(name)
    return f"; a galvanic scene or a couple has it as {key} of [metals.NAME]" if key else ""


def _check_ranks(options: argparse.Namespace, name: str, ready: Prepared) -> None:
    """Refuse more ranks than there are cores, and any where one process computes the scene."""
    from pipeline.record.machine import check_counts

    check_counts(options.ranks, None, options.oversubscribe, "--ranks")
    if options.ranks > 1 and ready.alone:
        raise ValueError(
            f"--ranks is {options.ranks} for scene '{name}'; it must be 1: {ready.alone}"
        )


def march_memory(ready: Prepared, ranks: int) -> RankMemory | None:
    """What a scene's march takes on so many ranks; None where it has no lattice."""
    from pipeline.planning.plan import BASE_MEMORY
    from pipeline.planning.rank_memory import rank_memory

    if not ready.nodes:
        return None
    return rank_memory(ready.nodes, BYTES_PER_NODE * ready.nodes, BASE_MEMORY, ranks)


def _run(
    options: argparse.Namespace, scene: SceneFile, out: str, say: Callable[[str], None]
) -> RunFolder:
    """March and write, in a locked folder."""
    from pipeline.record.machine import package_versions
    from pipeline.record.progress import progress_for
    from pipeline.record.run_folder import RunFolder, StageRecord, utc_now, write_json
    from pipeline.scenes.files import to_json
    from pipeline.scenes.writing import PLOT_FILE, SUMMARY_FILE, march_and_write

    prepared = scene.prepared()
    _check_ranks(options, scene.name, prepared)
    content, times = to_json(scene, prepared), [time.seconds for time in scene.times]
    mark = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    folder = RunFolder(out)
    if folder.path.exists() and not folder.path.is_dir():
        raise ValueError(f"--out is '{out}', which is a file; it must be a folder")
    if not folder.is_empty():
        if not options.resume:
            raise ValueError(f"folder '{out}' is not empty; go on with --resume or choose another")
        if not _same(folder, content):
            raise ValueError(f"folder '{out}' is of another scene or other values; choose another")
    with folder.lock(), progress_for(sys.stderr, options.quiet) as progress:
        checkpoint, key = folder.path / CHECKPOINT, scene.name
        done = folder.complete(folder.path, STAGE, mark)
        if done is not None:
            progress.reused(key)
        else:
            folder.forget(folder.path, STAGE)
            write_json(folder.scene_file, content)
            started = time.perf_counter()
            progress.started(key)

            def advanced(share: float, text: str) -> None:
                progress.advanced(key, share, text)

            if options.ranks == 1:
                paths, numbers = march_and_write(
                    folder.path, key, prepared, times, checkpoint=checkpoint,
                    resume=options.resume, progress=advanced,
                )  # fmt: skip
            else:
                from pipeline.scenes.on_ranks import march_on_ranks

                paths, numbers = march_on_ranks(
                    key, folder.scene_file, checkpoint, options.resume, options.ranks, advanced,
                    folder.descriptors,
                )  # fmt: skip
            seconds = time.perf_counter() - started
            record = StageRecord(
                STAGE,
                mark,
                seconds,
                utc_now(),
                folder.fingerprints(paths),
                numbers,
                package_versions(),
            )
            folder.write_record(folder.path, record)
            checkpoint.unlink(missing_ok=True)
            progress.finished(key, seconds)
    say(f"{scene.name} after {scene.times[-1].label}")
    with (folder.path / SUMMARY_FILE).open(newline="", encoding="utf-8") as table:
        for row in csv.DictReader(table):
            said = in_words(float(row["value"]), row["unit"])
            say(f"  {row['quantity']:42s} {said}")
    _say_assumed(prepared, say)
    say(f"table: {folder.path / SUMMARY_FILE}")
    say(f"plot:  {folder.path / PLOT_FILE}")
    return folder


def assumed_rows(ready: Prepared) -> list[dict[str, object]]:
    """Every value in use that is assumed, fitted or known to be wrong, with where it comes from."""
    return [{"name": name, **asdict(value)} for name, value in ready.assumed.items()]


def _say_assumed(ready: Prepared, say: Callable[[str], None]) -> None:
    """The same for a reader, a line each."""
    if not ready.assumed:
        return
    say("assumed, fitted or known to be wrong:")
    for name, v in ready.assumed.items():
        several = v.value if isinstance(v.value, list) else [v.value]
        text = ", ".join(x if isinstance(x, str) else in_words(x, v.unit) for x in several)
        where = ", ".join(filter(None, (v.source, v.where)))
        say(f"  {name:42s} {text:24s} {v.kind}{f': {where}' if where else ''}")


def in_words(value: float, unit: str) -> str:
    """A number of the summary for a reader: lengths in um or mm, areas in their squares."""
    from pipeline.scene.units import format_length

    if unit == "m":
        return format_length(value)
    if unit == "m2":
        return f"{1e12 * value:.4g} um2" if abs(value) < 1e-9 else f"{1e6 * value:.4g} mm2"
    return f"{value:.6g} {unit if unit != '1' else ''}".rstrip()


def _same(folder, content: dict) -> bool:
    try:
        return json.loads(folder.scene_file.read_text(encoding="utf-8")) == content
    except (OSError, ValueError):
        return False
