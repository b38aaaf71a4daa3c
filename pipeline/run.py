"""One run as the options of `perilife run` ask for it: for the command and for Python alike."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.campaigns.options import add_sample_options, add_until_options
from pipeline.record.options import add_folder_options, add_machine_options
from pipeline.scene.command.arguments import options_of
from pipeline.scene.command.options import add_scene_options
from pipeline.scene.command.parser import OneSentenceParser
from pipeline.scene.command.scene_file import KINDS, take_scene_file

if TYPE_CHECKING:
    from pipeline.campaigns.until import Wanted
    from pipeline.record.progress import Progress
    from pipeline.record.run_folder import RunFolder
    from pipeline.record.summary import SummaryRow
    from pipeline.scene.scene import Scene


def add_run_options(parser: OneSentenceParser) -> None:
    """Every option of `perilife run`, and the scene file that may give them."""
    _add_options(parser)
    take_scene_file(parser, every_option, localised=True)


def every_option() -> argparse.ArgumentParser:
    """A parser with every option that a scene file may name."""
    parser = argparse.ArgumentParser(add_help=False)
    _add_options(parser)
    return parser


def add_init_options(parser: argparse.ArgumentParser) -> None:
    """The options that `perilife init` writes into a scene file, none of them required."""
    _add_options(parser)
    for action in options_of(parser).values():
        action.required = False
    own = {name: action.default for name, action in options_of(parser).items()}
    parser.set_defaults(defaults=own)
    parser.add_argument(
        "--kind",
        default=KINDS[0],
        metavar="KIND",
        help=f"{', '.join(KINDS)}, or a name of `perilife scenes` ({KINDS[0]})",
    )


def _add_options(parser: argparse.ArgumentParser) -> None:
    add_scene_options(parser)
    add_folder_options(parser, resume=True)
    add_machine_options(parser, march=True)
    add_sample_options(parser)
    add_until_options(parser)
    parser.add_argument("--log", metavar="FILE", help="add what happens to it, as JSON lines")


def scene_of(options: argparse.Namespace) -> Scene:
    """The scene as the options say it, a spacing of `auto` not yet chosen."""
    from pipeline.scene.command.options import scene_from_options

    return scene_from_options(options)


def fitting_scene(options: argparse.Namespace) -> tuple[Scene, object]:
    """The scene of the options, and its solid where that had to be built to choose the spacing."""
    scene = scene_of(options)
    if options.spacing != "auto":
        return scene, None
    from pipeline.planning.sizes import with_fitting_spacing

    return with_fitting_spacing(scene)


def resolved(options: argparse.Namespace) -> tuple[Scene, object]:
    """The scene of a run and, where it had to be built, its solid.

    Raises ValueError or OSError with one sentence for what cannot be computed or is more than
    this machine has cores for.
    """
    from pipeline.record.machine import check_counts

    check_counts(options.np, options.pulls, options.oversubscribe)
    check_counts(options.ranks, None, options.oversubscribe, "--ranks")
    if options.samples is None:
        for name in ("strength_tolerance", "surrogate"):
            if getattr(options, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise ValueError(f"{option} goes with --samples, which must be given too")
    scene, solid = fitting_scene(options)
    _wanted(options, scene)
    return scene, solid


def _wanted(options: argparse.Namespace, scene: Scene) -> Wanted | None:
    """The strength below which the part is too weak, None where nobody asks."""
    if options.until_left is None and options.until_force is None:
        return None
    from pipeline.campaigns.until import wanted_of

    return wanted_of(options, scene)


def carry_out(
    options: argparse.Namespace, scene: Scene, solid: object, progress: Progress
) -> tuple[RunFolder, list[SummaryRow]]:
    """Run the scene in the folder that the options name; the folder and the rows of summary.csv."""
    from pipeline.record.run_folder import RunFolder

    folder = RunFolder(options.out)
    shared = {
        "resume": options.resume,
        "ranks": options.np,
        "workers": options.pulls,
        "progress": progress,
        "march_ranks": options.ranks,
    }
    wanted = _wanted(options, scene)
    if wanted is not None:
        from pipeline.campaigns.until import run_until

        return folder, run_until(scene, folder.path, wanted, solid=solid, **shared)
    if options.samples is None:
        from pipeline.life_cycle import run_life_cycle

        return folder, run_life_cycle(scene, folder, solid=solid, **shared)
    from pipeline.campaigns.bands import run_with_bands

    if options.strength_tolerance is not None:
        shared["tolerance"] = options.strength_tolerance
    shared["surrogate"] = options.surrogate
    return folder, run_with_bands(scene, folder.path, options.samples, **shared)


def how_sure(folder: RunFolder) -> list[str]:
    """How each solid of a run was held and how sure its numbers are, in lines for a reader."""
    from pipeline.record.run_results import read_run
    from pipeline.report.sure import in_words

    return in_words(read_run(folder.path, fields=False))


def files(folder: RunFolder) -> list[str]:
    """Where table and report of a run are, in lines for a reader, an empty one in front."""
    lines = ["", f"table:  {folder.summary_file}"]
    if folder.report_file.exists():
        sure = "how sure the numbers are, and what was assumed"
        lines.append(f"report: {folder.report_file} ({sure})")
    return lines


def told(folder: RunFolder, scene: Scene, rows: Sequence[SummaryRow]) -> dict[str, object]:
    """What a run found, for a program: rows of summary.csv, bands, when it is too weak, files.

    Beside these how each solid was held, how sure that is, what the run checked of itself, and
    every assumed or fitted value, as the report has them.
    """
    from dataclasses import asdict

    from pipeline.record.bands import BANDS_FILE, read_bands
    from pipeline.record.run_results import read_run
    from pipeline.record.summary import columns
    from pipeline.record.until import UNTIL_FILE, read_until
    from pipeline.report.doubts import checks
    from pipeline.report.sure import held, how_sure

    results = read_run(folder.path, fields=False)
    report = folder.report_file
    return {
        "folder": str(folder.path.absolute()),
        "report": str(report.absolute()) if report.exists() else None,
        "scene_hash": scene.hash(),
        "rows": [
            {name: getattr(row, field) for field, name in columns(row.load).items()} for row in rows
        ],
        "bands": [asdict(row) for row in read_bands(folder.path / BANDS_FILE)],
        "until": [asdict(row) for row in read_until(folder.path / UNTIL_FILE)],
        "held": held(scene),
        "how_sure": [asdict(row) for row in how_sure(results)],
        "doubts": checks(results),
        "assumed": assumed(scene),
    }


def assumed(scene: Scene) -> list[dict[str, object]]:
    """Every value of a scene that is assumed, fitted or known to be wrong, for a program."""
    from dataclasses import asdict

    from pipeline.report.provenance import parameter_rows, to_be_listed

    return [asdict(row) for row in to_be_listed(parameter_rows(scene))]
