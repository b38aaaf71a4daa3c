"""What a march leaves out: one type for every physics, and how much may be left out.

It needs the standard library alone, so that choices can be read without the solvers.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

DEFAULT_TOLERANCE = 1e-3
"""Bound of the relative error up to which something is left out."""


@dataclass(frozen=True)
class Omission:
    """One thing that a scene could leave out.

    name : how to refuse it, where it can be refused.  reason : one sentence.  bound : of the
    relative error of what `of` says (infinite where it cannot be left out).  applied : whether the
    plan leaves it out.
    """

    name: str
    reason: str
    bound: float
    applied: bool
    of: str = "the volume loss"


def check_request(tolerance: float, refused: Collection[str], offered: Collection[str]) -> None:
    """Whether a tolerance and the names that are refused make sense.

    Raises
    ------
    ValueError
        For a tolerance outside [0, 1) or a name in `refused` that is not offered.
    """
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance: {tolerance}; it must be from 0 to below 1")
    unknown = set(refused) - set(offered)
    if unknown:
        raise ValueError(f"refused: {sorted(unknown)}; known: {', '.join(offered)}")
