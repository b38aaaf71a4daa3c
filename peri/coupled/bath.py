"""A stirred bath of finite volume around the computed liquid: what leaves that stays in the bath.

    V dU/dt = F + gas,     U : totals of the components in the bath, minerals of the bath included,
                           F : what leaves the computed liquid through its refreshed layer, mol/s

The refreshed layer holds the bath's composition.  A bath that is open to a gas keeps that gas's
activity, so its totals are those that this takes (the gas comes or goes at once).  Minerals that
form in the whole liquid in equilibrium form in the bath, too.  Fresh medium replaces all of it
every so often.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from peri.engine.march.problem import Course
from peri.engine.march.runge_kutta import RungeKutta
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.speciation import Solution, speciate
from peri.transport.chemistry.species import MOLAR
from peri.transport.liquid import LiquidState
from peri.transport.mixing import Mixing
from peri.transport.nernst_planck import QuasiSteadyLiquid

_ROUNDS = 40
_TOLERANCE = 1e-11
"""Of the totals: below what the liquid's own balance is good for nothing is gained."""
_ROUND_OFF = 2.0 * np.finfo(float).eps
"""Of the largest total: a component that the medium lacks is known to no more than that."""


@dataclass(frozen=True)
class Bath:
    """A bath as people run it.

    volume : m3, > 0, without the computed liquid
    exchange : s, > 0, time between exchanges for fresh medium; infinite: never
    open_to : names of dissolved neutral species whose activity stays that of the fresh medium
    """

    volume: float
    exchange: float = math.inf
    open_to: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.volume) and self.volume > 0):
            raise ValueError(f"bath: its volume is {self.volume} m3; it must be finite and above 0")
        if not self.exchange > 0:
            raise ValueError(f"bath: exchanged every {self.exchange} s; it must be above 0")

    def due(self, time: float) -> bool:
        """Whether fresh medium comes in at this time, s."""
        if not math.isfinite(self.exchange) or time <= 0:
            return False
        count = time / self.exchange
        return abs(count - round(count)) < 1e-9 * max(count, 1.0) and round(count) > 0


@dataclass
class BathLiquid:
    """The chemistry of a bath of a medium.

    Raises ValueError for a gas that is no neutral species of the medium.
    """

    bath: Bath
    medium: Solution
    gas: dict[str, float] = field(init=False)
    minerals: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        chemistry = self.medium.chemistry
        self.gas = {}
        for name in self.bath.open_to:
            k = chemistry.index(name)
            amount = float(self.medium.concentration[k, 0])
            if chemistry.charge[k] or not amount:
                raise ValueError(
                    f"bath: open to {name}, which must be a neutral species that the medium holds"
                )
            self.gas[name] = amount / MOLAR * math.exp(self.medium.ln_gamma[k, 0])
        self.minerals = tuple(
            m.name for m in chemistry.minerals if m.kind == "equilibrium" and m.region == "liquid"
        )

    @property
    def fresh(self) -> np.ndarray:
        """Totals of the components of the fresh medium, (E,), mol/m3."""
        return self.medium.totals[:, 0]

    def settle(self, totals: np.ndarray, start: np.ndarray) -> tuple[Solution, np.ndarray]:
        """Composition of the bath and its totals with minerals, once the gas has come or gone.

        totals : (E,), neutral;  start : (E, 1) ln of the free components to begin with
        """
        chemistry, medium = self.medium.chemistry, self.medium
        found = speciate(
            chemistry, totals, "fixed", strength=float(medium.strength[0]),
            minerals=self.minerals, gas=self.gas, start=start,
            held=(medium.ln_gamma, medium.ln_water),
        )  # fmt: skip
        inside = found.totals[:, 0].copy()
        for mineral, amount in zip(chemistry.minerals, found.mineral[:, 0], strict=True):
            inside += mineral.stoichiometry * amount
        return found, inside if self.gas else np.array(totals, float)

    def hold(self, liquid: QuasiSteadyLiquid, totals: np.ndarray) -> Solution:
        """Give the refreshed layer the composition of the bath; returns that."""
        found, _ = self.settle(totals, self.medium.ln_component)
        liquid.hold(found.concentration[:, 0])
        return found

    def share(
        self,
        liquid: QuasiSteadyLiquid,
        solve: Callable[[LiquidState], LiquidState],
        state: LiquidState,
        old: np.ndarray,
        tau: float,
    ) -> tuple[LiquidState, np.ndarray]:
        """The liquid and the totals of the bath at the end of a stage, each for the other.

        solve : the liquid for the composition held, from a start;  old : (E,);  tau : s

        Raises ConvergenceError.
        """
        charge, inert = liquid.chemistry.component_charge, liquid.inert
        totals, mixing = old, Mixing()
        largest = np.abs(old).max()
        scale = np.maximum(np.abs(old), 1e-6 * largest)
        enough = np.maximum(_TOLERANCE * scale, _ROUND_OFF * largest)
        for _ in range(_ROUNDS):
            self.hold(liquid, totals)
            state = solve(state)
            left = liquid.leaving(state)
            if inert >= 0:  # what is left of a charge goes with the ion that takes it up inside
                left[inert] -= charge @ left / charge[inert]
            _, found = self.settle(old + tau / self.bath.volume * left, self.medium.ln_component)
            if (np.abs(found - totals) <= enough).all():
                return state, found
            totals = mixing.next(totals / scale, found / scale) * scale
        raise ConvergenceError(
            f"bath: its totals still change by {np.abs(found - totals).max():.2g} mol/m3 after "
            f"{_ROUNDS} rounds; a shorter step will do"
        )


@dataclass(frozen=True)
class Exchanges:
    """Steps that end where the bath is exchanged, and nowhere beyond.

    method : of the steps between;  every : s
    """

    method: RungeKutta
    every: float

    def choose_first_step(self, problem, state, end: float) -> float:  # type: ignore[no-untyped-def]
        """As the method does, not beyond the first exchange."""
        return min(self.method.choose_first_step(problem, state, end), self.every)

    def advance(self, problem, course: Course, target: float) -> None:  # type: ignore[no-untyped-def]
        """One step of the method towards `target` or the next exchange."""
        count = math.floor(course.state.time / self.every * (1 + 1e-12) + 1e-9) + 1
        self.method.advance(problem, course, min(target, count * self.every))
