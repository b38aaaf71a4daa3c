"""Error against run time of the corrosion stage: what each numerical choice costs and buys.

Every run is the reference screw in the scene of its published parameter set.  The error is the
largest relative difference of V_L over the output times, split into time (against a converged
march on the same lattice) and lattice (against the finest lattice at the same horizon, with time
converged): the sum of the two bounds the error of a setting.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from peri.corrosion.planning import LIQUID, corrode_lean, plan_omissions
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.corrosion.well_stirred import well_stirred
from peri.marching import TimeStepping

DAY = 86400.0
TIMES = (7 * DAY, 28 * DAY, 56 * DAY)
HORIZON_RATIOS = (2, 3, 4, 6)
STEPS = (96 * 3600.0, 48 * 3600.0, 24 * 3600.0, 12 * 3600.0)
RATE_CHANGES = (0.4, 0.2, 0.1, 0.05, 0.025)
CONVERGED = TimeStepping("sdirk2", rate_change=0.01)
WANTED_ERRORS = (0.10, 0.03, 0.01, 0.003)


@dataclass(frozen=True)
class Row:
    """One run: its choices, cost and error (relative, of V_L)."""

    alloy: str
    curve: str
    choice: str
    nodes: int
    horizon_ratio: float
    scheme: str
    step_s: float | None
    rate_change: float | None
    seconds: float
    steps: int
    volume_loss_56d: float
    time_error: float
    lattice_error: float

    @property
    def error(self) -> float:
        """Bound of the error of this setting: time plus lattice."""
        return self.time_error + self.lattice_error


def study_scene(alloy: str, ratio: float, horizon: float | None = None) -> CorrosionScene:
    """The scene of an alloy's published set with spacing = horizon / ratio."""
    from pipeline.corrosion_stage import corrosion_scene, domain_lattice, liquid_domain, metal_of
    from pipeline.geometry_stage import build_solid
    from pipeline.resolve import resolve_scene

    scene = resolve_scene([alloy], ["0w", "8w"], "quick")
    horizon = horizon or scene.lattice.horizon
    scene = replace(
        scene, lattice=replace(scene.lattice, spacing=horizon / ratio, horizon=horizon)
    )
    solid = build_solid(scene)
    lattice, domain = domain_lattice(scene, liquid_domain(scene, solid.points))
    return corrosion_scene(scene, alloy, lattice, domain, *metal_of(scene, lattice, solid))


def study_corrosion(
    alloys: list[str], tell: Callable[[str], None], ratios: tuple[int, ...] = HORIZON_RATIOS
) -> list[Row]:
    """Run the study; `tell` hears one line per run."""
    rows: list[Row] = []
    for alloy in alloys:
        rows += _study_alloy(alloy, tell, ratios)
    return rows


def _relative(values, reference) -> float:
    return float(np.max(np.abs(np.asarray(values) / np.asarray(reference) - 1.0)))


def _study_alloy(alloy: str, tell, ratios) -> list[Row]:
    scenes = {m: study_scene(alloy, m) for m in ratios}
    coarse = scenes[ratios[0]]
    liquid_is_clean = any(
        o.name == LIQUID and o.applied for o in plan_omissions(coarse, TIMES[-1])
    )
    # Where clean liquid is proven, the scalar equation is exact in time on every lattice.
    converged = {
        m: (
            well_stirred(scene, TIMES)
            if liquid_is_clean
            else corrode(scene, TIMES, CONVERGED if m == ratios[0] else TimeStepping())
        ).volume_loss
        for m, scene in scenes.items()
    }
    finest = converged[ratios[-1]]
    rows: list[Row] = []

    def run(curve: str, choice: str, m: int, stepping: TimeStepping, lean: bool = False) -> None:
        scene = scenes[m]
        if lean:
            result, _ = corrode_lean(scene, TIMES)
        else:
            result = corrode(scene, TIMES, stepping)
        row = Row(
            alloy, curve, choice, int(scene.domain.sum()), float(m), stepping.scheme,
            stepping.step, None if stepping.step else stepping.rate_change, result.wall_time,
            len(result.history["time"]) - 1, float(result.volume_loss[-1]),
            _relative(result.volume_loss, converged[m]), _relative(converged[m], finest),
        )
        rows.append(row)
        tell(
            f"{alloy} {curve} {choice}: {row.seconds:.2f} s, error in time "
            f"{100 * row.time_error:.3f} %, of the lattice {100 * row.lattice_error:.2f} %"
        )

    first = ratios[0]
    # The first march pays for compilation; it is not recorded.
    corrode(coarse, TIMES[:1], TimeStepping("backward_euler", STEPS[0]))
    for scheme in ("backward_euler", "sdirk2"):
        for step in STEPS:
            run(f"{scheme}, fixed step", f"{step / 3600:.0f} h", first, TimeStepping(scheme, step))
    for change in RATE_CHANGES:
        stepping = TimeStepping("sdirk2", rate_change=change)
        run("sdirk2, controlled step", f"{change:g}", first, stepping)
    for m in ratios[:-1]:
        run("lattice spacing", f"delta / {m}", m, TimeStepping())
    if liquid_is_clean:
        for m in ratios[:-1]:
            run("liquid left out", f"delta / {m}", m, TimeStepping(), lean=True)
    return rows


def horizon_effect(alloy: str, ratio: int = 4) -> list[tuple[float, float]]:
    """(delta, V_L after 56 days) in clean liquid for other horizons: what delta itself does."""
    return [
        (delta, float(well_stirred(study_scene(alloy, ratio, delta), TIMES).volume_loss[-1]))
        for delta in (100e-6, 200e-6, 300e-6)
    ]


def observed_orders(rows: list[Row]) -> list[tuple[str, str, float]]:
    """(alloy, curve, order): slope of log error over log step, control target or spacing."""
    found = []
    keys = {(r.alloy, r.curve): None for r in rows}
    for alloy, curve in keys:
        chosen = [r for r in rows if (r.alloy, r.curve) == (alloy, curve)]
        if curve in ("lattice spacing", "liquid left out"):
            points = [(1.0 / r.horizon_ratio, r.lattice_error) for r in chosen]
        else:
            points = [(r.step_s or r.rate_change, r.time_error) for r in chosen]
        points = [(h, e) for h, e in points if e > 1e-12]
        if len(points) >= 2:
            slope = np.polyfit(np.log([h for h, _ in points]), np.log([e for _, e in points]), 1)
            found.append((alloy, curve, float(slope[0])))
    return found


def cheapest(rows: list[Row]) -> list[tuple[str, float, Row | None]]:
    """(alloy, wanted error, cheapest run that reaches it or None)."""
    out = []
    for alloy in {r.alloy: None for r in rows}:
        for wanted in WANTED_ERRORS:
            good = [r for r in rows if r.alloy == alloy and r.error <= wanted]
            out.append((alloy, wanted, min(good, key=lambda r: r.seconds, default=None)))
    return out


def write_study(rows: list[Row], folder: Path) -> list[Path]:
    """Write corrosion.csv and the work-precision plot corrosion.png into `folder`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "corrosion.csv"
    temporary = table.with_suffix(".tmp")
    with temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*asdict(rows[0]), "error"])
        writer.writeheader()
        for row in rows:
            writer.writerow({**asdict(row), "error": row.error})
    os.replace(temporary, table)
    alloys = list({r.alloy: None for r in rows})
    figure = Figure(figsize=(6.4 * len(alloys), 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, alloy in zip(figure.subplots(1, len(alloys), squeeze=False)[0], alloys, strict=True):
        for curve in {r.curve: None for r in rows if r.alloy == alloy}:
            chosen = [r for r in rows if (r.alloy, r.curve) == (alloy, curve)]
            spatial = curve in ("lattice spacing", "liquid left out")
            errors = [r.lattice_error if spatial else r.time_error for r in chosen]
            label = f"{curve} ({'lattice' if spatial else 'time'} error)"
            axes.loglog([r.seconds for r in chosen], np.maximum(errors, 1e-9), "o-", label=label)
            for r, e in zip(chosen, errors, strict=True):
                axes.annotate(r.choice, (r.seconds, max(e, 1e-9)), fontsize=7,
                              xytext=(3, 3), textcoords="offset points")
        axes.set_xlabel("run time / s")
        axes.set_ylabel("largest relative error of the volume loss")
        axes.set_title(f"{alloy}: 7, 28 and 56 days")
        axes.grid(True, which="both", linewidth=0.3)
        axes.legend(fontsize=8)
    picture = folder / "corrosion.png"
    figure.savefig(folder / "corrosion.tmp.png", dpi=130)
    os.replace(folder / "corrosion.tmp.png", picture)
    return [table, picture]
