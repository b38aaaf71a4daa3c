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
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from peri.omissions.planning import Omission
from pipeline.calibration.models import Implant, ReducedModel, liquid_omission
from pipeline.calibration.strength_curve import StrengthCurve, strength_curve
from pipeline.life_cycle import StagedRun
from pipeline.record.progress import Progress
from pipeline.record.run_folder import RunFolder
from pipeline.scene.loads import LOADS
from pipeline.scene.scene import Scene, SceneError
from pipeline.scene.units import ImmersionTime
from pipeline.stages.pulls import Crew

CURVE_FOLDER = "strength-curve"
DEFAULT_TOLERANCE = 0.01
"""Error of the curve, of the intact strength."""
_INTACT = 1e-12
"""Volume losses up to it are round-off, as those below a coating that lets nothing through."""


def clean_at(scene: Scene, alloy: str, implant: Implant, times: ArrayLike) -> Omission:
    """The bound of leaving the liquid out for `times`, s; SceneError where the liquid counts."""
    omission = liquid_omission(scene, alloy, implant, times)
    if not omission.applied:
        raise SceneError(
            f"strength curve of {alloy}: the liquid cannot be left out ({omission.reason}), so the "
            "strength is no function of the volume loss alone, which must be so without --surrogate"
        )
    return omission


class CurveTests:
    """Mechanical tests of one alloy of a scene at given volume losses, in each way of holding.

    scene: the alloy, meshes and tests are those of the scene; folder: of the tests; geometry: a
    finished geometry folder of the same scene to take over, where there is one; workers: tests at
    a time; crew: children for them; intact: what the intact solid bears by way of holding, where
    that is known.  What the ions do is left out: they do not act on the metal.
    """

    def __init__(
        self,
        scene: Scene,
        alloy: str,
        implant: Implant,
        folder: Path,
        geometry: Path | None = None,
        ranks: int = 1,
        workers: int = 1,
        progress: Progress | None = None,
        crew: Crew | None = None,
        intact: dict[str, float] | None = None,
    ):
        # A constant rate reaches any volume loss soon, and the damage is the same.
        self.alloy = alloy
        self.scene = replace(
            scene,
            alloys=(scene.alloy(alloy),),
            corrosion=replace(scene.corrosion, kinetics="constant", coating=None),
            ions=None,
        )
        self.implant, self.folder, self.geometry = implant, folder, geometry
        self.how = {"ranks": ranks, "workers": workers, "progress": progress, "crew": crew}
        self.intact = intact or {}
        self._model = ReducedModel(self.scene, alloy, implant, ("interface_diffusivity",))

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

    def peaks(self, hold: str, losses: list[float]) -> list[float]:
        """Largest force (N), torque or moment (N m) at rising volume losses, held in one way.

        Several losses are one march and are tested in every way of holding of the scene at once:
        all curves begin with the same ones.
        """
        if losses[0] == 0 and hold in self.intact:
            return [self.intact[hold], *(self.peaks(hold, losses[1:]) if losses[1:] else [])]
        moments = tuple(
            ImmersionTime(f"V{100 * loss:.4f}", self.time_of(loss) if loss > 0 else 0.0)
            for loss in losses
        )
        if moments[-1].seconds > 0:
            clean_at(self.scene, self.alloy, self.implant, [m.seconds for m in moments])
        scene = self.scene.at(*moments)
        ends = dict.fromkeys((moments[0].label, moments[-1].label))
        folder = RunFolder(self.folder / "-".join(ends))
        if self.geometry is not None and not folder.geometry.exists():
            take_over(self.geometry, folder.geometry)
        cycle = StagedRun(scene, folder, **self.how)
        cycle.geometry()
        cycle.corrode(self.alloy)
        asked = scene.hold(hold)
        holds = scene.holds if len(moments) > 1 else (asked,)
        tests = [(self.alloy, moment, way) for way in holds for moment in moments]
        for test in tests:
            cycle.map(*test)
        records = dict(zip(((t[1], t[2].name) for t in tests), cycle.pull(tests), strict=True))
        reaction = LOADS[scene.tensile.load].reaction
        return [float(records[m, asked.name].numbers[f"peak_{reaction}"]) for m in moments]


def take_over(source: Path, target: Path) -> None:
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
    hold: str,
    largest_loss: float,
    tolerance: float = DEFAULT_TOLERANCE,
    said: Callable[[str], None] = lambda line: None,
    smallest_loss: float = 0.0,
) -> StrengthCurve:
    """The curve of peaks between two volume losses, held in one way.

    smallest_loss: none, too, where it is `_INTACT` or less.  Raises SceneError where too many tests
    leave too large an error.
    """
    try:
        curve = strength_curve(
            lambda losses: tests.peaks(hold, losses),
            largest_loss,
            tolerance,
            smallest_loss=smallest_loss if smallest_loss > _INTACT else 0.0,
        )
    except ValueError as error:
        raise SceneError(f"{error} ({tests.alloy} held by {hold})") from None
    said(
        f"strength curve of {tests.alloy}, {hold}: {len(curve.losses)} tests from "
        f"{100 * curve.losses[0]:.3g} to {100 * curve.losses[-1]:.3g} % of the volume, error "
        f"{100 * curve.error():.2g} %"
    )
    return curve
