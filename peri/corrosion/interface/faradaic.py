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

import numpy as np

from peri.corrosion.interface.exchange import Exchange
from peri.corrosion.laws import Discrete, InterfaceLaw
from peri.corrosion.metal.solids import Solid
from peri.corrosion.phases import Phases
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.problem import Attempt, Fields, Stage

_ROUNDS = 200
_TOLERANCE = 1e-12
_LATE = 4.0
"""Weight of what a step dissolves at an estimated time, as a change of the rate."""


class Faradaic(InterfaceLaw):
    """D_int w C_solid, until the metal node is empty."""

    name = "faradaic"
    saturations = ("complementarity", "none")
    schemes = ("backward_euler", "sdirk2")
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
        self._sent = self._passed = self._direct = None
        to_liquid = p.box(self.bonds)
        let_in = _over(to_liquid, p.box_seen_liquid)  # mean theta of the liquid that a node sees
        for _ in range(_ROUNDS):
            # Few nodes are emptied in a stage: only they and their bonds change in a round.
            near = p.box.rows_of(self.open > 0, around=True)
            demand = to_liquid + p.box.on_rows(p.box_metal_volume * self.open, near)
            demand *= drawn * local
            short = p.box_metal & (demand > self.old_metal)
            self.on = p.box_metal.astype(float)
            self.on[short] = self.old_metal[short] / demand[short]
            if not p.processes.any(short.any()):
                self.gained = self.open = np.zeros_like(theta)
                break
            inflow = p.box.on_rows(p.box_metal_volume * self.on * local, p.box.rows_of(short))
            before = self.open
            self.open = self._pass_on(short, 1.0 - self.on[short], drawn * inflow[short], let_in)
            change = float(np.abs(self.open - before).max())
            if p.processes.largest(change) <= _TOLERANCE:
                break
        self.demand, self.weight = demand, self.on * local
        self.emptied = short

    def _pass_on(
        self, nodes: np.ndarray, share: np.ndarray, inflow: np.ndarray, let_in: np.ndarray
    ) -> np.ndarray:
        """Of nodes that are liquid for a share of the stage: keep some of it, pass on the rest.

        share, inflow : of these nodes (bool), of the stage, and what each would receive in the
        whole of it, mol/m^3.  let_in : share of what it passes on that the liquid takes, on the
        box.  Returns `open`.
        """
        p, scene = self.p, self.p.scene
        gain = share * inflow
        beside, renewals = self._beside[nodes], share * self._renewals[nodes]
        kept = np.minimum(gain, (gain + renewals * beside) / (1.0 + renewals))
        if scene.pores:
            kept = np.zeros_like(gain)  # its pores are full already
        passed = gain - kept
        if scene.saturation == "complementarity":
            most = scene.saturation_concentration
            kept = np.minimum(kept, most)
            passed = np.minimum(passed, renewals * np.maximum(most - beside, 0.0))
        sent = _over(passed, gain) * share
        opened = np.where(inflow > 0, _over(kept, inflow) + sent * let_in[nodes], share)
        self.gained, self._sent, self._passed, out = np.zeros((4, *nodes.shape))
        self.gained[nodes], self._sent[nodes], out[nodes] = kept, sent, opened
        self._passed[nodes] = _over(passed, p.box_seen_liquid[nodes])
        return out

    def metal_concentration(self, liquid: np.ndarray) -> np.ndarray:
        """C_i = old_i - tau k sum w c theta, at least 0; the liquid plays no part."""
        value = self.old_metal - self.on * self.demand
        return np.where(self.p.box_metal & ~self.emptied, value, 0.0)

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

    def to_refreshed(self, metal: np.ndarray) -> np.ndarray:
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
