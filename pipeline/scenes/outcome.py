"""What a scene is made of and what its run gives, whatever its physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from peri.corrosion.run import CorrosionResult
from peri.corrosion.run import corrode as march_metal
from peri.coupled.galvanic import GalvanicResult
from peri.coupled.galvanic import corrode as march_couple
from peri.engine.lattice import Lattice
from peri.engine.omission import Omission
from peri.engine.results import Field
from perilife_data import TO_BE_LISTED


@dataclass(frozen=True)
class Value:
    """A value of a scene: SI, with its source (a key of references.bib, or in words) and kind."""

    value: float | str | list[float]
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
class Section:
    """A picture of values over a section, grey where they are NaN (no liquid).

    values : (nx, ny).  x, y : places of the nodes along its axes.  of : what the values are.
    """

    title: str
    along: str
    across: str
    x: np.ndarray
    y: np.ndarray
    values: np.ndarray
    of: str


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
    panels: Sequence[Panel | Section]
    wall_time: float


@dataclass(frozen=True)
class Marchers:
    """What marches a metal and what a couple: this process, or ranks (pipeline.scenes.ranks)."""

    metal: Callable[..., CorrosionResult] = march_metal
    couple: Callable[..., GalvanicResult] = march_couple


HERE = Marchers()
"""This process."""


class March(Protocol):
    """Marches a scene to its times."""

    def __call__(
        self,
        times: Sequence[float],
        *,
        checkpoint: Path | None = None,
        resume: bool = False,
        progress: Callable[[float, str], None] | None = None,
        by: Marchers = HERE,
    ) -> Outcome:
        """The outcome at the times (s)."""


@dataclass(frozen=True)
class Prepared:
    """A scene, checked and ready.

    values : for the record, by their keys.  march : to its times.  beside : values of data files
    that it uses, those alone, by name.  reductions : what it need not compute until a time (s).
    size : of what is computed, in words.  alone : why one process computes it; empty where ranks
    may, too.  nodes : of the lattice that is marched, 0 where there is none.
    """

    values: Mapping[str, Value]
    march: March
    beside: Mapping[str, Value] = field(default_factory=dict)
    reductions: Callable[[float], list[Omission]] = field(default=lambda end: [])
    size: str = ""
    alone: str = ""
    nodes: int = 0

    @property
    def assumed(self) -> dict[str, Value]:
        """The values in use that are assumed, fitted or known to be wrong, by name."""
        every = {**self.values, **self.beside}
        return {name: v for name, v in every.items() if v.kind in TO_BE_LISTED}
