"""How time is stepped: the choice of a scheme and of its control, and the arithmetic of steps.

It needs the standard library alone, so that choices can be read without the solvers; the schemes
themselves are in engine.march.runge_kutta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

GAMMA = 1.0 - math.sqrt(0.5)
"""Diagonal of the two-stage, stiffly accurate, L-stable SDIRK method of order two
(Alexander 1977)."""

SCHEMES = ("forward_euler", "backward_euler", "sdirk2")


@dataclass(frozen=True)
class TimeStepping:
    """How time is stepped.

    Parameters
    ----------
    scheme : {"sdirk2", "backward_euler", "forward_euler"}
    step : float, optional
        Fixed step, s (shortened evenly so that output times are hit, and where a surface that
        moves would leave what it takes away behind in one step).  Without it the step is
        controlled so that the rates (of corrosion: the metal's loss rate) change by about
        `rate_change` within a step.  An explicit step follows its stability limit (no metal node
        loses more than `rate_change` of what it has); a fixed one above the limit is refused,
        also when dissolving nodes lower the limit during the march.
    rate_change : float
        Target of the control, relative; the error of a first-order step relative to what the
        step dissolves is about this, that of the second-order one about its square.
    first_step : float, optional
        First controlled step, s (default: chosen from the fastest rate).
    """

    scheme: str = "sdirk2"
    step: float | None = None
    rate_change: float = 0.05
    first_step: float | None = None

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise ValueError(f"scheme: {self.scheme!r}; allowed: {', '.join(SCHEMES)}")
        for name in ("step", "first_step"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} s; it must be finite and positive")
        if not 0 < self.rate_change <= 1:
            raise ValueError(f"rate_change: {self.rate_change}; it must be in (0, 1]")

    @property
    def controlled(self) -> bool:
        """Whether the measured change of the rates sets the step."""
        return self.step is None and self.scheme != "forward_euler"


def step_towards(now: float, target: float, step: float) -> float:
    """The step to take so that `target` is hit exactly without a sliver of a last step."""
    remaining = target - now
    return remaining / max(1, math.ceil(remaining / step * (1 - 1e-9)))


def next_step(step: float, change: float, wanted: float) -> float:
    """A controlled step from the measured relative change of the rate (growth at most 2)."""
    return step * min(2.0, max(0.2, 0.9 * wanted / max(change, 1e-12)))


def time_after(now: float, step: float, target: float) -> float:
    """now + step, or the target itself where that is meant."""
    return target if abs(now + step - target) < 1e-9 * step else now + step
