"""The command `perilife`: parses, calls the stages, prints results and one-sentence errors.

Exit codes: 0 done, 1 a computation failed, 2 the input cannot be used (one sentence on stderr,
nothing half-written), 130 interrupted (the run folder can be resumed), 141 nobody reads the output.
"""

import argparse
import errno
import json
import logging
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from pipeline.calibration.command import add_calibrate_options
from pipeline.campaigns.options import add_campaign_options, add_design_options
from pipeline.compare.command import add_compare_options
from pipeline.completion import add_completion_options, print_completion
from pipeline.export.command import add_export_options
from pipeline.measured.command import add_compare_image_options
from pipeline.record import interruption
from pipeline.record.machine import prepare_libraries
from pipeline.record.options import add_folder_options, add_machine_options
from pipeline.record.summary import print_summary
from pipeline.run import add_init_options, add_run_options, assumed, every_option, fitting_scene
from pipeline.scene.command.alloy_command import add_alloy_options
from pipeline.scene.command.options import add_scene_options
from pipeline.scene.command.parser import OneSentenceParser, take_folder
from pipeline.scene.command.scene_file import KINDS, localised_kind, take_scene_file
from pipeline.scenes.command import add_scenes_options
from pipeline.studies.command import add_study_options

INTERRUPTED = 130
BROKEN_PIPE = 141

OF_THE_RUN = ("out", "quiet", "resume")
"""What a scene file says of its own run, not of a design or a fit."""


def build_parser() -> argparse.ArgumentParser:
    """The parser of `perilife` with all its subcommands."""
    parser = OneSentenceParser(
        prog="perilife",
        description="Residual strength of biodegradable magnesium implants after immersion.",
        epilog="to begin: perilife run --alloy Mg-5Gd --immersion 8w --out runs/first (a minute), "
        "then open runs/first/report.html; perilife COMMAND --help tells the rest",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="store_true", help="print the version and end")
    parser.add_argument("--verbose", action="store_true", help="log what the libraries do")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", parser_class=OneSentenceParser
    )

    def add(name: str, action: Callable[[argparse.Namespace], int], text: str) -> OneSentenceParser:
        command = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        command.set_defaults(action=action)
        return command

    run = add("run", _run, "the whole life cycle: geometry, corrosion, damage, tensile test")
    add_run_options(run)
    _add_json_option(run)
    add_init_options(add("init", _init, "print a scene file with every option, for `perilife run`"))
    geometry = add("geometry", _geometry, "begin a run folder: solid and mesh of a scene")
    add_scene_options(geometry)
    add_folder_options(geometry, resume=True)
    take_scene_file(geometry, every_option)
    for name, action, text in (
        ("corrode", _corrode, "corrosion of the alloys of a run folder"),
        ("map", _map, "damage on the mesh for the immersion times of a run folder"),
        ("pull", _pull, "tensile tests of a run folder"),
    ):
        stage = add(name, action, text)
        add_folder_options(stage)
        stage.add_argument("--alloy", nargs="+", metavar="A", help="only these of the run")
        if name != "corrode":
            stage.add_argument("--hold", nargs="+", metavar="H", help="only these of the run")
            times = "only these of the run, 0w (the intact solid) among them"
            stage.add_argument("--immersion", nargs="+", metavar="T", help=times)
        if name == "pull":
            add_machine_options(stage)
        take_folder(stage)
    report = add("report", _report, "summary.csv and report.html of a run folder")
    add_folder_options(report)
    take_folder(report)
    export = add("export", _export, "a corroded solid of a run folder for another program")
    add_export_options(export)
    measured = add("compare-image", _compare_image, "the loss in a later scan beside the computed")
    add_compare_image_options(measured)
    compare = add("compare", _compare, "several run folders over each other in one page")
    add_compare_options(compare)
    plan = add("plan", _plan, "what a run would compute, what not and why, time and memory")
    add_scene_options(plan)
    add_machine_options(plan, march=True)
    _add_json_option(plan)
    take_scene_file(plan, every_option, localised=True)
    calibrate = add("calibrate", _calibrate, "constants from measured volume loss, with doubts")
    add_scene_options(calibrate, immersion=False)
    add_calibrate_options(calibrate)
    add_folder_options(calibrate)
    take_scene_file(calibrate, every_option, without=OF_THE_RUN, stored=False)
    design = add("design", _design, "which value of an option keeps a strength for a time")
    add_scene_options(design, immersion=False)
    add_design_options(design)
    add_folder_options(design)
    take_scene_file(design, every_option, without=OF_THE_RUN, stored=False)
    campaign = add("campaign", _campaign, "many scenes from one file, each stage computed once")
    add_campaign_options(campaign)
    add_folder_options(campaign)
    scenes = add("scenes", _scenes, "pits, crevices and galvanic couples: list them, or run one")
    add_scenes_options(scenes)
    add_alloy_options(add("alloy", _alloy, "alloy new NAME: a file for an alloy of one's own"))
    _add_json_option(add("alloys", _alloys, "the alloys and parameter sets that are known"))
    bench = add("bench", _bench, "benchmarks of this machine")
    bench.add_argument("name", metavar="NAME", help="name of a benchmark, or list")
    _add_json_option(bench)
    bench.add_argument("--small", action="store_true", help="a small version, to see it work")
    study = add("study", _study, "error against run time, and the tables behind the presets")
    add_study_options(study)
    completion = add("completion", _completion, "a script that completes commands in a shell")
    add_completion_options(completion)
    return parser


def _add_json_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def main(arguments: list[str] | None = None) -> int:
    """Run `perilife` with the given arguments and return its exit code."""
    interruption.listen()
    prepare_libraries()
    options = argparse.Namespace(out=None)
    try:
        options = build_parser().parse_args(arguments)
        if options.verbose:
            logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
        if options.version:
            from pipeline.record.machine import version

            print(f"perilife {version()}")
            return 0
        if options.command is None:
            raise ValueError("no command was given; see `perilife --help`")
        return options.action(options)
    except KeyboardInterrupt:
        return _interrupted(options)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads what is left
        return BROKEN_PIPE
    except (ValueError, OSError, MemoryError) as error:
        if getattr(options, "verbose", False):
            logging.getLogger(__name__).exception("the refusal below came from here")
        print(f"perilife: {sentence(error)}", file=sys.stderr)
        return 2
    except RuntimeError as error:
        print(f"perilife: {sentence(error)}", file=sys.stderr)
        return 1


def sentence(error: BaseException) -> str:
    """Say an error in one sentence on one line."""
    text = str(error)
    if isinstance(error, OSError) and error.errno is not None:
        where = f"'{error.filename}'" if error.filename else "a file"
        reasons = {
            errno.ENOSPC: f"there is no space left to write {where}",
            errno.EACCES: f"there is no right to write or read {where}",
            errno.EPERM: f"there is no right to write or read {where}",
            errno.EROFS: f"{where} is on a file system that cannot be written",
        }
        text = reasons.get(error.errno, f"{where} cannot be used: {os.strerror(error.errno)}")
    text = " ".join(text.split()) or type(error).__name__
    return text if text.endswith(".") else f"{text}."


def _interrupted(options: argparse.Namespace) -> int:
    message = "perilife: interrupted."
    if getattr(options, "out", None) and Path(options.out, "scene.json").exists():
        message = (
            f"perilife: interrupted; what is complete in '{options.out}' is kept, and the same "
            "command with --resume goes on from there."
        )
    print(f"\n{message}", file=sys.stderr)
    return INTERRUPTED


def _run(options: argparse.Namespace) -> int:
    if localised_kind(options.scene) is not None:
        from pipeline.scenes.command import run_file

        run_file(options, print)
        return 0
    from pipeline.record.progress import progress_for
    from pipeline.run import carry_out, files, how_sure, resolved, told

    scene, solid = resolved(options)
    with progress_for(sys.stderr, options.quiet, options.log) as progress:
        folder, rows = carry_out(options, scene, solid, progress)
    if options.json:
        print(json.dumps(told(folder, scene, rows), indent=2))
        return 0
    print_summary(rows)
    print(*how_sure(folder), sep="\n")
    if options.samples is not None:
        from pipeline.record.bands import BANDS_FILE, print_bands, read_bands

        print_bands(read_bands(folder.path / BANDS_FILE))
    if options.until_left is not None or options.until_force is not None:
        from pipeline.record.until import UNTIL_FILE, read_until

        print("\nWhen is it too weak?")
        for row in read_until(folder.path / UNTIL_FILE):
            print(f"  {row.in_words()}")
    print(*files(folder), sep="\n")
    return 0


def _init(options: argparse.Namespace) -> int:
    if options.kind != KINDS[0]:
        from pipeline.scenes.command import init_file

        init_file(options, lambda text: print(text, end=""))
        return 0
    import perilife_data
    from pipeline.scene.command.arguments import check_units, options_of
    from pipeline.scene.command.template import write_template

    parser = every_option()
    for name in options.alloy or ():
        perilife_data.load_alloy(name)  # refuses what no run could use
    check_units(options_of(parser), options)
    print(write_template(parser, options), end="")
    return 0


def _geometry(options: argparse.Namespace) -> int:
    from pipeline.life_cycle import StagedRun
    from pipeline.planning.opening import open_run
    from pipeline.record.progress import progress_for

    scene, solid = fitting_scene(options)
    stages = ("geometry", "corrode", "map")
    with (
        open_run(scene, options.out, options.resume, solid=solid, stages=stages) as (folder, solid),
        progress_for(sys.stderr, options.quiet) as progress,
    ):
        record = StagedRun(scene, folder, progress=progress, solid=solid).geometry()
    for name, value in record.numbers.items():
        print(f"{name}: {value}")
    return 0


def _corrode(options: argparse.Namespace) -> int:
    return _stages(
        options, lambda cycle, alloys, tests: [cycle.corrode(a) for a in alloys], "corrode"
    )


def _map(options: argparse.Namespace) -> int:
    return _stages(options, lambda cycle, alloys, tests: [cycle.map(*t) for t in tests], "map")


def _pull(options: argparse.Namespace) -> int:
    from pipeline.record.machine import check_counts

    check_counts(options.np, options.pulls, options.oversubscribe)
    return _stages(options, lambda cycle, alloys, tests: cycle.pull(tests), "pull")


def _report(options: argparse.Namespace) -> int:
    from pipeline.run import files, how_sure

    def action(cycle, alloys, tests):
        print_summary(cycle.summarise())
        cycle.report(again=True)
        print(*how_sure(cycle.folder), *files(cycle.folder), sep="\n")

    return _stages(options, action)


def _stages(options: argparse.Namespace, action: Callable, stage: str = "") -> int:
    """Open the run folder of a stage command, lock it and let `action` work on it.

    stage: the one for which the machine is checked first.
    """
    from pipeline.life_cycle import StagedRun
    from pipeline.planning.opening import check_stage, read_run
    from pipeline.record.progress import progress_for

    folder, scene = read_run(options.out)
    names = getattr(options, "alloy", None) or [alloy.name for alloy in scene.alloys]
    alloys = [scene.alloy(name).name for name in names]
    labels = getattr(options, "immersion", None)
    times = scene.with_intact() if labels is None else [scene.time(label) for label in labels]
    ways = getattr(options, "hold", None)
    holds = scene.holds if ways is None else [scene.hold(name) for name in ways]
    tests = [(alloy, time, hold) for hold in holds for alloy in alloys for time in times]
    ranks, workers = getattr(options, "np", 1), getattr(options, "pulls", None)
    with folder.lock(), progress_for(sys.stderr, options.quiet) as progress:
        if stage:
            check_stage(folder, scene, stage, ranks, workers)
        cycle = StagedRun(scene, folder, ranks=ranks, workers=workers, progress=progress)
        action(cycle, alloys, tests)
    return 0


def _compare_image(options: argparse.Namespace) -> int:
    from pipeline.measured.command import compare_image

    compare_image(options, print)
    return 0


def _export(options: argparse.Namespace) -> int:
    from pipeline.export.command import run_export

    run_export(options, print)
    return 0


def _compare(options: argparse.Namespace) -> int:
    from pipeline.compare.command import run_compare

    run_compare(options, print)
    return 0


def _plan(options: argparse.Namespace) -> int:
    if localised_kind(options.scene) is not None:
        from pipeline.scenes.command import plan_file

        plan_file(options, print)
        return 0
    from pipeline.planning.plan import make_plan, print_plan
    from pipeline.planning.readiness import examine_machine, print_checks
    from pipeline.planning.sizes import check_screw
    from pipeline.record.machine import check_counts
    from pipeline.stages.geometry import build_solid

    check_counts(options.np, options.pulls, options.oversubscribe)
    check_counts(options.ranks, None, options.oversubscribe, "--ranks")
    scene, solid = fitting_scene(options)
    check_screw(scene)
    solid = solid or build_solid(scene)
    plan = make_plan(
        scene, solid, options.pulls, with_march=True, ranks=options.np, march_ranks=options.ranks
    )
    checks = examine_machine(scene, solid, plan, Path.cwd(), options.np)
    if options.json:
        told = {"machine": [asdict(c) for c in checks], "assumed": assumed(scene)}
        print(json.dumps({**plan.to_json(), **told}, indent=2))
    else:
        print_plan(plan)
        print_checks(checks)
    return 0


def _calibrate(options: argparse.Namespace) -> int:
    from pipeline.calibration.command import run_calibrate

    run_calibrate(options, print)
    return 0


def _design(options: argparse.Namespace) -> int:
    from pipeline.campaigns.design import run_design
    from pipeline.record.progress import progress_for

    with progress_for(sys.stderr, options.quiet) as progress:
        run_design(options, progress, print)
    return 0


def _campaign(options: argparse.Namespace) -> int:
    from pipeline.campaigns.campaign import run_from_options

    say = (lambda line: None) if options.quiet else (lambda line: print(line, flush=True))
    return run_from_options(options, say)


def _scenes(options: argparse.Namespace) -> int:
    from pipeline.scenes.command import run_scenes

    run_scenes(options, print)
    return 0


def _alloy(options: argparse.Namespace) -> int:
    from pipeline.scene.command.alloy_command import run_alloy

    run_alloy(options, print)
    return 0


def _alloys(options: argparse.Namespace) -> int:
    from pipeline.known import known, print_known

    print(json.dumps(known(), indent=2)) if options.json else print_known()
    return 0


def _bench(options: argparse.Namespace) -> int:
    from pipeline.benches.registry import BENCHMARKS, print_result, run_benchmark

    if options.name == "list":
        for name, benchmark in BENCHMARKS.items():
            print(f"{name:16s} {benchmark.description}")
        return 0
    result = run_benchmark(options.name, options.small)
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        print_result(result)
    return 0


def _completion(options: argparse.Namespace) -> int:
    print_completion(build_parser(), options.shell)
    return 0


def _study(options: argparse.Namespace) -> int:
    from pipeline.studies.command import run_study

    run_study(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
