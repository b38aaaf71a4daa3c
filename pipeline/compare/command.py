"""The command `perilife compare`: its options and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from pipeline.record.run_folder import REPORT_FILE, SCENE_FILE
from pipeline.scene.units import parse_time


def add_compare_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife compare`."""
    parser.add_argument("runs", nargs="+", metavar="RUN", help="run folders, at least two")
    parser.add_argument("--out", required=True, metavar="FILE", help="page to write, FILE.html")
    parser.add_argument(
        "--time", metavar="T", help="of the force curves: 8w (the last one that most runs have)"
    )


def run_compare(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Write the page; ValueError or OSError with one sentence where that cannot be."""
    out = Path(options.out)
    if out.suffix != ".html":
        raise ValueError(f"--out is '{out}'; a comparison is a page whose name ends in .html")
    if out.is_dir():
        raise IsADirectoryError(f"--out is '{out}', which is a folder; it must be a file or new")
    if not out.parent.is_dir():
        raise FileNotFoundError(f"--out is '{out}', whose folder does not exist")
    if out.name == REPORT_FILE and (out.parent / SCENE_FILE).exists():
        raise ValueError(f"--out is '{out}', the report of a run; choose another name")
    seconds = parse_time(options.time, "--time").seconds if options.time else None
    from pipeline.compare.page import write_comparison
    from pipeline.compare.runs import read_runs

    say(str(write_comparison(read_runs(options.runs), out, seconds)))
