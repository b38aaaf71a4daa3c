"""How the top grip moves: pulled along z, turned about z, or turned about a lateral axis.

Each load is a rigid motion of the top grip with one amount (elongation or angle) and the reaction
that does work on it (force, torque or moment).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fem.solid import Held

LOADS = ("axial", "torsion", "bending")


@dataclass(frozen=True)
class Pull:
    """The grips are drawn apart along z.

    extent: elongation per unit of nominal strain, the length between the grips [m].
    """

    extent: float
    motion = "elongation"  # [m]
    reaction, unit = "force", "N"
    floats = False

    def displacement(self, coordinates: np.ndarray, amount: float) -> np.ndarray:
        """Displacement (n, 3) [m] of nodes of the grip at an elongation [m]."""
        return amount * self.derivative(coordinates, amount)

    def derivative(self, coordinates: np.ndarray, amount: float) -> np.ndarray:
        """Change of the displacement with the elongation, (n, 3)."""
        return np.tile([0.0, 0.0, 1.0], (len(coordinates), 1))


@dataclass(frozen=True)
class Turn:
    """The top grip turns rigidly about `axis`; the bottom grip is held fully.

    The grip floats: its translation follows from the condition that the reaction is a pure couple,
    so torsion leaves no axial force and bending no shear, the moment is the same in all sections,
    and it does not matter where the axis lies. x = centre + c + R(angle) (X - centre), R by
    Rodrigues' formula; the work of the couple is the integral of its component along the axis over
    the angle. extent: angle per unit of nominal strain, length over radius [rad].
    """

    extent: float
    axis: tuple[float, float, float]  # of unit length
    centre: tuple[float, float, float]  # [m]; near the grip for the sake of round-off
    reaction: str  # "torque" or "moment"
    motion = "angle"  # [rad]
    unit = "N m"
    floats = True

    def displacement(self, coordinates: np.ndarray, amount: float) -> np.ndarray:
        """Displacement (n, 3) [m] of nodes of the grip turned by an angle [rad], with c = 0."""
        arm = coordinates - np.array(self.centre)
        across = np.cross(self.axis, arm)
        # 1 - cos without cancellation at small angles
        return np.sin(amount) * across + 2.0 * np.sin(0.5 * amount) ** 2 * np.cross(
            self.axis, across
        )

    def derivative(self, coordinates: np.ndarray, amount: float) -> np.ndarray:
        """Change of the displacement with the angle, (n, 3) [m]."""
        across = np.cross(self.axis, coordinates - np.array(self.centre))
        return np.cos(amount) * across + np.sin(amount) * np.cross(self.axis, across)


Load = Pull | Turn


def make_load(name: str, azimuth: float, points: np.ndarray, cells: np.ndarray, held: Held) -> Load:
    """The load called `name` on the whole solid, corroded or not.

    points (n, 3) [m]; cells (nc, 4); azimuth [rad]: angle from x to the axis about which "bending"
    turns the grip. The radius that relates angle and nominal strain is the largest distance of a
    vertex from the line through the centroid along z.
    """
    length = held.length
    if name == "axial":
        return Pull(length)
    corners = points[cells]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    centroid = volumes @ corners.mean(axis=1) / volumes.sum()
    radius = float(np.hypot(*(points - centroid)[:, :2].T).max())
    centre = points[held.at_top(points)].mean(axis=0)
    if name == "torsion":
        return Turn(length / radius, (0.0, 0.0, 1.0), tuple(map(float, centre)), "torque")
    axis = (float(np.cos(azimuth)), float(np.sin(azimuth)), 0.0)
    return Turn(length / radius, axis, tuple(map(float, centre)), "moment")


class MovingGrip:
    """The nodes of the top grip on this rank and their motion."""

    def __init__(
        self, comm: MPI.Comm, load: Load, coordinates: np.ndarray, held: np.ndarray, owned: int
    ) -> None:
        """coordinates: (n, 3) of the local nodes; held: (n, 3) bool, unknowns moved by the grip."""
        self.comm, self.load, self.held, self.owned = comm, load, held, owned
        self.nodes = np.flatnonzero(held.any(axis=1))
        self._coordinates = coordinates[self.nodes]
        self._mine = self.nodes < owned
        self.count = int(comm.allreduce(int(self._mine.sum())))

    def place(self, displacement: np.ndarray, amount: float) -> np.ndarray:
        """A displacement (n, 3) with the grip's nodes moved to where `amount` has them, exactly.

        A floating grip keeps the mean displacement of its nodes.
        """
        exact = self.load.displacement(self._coordinates, amount)
        if self.load.floats:
            apart = (displacement[self.nodes] - exact)[self._mine].sum(axis=0)
            exact += self.comm.allreduce(apart) / self.count
        placed = displacement.copy()
        held = self.held[self.nodes]
        placed[self.nodes] = np.where(held, exact, displacement[self.nodes])
        return placed

    def derivative(self, amount: float) -> np.ndarray:
        """Change of the displacement with the amount, (n, 3), zero outside the grip."""
        result = np.zeros(self.held.shape)
        result[self.nodes] = self.load.derivative(self._coordinates, amount)
        return np.where(self.held, result, 0.0)

    def translations(self) -> np.ndarray:
        """Unit translations that the grip is free to make, (3, n, 3); (0, n, 3) for none."""
        if not self.load.floats:
            return np.zeros((0, *self.held.shape))
        return np.eye(3)[:, None, :] * self.held.any(axis=1)[None, :, None]
