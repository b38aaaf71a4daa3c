"""What rate classes leave of the lattice's error, beside one rate per node, as tables.

The reference screw in the scene of its published parameter set.  The error of a lattice is the
largest relative error of V_L after 7, 28 and 56 days, its median over positions of the lattice.
Where the liquid is proven clean, V_L is exact in time and compared with the limit without a lattice
(`reference`, itself sure to 0.1 %); else with the limit that the two finest lattices extrapolate
to at second order, which is as unsure as it is far from the finest.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice, box_lattice
from peri.engine.march.marching import TimeStepping
from peri.omissions.names import LIQUID
from peri.omissions.planning import plan_omissions
from peri.omissions.sampling_error import sampling_error
from peri.omissions.well_stirred import well_stirred
from pipeline.stages.corrosion import (
    corrosion_scene,
    exposure_of,
    in_domain,
    liquid_domain,
    metal_of,
)
from pipeline.studies.corrosion import COMMON, TIMES, Cases

POSITIONS = {2: 3, 3: 1, 4: 1}
"""Positions of the lattice by horizon over spacing: of a ball they move V_L by 0.01 %."""

RATE_CHANGES = (0.4, 0.2, 0.1, 0.05)
"""Control targets of the steps that are tried on the coarsest lattice."""


@dataclass(frozen=True)
class LatticeRow:
    """One lattice: errors are relative, seconds of the processor.

    error, spread: of V_L, largest over TIMES: median and range over positions; own: what the scene
    finds of its error itself (None where the liquid is computed); setup, march: seconds.
    """

    alloy: str
    ratio: int
    classes: int
    positions: int
    error: float
    spread: float
    own: float | None
    setup: float
    march: float


@dataclass(frozen=True)
class StepRow:
    """One control target of the steps with rate classes on the coarsest lattice."""

    alloy: str
    rate_change: float
    steps: int
    error: float
    march: float


def study_rate_classes(
    alloys: list[str], tell: Callable[[str], None], positions: dict[int, int] | None = None
) -> tuple[list[LatticeRow], list[StepRow]]:
    """Run the study; `tell` hears one line per lattice.  positions: as POSITIONS, two at least."""
    positions = positions or POSITIONS
    lattices: list[LatticeRow] = []
    steps: list[StepRow] = []
    cases = {}
    for alloy in alloys:
        cases[alloy] = Cases(alloy, next(iter(cases.values())).solid if cases else None)
    kept: dict[tuple, tuple] = {}  # the surface's part is the same for all alloys
    for alloy, case in cases.items():
        found: dict[tuple[int, int], list[_March]] = {}
        first = case.scene(min(positions))
        clean = any(o.name == LIQUID and o.applied for o in plan_omissions(first, TIMES[-1]))
        for ratio, count in positions.items():
            shifts = np.random.default_rng(ratio).random((count, 3))
            for classes in (0, 3):
                found[ratio, classes] = [
                    _march(case, ratio, shift, classes, clean, kept) for shift in shifts
                ]
        limit = case.exact() if clean else _extrapolated(found, sorted(positions), 3)
        for classes in (0, 3):
            for ratio in positions:
                row = _row(alloy, ratio, classes, found[ratio, classes], limit)
                lattices.append(row)
                tell(_in_words(row))
        scene = found[min(positions), 3][0].scene
        steps += _steps(alloy, scene, clean)
    return lattices, steps


@dataclass(frozen=True)
class _March:
    scene: CorrosionScene
    volume_loss: NDArray[np.float64]
    own: float | None
    setup: float
    march: float


def _march(case, ratio, shift, classes, clean, kept) -> _March:
    """One lattice moved by `shift` (in spacings), with classes or one rate per node."""
    started = time.process_time()
    settings = replace(case.base.corrosion, classes=classes)
    spacing = case.horizon / ratio
    scene = replace(
        case.base, lattice=replace(case.base.lattice, spacing=spacing), corrosion=settings
    )
    region = liquid_domain(scene, case.solid.points)
    start = np.asarray(region.lower) - (1.0 - np.asarray(shift)) * spacing
    lattice: Lattice = box_lattice(start, np.asarray(region.upper) + spacing, spacing)
    key = (ratio, classes, tuple(shift))
    if key not in kept:
        metal, fraction = metal_of(scene, lattice, case.solid)
        exposed = exposure_of(scene, lattice, region, case.solid, fraction)
        kept[key] = metal, fraction, exposed, time.process_time() - started
    metal, fraction, exposed, setup = kept[key]
    corrosion = corrosion_scene(
        scene, case.alloy, lattice, in_domain(lattice, region), metal, fraction, exposed
    )
    started = time.process_time()
    if clean:
        losses = well_stirred(corrosion, TIMES).volume_loss
    else:
        losses = corrode(corrosion, TIMES, COMMON).volume_loss
    march = time.process_time() - started
    own = sampling_error(corrosion, TIMES) if classes else None
    return _March(corrosion, losses, own, setup, march)


def _extrapolated(found, ratios, classes) -> NDArray[np.float64]:
    """V_L without a lattice from the two finest ones at second order."""
    coarse, fine = ratios[-2:]
    far, near = (
        np.median([m.volume_loss for m in found[r, classes]], axis=0) for r in (coarse, fine)
    )
    return near + (near - far) / ((fine / coarse) ** 2 - 1)


def _row(alloy, ratio, classes, marches, limit) -> LatticeRow:
    losses = np.array([m.volume_loss for m in marches])
    worst = np.abs(losses / limit - 1).max(axis=1)
    own = [m.own for m in marches if m.own is not None]
    return LatticeRow(
        alloy, ratio, classes, len(marches), float(np.median(worst)),
        float((np.ptp(losses, axis=0) / limit).max()), float(np.median(own)) if own else None,
        float(np.median([m.setup for m in marches])), float(np.median([m.march for m in marches])),
    )  # fmt: skip


def _steps(alloy: str, scene: CorrosionScene, clean: bool) -> list[StepRow]:
    """Error of the steps alone, against the exact scalar equation or far shorter steps."""

    def march(change: float):
        started = time.process_time()
        result = corrode(scene, TIMES, TimeStepping("sdirk2", rate_change=change))
        return result, time.process_time() - started

    exact = (well_stirred(scene, TIMES) if clean else march(0.0125)[0]).volume_loss
    rows = []
    for change in RATE_CHANGES:
        result, seconds = march(change)
        error = float(np.abs(result.volume_loss / exact - 1).max())
        rows.append(StepRow(alloy, change, len(result.history["time"]) - 1, error, seconds))
    return rows


def _in_words(row: LatticeRow) -> str:
    how = f"{row.classes} rate classes" if row.classes else "one rate per node"
    return (
        f"{row.alloy}, δ/{row.ratio}, {how}: error {100 * row.error:.2f} %, set-up "
        f"{row.setup:.1f} s, march {row.march:.1f} s"
    )


def print_rate_classes(alloys: list[str], positions: dict[int, int] | None = None) -> None:
    """Print the tables as they stand in pipeline/MEASURED.md."""
    lattices, steps = study_rate_classes(alloys, lambda line: print(line, flush=True), positions)
    print("\n| alloy | rates | δ/dx | positions | error | range | own estimate | set-up | march |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for row in lattices:
        own = "" if row.own is None else f"{100 * row.own:.2f} %"
        print(
            f"| {row.alloy} | {row.classes or 'one per node'} | {row.ratio} | {row.positions} | "
            f"{100 * row.error:.2f} % | {100 * row.spread:.2f} % | {own} | {row.setup:.1f} s | "
            f"{row.march:.1f} s |"
        )
    print("\n| alloy | rate change | steps | error of time | march |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for step in steps:
        print(
            f"| {step.alloy} | {step.rate_change:g} | {step.steps} | {100 * step.error:.2f} % | "
            f"{step.march:.1f} s |"
        )
