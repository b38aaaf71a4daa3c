"""Benchmarks of calibration: one curve, a fit from many starts, a posterior, a whole command."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pipeline.benches.result import Result
from pipeline.calibration.calibrate import calibrate, free_and_held
from pipeline.calibration.fit import Measurements, Model, fit
from pipeline.calibration.models import Implant, ReducedModel, constants, march
from pipeline.calibration.posterior import posterior
from pipeline.calibration.writing import begun_from, write_calibration
from pipeline.campaigns.bands import run_with_bands
from pipeline.record.bands import BANDS_FILE, LEVELS, read_bands
from pipeline.record.run_folder import RunFolder
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import DomainSettings, Scene, ScrewGeometry
from pipeline.scene.screw import ScrewParameters

WEEKS = np.array([1, 2, 3, 4, 8]) * 7 * 86400.0
SCATTER = 0.01
ACTING = ("interface_diffusivity", "volume_loss_scale")
REPEATS = 21


def calibration() -> list[Result]:
    """The screw at 100 um: every case of the table, marches and mechanical tests included."""
    scene = resolve_scene(["Mg-5Gd"], ["12w", "24w"])
    return [*_reduced(scene), *_whole(scene), *_marches()]


def small_calibration() -> list[Result]:
    """A coarse pin: the cases that need neither marches nor mechanical tests."""
    scene = resolve_scene(
        ["Mg-5Gd"],
        ["12w"],
        geometry=ScrewGeometry(ScrewParameters(thread="none")),
        spacing=250e-6,
        horizon=250e-6,
        domain=DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
    )
    return _reduced(scene)


def synthetic(model: Model, names: Sequence[str], scene: Scene, alloy: str) -> Measurements:
    """Volume losses of the scene's own constants with normal scatter; nothing was measured."""
    logs = np.log([constants(scene, alloy)[name] for name in names])
    values = model(WEEKS, logs)[0]
    values = values + SCATTER * np.random.default_rng(1).standard_normal(len(WEEKS))
    return Measurements(WEEKS, values, np.full(len(WEEKS), SCATTER))


def _reduced(scene: Scene) -> list[Result]:
    implant = Implant(scene)
    model = ReducedModel(scene, "Mg-5Gd", implant, ACTING)
    logs = np.log([constants(scene, "Mg-5Gd")[name] for name in ACTING])
    curve = _median(lambda: model(WEEKS, logs))
    data = synthetic(model, ACTING, scene, "Mg-5Gd")
    parameters, _ = free_and_held(scene, "Mg-5Gd", ACTING, {})
    begun = time.process_time()
    found = fit(model, data, parameters, starts=50)
    fitted = time.process_time() - begun
    begun = time.process_time()
    sampled = posterior(model, found)
    drawn = time.process_time() - begun
    return [
        Result("groups of equal bond sums", float(model.reduced.bond_sums.size), "1"),
        Result("one V_L curve with derivatives, processor time", 1e3 * curve, "ms", "<= 1"),
        Result("fit from 50 starts, processor time", fitted, "s", "<= 2"),
        Result("starts that end at the one optimum", float(found.reached), "of 50", "50"),
        Result("evaluations of the 50 starts", float(found.evaluations), "1"),
        Result("posterior of 2 parameters, 60 x 60, processor time", drawn, "s", "<= 5"),
        Result("effective samples", sampled.effective, "1", ">= 100"),
    ]


def _whole(scene: Scene) -> list[Result]:
    """From measurements to a parameter set, then bands of a run with that set."""
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        begun = time.perf_counter()
        implant = Implant(scene)
        model = ReducedModel(scene, "Mg-5Gd", implant, ACTING)
        found = calibrate(
            scene, "Mg-5Gd", synthetic(model, ACTING, scene, "Mg-5Gd"), implant=implant
        )
        data = Path(place, "synthetic.csv")
        data.write_text("no file: synthetic\n")
        set_file = write_calibration(
            Path(place, "fit"), begun_from(scene), found, implant, data, "0" * 64
        )[0]
        seconds = time.perf_counter() - begun
        begun = time.perf_counter()
        fitted = resolve_scene(["Mg-5Gd"], ["12w", "24w"], parameter_set=str(set_file))
        run_with_bands(fitted, Path(place, "run"), 200)
        banded = time.perf_counter() - begun
        rows = read_bands(Path(place, "run", BANDS_FILE))
        record = RunFolder(Path(place, "run")).read_record(Path(place, "run"), "bands")
        tests = record.numbers["Mg-5Gd"]["tests"]["shank"]
    bands = []
    for row in rows:
        weeks = f"after {row.immersion_days / 7:g} weeks"
        for name, values in (("V_L", row.volume_loss), ("strength", row.strength_ratio)):
            bands += [
                Result(f"{name} {weeks}, {level} %", value, "1")
                for level, value in zip(LEVELS, values, strict=True)
            ]
    return [
        Result("calibrate Mg-5Gd, five points, to the set", seconds, "s", "<= 20"),
        Result("run with bands at 12 and 24 weeks", banded / 60, "min", "<= 3"),
        Result("mechanical tests of the strength curve", float(tests), "1", "<= 5"),
        Result("error of the strength curve", rows[0].strength_curve_error, "1", "<= 0.01"),
        *bands,
    ]


def _marches() -> list[Result]:
    scene = resolve_scene(["Mg-10Gd"], ["8w"])
    losses = np.array(march(scene.to_json(), "Mg-10Gd", WEEKS.tolist()))
    data = Measurements(WEEKS, losses, np.full(len(WEEKS), SCATTER))
    begun = time.perf_counter()
    found = calibrate(scene, "Mg-10Gd", data)
    seconds = time.perf_counter() - begun
    return [
        Result("Mg-10Gd by marches on 100 um", seconds / 60, "min", "<= 10"),
        Result("constants that its data determine", float(len(found.result.names)), "1"),
        Result("marches of that fit", float(found.marches), "1"),
    ]


def _median(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return statistics.median(times)
