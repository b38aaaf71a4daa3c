"""B-splines of a thread: its profile in pieces, a turn of a helix, where turns may meet.

NumPy and SciPy only, lengths in mm; ``pipeline.geometry.solids`` makes surfaces of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from pipeline.scene.screw import ScrewParameters

MM = 1e3  # model units per m
TURN_INTERVALS = 24  # cubic pieces per turn: the helix is off by 1e-5 of its radius at most
ROOT_INTERVALS = 4  # per half of the root


@dataclass(frozen=True)
class ProfilePiece:
    """One piece of the profile in the (radius, axial distance) plane: a B-spline, mm.

    knots are arc length, so that a surface has nearly the metric of its parameters: gmsh meshes
    such a surface well, and a strip 0.1 mm by 6 mm with knots in [0, 1] badly.
    """

    knots: np.ndarray
    degree: int
    radii: np.ndarray
    heights: np.ndarray


@dataclass(frozen=True)
class HelixTurn:
    """One turn of a unit helix as cubic B-spline: knots and Greville angles from 0 (rad), poles."""

    knots: np.ndarray
    angles: np.ndarray
    sine: np.ndarray
    cosine: np.ndarray


def helix_turn(start: float) -> HelixTurn:
    """The turn that begins at the angle ``start`` (rad)."""
    sine, cosine = sine_and_cosine(start, start + 2 * math.pi, TURN_INTERVALS)
    knots = cosine.t - start
    angles = np.array([knots[k + 1 : k + 4].mean() for k in range(len(cosine.c))])
    return HelixTurn(knots, angles, sine.c, cosine.c)


def line_piece(height0: float, height1: float, radius0: float, radius1: float) -> ProfilePiece:
    """A straight piece between two points of the (radius, axial distance) plane."""
    length = math.hypot(height1 - height0, radius1 - radius0)
    knots = np.array([0.0, 0.0, length, length])
    return ProfilePiece(knots, 1, np.array([radius0, radius1]), np.array([height0, height1]))


def profile_pieces(screw: ScrewParameters) -> list[ProfilePiece]:
    """Crest, flank, two halves of the root, flank of one pitch from u = -crest/2, as B-splines.

    The root is halved so that meshes have nodes on its bottom; a chord across the whole root
    would add 1 % to the volume.
    """
    half, flank, pitch = (v * MM for v in (screw.crest_width / 2, screw.flank_width, screw.pitch))
    outer, inner = screw.diameter / 2 * MM, screw.minor_diameter / 2 * MM

    middle = pitch / 2
    if screw.root_depth == 0.0:
        halves = [
            line_piece(half + flank, middle, inner, inner),
            line_piece(middle, pitch - half - flank, inner, inner),
        ]
    else:
        radius = screw.root_radius * MM
        centre = screw.root_diameter / 2 * MM + radius
        angle = math.asin(screw.root_width * MM / 2 / radius)

        def arc(start: float, end: float) -> ProfilePiece:
            sine, cosine = sine_and_cosine(start, end, ROOT_INTERVALS)
            knots = (sine.t - start) * radius
            return ProfilePiece(knots, 3, centre - radius * cosine.c, middle + radius * sine.c)

        halves = [arc(-angle, 0.0), arc(0.0, angle)]
    return [
        line_piece(-half, half, outer, outer),
        line_piece(half, half + flank, outer, inner),
        *halves,
        line_piece(pitch - half - flank, pitch - half, inner, outer),
    ]


def sine_and_cosine(start: float, end: float, intervals: int) -> tuple[BSpline, BSpline]:
    """Cubic splines through sine and cosine, end slopes exact."""
    angle = np.linspace(start, end, intervals + 1)

    def spline(values: np.ndarray, slope_start: float, slope_end: float) -> BSpline:
        ends = ([(1, slope_start)], [(1, slope_end)])
        return make_interp_spline(angle, values, k=3, bc_type=ends)

    sine = spline(np.sin(angle), math.cos(start), math.cos(end))
    cosine = spline(np.cos(angle), -math.sin(start), -math.sin(end))
    return sine, cosine


def multiplicities(knots: np.ndarray) -> tuple[list[float], list[int]]:
    """Distinct knots and how often each occurs."""
    values, counts = np.unique(np.round(knots, 12), return_counts=True)
    return values.tolist(), counts.tolist()


def seam_angle(screw: ScrewParameters) -> float:
    """The angle where turns meet, as far as can be from the corners that the ends cut.

    Where seam, end plane and an edge of the profile nearly meet, gmsh would find a tiny edge.
    """
    candidates = (np.arange(360) + 0.5) * 2 * math.pi / 360
    clearance = np.full(candidates.shape, np.inf)
    for height in (0.0, screw.length, screw.length - screw.slot_depth):
        axial = height - screw.crest_height - screw.pitch * candidates / (2 * math.pi)
        for offset, _ in screw.edges:
            gap = np.mod(axial - offset + screw.pitch / 2, screw.pitch) - screw.pitch / 2
            clearance = np.minimum(clearance, np.abs(gap))
    # and away from the walls of the slot
    radius = screw.root_diameter / 2
    wall = np.abs(np.abs(np.sin(candidates)) * radius - screw.slot_width / 2)
    clearance[wall < screw.slot_width / 4] = 0.0
    return float(candidates[int(np.argmax(clearance))])
