"""The parametric screw: its parameters, its ISO profile, and volume and area by integration.

Nothing here uses a CAD kernel: what is computed from the parameters is the independent check of
what ``pipeline.geometry.solids`` builds.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields

import numpy as np

from perilife_data import did_you_mean

THREADS = ("helical", "grooves", "none")


@dataclass(frozen=True)
class ScrewParameters:
    """Headless screw along z: flat faces at z = 0 and z = length, a slot across the upper one.

    Lengths in m, angles in rad. The defaults are the reference screw M2 x 4 mm with a slot of
    0.5 x 0.5 mm and the ISO metric coarse thread (pitch 0.4 mm, d 2.000, d1 1.567, d3 1.509 mm).
    ``minor_diameter`` (d1, where the flanks end) and ``root_diameter`` (d3, the bottom of the
    rounded root) follow from diameter and pitch (d - 1.082532 P and d - 1.226869 P, ISO 68-1 and
    ISO 965-1) where they are None; both are rounded to the micrometre as in the tables.

    thread: ``helical`` (right-handed), ``grooves`` (the same profile as closed rings) or ``none``
    (a plain pin with the cross-section area of the helical thread, so that all three carry the
    same metal: 1.755 mm for the reference screw).
    """

    diameter: float = 2.0e-3
    length: float = 4.0e-3
    pitch: float = 0.4e-3
    thread: str = "helical"
    thread_angle: float = math.radians(60.0)
    minor_diameter: float | None = None
    root_diameter: float | None = None
    slot_width: float = 0.5e-3
    slot_depth: float = 0.5e-3

    def __post_init__(self) -> None:
        _check_types(self)
        _range(self, "diameter", 1e-4, 0.1)
        _range(self, "length", 0.1 * self.diameter, 50 * self.diameter)
        if self.thread not in THREADS:
            raise ValueError(
                f"thread is {self.thread!r}{did_you_mean(self.thread, THREADS)}: allowed are "
                f"{', '.join(map(repr, THREADS))}."
            )
        _range(self, "pitch", self.diameter / 20, self.diameter / 2)
        angle = math.degrees(self.thread_angle)
        if not 20.0 <= angle <= 120.0:
            raise ValueError(f"thread_angle is {angle:.6g} degrees: allowed are 20 to 120 degrees.")
        if self.minor_diameter is None:
            object.__setattr__(
                self, "minor_diameter", _micrometre(self.diameter - 1.0825318 * self.pitch)
            )
        _range(self, "minor_diameter", 0.2 * self.diameter, 0.99 * self.diameter)
        if self.root_width <= 0.02 * self.pitch:
            allowed = self.diameter - (0.855 * self.pitch) / math.tan(self.thread_angle / 2)
            raise ValueError(
                f"minor_diameter is {self.minor_diameter * 1e3:.6g} mm: the flanks meet above it; "
                f"allowed for this pitch and thread_angle is {allowed * 1e3:.6g} mm or more."
            )
        if self.root_diameter is None:
            # 0.0722 P for ISO; less where a wide thread_angle leaves a narrow root
            depth = min(0.0721688 * self.pitch, 0.45 * self.root_width)
            object.__setattr__(self, "root_diameter", _micrometre(self.minor_diameter - 2 * depth))
        # deeper than a half circle the root would undercut the flank
        deepest = self.minor_diameter - self.root_width
        _range(
            self,
            "root_diameter",
            max(deepest, 0.1 * self.diameter),
            self.minor_diameter,
        )
        _range(self, "slot_width", 0.0, 0.8 * self.root_diameter)
        _range(self, "slot_depth", 0.0, 0.8 * self.length)
        if (self.slot_width == 0.0) != (self.slot_depth == 0.0):
            raise ValueError(
                f"slot_width is {self.slot_width * 1e3:.6g} mm and slot_depth "
                f"{self.slot_depth * 1e3:.6g} mm: allowed are both positive, or both 0 (no slot)."
            )

    @property
    def crest_width(self) -> float:
        """Axial width of the flat crest, P/8 (m)."""
        return self.pitch / 8

    @property
    def flank_width(self) -> float:
        """Axial width of one flank between d and d1 (m)."""
        return (self.diameter - self.minor_diameter) / 2 * math.tan(self.thread_angle / 2)

    @property
    def root_width(self) -> float:
        """Axial width of the rounded root at d1 (m); P/4 for the ISO profile."""
        return self.pitch - self.crest_width - 2 * self.flank_width

    @property
    def root_depth(self) -> float:
        """Depth of the rounded root below d1 (m)."""
        return (self.minor_diameter - self.root_diameter) / 2

    @property
    def root_radius(self) -> float:
        """Radius of the arc of the root (m, inf for a flat root); about 0.144 P for ISO."""
        if self.root_depth == 0.0:
            return math.inf
        return self.root_width**2 / (8 * self.root_depth) + self.root_depth / 2

    @property
    def has_slot(self) -> bool:
        return self.slot_depth > 0.0

    @property
    def pin_diameter(self) -> float:
        """Diameter (m) of the circle with the area of the thread's cross-section."""
        axial = (np.arange(20_000) + 0.5) / 20_000 * self.pitch
        return 2.0 * math.sqrt(float(np.mean(self.radius(axial, "helical") ** 2)))

    def radius(self, axial: np.ndarray, thread: str | None = None) -> np.ndarray:
        """Radius (m) of the profile at the axial distance ``axial`` (m) from a crest's middle."""
        axial = np.asarray(axial, dtype=float)
        if (thread or self.thread) == "none":
            return np.full(axial.shape, self.pin_diameter / 2)
        distance = np.abs(np.mod(axial + self.pitch / 2, self.pitch) - self.pitch / 2)
        flank_end = self.crest_width / 2 + self.flank_width
        slope = 1.0 / math.tan(self.thread_angle / 2)
        flank = self.diameter / 2 - np.maximum(distance - self.crest_width / 2, 0.0) * slope
        from_root = self.pitch / 2 - distance
        if self.root_depth == 0.0:
            root = np.full(axial.shape, self.minor_diameter / 2)
        else:
            sagitta = np.sqrt(np.maximum(self.root_radius**2 - from_root**2, 0.0))
            root = self.root_diameter / 2 + self.root_radius - sagitta
        return np.where(distance < flank_end, flank, root)

    @functools.cached_property
    def crest_height(self) -> float:
        """z (m) of the middle of a crest at angle 0, where plane cuts leave no tiny faces.

        Helical: the edges of the profile meet the planes of the slot's floor and mouth as far as
        can be from the slot's walls. Grooves: they stay far from the end planes and the floor.
        """
        floor = self.length - self.slot_depth
        crests = floor - (np.arange(400) + 0.5) / 400 * self.pitch
        if self.thread == "helical" and not self.has_slot:
            return floor - self.pitch / 8
        clearance = np.full(crests.shape, np.inf)
        for offset, radius in self.edges:
            if self.thread == "helical":
                wall = math.asin(self.slot_width / 2 / radius)
                angles = np.array([wall, -wall, math.pi + wall, math.pi - wall])
                levels = np.array([[floor], [self.length]]) - self.pitch * angles / (2 * math.pi)
            else:
                levels = np.array([0.0, floor, self.length])
            gap = levels.reshape(-1, 1) - crests - offset
            gap = np.abs(np.mod(gap + self.pitch / 2, self.pitch) - self.pitch / 2)
            clearance = np.minimum(clearance, gap.min(axis=0))
        return float(crests[int(np.argmax(clearance))])

    @property
    def edges(self) -> list[tuple[float, float]]:
        """Edges of the profile and the bottom of its root: axial distance from a crest, radius."""
        crest = self.crest_width / 2
        flank = crest + self.flank_width
        outer, minor, root = self.diameter / 2, self.minor_diameter / 2, self.root_diameter / 2
        sides = [(crest, outer), (-crest, outer), (flank, minor), (-flank, minor)]
        return [*sides, (self.pitch / 2, root)]

    def surface_radius(self, angle: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Radius (m) of the threaded surface at an angle (rad) about the axis and a z (m)."""
        angle, height = np.broadcast_arrays(angle, height)
        turn = angle / (2 * math.pi) if self.thread == "helical" else 0.0
        return self.radius(height - self.crest_height - self.pitch * turn)

    @property
    def smallest_feature(self) -> float:
        """Width (m) of the smallest thing that a lattice has to resolve.

        Counted are the slot's width and depth, the two prongs beside it, and the ridge of the
        thread at the pitch diameter, where ridge and groove are both P/2 wide; the flat of the
        crest, P/8, is part of the ridge and not a feature of its own.
        """
        sizes = [self.length, self.root_diameter]
        if self.has_slot:
            prong = (self.root_diameter - self.slot_width) / 2
            sizes += [self.slot_width, self.slot_depth, prong]
        if self.thread != "none":
            sizes.append(self.pitch / 2)
        return float(min(sizes))


def reference_volume_and_area(
    screw: ScrewParameters, angles: int = 1440, heights: int = 120
) -> tuple[float, float]:
    """Volume (m^3) and surface area (m^2) of the screw from its parameters alone.

    The body is star-shaped about its axis, so with r(angle, z) the radius of the surface
        V = int int r^2/2 dangle dz,  A_thread = int int sqrt(r_a^2 + r^2 (1 + r_z^2)) dangle dz,
    and for a slot |y| < w/2 the part of a cross-section inside it is int min(r, w/2/|sin a|)^2/2
    and the length of its two walls the derivative of that with respect to w/2. Midpoint rule;
    ``heights`` intervals per pitch. The default is within 1e-4 of the limit (measured
    by doubling both counts).
    """
    step_angle = 2 * math.pi / angles
    angle = (np.arange(angles) + 0.5) * step_angle
    if screw.thread == "none":
        heights = 1

    def layers(bottom: float, top: float) -> tuple[np.ndarray, float]:
        count = max(1, round((top - bottom) / screw.pitch * heights))
        return bottom + (np.arange(count) + 0.5) * (top - bottom) / count, (top - bottom) / count

    def lateral(radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        small = 1e-6 * screw.pitch
        slope = (
            screw.surface_radius(angle[None, :], height[:, None] + small)
            - screw.surface_radius(angle[None, :], height[:, None] - small)
        ) / (2 * small)
        turning = screw.pitch / (2 * math.pi) if screw.thread == "helical" else 0.0
        return np.sqrt((turning * slope) ** 2 + radius**2 * (1 + slope**2))

    def section(height: float) -> np.ndarray:
        return screw.surface_radius(angle, np.full(angles, height))

    volume = area = 0.0
    floor = screw.length - screw.slot_depth
    height, step = layers(0.0, floor)
    radius = screw.surface_radius(angle[None, :], height[:, None])
    volume += float(np.sum(radius**2)) / 2 * step_angle * step
    area += float(np.sum(lateral(radius, height))) * step_angle * step
    area += float(np.sum(section(0.0) ** 2)) / 2 * step_angle
    top = section(screw.length)
    area += float(np.sum(top**2)) / 2 * step_angle
    if screw.has_slot:
        half = screw.slot_width / 2
        sine = np.abs(np.sin(angle))
        clip = half / sine
        height, step = layers(floor, screw.length)
        radius = screw.surface_radius(angle[None, :], height[:, None])
        outside = radius > clip[None, :]
        kept = np.where(outside, radius**2 - clip[None, :] ** 2, 0.0)
        volume += float(np.sum(kept)) / 2 * step_angle * step
        area += float(np.sum(np.where(outside, lateral(radius, height), 0.0))) * step_angle * step
        walls = np.where(outside, half / sine[None, :] ** 2, 0.0)
        area += float(np.sum(walls)) * step_angle * step
        area += float(np.sum(np.minimum(section(floor), clip) ** 2)) / 2 * step_angle
        area -= float(np.sum(np.minimum(top, clip) ** 2)) / 2 * step_angle
    return volume, area


def _micrometre(length: float) -> float:
    return round(length * 1e6) * 1e-6


def _check_types(screw: ScrewParameters) -> None:
    for field in fields(screw):
        value = getattr(screw, field.name)
        if field.name == "thread" or (value is None and field.default is None):
            continue
        number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            raise ValueError(f"{field.name} is {value!r}: allowed is a finite number in SI units.")


def _range(screw: ScrewParameters, name: str, low: float, high: float) -> None:
    value = getattr(screw, name)
    if not low * (1 - 1e-12) <= value <= high * (1 + 1e-12):
        others = ", ".join(
            f"{other} {getattr(screw, other) * 1e3:.6g} mm"
            for other in ("diameter", "length", "pitch")
            if name not in ("diameter", other)
        )
        raise ValueError(
            f"{name} is {value * 1e3:.6g} mm: allowed are {low * 1e3:.6g} to {high * 1e3:.6g} mm"
            f"{f' ({others})' if others else ''}."
        )
