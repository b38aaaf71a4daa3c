"""Error against run time of the corrosion stage: what each numerical choice costs and buys.

Every run is the reference screw in the scene of its published parameter set.  The error of a
setting is the largest relative error of V_L after 7, 28 and 56 days, bounded by the sum of two
measured parts.  Time: against the same lattice with time converged (exactly where the liquid is
proven clean: peri.omissions.well_stirred; else a march with far shorter steps).  Lattice: against
the limit of no spacing at all at the same horizon (pipeline.studies.reference) where the liquid is
clean, plus that limit's own error; else against the finest lattice, plus that lattice's own error
in clean liquid and what its position in the domain moves.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice, box_lattice
from peri.engine.march.marching import TimeStepping
from peri.omissions.names import LIQUID
from peri.omissions.planning import corrode_lean, plan_omissions
from peri.omissions.well_stirred import well_stirred
from pipeline.geometry.surface import Solid
from pipeline.scene.resolve import resolve_scene
from pipeline.stages.corrosion import (
    corrosion_scene,
    domain_lattice,
    in_domain,
    liquid_domain,
    metal_of,
)
from pipeline.stages.geometry import build_solid
from pipeline.studies.reference import continuum_volume_loss

DAY = 86400.0
HOUR = 3600.0
TIMES = (7 * DAY, 28 * DAY, 56 * DAY)
RATIOS = (2, 3, 4, 6)
REFERENCE_RATIOS = (8,)
"""Finer ones, for alloys whose finest lattice with its liquid is the reference of the others."""
LEAN_RATIOS = (2, 3, 4, 6, 8, 10, 12, 16)
REFERENCE_ERROR = 1e-3
"""Of V_L without a lattice: two draws differ by 0.06 %, 24 and 32 voxels a horizon by 0.008 %."""
POSITIONS = 4
"""Positions of the lattice in the domain that tell what they move where liquid is computed."""

STEPS = (96 * HOUR, 48 * HOUR, 24 * HOUR, 12 * HOUR)
RATE_CHANGES = (0.4, 0.2, 0.1, 0.05, 0.025)
CONVERGED = 0.0125
COMMON = TimeStepping("sdirk2", rate_change=0.1)
"""The stepping with which the lattices are compared."""

STEP_CURVES = ("backward Euler, fixed steps", "SDIRK2, fixed steps", "SDIRK2, controlled steps")
LATTICE_CURVES = (
    "all computed, SDIRK2 0.1", "all computed, backward Euler 24 h", "liquid left out",
    "liquid left out, two spacings extrapolated",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One run: its choices, its cost and its error (relative, of V_L).

    curve, choice: which line of the plot, which point on it; step: fixed, s, else None and
    rate_change controls it; processor_seconds: of all threads together.
    """

    alloy: str
    curve: str
    choice: str
    horizon_ratio: int
    spacing: float
    liquid: str
    scheme: str
    step: float | None
    rate_change: float | None
    nodes: int
    steps: int
    processor_seconds: float
    seconds: float
    volume_loss_7d: float
    volume_loss_28d: float
    volume_loss_56d: float
    time_error: float
    lattice_error: float

    @property
    def error(self) -> float:
        """Bound of the error of this setting: time plus lattice."""
        return self.time_error + self.lattice_error

    @property
    def volume_loss(self) -> np.ndarray:
        """V_L after 7, 28 and 56 days."""
        return np.array([self.volume_loss_7d, self.volume_loss_28d, self.volume_loss_56d])


@dataclass(frozen=True)
class Study:
    """All rows, and what was measured beside them.

    horizon: of all rows, m; exact: V_L at TIMES in the limit of no spacing, by alloy, for alloys
    whose liquid is clean; spread: (alloy, ratio, error of 7, 28 and 56 d) standard deviation of
    V_L over positions of the lattice; horizons: (alloy, horizon, V_L after 56 d); explicit:
    (alloy, stable step in s, seconds of a step): forward Euler on the coarsest lattice.
    """

    rows: tuple[Row, ...]
    horizon: float
    exact: dict[str, tuple[float, ...]]
    spread: tuple[tuple[str, int, tuple[float, ...]], ...]
    horizons: tuple[tuple[str, float, float], ...]
    explicit: tuple[tuple[str, float, float], ...]


class Cases:
    """Corrosion scenes of one alloy on lattices of one solid."""

    def __init__(self, alloy: str, solid: Solid | None = None) -> None:
        self.alloy = alloy
        self.base = resolve_scene([alloy], ["0w", "8w"], "quick")
        self.horizon = self.base.lattice.horizon
        self.solid = solid or build_solid(self.base)

    def scene(
        self, ratio: int, horizon: float | None = None, shift: np.ndarray | None = None
    ) -> CorrosionScene:
        """The scene with spacing = horizon / ratio; shift: of the lattice, in spacings."""
        horizon = horizon or self.horizon
        settings = replace(self.base.lattice, spacing=horizon / min(ratio, 8), horizon=horizon)
        scene = replace(self.base, lattice=settings)
        region = liquid_domain(scene, self.solid.points)
        spacing = horizon / ratio
        if ratio > 8 or shift is not None:
            # Beyond what a run allows, and only in clean liquid: a tight box is enough.
            lattice = _tight_lattice(self.solid, horizon, spacing, shift)
            domain = np.ones(lattice.shape, bool)
        else:
            lattice, domain = domain_lattice(scene, region)
        return corrosion_scene(
            scene, self.alloy, lattice, domain, *metal_of(scene, lattice, self.solid)
        )

    def exact(self, times=TIMES) -> np.ndarray:
        """V_L in clean liquid without a lattice."""
        scene = self.scene(2)
        return continuum_volume_loss(
            self.solid, self.horizon, scene.dissolution_flux, scene.solid_concentration,
            scene.saturation_concentration, scene.kinetics, times, voxels=24,
        )  # fmt: skip

    def moved(self, ratio: int, shift: np.ndarray) -> CorrosionScene:
        """The whole scene, liquid and all, on a lattice moved by `shift` (in spacings)."""
        spacing = self.horizon / ratio
        scene = replace(self.base, lattice=replace(self.base.lattice, spacing=spacing))
        region = liquid_domain(scene, self.solid.points)
        start = np.asarray(region.lower) - (1.0 - np.asarray(shift)) * spacing
        lattice = box_lattice(start, np.asarray(region.upper) + spacing, spacing)
        domain = in_domain(lattice, region)
        return corrosion_scene(
            scene, self.alloy, lattice, domain, *metal_of(scene, lattice, self.solid)
        )


def screw_scene(alloy: str, ratio: int, saturation: str) -> CorrosionScene:
    """The scene of an alloy's published set with spacing = horizon / ratio."""
    return replace(Cases(alloy).scene(ratio), saturation=saturation)


def _tight_lattice(solid: Solid, horizon: float, spacing: float, shift) -> Lattice:
    lower, upper = solid.points.min(axis=0), solid.points.max(axis=0)
    margin = horizon + 2 * spacing
    shift = np.full(3, 0.5) if shift is None else np.asarray(shift)
    count = np.ceil((upper - lower + 2 * margin) / spacing).astype(int) + 1
    return Lattice(tuple(lower - margin + (shift - 0.5) * spacing), (spacing,) * 3, tuple(count))


def study_corrosion(
    alloys: list[str], tell: Callable[[str], None], ratios: tuple[int, ...] = RATIOS,
    lean_ratios: tuple[int, ...] = LEAN_RATIOS,
    reference_ratios: tuple[int, ...] = REFERENCE_RATIOS,
) -> Study:  # fmt: skip
    """Run the study; `tell` hears one line per run.  All ratios ascend."""
    rows, exact, spread, horizons, explicit = [], {}, [], [], []
    solid, horizon = None, 0.0
    for alloy in alloys:
        cases = Cases(alloy, solid)
        solid, horizon = cases.solid, cases.horizon
        coarse = cases.scene(ratios[0])
        clean = any(o.name == LIQUID and o.applied for o in plan_omissions(coarse, TIMES[-1]))
        truth = cases.exact()
        here = [(alloy, m, _position_spread(cases, m)) for m in (2, 4)] if clean else []
        marched = ratios if clean else (*ratios, *reference_ratios)
        marches = _Marches(cases, clean, truth, tell, marched, lean_ratios, here)
        rows += marches.rows
        explicit.append((alloy, *_explicit_cost(coarse)))
        spread += marches.spread
        if clean:
            exact[alloy] = tuple(map(float, truth))
            horizons += [(alloy, d, _loss(cases, d)) for d in (100e-6, 200e-6, 300e-6)]
    return Study(tuple(rows), horizon, exact, tuple(spread), tuple(horizons), tuple(explicit))


def _relative(values, reference) -> float:
    return float(np.max(np.abs(np.asarray(values) / np.asarray(reference) - 1.0)))


class _Marches:
    """The runs of one alloy: every stepping on the coarsest lattice, then every lattice."""

    def __init__(self, cases, clean, truth, tell, ratios, lean_ratios, spread) -> None:
        self.cases, self.clean, self.tell = cases, clean, tell
        self.rows: list[Row] = []
        self.spread: list[tuple[str, int, tuple[float, ...]]] = list(spread)
        self.time_errors: dict[TimeStepping, float] = {}
        self.scenes = {m: cases.scene(m) for m in ratios}
        first = ratios[0]
        # The first march pays for compilation; it is not recorded.
        corrode(self.scenes[first], TIMES[:1], TimeStepping("backward_euler", 7 * DAY))
        self._stepping(first)
        self._lattices(ratios, truth)
        if clean:
            self._lean(lean_ratios, truth)

    def _march(self, m: int, stepping: TimeStepping):
        started = time.process_time()
        result = corrode(self.scenes[m], TIMES, stepping)
        return result, time.process_time() - started

    def _add(self, curve, choice, m, stepping, result, processor, time_error, lattice_error):
        row = Row(
            self.cases.alloy, curve, choice, m, self.cases.horizon / m,
            "left out" if stepping is None else "computed",
            "exact" if stepping is None else stepping.scheme,
            stepping and stepping.step,
            None if stepping is None or stepping.step else stepping.rate_change,
            int(result.scene.domain.sum()), len(result.history["time"]) - 1,
            processor, result.wall_time, *map(float, result.volume_loss),
            time_error, lattice_error,
        )  # fmt: skip
        self.rows.append(row)
        self.tell(
            f"{row.alloy}, {curve}, {choice}: {processor:.2f} s; error of time "
            f"{100 * time_error:.3f} %, of the lattice {100 * lattice_error:.2f} %"
        )

    def _stepping(self, m: int) -> None:
        """Time error of every stepping on the coarsest lattice."""
        if self.clean:
            exact = well_stirred(self.scenes[m], TIMES).volume_loss
        else:
            exact = self._march(m, TimeStepping("sdirk2", rate_change=CONVERGED))[0].volume_loss
        for scheme, curve in zip(("backward_euler", "sdirk2"), STEP_CURVES[:2], strict=True):
            for step in STEPS:
                self._time(curve, f"{step / HOUR:.0f} h", m, TimeStepping(scheme, step), exact)
        for change in RATE_CHANGES:
            stepping = TimeStepping("sdirk2", rate_change=change)
            self._time(STEP_CURVES[2], f"{change:g}", m, stepping, exact)

    def _time(self, curve, choice, m, stepping, exact) -> None:
        result, processor = self._march(m, stepping)
        self.time_errors[stepping] = _relative(result.volume_loss, exact)
        # The lattice's error is filled in once it is known.
        self._add(curve, choice, m, stepping, result, processor, self.time_errors[stepping], 0.0)

    def _lattices(self, ratios, truth) -> None:
        """Lattice error of every spacing, with two steppings."""
        runs = {m: self._march(m, COMMON) for m in ratios}
        finest = ratios[-1]
        if self.clean:
            errors = {
                m: REFERENCE_ERROR
                + _relative(well_stirred(self.scenes[m], TIMES).volume_loss, truth)
                for m in ratios
            }
        else:
            own = _relative(well_stirred(self.scenes[finest], TIMES).volume_loss, truth)
            own += REFERENCE_ERROR + self._moved(ratios[min(1, len(ratios) - 1)], finest)
            best = runs[finest][0].volume_loss
            errors = {m: own + _relative(runs[m][0].volume_loss, best) for m in ratios}
        self.rows = [replace(row, lattice_error=errors[ratios[0]]) for row in self.rows]
        for m, (result, processor) in runs.items():
            self._add(
                LATTICE_CURVES[0], f"δ/{m}", m, COMMON, result, processor,
                self.time_errors[COMMON], errors[m],
            )  # fmt: skip
        stepping = TimeStepping("backward_euler", 24 * HOUR)
        # Where the liquid saturates this takes minutes on the finer lattices.
        for m in ratios[: -1 if self.clean else 2]:
            result, processor = self._march(m, stepping)
            self._add(
                LATTICE_CURVES[1], f"δ/{m}", m, stepping, result, processor,
                self.time_errors[stepping], errors[m],
            )  # fmt: skip

    def _moved(self, ratio: int, finest: int) -> float:
        """What the position of the finest lattice moves V_L: from a coarser one, as the spacing."""
        random = np.random.default_rng(0)
        started = time.process_time()
        values = np.array([
            corrode(self.cases.moved(ratio, random.random(3)), TIMES, COMMON).volume_loss
            for _ in range(POSITIONS)
        ])  # fmt: skip
        found = values.std(axis=0, ddof=1) / values.mean(axis=0)
        self.spread.append((self.cases.alloy, ratio, tuple(map(float, found))))
        self.tell(
            f"{self.cases.alloy}, {POSITIONS} positions of δ/{ratio}: "
            f"{time.process_time() - started:.2f} s; largest spread {100 * found.max():.2f} %"
        )
        return float(found.max()) * ratio / finest

    def _lean(self, ratios, truth) -> None:
        """What leaving the liquid out costs and errs: the scalar equation, exact in time.

        Also of two lattices, one twice as fine, extrapolated to no spacing at first order.  Their
        error includes the spread between positions of the lattice: it falls like the spacing,
        the finer lattice counts twice and the coarser one has twice as much.
        """
        runs, bound = {}, 0.0
        known = [(m, max(spread)) for _, m, spread in self.spread]
        apart = max((math.sqrt(8) * m * spread for m, spread in known[-1:]), default=0.0)
        for m in ratios:
            scene = self.scenes.get(m) or self.cases.scene(m)
            started = time.process_time()
            if m in self.scenes:
                result, omissions = corrode_lean(scene, TIMES)
                bound = next(o.bound for o in omissions if o.name == LIQUID)
            else:
                result = well_stirred(scene, TIMES)
            processor = time.process_time() - started
            runs[m] = result.volume_loss, processor
            error = _relative(result.volume_loss, truth) + REFERENCE_ERROR
            self._add(LATTICE_CURVES[2], f"δ/{m}", m, None, result, processor, bound, error)
            if m % 2 == 0 and m // 2 in runs:
                coarse, before = runs[m // 2]
                result = replace(result, volume_loss=2 * result.volume_loss - coarse)
                error = _relative(result.volume_loss, truth) + REFERENCE_ERROR + apart / m
                self._add(
                    LATTICE_CURVES[3], f"δ/{m // 2}, δ/{m}", m, None, result, before + processor,
                    bound, error,
                )  # fmt: skip


def _explicit_cost(scene: CorrosionScene) -> tuple[float, float]:
    """Forward Euler: longest stable step (s), and processor seconds of one step."""
    problem = BiMaterial(scene)
    limit = 1.0 / problem.fastest_rate()
    state, _, _ = problem.explicit_step(problem.initial_concentration.copy(), limit, 0.0)
    started = time.process_time()
    for _ in range(5):
        state, _, _ = problem.explicit_step(state, limit, 0.0)
    return limit, (time.process_time() - started) / 5


def _position_spread(cases: Cases, ratio: int, positions: int = 5) -> tuple[float, ...]:
    """Standard deviation of V_L at TIMES, relative, over random positions of the lattice."""
    random = np.random.default_rng(0)
    values = np.array(
        [
            well_stirred(cases.scene(ratio, shift=random.random(3)), TIMES).volume_loss
            for _ in range(positions)
        ]
    )
    return tuple(map(float, values.std(axis=0, ddof=1) / values.mean(axis=0)))


def _loss(cases: Cases, horizon: float, ratio: int = 4) -> float:
    """V_L after 56 days in clean liquid with another horizon."""
    return float(well_stirred(cases.scene(ratio, horizon), TIMES).volume_loss[-1])
