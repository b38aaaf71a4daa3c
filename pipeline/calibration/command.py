"""The command `perilife calibrate`: its options, what it prints and what it writes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from pipeline.scene.ions import MODELS

JSON_FILE = "calibration.json"


def add_calibrate_options(parser: argparse.ArgumentParser) -> None:
    """Options of `perilife calibrate` beside those of the scene."""
    group = parser.add_argument_group("calibration")
    group.add_argument(
        "--free", nargs="+", metavar="NAME", help="search only these constants (all that act)"
    )
    group.add_argument(
        "--fix", action="append", default=[], metavar="NAME=VALUE", help="hold a constant (SI)"
    )
    group.add_argument(
        "--profile", nargs="+", default=[], metavar="NAME", help="profile likelihood of these, too"
    )
    group.add_argument(
        "--wanted", default="12w", metavar="T", help="time for `what to measure next` (12w)"
    )


def run_calibrate(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    import numpy as np

    from pipeline.calibration.calibrate import calibrate, free_and_held, measurements_of
    from pipeline.calibration.models import SEARCHED, Implant
    from pipeline.calibration.writing import lines_of, next_lines, profile_lines, write_calibration
    from pipeline.scene.options import scene_from_options
    from pipeline.scene.units import parse_time

    if len(options.alloy) != 1:
        raise ValueError(f"--alloy is {' '.join(options.alloy)}; a fit is of one alloy")
    if options.model != MODELS[0]:
        raise ValueError(
            f"--model is '{options.model}'; it must be {MODELS[0]} in a fit, since the ions do not "
            "act back on the volume loss"
        )
    fix = _fixed(options.fix)
    wanted = parse_time(options.wanted, "wanted time").seconds
    files = dict(text.partition("=")[::2] for text in options.volume_loss)
    if not files:
        raise ValueError("no measurements were given; name them with --volume-loss ALLOY=FILE.csv")
    options.immersion = ["8w"]
    scene = scene_from_options(options)
    alloy = scene.alloys[0].name
    if set(files) - {alloy, options.alloy[0]}:
        raise ValueError(f"--volume-loss is of {', '.join(files)}; it must be of {alloy}")
    path = Path(next(iter(files.values())))
    measurements, digest = measurements_of(path)
    free_and_held(scene, alloy, options.free, fix)
    unknown = [name for name in options.profile if name not in SEARCHED]
    if unknown:
        raise ValueError(f"--profile is {unknown[0]}; it must be one of {', '.join(SEARCHED)}")
    out = Path(options.out)
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"folder '{out}' is not empty; choose another with --out")
    implant = Implant(scene)
    found = calibrate(scene, alloy, measurements, free=options.free, fix=fix, implant=implant)
    for line in lines_of(found):
        say(line)
    weeks = np.array([1, 2, 4, 8, 12, 16, 24]) * 7 * 86400.0
    for line in next_lines(found, weeks, wanted, options.wanted):
        say(line)
    for name in options.profile:
        for line in profile_lines(found, name):
            say(line)
    base = options.parameters or scene.parameter_set
    for written in write_calibration(out, base, found, implant, path, digest):
        say(str(written))


def _fixed(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = float("nan")
        if not equals or not 0 < found[name] < float("inf"):
            raise ValueError(f"--fix is '{text}'; write NAME=VALUE with a value above 0, SI")
    return found
