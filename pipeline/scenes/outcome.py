"""What a scene is made of and what its run gives, whatever its physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from peri.engine.lattice import Lattice
from peri.engine.results import Field


@dataclass(frozen=True)
class Value:
    """A number of a scene: SI, with its source (a key of references.bib, or in words) and kind."""

    value: float | str
    unit: str
    source: str
    where: str
    kind: str


@dataclass(frozen=True)
class Curve:
    """A line of a plot: x and y, and its name; a scene's own units.  dots: no line, points."""

    name: str
    x: np.ndarray
    y: np.ndarray
    dots: bool = False


@dataclass(frozen=True)
class Panel:
    """One set of axes with its curves."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    logarithmic: bool = False


@dataclass(frozen=True)
class Outcome:
    """A run.

    times : s.  fields : on the lattice, time first.  history : per step.  units : of each of its
    columns.  summary : name -> (value, unit), what one wants to know first.  panels : of the plot.
    """

    lattice: Lattice
    times: np.ndarray
    fields: Mapping[str, Field]
    history: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    summary: Mapping[str, tuple[float, str]]
    panels: Sequence[Panel]
    wall_time: float


class March(Protocol):
    """Marches a scene to its times."""

    def __call__(
        self,
        times: Sequence[float],
        *,
        checkpoint: Path | None = None,
        resume: bool = False,
        progress: Callable[[float, str], None] | None = None,
    ) -> Outcome:
        """The outcome at the times (s)."""


@dataclass(frozen=True)
class Prepared:
    """A scene, checked and ready: its values for the record, its times and its march."""

    values: Mapping[str, Value]
    march: March
    assumed: Sequence[str] = field(init=False)

    def __post_init__(self) -> None:
        names = [name for name, v in self.values.items() if v.kind in ("assumed", "fitted")]
        object.__setattr__(self, "assumed", tuple(names))
