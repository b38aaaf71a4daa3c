"""Error against run time of the corrosion stage: what each numerical choice costs and buys.

Every run is the reference screw in the scene of its published parameter set, with rate classes and
with one rate per node.  The error of a setting is the largest relative error of V_L after 7, 28 and
56 days, bounded by the sum of two measured parts.  Time: against the same lattice with time
converged (exactly where the liquid is proven clean: peri.omissions.well_stirred; else a march with
far shorter steps); of controlled steps, which are longest where a march stops nowhere before its
end, the largest of marches to 7, 28, 56 and 168 days alone, too.  Lattice, its median over
positions: against the limit of no spacing at all (pipeline.studies.reference) where the liquid is
clean, plus that limit's own error; else against the limit that the two finest lattices with rate
classes, laid as a run lays them, extrapolate to at second order, plus what that limit differs from
the finest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.marching import TimeStepping
from peri.omissions.names import LIQUID
from peri.omissions.planning import plan_omissions
from peri.omissions.well_stirred import well_stirred
from pipeline.studies.cases import ALONE, CLASSES, EXACT, HOUR, TIMES, Cases, March, Place

POSITIONS = {2: 5, 3: 5, 4: 5, 6: 1}
"""Positions of a lattice with rate classes, by horizon over spacing."""
NODE_POSITIONS = {2: 1, 3: 1}
"""The same with one rate per node."""
REFERENCE_ERROR = 1e-3
"""Of V_L without a lattice: two draws differ by 0.06 %, 24 and 32 voxels a horizon by 0.008 %."""

STEPS = (96 * HOUR, 48 * HOUR, 24 * HOUR)
RATE_CHANGES = (0.4, 0.2, 0.1, 0.05)
CONVERGED = 0.025
COMMON = TimeStepping("sdirk2", rate_change=0.1)
"""The stepping with which the lattices are compared."""

STEP_CURVES = ("backward Euler, fixed steps", "SDIRK2, fixed steps", "SDIRK2, controlled steps")
LATTICE_CURVES = (
    "rate classes, liquid computed", "rate classes, liquid left out",
    "one rate per node, liquid computed", "one rate per node, liquid left out",
)  # fmt: skip
HORIZONS = (100e-6, 200e-6, 300e-6)


@dataclass(frozen=True)
class Row:
    """One setting: its choices, its cost and its error (relative, of V_L).

    curve, choice: which line of the plot, which point on it; classes: 0 for one rate per node;
    positions: of the lattice, spread: range of V_L over them; step: fixed, s, else None and
    rate_change controls it; own: what the run finds of its error itself; setup_seconds: of the
    surface, once for a lattice, processor_seconds: of the march, of all threads together.
    """

    alloy: str
    curve: str
    choice: str
    horizon_ratio: int
    spacing: float
    classes: int
    positions: int
    spread: float
    liquid: str
    scheme: str
    step: float | None
    rate_change: float | None
    nodes: int
    steps: int
    setup_seconds: float
    processor_seconds: float
    volume_loss_7d: float
    volume_loss_28d: float
    volume_loss_56d: float
    time_error: float
    lattice_error: float
    own: float | None = None

    @property
    def error(self) -> float:
        """Bound of the error of this setting: time plus lattice."""
        return self.time_error + self.lattice_error

    @property
    def volume_loss(self) -> NDArray[np.float64]:
        """V_L after 7, 28 and 56 days."""
        return np.array([self.volume_loss_7d, self.volume_loss_28d, self.volume_loss_56d])


@dataclass(frozen=True)
class Study:
    """All rows, and what was measured beside them.

    horizon: of all rows, m; limits: (alloy, V_L at TIMES without a lattice, doubt of it, relative);
    horizons: (alloy, horizon, V_L after 56 d); explicit: (alloy, stable step in s, seconds of a
    step): forward Euler on the coarsest lattice, one rate per node.
    """

    rows: tuple[Row, ...]
    horizon: float
    limits: tuple[tuple[str, tuple[float, ...], float], ...] = ()
    horizons: tuple[tuple[str, float, float], ...] = ()
    explicit: tuple[tuple[str, float, float], ...] = ()


def study_corrosion(
    alloys: list[str],
    tell: Callable[[str], None],
    positions: Mapping[int, int] = POSITIONS,
    node_positions: Mapping[int, int] = NODE_POSITIONS,
    keep: Path | None = None,
) -> Study:
    """Run the study; `tell` hears one line per row.  positions: by ratios that ascend.

    keep: folder for what has been found, so that an interrupted study goes on.
    """
    rows, limits, horizons, explicit = [], [], [], []
    solid, horizon = None, 0.0
    for alloy in alloys:
        cases = Cases(alloy, solid, keep)
        solid, horizon = cases.solid, cases.horizon
        coarse = cases.scene(min(positions))
        liquid = next(o for o in plan_omissions(coarse, TIMES) if o.name == LIQUID)
        clean = liquid.applied
        left_out = liquid.bound if clean else None
        work = _OfAlloy(cases, left_out, positions, node_positions)
        found = work.rows()
        for row in found:
            tell(in_words(row))
        rows += found
        limits.append((alloy, tuple(map(float, work.limit)), work.doubt))
        explicit.append((alloy, *_explicit_cost(coarse)))
        if clean:
            horizons += [(alloy, d, _loss(cases, d)) for d in HORIZONS]
    return Study(tuple(rows), horizon, tuple(limits), tuple(horizons), tuple(explicit))


def relative_error(values, limit) -> float:
    """The largest relative difference."""
    return float(np.max(np.abs(np.asarray(values) / np.asarray(limit) - 1.0)))


def extrapolated(losses: Mapping[int, NDArray[np.float64]]) -> tuple[NDArray[np.float64], float]:
    """V_L without a lattice from the two finest ratios at second order, and its doubt, relative.

    The doubt is all that is extrapolated, the change from the finest lattice: of the screw the
    observed order is above two, so that the limit lies between.
    """
    coarse, fine = sorted(losses)[-2:]
    change = losses[fine] - losses[coarse]
    limit = losses[fine] + change / ((fine / coarse) ** 2 - 1)
    return limit, relative_error(losses[fine], limit)


class _OfAlloy:
    """The rows of one alloy: every lattice, then every stepping on the coarsest one."""

    def __init__(self, cases, left_out: float | None, positions, node_positions) -> None:
        """left_out: error of V_L by leaving the liquid out; None where it is computed."""
        self.cases, self.left_out = cases, left_out
        self.clean = clean = left_out is not None
        self.positions = {CLASSES: positions, 0: node_positions}
        self.common = EXACT if clean else COMMON
        self.losses = {
            classes: {m: self._losses(m, classes) for m in places}
            for classes, places in self.positions.items()
        }
        if clean:
            self.limit, self.doubt = cases.exact(), REFERENCE_ERROR
        else:
            # A run lays every lattice alike on the end faces, so that these converge smoothly.
            laid = {m: losses[0] for m, losses in self.losses[CLASSES].items()}
            self.limit, self.doubt = extrapolated(laid)

    def rows(self) -> list[Row]:
        first = min(self.positions[CLASSES])
        exact = self._march(first, CLASSES, EXACT if self.clean else _converged(), ALONE)
        controlled = [TimeStepping("sdirk2", rate_change=change) for change in RATE_CHANGES]
        found, time_error = [], {}
        steps = STEPS if self.clean else ()  # minutes where the liquid saturates
        for curve, stepping in [
            *((STEP_CURVES[0], TimeStepping("backward_euler", step)) for step in steps),
            *((STEP_CURVES[1], TimeStepping("sdirk2", step)) for step in steps),
            *((STEP_CURVES[2], stepping) for stepping in controlled),
        ]:
            march = self._march(first, CLASSES, stepping)
            errors = [relative_error(march.volume_loss, exact.volume_loss[: len(TIMES)])]
            if stepping in controlled:
                errors += [
                    relative_error(self._march(first, CLASSES, stepping, (end,)).volume_loss, loss)
                    for end, loss in zip(ALONE, exact.volume_loss, strict=True)
                ]
            time_error[stepping] = max(errors)
            choice = f"{stepping.step / HOUR:.0f} h" if stepping.step else f"{stepping.rate_change}"
            found.append(self._row(curve, choice, first, CLASSES, stepping, march,
                                   time_error[stepping]))  # fmt: skip
        for classes, places in self.positions.items():
            computed, left_out = LATTICE_CURVES[:2] if classes else LATTICE_CURVES[2:]
            for m in places:
                march = self._march(m, classes, self.common)
                if self.left_out is not None:  # as a run does
                    found.append(
                        self._row(left_out, f"δ/{m}", m, classes, None, march, self.left_out)
                    )
                else:
                    found.append(self._row(computed, f"δ/{m}", m, classes, COMMON, march,
                                           time_error[COMMON]))  # fmt: skip
        return found

    def _march(
        self, ratio: int, classes: int, how: TimeStepping | str, times: tuple[float, ...] = TIMES
    ) -> March:
        return self.cases.march(Place(ratio, classes), how, times)

    def _losses(self, ratio: int, classes: int) -> NDArray[np.float64]:
        """V_L at every position, (positions, nt)."""
        places = [Place(ratio, classes, n) for n in range(self.positions[classes][ratio])]
        return np.array([self.cases.march(place, self.common).volume_loss for place in places])

    def _row(self, curve, choice, m, classes, stepping, march: March, time_error: float) -> Row:
        losses = self.losses[classes][m]
        errors = np.abs(losses / self.limit - 1).max(axis=1)
        return Row(
            self.cases.alloy, curve, choice, m, self.cases.horizon / m, classes, len(losses),
            float((np.ptp(losses, axis=0) / self.limit).max()),
            "left out" if stepping is None else "computed",
            "exact" if stepping is None else stepping.scheme,
            stepping and stepping.step,
            None if stepping is None or stepping.step else stepping.rate_change,
            march.nodes, march.steps, march.setup, march.march, *march.volume_loss,
            time_error, float(np.median(errors)) + self.doubt, march.own,
        )  # fmt: skip


def _converged() -> TimeStepping:
    return replace(COMMON, rate_change=CONVERGED)


def in_words(row: Row) -> str:
    """A row for whoever waits."""
    return (
        f"{row.alloy}, {row.curve}, {row.choice}: set-up {row.setup_seconds:.2f} s, march "
        f"{row.processor_seconds:.2f} s; error of time {100 * row.time_error:.3f} %, of the "
        f"lattice {100 * row.lattice_error:.2f} %"
    )


def _explicit_cost(scene: CorrosionScene) -> tuple[float, float]:
    """Forward Euler: longest stable step (s), and processor seconds of one step."""
    problem = BiMaterial(scene)
    limit = 1.0 / problem.fastest_rate()
    state, _, _ = problem.explicit_step(problem.initial_concentration.copy(), limit, 0.0)
    started = time.process_time()
    for _ in range(5):
        state, _, _ = problem.explicit_step(state, limit, 0.0)
    return limit, (time.process_time() - started) / 5


def _loss(cases: Cases, horizon: float, ratio: int = 4) -> float:
    """V_L after 56 days in clean liquid with another horizon, one rate per node."""
    return float(well_stirred(cases.scene(ratio, horizon), TIMES).volume_loss[-1])
