"""The command `perilife`: parses, calls the stages, prints results and one-sentence errors.

Exit codes: 0 done, 1 a computation failed, 2 the input cannot be used (one sentence on stderr,
nothing half-written), 130 interrupted (the run folder can be resumed).
"""

import argparse
import errno
import importlib
import json
import logging
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from perilife_data import did_you_mean
from pipeline.calibration.command import add_calibrate_options
from pipeline.campaigns.options import (
    add_campaign_options,
    add_design_options,
    add_sample_options,
)
from pipeline.export.command import add_export_options
from pipeline.record import interruption
from pipeline.record.machine import find_place_for_compiled_code
from pipeline.record.summary import print_summary
from pipeline.scene.options import add_scene_options
from pipeline.scene.parser import OneSentenceParser
from pipeline.scene.scene import Scene

INTERRUPTED = 130

STUDIES = {
    "corrosion": "error of the volume loss against processor time, and the presets (15 min)",
    "rates": "what lattice and orientation do to the dissolution rate (seconds)",
    "saturation": "what the time step does to the two saturation models (5 min)",
    "boundaries": "what no-flux walls and held layers do to diffusion near them (seconds)",
    "tensile": "error of peak force and strength left against processor time, presets (20 min)",
    "published": "the published tensile outcome beside what pulled end faces give",
    "calibration": "searches of a fit by evaluations, and surrogates by points (2 min)",
    "life-cycle": "where the error of the strength left comes from, and what less of it costs",
}


def build_parser() -> argparse.ArgumentParser:
    """The parser of `perilife` with all its subcommands."""
    parser = OneSentenceParser(
        prog="perilife",
        description="Residual strength of biodegradable magnesium implants after immersion.",
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
    add_scene_options(run)
    _add_folder_options(run, resume=True)
    _add_machine_options(run)
    add_sample_options(run)
    geometry = add("geometry", _geometry, "begin a run folder: solid and mesh of a scene")
    add_scene_options(geometry)
    _add_folder_options(geometry, resume=True)
    for name, action, text in (
        ("corrode", _corrode, "corrosion of the alloys of a run folder"),
        ("map", _map, "damage on the mesh for the immersion times of a run folder"),
        ("pull", _pull, "tensile tests of a run folder"),
    ):
        stage = add(name, action, text)
        _add_folder_options(stage)
        stage.add_argument("--alloy", nargs="+", metavar="A", help="only these of the run")
        if name != "corrode":
            stage.add_argument("--hold", nargs="+", metavar="H", help="only these of the run")
            stage.add_argument("--immersion", nargs="+", metavar="T", help="only these of the run")
        if name == "pull":
            _add_machine_options(stage)
    _add_folder_options(add("report", _report, "summary.csv and report.html of a run folder"))
    export = add("export", _export, "a corroded solid of a run folder for another program")
    add_export_options(export)
    plan = add("plan", _plan, "what a run would compute, what not and why, time and memory")
    add_scene_options(plan)
    _add_machine_options(plan)
    plan.add_argument("--json", action="store_true", help="as one JSON object")
    calibrate = add("calibrate", _calibrate, "constants from measured volume loss, with doubts")
    add_scene_options(calibrate, immersion=False)
    add_calibrate_options(calibrate)
    _add_folder_options(calibrate)
    design = add("design", _design, "which value of an option keeps a strength for a time")
    add_scene_options(design, immersion=False)
    add_design_options(design)
    _add_folder_options(design)
    campaign = add("campaign", _campaign, "many scenes from one file, each stage computed once")
    add_campaign_options(campaign)
    _add_folder_options(campaign)
    add("alloys", _alloys, "the alloys and parameter sets that are known")
    bench = add("bench", _bench, "benchmarks of this machine")
    bench.add_argument("name", metavar="NAME", help="name of a benchmark, or list")
    bench.add_argument("--json", action="store_true", help="as one JSON object")
    bench.add_argument("--small", action="store_true", help="a small version, to see it work")
    study = add("study", _study, "error against run time, and the tables behind the presets")
    study.add_argument(
        "what", metavar="WHAT", help=f"{', '.join(STUDIES)} (what each finds: study list)"
    )
    study.add_argument(
        "--alloy",
        nargs="+",
        metavar="A",
        help="corrosion: both Mg-Gd alloys; tensile and life-cycle: Mg-5Gd",
    )
    study.add_argument(
        "--immersion", nargs="+", metavar="T", help="tensile: 4w 8w 24w; life-cycle: 8w"
    )
    study.add_argument("--long", action="store_true", help="tensile: finer; published: 47 um mesh")
    study.add_argument("--out", metavar="DIR", help="folder for the results")
    return parser


def _add_folder_options(parser: argparse.ArgumentParser, resume: bool = False) -> None:
    parser.add_argument("--out", required=True, metavar="DIR", help="the run folder")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    if resume:
        parser.add_argument("--resume", action="store_true", help="go on with the same scene")


def _add_machine_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--np", type=int, default=1, metavar="NP", help="MPI ranks per pull (1)")
    parser.add_argument(
        "--pulls", type=int, metavar="N", help="pulls at a time (as many as cores allow)"
    )
    parser.add_argument(
        "--oversubscribe", action="store_true", help="allow more ranks and pulls than cores"
    )


def main(arguments: list[str] | None = None) -> int:
    """Run `perilife` with the given arguments and return its exit code."""
    interruption.listen()
    # Threads that wait must not spin: on a busy machine that costs hundreds of times the work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    find_place_for_compiled_code()
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
        where = f"'{error.filename}'" if error.filename else "the run folder"
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


def _scene(options: argparse.Namespace) -> tuple[Scene, object]:
    """The scene of the options, and its solid where that had to be built."""
    from pipeline.scene.options import scene_from_options

    scene = scene_from_options(options)
    if options.spacing != "auto":
        return scene, None
    from pipeline.stages.sizes import with_fitting_spacing

    return with_fitting_spacing(scene)


def _run(options: argparse.Namespace) -> int:
    from pipeline.life_cycle import run_life_cycle
    from pipeline.record.machine import check_counts
    from pipeline.record.progress import progress_for
    from pipeline.record.run_folder import RunFolder
    from pipeline.stages.march_on_ranks import check_ranks

    check_counts(options.np, options.pulls, options.oversubscribe)
    check_counts(options.ranks, None, options.oversubscribe, "--ranks")
    scene, solid = _scene(options)
    check_ranks(scene, options.ranks)
    folder = RunFolder(options.out)
    with progress_for(sys.stderr, options.quiet) as progress:
        shared = {
            "resume": options.resume,
            "ranks": options.np,
            "workers": options.pulls,
            "progress": progress,
            "march_ranks": options.ranks,
        }
        if options.samples is None:
            rows = run_life_cycle(scene, folder, solid=solid, **shared)
        else:
            from pipeline.campaigns.bands import run_with_bands

            shared["tolerance"] = options.strength_tolerance
            shared["surrogate"] = options.surrogate
            rows = run_with_bands(scene, folder.path, options.samples, **shared)
    print_summary(rows)
    if options.samples is not None:
        from pipeline.record.bands import BANDS_FILE, print_bands, read_bands

        print_bands(read_bands(folder.path / BANDS_FILE))
    print(f"\ntable:  {folder.summary_file}")
    if folder.report_file.exists():
        print(f"report: {folder.report_file}")
    return 0


def _geometry(options: argparse.Namespace) -> int:
    from pipeline.life_cycle import LifeCycle
    from pipeline.record.progress import progress_for
    from pipeline.stages.opening import open_run

    scene, solid = _scene(options)
    stages = ("geometry", "corrode", "map")
    with (
        open_run(scene, options.out, options.resume, solid=solid, stages=stages) as (folder, solid),
        progress_for(sys.stderr, options.quiet) as progress,
    ):
        record = LifeCycle(scene, folder, progress=progress, solid=solid).geometry()
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
    def action(cycle, alloys, tests):
        print_summary(cycle.summarise())
        cycle.report(again=True)

    return _stages(options, action)


def _stages(options: argparse.Namespace, action: Callable, stage: str = "") -> int:
    """Open the run folder of a stage command, lock it and let `action` work on it.

    stage: the one for which the machine is checked first.
    """
    from pipeline.life_cycle import LifeCycle
    from pipeline.record.progress import progress_for
    from pipeline.stages.opening import check_stage, read_run

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
        cycle = LifeCycle(scene, folder, ranks=ranks, workers=workers, progress=progress)
        action(cycle, alloys, tests)
    return 0


def _export(options: argparse.Namespace) -> int:
    from pipeline.export.command import run_export

    run_export(options, print)
    return 0


def _plan(options: argparse.Namespace) -> int:
    from pipeline.record.machine import check_counts
    from pipeline.stages.geometry import build_solid
    from pipeline.stages.plan import make_plan, print_plan
    from pipeline.stages.readiness import examine_machine, print_checks
    from pipeline.stages.sizes import check_screw

    check_counts(options.np, options.pulls, options.oversubscribe)
    scene, solid = _scene(options)
    check_screw(scene)
    solid = solid or build_solid(scene)
    plan = make_plan(scene, solid, options.pulls, with_march=True, ranks=options.np)
    checks = examine_machine(scene, solid, plan, Path.cwd(), options.np)
    if options.json:
        print(json.dumps({**plan.to_json(), "machine": [asdict(c) for c in checks]}, indent=2))
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


def _alloys(options: argparse.Namespace) -> int:
    import perilife_data

    for name in perilife_data.list_alloys():
        print(f"{name:12s} {perilife_data.load_alloy(name).title}")
    print()
    for name in perilife_data.list_parameter_sets():
        parameters = perilife_data.load_parameter_set(name)
        print(f"{name:24s} {parameters.title} ({', '.join(parameters.alloys)})")
    print("\nother records of hardening (--hardening)")
    for name in perilife_data.list_hardening():
        print(f"{name:26s} {perilife_data.load_hardening(name).title}")
    print("\nlosses that others printed (perilife_data.load_experiment)")
    for name in perilife_data.list_experiments():
        experiment = perilife_data.load_experiment(name)
        for label, loss in experiment.results.items():
            found = [str(q) for q in (loss.degradation_rate, loss.mass_loss) if q is not None]
            after = "" if loss.after is None else f" after {loss.after}"
            print(f"{name:16s} {label.replace('_', ' ')}: {found[0]}{after} ({experiment.title})")
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


def _study(options: argparse.Namespace) -> int:
    if options.what == "list":
        for name, text in STUDIES.items():
            print(f"{name:12s} {text}")
        return 0
    if options.what not in STUDIES:
        near, known = did_you_mean(options.what, STUDIES), ", ".join(STUDIES)
        raise ValueError(f"study '{options.what}' is not known{near}; it must be one of {known}")
    if options.what == "published":
        from pipeline.studies.published import print_published

        print_published(options.long, Path(options.out) if options.out else None)
        return 0
    if options.what in ("rates", "boundaries", "saturation"):  # print, and need nothing
        study = importlib.import_module(f"pipeline.studies.{options.what}")
        getattr(study, f"print_{options.what}")()
        return 0
    if options.what == "calibration":
        from pipeline.studies.calibration import study_calibration

        study_calibration(Path(options.out) if options.out else None)
        return 0
    if options.what == "life-cycle":
        from pipeline.studies.life_cycle import print_study

        print_study((options.alloy or ["Mg-5Gd"])[0], (options.immersion or ["8w"])[0])
        return 0
    if options.what == "tensile":
        return _study_tensile(options)
    options.alloy = options.alloy or ["Mg-5Gd", "Mg-10Gd"]
    if options.out is None:
        raise ValueError("study corrosion writes a table and a plot; say where with --out DIR")
    from pipeline.scene.resolve import resolve_scene

    for alloy in options.alloy:
        resolve_scene([alloy], ["0w"], "quick")
    from pipeline.studies import corrosion as study_corrosion
    from pipeline.studies import corrosion_results as study_results

    study = study_corrosion.study_corrosion(options.alloy, lambda line: print(line, flush=True))
    command = f"perilife study corrosion --alloy {' '.join(options.alloy)} --out {options.out}"
    paths = study_results.write_study(study, Path(options.out), command)
    print()
    for line in study_results.summary_lines(study):
        print(line)
    print("\n" + "\n".join(map(str, paths)))
    return 0


def _study_tensile(options: argparse.Namespace) -> int:
    from pipeline.scene.resolve import resolve_scene
    from pipeline.studies import tensile as study_tensile
    from pipeline.studies import tensile_results as study_tensile_results

    if options.out is None:
        raise ValueError("study tensile writes a table and a plot; say where with --out DIR")
    alloys = options.alloy or ["Mg-5Gd"]
    immersion = options.immersion or list(study_tensile.IMMERSION)
    for alloy in alloys:
        resolve_scene([alloy], [t for t in immersion if t != "0w"], "quick")
    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    study = study_tensile.study_tensile(
        alloys,
        immersion,
        lambda line: print(line, flush=True),
        options.long,
        keep=folder / "tensile.csv",
    )
    given = f" --immersion {' '.join(options.immersion)}" if options.immersion else ""
    given += " --long" if options.long else ""
    command = f"perilife study tensile --alloy {' '.join(alloys)}{given} --out {options.out}"
    paths = study_tensile_results.write_study(study, folder, command)
    print("\n" + "\n".join(study_tensile_results.tables(study)))
    print("\n" + "\n".join(map(str, paths)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
