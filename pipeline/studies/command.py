"""The command `perilife study`: which studies there are, its options and what it does."""

import argparse
import importlib
from pathlib import Path

from perilife_data import did_you_mean

STUDIES = {
    "corrosion": "error of the volume loss against processor time, and the presets (15 min)",
    "rates": "what lattice and orientation do to the dissolution rate (seconds)",
    "saturation": "what the time step does to the two saturation models (5 min)",
    "boundaries": "what no-flux walls and held layers do to diffusion near them (seconds)",
    "tensile": "error of peak force and strength left against processor time, presets (30 min)",
    "nnpp": "ions: error against processor time; --published: the published features (3 min)",
    "published": "the published tensile outcome beside what pulled end faces give",
    "galvanic": "AE44 beside steel, AA6063: renewal, horizon, slopes, ions, mirrors; titanium",
    "crevice": "which seeds ignite, right and as on the printed lattice (4 min)",
    "pitting": "onset of a salt layer, and a lacy cover, by spacing and step (4 min)",
    "calibration": "searches of a fit by evaluations, and surrogates by points (2 min)",
    "life-cycle": "where the error of the strength left comes from, what less costs (4 min)",
}


def add_study_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife study`."""
    parser.add_argument(
        "what", metavar="WHAT", help=f"{', '.join(STUDIES)} (what each finds: study list)"
    )
    parser.add_argument(
        "--alloy",
        nargs="+",
        metavar="A",
        help="corrosion: both Mg-Gd alloys; tensile and life-cycle: Mg-5Gd",
    )
    parser.add_argument(
        "--immersion", nargs="+", metavar="T", help="tensile: 8w 24w; life-cycle: 8w"
    )
    parser.add_argument("--long", action="store_true", help="tensile: finer; published: 47 um mesh")
    parser.add_argument("--published", action="store_true", help="nnpp: the published features")
    parser.add_argument("--out", metavar="DIR", help="folder for the results")


def run_study(options: argparse.Namespace) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    if options.what == "list":
        for name, text in STUDIES.items():
            print(f"{name:12s} {text}")
        return
    if options.what not in STUDIES:
        near, known = did_you_mean(options.what, STUDIES), ", ".join(STUDIES)
        raise ValueError(f"study '{options.what}' is not known{near}; it must be one of {known}")
    if options.what == "published":
        from pipeline.studies.published import print_published

        print_published(options.long, Path(options.out) if options.out else None)
        return
    if options.what == "nnpp":
        from pipeline.studies import ions, ions_published

        show = ions_published.print_published_ions if options.published else ions.print_ions
        show(Path(options.out) if options.out else None)
        return
    if options.what in ("galvanic", "crevice", "pitting"):
        localised = importlib.import_module("pipeline.studies.localised")
        getattr(localised, f"print_{options.what}")()
        return
    if options.what in ("rates", "boundaries", "saturation"):  # print, and need nothing
        study = importlib.import_module(f"pipeline.studies.{options.what}")
        getattr(study, f"print_{options.what}")()
        return
    if options.what == "calibration":
        from pipeline.studies.calibration import study_calibration

        study_calibration(Path(options.out) if options.out else None)
        return
    if options.what == "life-cycle":
        from pipeline.studies.life_cycle import print_study

        out = Path(options.out) if options.out else None
        print_study((options.alloy or ["Mg-5Gd"])[0], (options.immersion or ["8w"])[0], out)
        return
    if options.what == "tensile":
        _study_tensile(options)
        return
    options.alloy = options.alloy or ["Mg-5Gd", "Mg-10Gd"]
    if options.out is None:
        raise ValueError("study corrosion writes a table and a plot; say where with --out DIR")
    from pipeline.scene.resolve import resolve_scene

    for alloy in options.alloy:
        resolve_scene([alloy], ["0w"], "quick")
    from pipeline.studies import corrosion as study_corrosion
    from pipeline.studies import corrosion_results as study_results

    keep = Path(options.out) / "marches"
    keep.mkdir(parents=True, exist_ok=True)
    study = study_corrosion.study_corrosion(
        options.alloy, lambda line: print(line, flush=True), keep=keep
    )
    command = f"perilife study corrosion --alloy {' '.join(options.alloy)} --out {options.out}"
    paths = study_results.write_study(study, Path(options.out), command)
    print("\n" + "\n".join(study_results.tables(study.rows)) + "\n")
    for line in study_results.summary_lines(study):
        print(line)
    print("\n" + "\n".join(map(str, paths)))


def _study_tensile(options: argparse.Namespace) -> None:
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
        rows=folder / "tensile.csv",
        keep=folder / "pulls",
    )
    given = f" --immersion {' '.join(options.immersion)}" if options.immersion else ""
    given += " --long" if options.long else ""
    command = f"perilife study tensile --alloy {' '.join(alloys)}{given} --out {options.out}"
    paths = study_tensile_results.write_study(study, folder, command)
    print("\n" + "\n".join(study_tensile_results.tables(study)))
    print("\n" + "\n".join(map(str, paths)))
