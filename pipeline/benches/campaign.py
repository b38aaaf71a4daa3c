"""Benchmarks of campaigns: forty samples of one geometry, and what an engine adds to a task."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from pipeline.benches.result import Result
from pipeline.calibration.calibrate import calibrate
from pipeline.calibration.fit import Measurements
from pipeline.calibration.models import Implant, ReducedModel, constants
from pipeline.calibration.writing import begun_from, write_calibration
from pipeline.campaigns.campaign import STORE_FOLDER, read_campaign, run_campaign
from pipeline.campaigns.engines import local
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.command.parser import OneSentenceParser
from pipeline.scene.scene import Scene

WEEKS = np.array([1, 2, 3, 4, 8]) * 604800.0
SCATTER = 0.01
NAMES = ("interface_diffusivity", "volume_loss_scale")
SAMPLES = 40
TASKS = 300
"""Empty tasks that are timed on an engine."""

SMALL = {
    "thread": "none", "spacing": "250um", "horizon": "250um", "radial-margin": "0.5mm",
    "axial-margin": "0.5mm", "mesh-size": "0.8mm", "final-strain": "0.02",
}  # fmt: skip


def campaign() -> list[Result]:
    """Forty samples of the constants of Mg-5Gd on the reference screw at 12 weeks."""
    return [*_samples(SAMPLES, {}), *dask_overhead()]


def small_campaign() -> list[Result]:
    """Two samples of a coarse pin."""
    return _samples(2, SMALL)


def _scene(options: dict[str, str]) -> Scene:
    parser = OneSentenceParser(prog="campaign")
    add_scene_options(parser)
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    return scene_from_options(
        parser.parse_args(["--alloy", "Mg-5Gd", "--immersion", "12w", *words])
    )


def _samples(count: int, options: dict[str, str]) -> list[Result]:
    """V_L and strength of so many samples: time, and how often each stage was done."""
    with tempfile.TemporaryDirectory(prefix="perilife-bench-") as place:
        folder = Path(place)
        scene = _scene(options)
        implant = Implant(scene)
        model = ReducedModel(scene, "Mg-5Gd", implant, NAMES)
        logs = np.log([constants(scene, "Mg-5Gd")[name] for name in NAMES])
        # half the published rate: samples of a coarse pin would leave clean liquid otherwise
        values = model(WEEKS, logs - np.log([2.0, 1.0]))[0]
        data = Measurements(WEEKS, values, np.full(len(WEEKS), SCATTER))
        found = calibrate(scene, "Mg-5Gd", data, implant=implant, starts=1)
        file = folder / "synthetic.csv"
        file.write_text("no file: synthetic\n")
        parameters = write_calibration(
            folder / "fit", begun_from(scene), found, implant, file, "0" * 64
        )[0]
        lines = [f'{name} = "{value}"' for name, value in options.items()]
        toml = folder / "campaign.toml"
        toml.write_text(
            f'alloys = ["Mg-5Gd"]\nimmersion = ["12w"]\nsamples = {count}\n[options]\n'
            f'parameters = "{parameters}"\n' + "\n".join(lines) + "\n"
        )
        begun = time.perf_counter()
        with local(None, None) as crew:
            path, failures = run_campaign(
                read_campaign(toml), folder / "out", crew.executor, threads=crew.threads
            )
        seconds = time.perf_counter() - begun
        rows = [line.split(",") for line in path.read_text().splitlines()]
        done = {
            stage: len(list((folder / "out" / STORE_FOLDER).rglob(f"{stage}.stage.json")))
            for stage in ("geometry", "corrode", "pull")
        }
    left = [float(row[rows[0].index("strength_ratio")]) for row in rows[1:] if row[-1] != "failed"]
    return [
        Result(f"campaign of {count} samples of one geometry", seconds / 60, "min", "<= 5"),
        Result("geometries made", float(done["geometry"]), "1", "1"),
        Result("marches", float(done["corrode"]), "1"),
        Result("mechanical tests", float(done["pull"]), "1"),
        Result("scenes that failed", float(len(failures)), "1", "0"),
        Result("strength left, least of the samples", min(left), "1"),
        Result("strength left, largest of the samples", max(left), "1"),
    ]


def dask_overhead() -> list[Result]:
    """Seconds per empty task of Dask on one machine; nothing where distributed is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        return []
    from pipeline.campaigns.engines import dask

    with dask(None, None) as crew:
        list(crew.executor.map(_nothing, range(20)))
        begun = time.perf_counter()
        list(crew.executor.map(_nothing, range(TASKS)))
        each = (time.perf_counter() - begun) / TASKS
    return [Result("Dask overhead per task", 1e3 * each, "ms", "<= 50")]


def _nothing(number: int) -> int:
    return number
