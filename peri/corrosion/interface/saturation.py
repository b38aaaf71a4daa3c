"""What happens at a liquid node that reaches the saturation concentration.

Complementarity (default): one factor theta_j in [0, 1] scales all interface bonds of liquid node
j, with 0 <= 1 - theta_j  perpendicular to  C_sat - C_j >= 0.  The active nodes are those held at
C_sat; their theta follows from their own balance.  A primal-dual active set.

as_published: Algorithm 1 of the dissertation, made symmetric: every interface bond of a metal
node that sees a liquid node at or above C_sat is off for the step.  Its result depends on the
step; it is kept for comparison.
"""

from __future__ import annotations

import math

import numpy as np


def next_active_set(
    active: np.ndarray,
    concentration: np.ndarray,
    needed: np.ndarray,
    available: np.ndarray,
    saturation_concentration: float,
    stiffness: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """One primal-dual step: the new active set and theta on it.

    active : bool array, nodes held at C_sat in the last solution.
    concentration : array, mol/m^3.
    needed, available : arrays, the interface inflow that keeps a node at C_sat, and the inflow
        that its bonds would carry with theta = 1 (mol/(m^3 s) times relative volume).
    stiffness : how often a node's content flows off in the step.  What it has beyond C_sat counts
        with what leaves it for that, so that it is no source for those held at C_sat.

    Returns
    -------
    active, theta : an active node stays while what it needs does not exceed what is available;
        a free node joins when it exceeds C_sat.
    """
    stays = active & (needed <= available) & (available > 0)
    beyond = (concentration - saturation_concentration) * (1.0 + stiffness)
    joins = ~active & (beyond > 1e-12 * saturation_concentration)
    ratio = np.divide(needed, available, out=np.ones_like(needed), where=available > 0)
    # Not clipped at zero: a need that is negative by round-off stays in the mass balance.
    theta = np.where(stays, np.minimum(ratio, 1.0), 1.0)
    # A node that joins starts from full bonds; the next round computes its theta.
    return stays | joins, theta


class Stall:
    """Whether rounds of the active set have stopped to get anywhere.

    A stage without a solution (a right side above C_sat) makes the same nodes join and leave in
    turn: for a few rounds neither their number nor the inflow in dispute falls.
    """

    def __init__(self, patience: int = 4) -> None:
        self.patience, self.idle = patience, 0
        self.changes, self.mismatch = math.inf, math.inf

    def after(self, changes: int, mismatch: float) -> bool:
        """True when the last `patience` rounds brought nothing.

        changes : nodes that joined or left.  mismatch : amount in dispute.
        """
        better = changes == 0 or changes < self.changes or mismatch < 0.9 * self.mismatch
        self.idle = 0 if better else self.idle + 1
        self.changes = min(self.changes, changes)
        self.mismatch = min(self.mismatch, mismatch)
        return self.idle >= self.patience


def published_switch(saturated_neighbours: np.ndarray, metal: np.ndarray) -> np.ndarray:
    """Metal nodes whose interface bonds are on: those that see no saturated liquid node."""
    return metal & (saturated_neighbours <= 0)
