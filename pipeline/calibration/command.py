"""The command `perilife calibrate`: its options, what it prints and what it writes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from pipeline.scene.laws.ions import MODELS

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
        "--media",
        nargs="+",
        metavar="MEDIUM=FILE",
        help="instead of --volume-loss: two media, as in-vitro=A.csv in-vivo=B.csv, compared",
    )
    group.add_argument(
        "--wanted", default="12w", metavar="T", help="time for `what to measure next` (12w)"
    )


def run_calibrate(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Do what the options ask; ValueError or OSError with one sentence where that cannot be."""
    import numpy as np

    from pipeline.calibration.calibrate import calibrate, free_and_held, measurements_of
    from pipeline.calibration.media import compare, write_comparison
    from pipeline.calibration.models import SEARCHED, Implant, marching_executor
    from pipeline.calibration.parameter_file import SET_FILE
    from pipeline.calibration.writing import (
        begun_from,
        lines_of,
        next_lines,
        profile_lines,
        write_calibration,
    )
    from pipeline.scene.command.options import scene_from_options
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
    files = _files(options)
    options.immersion = ["8w"]
    scene = scene_from_options(options)
    alloy = scene.alloys[0].name
    if options.media is None and set(files) - {alloy, options.alloy[0]}:
        raise ValueError(f"--volume-loss is of {', '.join(files)}; it must be of {alloy}")
    measured = {name: measurements_of(path) for name, path in files.items()}
    free_and_held(scene, alloy, options.free, fix)
    unknown = [name for name in options.profile if name not in SEARCHED]
    if unknown:
        raise ValueError(f"--profile is {unknown[0]}; it must be one of {', '.join(SEARCHED)}")
    out = Path(options.out)
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"folder '{out}' is not empty; choose another with --out")
    base = begun_from(scene, options.parameters)
    weeks = np.array([1, 2, 4, 8, 12, 16, 24]) * 7 * 86400.0
    fits = {}
    with ExitStack() as stack:
        place = Path(stack.enter_context(TemporaryDirectory(prefix="perilife-surface-")))
        implant = Implant(scene, folder=place)
        executor = _Late(lambda: stack.enter_context(marching_executor(surfaces=place)))
        for name, (data, _) in measured.items():
            found = calibrate(
                scene, alloy, data, free=options.free, fix=fix, implant=implant, executor=executor
            )
            fits[name] = found
            if options.media is not None:
                say(f"--- {name}")
            for line in lines_of(found):
                say(line)
            for line in next_lines(found, weeks, wanted, options.wanted):
                say(line)
            for constant in options.profile:
                for line in profile_lines(found, constant):
                    say(line)
        comparison = None if options.media is None else compare(fits, weeks)
    for line in () if comparison is None else comparison.lines():
        say(line)
    for name, found in fits.items():
        folder = out if comparison is None else out / name
        path, digest = Path(files[name]), measured[name][1]
        for written in write_calibration(folder, base, found, implant, path, digest):
            say(str(written))
        say(
            f"Then: perilife run --alloy {options.alloy[0]} --immersion 8w --parameters "
            f"{folder / SET_FILE} --out runs/{alloy}; of a couple or a galvanic scene it is the "
            "key parameters of [metals.NAME]"
        )
    for written in () if comparison is None else write_comparison(out, comparison):
        say(str(written))


class _Late(Executor):
    """An executor that is made when something is submitted: clean liquid needs none."""

    def __init__(self, make: Callable[[], Executor]):
        self._make, self._made = make, None

    def submit(self, *work, **more):
        """Hand on to the executor."""
        self._made = self._made or self._make()
        return self._made.submit(*work, **more)


def _files(options: argparse.Namespace) -> dict[str, str]:
    """File of measurements by alloy, or by medium."""
    if options.media is None:
        texts, wanted = options.volume_loss, "ALLOY=FILE.csv"
    elif options.volume_loss:
        raise ValueError("--media and --volume-loss exclude each other; give one of them")
    else:
        texts, wanted = options.media, "MEDIUM=FILE.csv"
    files = {}
    for text in texts:
        name, equals, path = text.partition("=")
        if not (equals and name and path) or "/" in name or name.startswith("."):
            raise ValueError(f"'{text}' is not understood; write {wanted}")
        files[name] = path
    if not files:
        raise ValueError("no measurements were given; name them with --volume-loss ALLOY=FILE.csv")
    if options.media is not None and len(files) != 2:
        raise ValueError(f"--media names {len(files)} media; they must be two")
    return files


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
