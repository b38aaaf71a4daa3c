"""The mechanical test of a scene and its mesh, for each way of holding."""

import math
from dataclasses import dataclass

from fem.quadrature import ELEMENTS
from pipeline.scene.checks import at_most, check, one_of, positive
from pipeline.scene.loads import LOADS
from pipeline.scene.units import format_length

LATERAL = ("free", "clamped")
DAMAGE_UPDATES = ("point", "cell", "implicit")
"""How f grows; named as in fem.settings, which is slow to import."""
AUTO, NODES, EXPOSURES = "auto", "nodes", "exposures"
MAPPINGS = (AUTO, NODES, EXPOSURES)
"""How the lattice's loss comes to a point of the mesh: between the nodes, or by what it sees of the
liquid; auto: the latter where the scene can have it (pipeline.scene.mapping)."""

PULLED_FACE_CELLS = 50e-6
"""Edge length (m) at end faces that are pulled, unless it is given: about the published one.  The
layer that carries is as thick as these cells, so that the strength left is theirs: it is the same
with every preset."""


@dataclass(frozen=True)
class MeshSettings:
    """Edge length of the tetrahedra in the bulk and at thread and slot (m).

    size_bottom, size_top: within two of these lengths of an end face; None: as elsewhere.
    """

    size: float
    size_fine: float
    size_bottom: float | None = None
    size_top: float | None = None

    def __post_init__(self) -> None:
        positive("mesh size", self.size)
        smaller = {"fine": self.size_fine, "bottom": self.size_bottom, "top": self.size_top}
        for name, size in smaller.items():
            if size is None:
                continue
            positive(f"{name} mesh size", size)
            check(
                at_most(size, self.size),
                f"{name} mesh size",
                format_length(size),
                f"at most the mesh size, {format_length(self.size)}",
            )

    @property
    def size_ends(self) -> tuple[float | None, float | None]:
        """Edge lengths at the bottom and at the top end face (m)."""
        return self.size_bottom, self.size_top


@dataclass(frozen=True)
class TensileScene:
    """The mechanical test: load, element, nominal strain at the end, largest increment, grips.

    load: the top grip is pulled ("axial"), turned about the axis ("torsion") or about a lateral
    axis ("bending") at the angle bending_azimuth (rad) from x, None where nothing is bent; nominal
    strain is then that of the surface, angle times radius over length, and the grips hold fully.
    The length of a strain is that between the grips.
    bottom_grip, top_grip: held lengths at the ends (m), 0 holds the end faces only; lateral:
    whether grips leave lateral motion free; peak_drop: the test ends when the force (torque,
    moment) has fallen by this fraction below its peak, or at the final strain; 1 asks for the
    whole curve; damage, damage_length: how f grows and over which length (m) its growth is
    averaged (fem.settings); mapping: how f comes from the lattice to a point of the mesh, between
    the nodes (pipeline.stages.damage_map), by its exposure (pipeline.stages.doses), or the latter
    where that can be had.
    """

    element: str = "P2-Fbar"
    final_strain: float = 0.10
    increment: float = 0.005
    bottom_grip: float = 0.0
    top_grip: float = 0.0
    lateral: str = "free"
    peak_drop: float = 0.05
    damage: str = "point"
    damage_length: float = 0.0
    mapping: str = AUTO
    load: str = "axial"
    bending_azimuth: float | None = None

    def __post_init__(self) -> None:
        one_of("element", self.element, tuple(ELEMENTS))
        one_of("lateral", self.lateral, LATERAL)
        one_of("load", self.load, tuple(LOADS))
        check(
            self.load == "axial" or self.lateral == "clamped",
            "lateral",
            f"'{self.lateral}'",
            f"clamped where the load is {self.load}, which only grips that hold fully can apply",
        )
        azimuth = self.bending_azimuth
        check(
            azimuth is None or self.load == "bending",
            "bending azimuth",
            None if azimuth is None else f"{math.degrees(azimuth):g}deg",
            f"left out where the load is {self.load}",
        )
        check(azimuth is None or math.isfinite(azimuth), "bending azimuth", azimuth, "finite")
        one_of("damage", self.damage, DAMAGE_UPDATES)
        one_of("mapping", self.mapping, MAPPINGS)
        check(0 < self.peak_drop <= 1, "peak drop", self.peak_drop, "in (0, 1]")
        for name in ("bottom_grip", "top_grip", "damage_length"):
            value = getattr(self, name)
            check(math.isfinite(value) and value >= 0, name.replace("_", " "), value, "at least 0")
        check(
            self.damage_length == 0 or self.damage == "cell",
            "damage",
            self.damage,
            "cell where a damage length is given",
        )
        check(0 < self.final_strain <= 1, "final strain", self.final_strain, "in (0, 1]")
        check(
            0 < self.increment and at_most(self.increment, self.final_strain),
            "tensile increment",
            self.increment,
            f"above 0 and at most the final strain, {self.final_strain}",
        )


@dataclass(frozen=True)
class HoldScene:
    """One way of holding the solid (pipeline.scene.holding): its test and the mesh for it."""

    name: str
    mesh: MeshSettings
    tensile: TensileScene
