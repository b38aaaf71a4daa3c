"""The command `perilife scenes`: lists the scenes of localised corrosion, and runs one."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict

STAGE = "scene"
CHECKPOINT = "march.h5"


def add_scenes_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife scenes`."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="the scene to run; none: list all")
    parser.add_argument("--out", metavar="DIR", help="the folder for its results")
    parser.add_argument("--spacing", metavar="L", help="lattice spacing (the scene's own)")
    parser.add_argument("--times", nargs="+", metavar="T", help="output times (the scene's own)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--resume", action="store_true", help="go on with the same scene")


def run_scenes(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    from pipeline.scenes.registry import SCENES, check_spacing, entry_of

    if options.name is None:
        given = [n for n in ("out", "spacing", "times") if getattr(options, n) is not None]
        if given:
            raise ValueError(f"--{given[0]} is of a scene; name one, `perilife scenes` lists them")
        for name, entry in SCENES.items():
            say(f"{name:22s} {entry.title}")
        return
    entry = entry_of(options.name)
    if options.out is None:
        raise ValueError(f"scene '{options.name}' writes a folder; say where with --out DIR")
    times, labels = _times(options.times or list(entry.times))
    spacing = _spacing(options.spacing)
    check_spacing(options.name, spacing)
    prepared = entry.prepare(spacing)
    content = {
        "scene": options.name,
        "times_s": times,
        "values": {n: asdict(v) for n, v in prepared.values.items()},
    }
    _run(options, prepared, content, labels, say)


def _times(texts: list[str]) -> tuple[list[float], list[str]]:
    """Seconds, and the times as typed."""
    from pipeline.scene.units import parse_immersion_times

    times = parse_immersion_times(texts)
    if not times[-1].seconds > 0:
        raise ValueError(f"--times is {texts[-1]}; the last must be above 0")
    return [t.seconds for t in times], [t.label for t in times]


def _spacing(text: str | None) -> float | None:
    from pipeline.scene.units import parse_length

    if text is None:
        return None
    return parse_length(text, "spacing")


def _run(options, prepared, content: dict, labels: list[str], say: Callable[[str], None]) -> None:
    """March and write, in a locked folder."""
    from pipeline.record.machine import package_versions
    from pipeline.record.progress import progress_for
    from pipeline.record.run_folder import RunFolder, StageRecord, utc_now, write_json
    from pipeline.scenes.writing import PLOT_FILE, SUMMARY_FILE, write_outcome

    mark = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    folder = RunFolder(options.out)
    if folder.path.exists() and not folder.path.is_dir():
        raise ValueError(f"--out is '{options.out}', which is a file; it must be a folder")
    if not folder.is_empty():
        if not options.resume:
            raise ValueError(
                f"folder '{options.out}' is not empty; go on with --resume or choose another"
            )
        if not _same(folder, content):
            raise ValueError(
                f"folder '{options.out}' is of another scene or other values; choose another"
            )
    with folder.lock(), progress_for(sys.stderr, options.quiet) as progress:
        checkpoint, key = folder.path / CHECKPOINT, options.name
        done = folder.complete(folder.path, STAGE, mark)
        if done is not None:
            progress.reused(key)
        else:
            folder.forget(folder.path, STAGE)
            write_json(folder.scene_file, content)
            started = time.perf_counter()
            progress.started(key)
            outcome = prepared.march(
                content["times_s"],
                checkpoint=checkpoint,
                resume=options.resume,
                progress=lambda share, text: progress.advanced(key, share, text),
            )
            paths = write_outcome(folder.path, options.name, outcome)
            seconds = time.perf_counter() - started
            numbers = {n: [v, unit] for n, (v, unit) in _finite(outcome.summary).items()}
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
    say(f"{options.name} after {labels[-1]}")
    for line in (folder.path / SUMMARY_FILE).read_text(encoding="utf-8").splitlines()[1:]:
        quantity, value, unit = line.rsplit(",", 2)
        say(f"  {quantity.strip(chr(34)):42s} {float(value):.6g} {unit}".rstrip())
    assumed = ", ".join(prepared.assumed)
    if assumed:
        say(f"assumed: {assumed}")
    say(f"table: {folder.path / SUMMARY_FILE}")
    say(f"plot:  {folder.path / PLOT_FILE}")


def _finite(summary: dict) -> dict:
    """Without what has no number, which JSON has none for."""
    return {n: v for n, v in summary.items() if abs(v[0]) < float("inf")}


def _same(folder, content: dict) -> bool:
    try:
        return json.loads(folder.scene_file.read_text(encoding="utf-8")) == content
    except (OSError, ValueError):
        return False
