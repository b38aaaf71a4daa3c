"""Refusals of a scene: one sentence that names field, value and what is allowed."""

import math
from collections.abc import Sequence

from perilife_data import did_you_mean
from pipeline.scene.units import ImmersionTime

YEAR = 365.25 * 86400.0
LONGEST_IMMERSION = 100 * YEAR
"""Seconds; longer than a person carries an implant is a slip in a unit."""
MOST_STEPS = 1_000_000
"""Fixed time steps of a march; raising it allows runs of months and more."""


class SceneError(ValueError):
    """A scene that cannot be computed; the message names field, value and what is allowed."""


def check(condition: bool, name: str, value: object, allowed: str) -> None:
    """Raise SceneError with field, value and what is allowed unless the condition holds."""
    if not condition:
        raise SceneError(f"{name} is {value}; it must be {allowed}")


def at_most(value: float, limit: float) -> bool:
    """Whether a value is at most a positive limit, or above it by round-off only."""
    return value <= limit * (1.0 + 1e-9)


def positive(name: str, value: float) -> None:
    """Raise SceneError unless the value is finite and above 0."""
    check(math.isfinite(value) and value > 0, name, value, "a finite number above 0")


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise SceneError unless the value is among the allowed ones."""
    near = did_you_mean(value, allowed)
    check(value in allowed, name, f"'{value}'{near}", f"one of {', '.join(allowed)}")


def check_times(times: Sequence[ImmersionTime], step: float | None) -> None:
    """Raise SceneError unless immersion times rise and a fixed time step (s) suits the longest."""
    check(bool(times), "list of immersion times", "empty", "at least one time")
    seconds = [time.seconds for time in times]
    check(
        seconds[0] >= 0 and all(a < b for a, b in zip(seconds, seconds[1:], strict=False)),
        "list of immersion times",
        [time.label for time in times],
        "at least 0 and rising",
    )
    last = times[-1]
    check(
        last.seconds <= LONGEST_IMMERSION,
        "immersion time",
        f"{last.label}, {last.seconds / YEAR:.4g} years",
        f"at most {LONGEST_IMMERSION / YEAR:g} years",
    )
    if step is not None and last.seconds > 0:
        check(
            at_most(step, last.seconds) and at_most(last.seconds, MOST_STEPS * step),
            "corrosion step",
            f"{step:g} s",
            f"at most the longest immersion time, {last.label} or {last.seconds:g} s, and at least "
            f"{last.seconds / MOST_STEPS:g} s, a millionth of it",
        )
