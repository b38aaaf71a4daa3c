"""The strength curve of a scene: mechanical tests at chosen volume losses in clean liquid.

Each test is a small run folder of its own below `strength-curve/`, so that it is done once.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from peri.omissions.planning import Omission
from pipeline.calibration.models import Implant, ReducedModel, liquid_omission
from pipeline.calibration.strength_curve import StrengthCurve, strength_curve
from pipeline.life_cycle import LifeCycle
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene, SceneError
from pipeline.scene.units import ImmersionTime

CURVE_FOLDER = "strength-curve"
DEFAULT_TOLERANCE = 0.01
"""Error of the curve, of the intact strength."""


def clean_until(scene: Scene, alloy: str, implant: Implant, end: float) -> Omission:
    """The bound of leaving the liquid out until `end`; SceneError where the liquid counts."""
    omission = liquid_omission(scene, alloy, implant, end)
    if not omission.applied:
        raise SceneError(
            f"strength curve of {alloy}: the liquid cannot be left out ({omission.reason}), so the "
            "strength is no function of the volume loss alone, which must be so"
        )
    return omission


class CurveTests:
    """Mechanical tests of one alloy of a scene at given volume losses.

    scene: the alloy, mesh and test are those of the scene; folder: of the tests; geometry: a
    finished geometry folder of the same scene to take over, where there is one.
    """

    def __init__(
        self,
        scene: Scene,
        alloy: str,
        implant: Implant,
        folder: Path,
        geometry: Path | None = None,
        ranks: int = 1,
        progress: Progress | None = None,
    ):
        # A constant rate reaches any volume loss soon, and the damage is the same.
        self.alloy = alloy
        self.scene = replace(
            scene,
            alloys=(scene.alloy(alloy),),
            corrosion=replace(scene.corrosion, kinetics="constant"),
        )
        self.implant, self.folder, self.geometry = implant, folder, geometry
        self.ranks, self.progress = ranks, progress
        self._model = ReducedModel(self.scene, alloy, implant, ("interface_diffusivity",))
        self.tests = 0

    def time_of(self, loss: float) -> float:
        """When the constant rate has dissolved this share of the metal, s."""
        rate = np.log([self.scene.alloy(self.alloy).corrosion.interface_diffusivity])
        reduced = self._model.reduced
        if not loss < reduced.largest_loss():
            raise SceneError(
                f"volume loss is {100 * loss:.4g} %; what the liquid sees of this solid on the "
                f"lattice is {100 * reduced.largest_loss():.4g} %, and it must be below"
            )

        def excess(log_time: float) -> float:
            return float(self._model(np.array([np.exp(log_time)]), rate)[0][0]) - loss

        return float(np.exp(brentq(excess, 0.0, np.log(1e12), xtol=1e-12)))

    def peaks(self, losses: list[float]) -> list[float]:
        """Largest force (N), torque or moment (N m) at each volume loss."""
        return [self._peak(loss) for loss in losses]

    def _peak(self, loss: float) -> float:
        seconds = self.time_of(loss) if loss > 0 else 0.0
        if seconds > 0:
            clean_until(self.scene, self.alloy, self.implant, seconds)
        moment = ImmersionTime(f"V{100 * loss:.4f}", seconds)
        scene = replace(self.scene, immersion=(moment,))
        folder = RunFolder(self.folder / moment.label)
        if self.geometry is not None and not folder.geometry.exists():
            _take_over(self.geometry, folder.geometry)
        cycle = LifeCycle(scene, folder, ranks=self.ranks, workers=1, progress=self.progress)
        cycle.geometry()
        cycle.corrode(self.alloy)
        test = (self.alloy, moment, scene.holds[0])
        cycle.map(*test)
        record = cycle.pull([test])[0]
        self.tests += 1
        return float(record.numbers[f"peak_{LOADS[scene.tensile.load].reaction}"])


def _take_over(source: Path, target: Path) -> None:
    """The geometry stage of another folder, by hard links where the file system has them."""
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.parent.mkdir(parents=True, exist_ok=True)
    try:
        shutil.copytree(source, temporary, copy_function=_link)
        os.rename(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _link(source: str, target: str) -> str:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
    return target


def curve_to(
    tests: CurveTests,
    largest_loss: float,
    tolerance: float = DEFAULT_TOLERANCE,
    said: Callable[[str], None] = lambda line: None,
) -> StrengthCurve:
    """The curve of peaks from the intact solid to a volume loss."""
    curve = strength_curve(tests.peaks, largest_loss, tolerance)
    said(
        f"strength curve of {tests.alloy}: {len(curve.losses)} tests to "
        f"{100 * curve.losses[-1]:.3g} % of the volume, error {100 * curve.error():.2g} %"
    )
    return curve
