"""Refusals of a scene: one sentence that names field, value and what is allowed."""

import math

from perilife_data import did_you_mean


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
