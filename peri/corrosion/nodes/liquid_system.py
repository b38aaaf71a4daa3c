"""The liquid's linear system in a stage: who is solved for, what metal and pores add."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from peri.corrosion.interface.exchange import Exchange
from peri.corrosion.nodes.pores import Pores
from peri.corrosion.nodes.rates import InterfaceRates
from peri.engine import kernels
from peri.engine.solvers import DiffusionSystem

_FEW = 0.2
"""Of the nodes held at C_sat: while fewer have joined or left, the preconditioner stays.  It takes
4 to 7 % more iterations and 0.75 to 0.85 of the time (`pitting-step` on 96 x 96 x 64)."""
_LITTLE = 0.1
"""Of its content, what a metal node may exchange in a stage for what it returns to be left out of a
round that shrinks the residual by no more than that."""


@dataclass
class Right:
    """What a stage starts from, on padded arrays of the lattice: right side and step (s).

    pores : liquid in the metal's emptied share, where the scene has it.
    """

    old: np.ndarray
    tau: float
    pores: Pores | None = None


class MetalShare:
    """What liquid gives to the metal beside it, and what comes back from there.

    A metal node returns the share q / (1 + q) of what it receives in a stage that exchanges q times
    its content.  Where that is little, a round that only has to come closer may go without
    (`roughly`); the matrix stays symmetric and positive.

    unknown : padded box array, relative volume of the nodes that are solved for, else 0.
    """

    def __init__(self, d: InterfaceRates, unknown: np.ndarray, exchange: Exchange) -> None:
        self.d, self._exchange = d, exchange
        self._own = exchange.diagonal() * (unknown > 0)
        self._back = exchange.theta * unknown * exchange.rate
        self._returns = True

    def roughly(self) -> None:
        """Leave out what is returned, where it is little."""
        self._returns = self.d.processes.largest(self._exchange.turnover()) > _LITTLE

    def add(self, u: np.ndarray, y: np.ndarray) -> float:
        """y += the share of the matrix times u, padded arrays; returns its u . A u."""
        d = self.d
        if not self._returns:
            there, share = u[d.window], self._own[d.box.interior] * u[d.window]
            y[d.window] += share
            return float((share * there).sum())
        box_u = d.take(u)
        share = self._own * box_u - self._back * self._exchange.through_metal(box_u)
        y[d.window] += share[d.box.interior]
        return float(kernels.inner_product(share, box_u).sum())


class LiquidSystem:
    """The system round by round; its preconditioner stays while few nodes join or leave."""

    def __init__(self) -> None:
        self._system: DiffusionSystem | None = None
        self._held: np.ndarray | None = None
        """Nodes that the system does not solve for."""
        self._made: tuple[float, np.ndarray | None] | None = None
        """The step and those nodes that its preconditioner was made for."""
        self._metal: tuple[np.ndarray, float] | None = None
        """The metal's diagonal and its share of storage then."""

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._system = self._made = None

    def set_aside(self) -> None:
        """Give its memory back; a later stage makes it anew, the same to the last bit."""
        self._system = None

    def at(
        self,
        d: InterfaceRates,
        right: Right,
        exchange: Exchange | None,
        active: np.ndarray | None,
    ) -> tuple[DiffusionSystem, MetalShare | None]:
        """The system with the `active` nodes (padded box array) held, and the metal's share."""
        if self._strays(d, right, active):
            self._made, self._metal, self._system = (right.tau, active), None, None
            if exchange is not None:
                self._metal = exchange.diagonal().copy(), exchange.storage_share
        assert self._made is not None
        if d.processes.any(self._system is None):
            self._held = self._made[1]
            self._system = self._make(d, right, self._held)
        system = self._system
        assert system is not None
        if not _same(active, self._held):
            weight = _weight(d, active)
            system = self._system = system.with_weight(weight, self._metal_diagonal(d, weight))
            self._held = active
        share = None
        if exchange is not None and exchange.couples:
            share = MetalShare(d, d.take(system.weight), exchange)
        system.extra = None if share is None else share.add
        if right.pores is not None:
            system.extra = _storage(d, system, right.pores.volume / right.tau)
        return system, share

    def _strays(self, d: InterfaceRates, right: Right, active: np.ndarray | None) -> bool:
        """Whether the preconditioner at hand is none for this step and these nodes."""
        if self._made is None or self._made[0] != right.tau:
            return True
        before, total = self._made[1], d.processes.total
        if before is None or active is None:
            return before is not active
        changed = total(float((active != before).sum()))
        if d.walls is not None:  # they belong to the operator
            return changed > 0
        return changed > _FEW * total(float(before.sum()))

    def _metal_diagonal(self, d: InterfaceRates, weight: np.ndarray) -> np.ndarray | None:
        return None if self._metal is None else (weight > 0) * d.put(self._metal[0])

    def _make(self, d: InterfaceRates, right: Right, active: np.ndarray | None) -> DiffusionSystem:
        weight, diffusivity = _weight(d, active), d.scene.liquid_diffusivity
        diagonal = 1.0 / right.tau + diffusivity * d.neighbour_liquid
        sink = weight * (diagonal - diffusivity * d.flow(weight))
        if d.walls is not None:
            on = (weight > 0).astype(float)
            sink = sink + on * (d.walls.diagonal - d.walls.gain(on, np.zeros_like(on)))
        extra_diagonal = None
        if self._metal is not None:
            extra_diagonal = self._metal_diagonal(d, weight)
            sink = sink + extra_diagonal * self._metal[1]
        if right.pores is not None:
            extra_diagonal = (weight > 0) * d.put(right.pores.volume) / right.tau
            sink = sink + extra_diagonal
        return DiffusionSystem(
            d.flow,
            weight,
            diagonal,
            diffusivity,
            sink,
            extra_diagonal=extra_diagonal,
            walls=d.walls,
        )


def _same(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    if one is other or one is None or other is None:
        return one is other
    return np.array_equal(one, other)


def _weight(d: InterfaceRates, active: np.ndarray | None) -> np.ndarray:
    """Relative volume of the nodes that are solved for, padded."""
    weight = d.free_volume.copy()
    if active is not None:
        weight[d.window][active[d.box.interior]] = 0.0
    return weight


def _storage(
    d: InterfaceRates, system: DiffusionSystem, per_second: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], float]:
    """What pores add to the liquid's matrix, 1/s times relative volume, on the box."""
    share = np.where(d.take(system.weight) > 0, per_second, 0.0)[d.box.interior]

    def add(u: np.ndarray, y: np.ndarray) -> float:
        own = share * u[d.window]
        y[d.window] += own
        return float((own * u[d.window]).sum())

    return add
