"""How a tensile test is run: every numerical choice, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fem.loading import LOADS
from fem.quadrature import find_element
from fem.solid import Grips
from fem.solvers import SOLVERS

MORE_TRIED, TRIED_EACH = 300, 10
"""Of `TensileSettings.most_tried`: raising them costs time where a test gets nowhere. Measured by
slotted sections of Mg-5Gd and Mg-10Gd with every hardening record: 8 to 50 increments tried where
the largest size would do with 5; a waisted bar of two metals, one 1e6 times stiffer, takes 248 of
P1-Fbar (`tests/extreme/test_tensile_extreme.py`)."""

DAMAGE_UPDATES = ("point", "cell", "implicit")


@dataclass(frozen=True)
class TensileSettings:
    """How the test is run. Strains are elongation over the free length between the grips.

    load: how the top grip moves: "axial" (the tensile test), "torsion" (it turns about z) or
    "bending" (it turns about the lateral axis at the angle `bending_azimuth` [rad] from x; of two
    directions the weaker one counts in a slotted or unevenly corroded solid). For these two, strain
    is the nominal one of the surface, angle times radius over that length (`fem.loading`), both
    grips hold their nodes fully whatever `grips.lateral` says, and the peak is that of torque or
    moment.

    lag_tolerance: share of the reaction that it may be off because f, which is foreseen, lags in an
    increment (fem/README.md). Increments after `first_increment` are sized for it, between
    `minimum_increment` and `maximum_increment`; one of four times as much is taken anew, shorter.
    inf: only the iterations of Newton's method count.

    element: "P1", "P1-Fbar", "P2" or "P2-Fbar". The test ends at `maximum_strain`, or, unless
    `full_curve`, once the force has fallen by the fraction `peak_drop` below its peak, or after
    `most_tried` increments, those without equilibrium included (None: `MORE_TRIED` and
    `TRIED_EACH` for every one of the largest size; a test that loses cell after cell creeps on in
    ever smaller ones). `tolerance`
    is that of the residual force relative to the largest reaction. threads: None takes the
    processors there are when the communicator has one rank, and one otherwise.

    linear_solver: "auto", or what is tried first (`fem.solvers`): "pmg" (two-level multigrid of the
    ten-node elements, the default for them), "mumps" (factorisation), "gamg" (aggregation).

    damage: how f grows: "point" (at each quadrature point, foreseen before each increment), "cell"
    (one f per cell, likewise: sound metal softens with the corroded metal of its cell) or
    "implicit" (per point and within the increment, as published; where corroded metal tears, tests
    hardly ever get to their peak with it). damage_length [m]: the
    growth of f is averaged over it (`fem.damage_length`; only with "cell"); 0 does not average.
    """

    element: str = "P2"
    maximum_strain: float = 0.1
    first_increment: float = 0.002
    maximum_increment: float = 0.005
    minimum_increment: float = 1e-6
    lag_tolerance: float = 0.0015
    most_tried: int | None = None
    peak_drop: float = 0.02
    full_curve: bool = False
    tolerance: float = 1e-5
    maximum_iterations: int = 12
    linear_solver: str = "auto"
    damage: str = "point"
    damage_length: float = 0.0
    load: str = "axial"
    bending_azimuth: float = 0.0
    grips: Grips = field(default_factory=Grips)
    threads: int | None = None

    def __post_init__(self) -> None:
        find_element(self.element)
        for name, low, high in (
            ("maximum_strain", 0.0, 10.0),
            ("first_increment", 0.0, 10.0),
            ("maximum_increment", 0.0, 10.0),
            ("minimum_increment", 0.0, 10.0),
            ("lag_tolerance", 0.0, np.inf),
            ("peak_drop", 0.0, 1.0),
            ("tolerance", 0.0, 0.1),
        ):
            value = getattr(self, name)
            if not low < value <= high:
                raise ValueError(
                    f"tensile {name} is {value}; it must be above {low} and at most {high}"
                )
        if not self.minimum_increment <= self.first_increment:
            raise ValueError(
                f"tensile first_increment is {self.first_increment}; it must be at least "
                f"minimum_increment, {self.minimum_increment}"
            )
        if self.most_tried is not None and self.most_tried < 1:
            raise ValueError(f"tensile most_tried is {self.most_tried}; it must be at least 1")
        if self.maximum_iterations < 1:
            raise ValueError(f"tensile maximum_iterations is {self.maximum_iterations}; at least 1")
        if self.linear_solver not in SOLVERS:
            raise ValueError(
                f"tensile linear_solver is {self.linear_solver!r}; allowed are {', '.join(SOLVERS)}"
            )
        if self.linear_solver == "pmg" and find_element(self.element).order == 1:
            raise ValueError(
                f"tensile linear_solver is 'pmg'; element {self.element} has no coarser one, "
                "P2 and P2-Fbar have"
            )
        if self.load not in LOADS:
            raise ValueError(f"tensile load is {self.load!r}; allowed are {', '.join(LOADS)}")
        if not np.isfinite(self.bending_azimuth):
            raise ValueError(
                f"tensile bending_azimuth is {self.bending_azimuth}; it must be an angle in rad"
            )
        if self.damage not in DAMAGE_UPDATES:
            raise ValueError(
                f"tensile damage is {self.damage!r}; allowed are {', '.join(DAMAGE_UPDATES)}"
            )
        if not 0.0 <= self.damage_length < np.inf:
            raise ValueError(
                f"tensile damage_length is {self.damage_length}; it must be a length in m or zero"
            )
        if self.damage_length > 0.0 and self.damage != "cell":
            raise ValueError(
                f"tensile damage is {self.damage!r}; a damage_length is only allowed with 'cell'"
            )
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"tensile threads is {self.threads}; it must be at least 1")

    @property
    def tries(self) -> int:
        """`most_tried`, or what stands for it."""
        largest = math.ceil(self.maximum_strain / self.maximum_increment)
        return self.most_tried or MORE_TRIED + TRIED_EACH * largest

    @property
    def lateral_free(self) -> bool:
        """Whether the grips let their nodes move laterally."""
        return self.load == "axial" and self.grips.lateral == "free"
