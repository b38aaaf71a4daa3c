"""Dissolution at the rate of Faraday's law: every interface bond carries a given flux.

dC_i/dt = -k sum_j w_ij c_j theta_j over the liquid j, k = D_int C_solid g: the flux of a bond
does not depend on what its metal node still holds (Zhao et al. 2021, Eqs 16 to 20, with the sum
over the actual family in the place of its flat-front value f(z), so that each amount has a node
that receives it).  A flat front anywhere delivers i/(zF), and travels at i/(zF C_solid); under
the proportional law it is slower by ln(C_solid/C_sat) (reference.fronts.front_speed_ratio).

A node is metal until it is empty.  A stage that empties nodes treats each one as liquid for the
share of the stage that is left: without saturation a step of up to a layer is exact for a flat
front, because rates are constant between two such events.  What reaches an emptied node goes on to
the liquid beside it (FaradaicExchange), so that neither does a salt layer begin because a step is
long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from peri.corrosion.interface.exchange import Exchange
from peri.corrosion.laws import Discrete, InterfaceLaw
from peri.corrosion.metal.solids import Solid
from peri.corrosion.phases import Phases
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.problem import Attempt, Fields, Stage
from peri.engine.operators import NonlocalSum

_ROUNDS = 200
_TOLERANCE = 1e-12
_LATE = 4.0
"""Weight of what a step dissolves at an estimated time, as a change of the rate."""


class Faradaic(InterfaceLaw):
    """D_int w C_solid, until the metal node is empty."""

    name = "faradaic"
    saturations = ("complementarity", "none")
    schemes = ("backward_euler", "sdirk2")
    reaches = 2
    by_layers = True
    only = "implicit stages know when a node is empty; the published switch is the other law's"

    def liquid_below(self, scene: CorrosionScene) -> float:
        """0: a node is metal until it is empty."""
        return 0.0

    def lifetime(self, scene: CorrosionScene) -> float:
        """1, or less for a solid that holds less than the scene's."""
        return min(solid.concentration for solid in scene.solids) / scene.solid_concentration

    def share_of(self, solid: Solid, scene: CorrosionScene) -> float:
        """The flux itself is given."""
        return solid.rate

    def exchange(self, discrete: Phases, old: np.ndarray, tau: float) -> FaradaicExchange:
        """Bonds that carry a given flux."""
        return FaradaicExchange(discrete, old, tau)

    def gone(
        self, discrete: Discrete, concentration: np.ndarray, emptied: np.ndarray | None
    ) -> np.ndarray | None:
        """Metal that the step has emptied."""
        return emptied

    def check(self, discrete: Discrete, concentration: np.ndarray, time: float) -> None:
        """Liquid without a bound may not pass the metal."""
        highest = discrete.scene.highest_concentration * (1 + 1e-12)
        if discrete.processes.any(concentration.max() > highest):
            raise ValueError(
                "saturation: 'none' with dissolution 'faradaic'; the liquid fills beyond the "
                f"metal's concentration at {time:.4g} s, use 'complementarity'"
            )

    def continues(self, discrete: Discrete, first: Stage, right: Fields) -> bool:
        """Whether no node is empty at the first stage or negative in its right side."""
        negative = right["concentration"].min() < 0
        return not discrete.processes.any(negative or _any(first.extra.emptied))

    def admissible(self, discrete: Discrete, stages: Sequence[Stage]) -> bool:
        """Whether no node is empty."""
        return not discrete.processes.any(_any(stages[-1].extra.emptied))

    def change(self, discrete: Discrete, attempt: Attempt) -> float:
        """Of the loss in sum: a moving front hands its rate from node to node."""
        last, loss = attempt.stages[-1], attempt.old.numbers["volume_loss"]
        lost = last.numbers["volume_loss"] - loss
        change = 0.0
        if attempt.previous_step and lost > 0.1 * discrete.tolerance:
            before = loss - attempt.previous.numbers["volume_loss"]
            expected = attempt.step / attempt.previous_step * before
            change = abs(lost - expected) / lost
        return max(change, _LATE * last.extra.late)


def _any(emptied: np.ndarray | None) -> bool:
    """Whether a stage emptied nodes; None where there is no metal."""
    return emptied is not None and bool(emptied.any())


def _over(amount: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """amount / whole, 0 where there is none."""
    return np.divide(amount, whole, out=np.zeros_like(amount), where=whole > 0)


@dataclass(frozen=True)
class _Received:
    """What becomes of the inflow of nodes that a stage empties, an array over them each.

    opened : as FaradaicExchange.open.  kept : mol/m^3.  sent : share of the stage's inflow that is
    passed on.  passed : that amount over the node's bonds to liquid.
    """

    opened: np.ndarray
    kept: np.ndarray
    sent: np.ndarray
    passed: np.ndarray


class FaradaicExchange(Exchange):
    """Metal-liquid exchange of one stage whose bonds carry a given flux.

    An emptied node is liquid for the share of the stage that is left.  Of what it receives then it
    keeps (g + p C) / (1 + p), at most g and C_sat: g the whole gain, C the liquid beside it and p
    the number of times that diffusion renews it in that while.  The rest, at most p (C_sat - C),
    passes on to that liquid along its bonds, so that a long step withholds no current where there
    is no salt layer.

    open : share of the stage in which bonds to a node are open, less what saturated liquid holds
    back.  gained : what emptied nodes keep, mol/m^3.
    """

    couples = False

    def __init__(self, phases: Phases, old: np.ndarray, tau: float) -> None:
        super().__init__(phases, old, tau)
        self.open = np.zeros_like(self.old_metal)  # each `set` starts with that of the one before
        seen = phases.box_seen_liquid
        self._renewals = tau * phases.scene.liquid_diffusivity * phases.box_neighbour_liquid
        liquid = np.where(phases.box_metal, 0.0, self.old_metal)
        self._beside = _over(phases.box(phases.box_liquid_volume * liquid), seen)

    def set(self, theta: np.ndarray, rate: float, local: np.ndarray | float = 1.0) -> None:
        """Fix the saturation factors, D_int and the nodes' shares; find when each node is empty."""
        p, scene = self.p, self.p.scene
        self.theta = theta
        self.rate = rate * scene.solid_concentration
        self.bonds = theta * p.box_liquid_volume
        self.local = local
        drawn = self.tau * self.rate
        self._sent = self._passed = self._direct = self._left = None
        to_liquid = p.box(self.bonds)
        let_in = _over(to_liquid, p.box_seen_liquid)  # mean theta of the liquid that a node sees
        demand = drawn * local * to_liquid
        # Few nodes are emptied in a stage: only they and their bonds change in a round.
        carries = p.box_metal_volume * local
        each, need = np.broadcast_to(local, demand.shape).ravel(), demand.ravel()
        by_liquid, held = p.box_metal & (demand > self.old_metal), self.old_metal.ravel()
        volume, was_open = p.box_metal_volume.ravel(), self.open.ravel().copy()
        source, flow = (p.box_metal_volume * self.open), carries.copy()
        nodes = np.flatnonzero(was_open)
        for _ in range(_ROUNDS):
            near = self._near(nodes, by_liquid)
            wanted = need[near] + drawn * each[near] * p.box.at(source, near)
            empties = wanted > held[near]
            before, nodes = nodes, near[empties]
            if not p.processes.any(nodes.size > 0):
                # No node is open, those of the round before neither: metal goes on to none of them.
                if not p.processes.any(before.size > 0):
                    break
                source.ravel()[before] = was_open[before] = 0.0
                continue
            on = held[nodes] / wanted[empties]
            flow.ravel()[nodes] *= on
            inflow = drawn * p.box.at(flow, nodes)
            flow.ravel()[nodes] = carries.ravel()[nodes]
            parts = self._pass_on(nodes, 1.0 - on, inflow, let_in.ravel()[nodes])
            change = np.abs(parts.opened - was_open[nodes]).max(initial=0.0)
            was_open[nodes] = 0.0
            change = max(change, was_open[before].max(initial=0.0))
            was_open[before] = source.ravel()[before] = 0.0
            was_open[nodes] = parts.opened
            source.ravel()[nodes] = volume[nodes] * parts.opened
            if p.processes.largest(float(change)) <= _TOLERANCE:
                break
        need[near] = wanted
        self.demand, self.on = demand, p.box_metal.astype(float)
        self.emptied = np.zeros(demand.shape, bool)
        self.gained, self.open = np.zeros((2, *demand.shape))
        if p.processes.any(nodes.size > 0):
            self._sent, self._passed = np.zeros((2, *demand.shape))
            self.on.ravel()[nodes], self.emptied.ravel()[nodes] = on, True
            self.open.ravel()[nodes], self.gained.ravel()[nodes] = parts.opened, parts.kept
            self._sent.ravel()[nodes], self._passed.ravel()[nodes] = parts.sent, parts.passed
        self.weight = self.on * local

    def _near(self, opened: np.ndarray, by_liquid: np.ndarray) -> np.ndarray:
        """Metal nodes that may be emptied: by what the liquid takes, or beside opened ones."""
        p = self.p
        if not p.processes.whole:  # the opened nodes of the other blocks are not known here
            return np.flatnonzero(p.box_metal)
        near = by_liquid.copy()
        near.ravel()[p.box.around(opened)] = True
        return np.flatnonzero(near & p.box_metal)

    def _pass_on(
        self, nodes: np.ndarray, share: np.ndarray, inflow: np.ndarray, let_in: np.ndarray
    ) -> _Received:
        """Of nodes that are liquid for a share of the stage: keep some of it, pass on the rest.

        nodes : flat indices.  share, inflow, let_in : of each of them: of the stage, what it would
        receive in the whole of that, mol/m^3, and the share of what it passes on that the liquid
        takes.
        """
        p, scene = self.p, self.p.scene
        gain = share * inflow
        beside, renewals = self._beside.ravel()[nodes], share * self._renewals.ravel()[nodes]
        kept = np.minimum(gain, (gain + renewals * beside) / (1.0 + renewals))
        if scene.pores:
            kept = np.zeros_like(gain)  # its pores are full already
        passed = gain - kept
        if scene.saturation == "complementarity":
            most = scene.saturation_concentration
            kept = np.minimum(kept, most)
            passed = np.minimum(passed, renewals * np.maximum(most - beside, 0.0))
        sent = _over(passed, gain) * share
        opened = np.where(inflow > 0, _over(kept, inflow) + sent * let_in, share)
        return _Received(opened, kept, sent, _over(passed, p.box_seen_liquid.ravel()[nodes]))

    def metal_concentration(self, liquid: np.ndarray) -> np.ndarray:
        """C_i = old_i - tau k sum w c theta, at least 0; the liquid plays no part."""
        if self._left is None:
            value = self.old_metal - self.on * self.demand
            self._left = np.where(self.p.box_metal & ~self.emptied, value, 0.0)
        return self._left

    def liquid_gain(self, liquid: np.ndarray) -> np.ndarray:
        """Net interface inflow of the free liquid nodes; no content plays a part."""
        return self.theta * self.offered(liquid, liquid)

    def late(self) -> float:
        """Share of the stage's flux that nodes emptied late do not deliver.

        Late nodes are those that emptied ones expose: only when they empty is an estimate.
        """
        p = self.p
        if not p.processes.any(self.emptied.any()):
            return 0.0
        late = self.demand - self.tau * self.rate * self.local * p.box(self.bonds)
        lost = (1.0 - self.on) * late * p.box_metal_volume
        whole = p.processes.total(float((self.demand * p.box_metal_volume).sum()))
        return p.processes.total(float(lost.sum())) / whole if whole > 0 else 0.0

    def offered(self, metal: np.ndarray, liquid: np.ndarray | float) -> np.ndarray:
        """Interface inflow of the free liquid nodes with theta = 1."""
        return self.p.box_free_volume * self.to_refreshed(metal)

    def to_refreshed(self, metal: np.ndarray, box: NonlocalSum | None = None) -> np.ndarray:
        """Interface inflow of the box's nodes per relative volume, passed on or not."""
        p = self.p
        if self._direct is None:
            flux = self.rate * self.weight
            if self._passed is not None:
                flux = flux + self._passed / self.tau
            self._direct = p.box(p.box_metal_volume * flux)
        return self._direct

    def correct(self, metal: np.ndarray, change: np.ndarray, saturated: float) -> np.ndarray:
        """Metal after the flux of the active nodes changed by `change` in theta."""
        p = self.p
        bonds = change * p.box_free_volume
        if self._sent is not None:
            through = _over(p.box(bonds), p.box_seen_liquid)
            bonds = bonds + p.box_metal_volume * self._sent * through
        flux = self.rate * self.local * p.box(bonds)
        return np.where(self.emptied, 0.0, np.clip(metal - self.tau * flux, 0.0, self.old_metal))
