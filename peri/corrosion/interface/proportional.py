"""Dissolution in proportion to what is there: a bond carries D_int w theta_j (C_i - C_j).

The published law (dissertation 2.3.3).  A node is metal until it falls below C_sat.
"""

from __future__ import annotations

import math

import numpy as np

from peri.corrosion.interface import saturation
from peri.corrosion.interface.exchange import Exchange
from peri.corrosion.laws import Discrete, InterfaceLaw
from peri.corrosion.metal.solids import Solid
from peri.corrosion.phases import Phases
from peri.corrosion.scene import CorrosionScene
from peri.engine.march.problem import Attempt
from peri.engine.operators import NonlocalSum

LATE = 4.0
"""Weight of what a step exposes too late, as a change of the rate."""


class Proportional(InterfaceLaw):
    """D_int w (C_i - C_j), until the metal node is below C_sat."""

    name = "proportional"
    reduces = True

    def liquid_below(self, scene: CorrosionScene) -> float:
        """C_sat."""
        return scene.saturation_concentration

    def lifetime(self, scene: CorrosionScene) -> float:
        """ln(C_solid / C_sat) of the thinnest solid."""
        thinnest = min(solid.concentration for solid in scene.solids)
        return math.log(thinnest / scene.saturation_concentration)

    def share_of(self, solid: Solid, scene: CorrosionScene) -> float:
        """A bond's flux grows with its own C_solid, D_int is calibrated for the scene's."""
        return solid.rate * scene.solid_concentration / solid.concentration

    def exchange(self, discrete: Phases, old: np.ndarray, tau: float) -> ProportionalExchange:
        """Bonds that follow the content."""
        return ProportionalExchange(discrete, old, tau)

    def gone(
        self, discrete: Discrete, concentration: np.ndarray, emptied: np.ndarray | None
    ) -> np.ndarray:
        """Metal below C_sat."""
        return discrete.metal & (concentration < discrete.balance.liquid_below)

    def change(self, discrete: Discrete, attempt: Attempt) -> float:
        """Difference of the metal's change from the expected one, and what is exposed late."""
        old = attempt.old.fields["concentration"]
        new = attempt.stages[-1].fields["concentration"]
        change = _relative_change(discrete, new - old, attempt.expected["concentration"])
        late = LATE * late_exposure(discrete, old, new) if discrete.box is not None else 0.0
        return max(attempt.share * change, late)


class ProportionalExchange(Exchange):
    """Metal-liquid exchange of one stage on the box around the metal.

    on : switch of each metal node's bonds, 0 or 1.  weight : the same times the node's own rate
    (kinetics that differ from node to node).  seen_metal : sum of a node's bonds to metal times
    weight.
    """

    def __init__(self, phases: Phases, old: np.ndarray, tau: float) -> None:
        super().__init__(phases, old, tau)
        self.on = self.weight
        self.seen_metal = phases.box_seen_metal

    def switch_off(self, saturated_volume: np.ndarray) -> None:
        """Algorithm 1: no exchange for metal nodes that see saturated liquid."""
        p = self.p
        neighbours = p.box(p.take(saturated_volume))
        self.on = saturation.published_switch(neighbours, p.box_metal).astype(float)
        self.seen_metal = p.box(p.box_metal_volume * self.on)

    def switch(self) -> np.ndarray:
        """See Exchange.switch."""
        return self.on

    def hold_back(self, metal: np.ndarray) -> bool:
        """See Exchange.hold_back."""
        back = (self.on > 0) & (metal > self.old_metal * (1 + 1e-13))
        if not self.p.processes.any(back.any()):
            return False
        self.on = np.where(back, 0.0, self.on)
        self.weight = np.where(back, 0.0, self.weight)
        self.seen_metal = self.p.box(self.p.box_metal_volume * self.weight)
        return True

    def set(self, theta: np.ndarray, rate: float, local: np.ndarray | float = 1.0) -> None:
        """Fix the saturation factors, the interface diffusivity (m^2/s) and the nodes' shares."""
        p = self.p
        self.theta, self.rate, self.local = theta, rate, local
        self.weight = self.on * local
        if np.ndim(local):
            self.seen_metal = p.box(p.box_metal_volume * self.weight)
        self.bonds = theta * p.box_liquid_volume
        self.outflow = rate * self.weight * p.box(self.bonds)
        self._response: np.ndarray | None = None

    def _responses(self) -> np.ndarray:
        """What a metal node gives per mol/(m^3 s) that flow into it, s, times its volume."""
        if self._response is None:
            decay, out = 1.0 / self.tau + self.outflow, np.zeros_like(self.outflow)
            response = np.divide(self.weight**2, decay, out=out, where=decay > 0)
            self._response = self.p.box_metal_volume * response
        return self._response

    def turnover(self) -> float:
        """See Exchange.turnover."""
        return self.tau * float(self.outflow[self.p.box_metal].max(initial=0.0))

    @property
    def storage_share(self) -> float:
        """See Exchange."""
        total = self.p.processes.total
        decay = 1.0 / self.tau + self.outflow[self.p.box_metal]
        stored = np.divide(1.0 / self.tau, decay, out=np.ones_like(decay), where=decay > 0)
        count = total(stored.size)
        return total(float(stored.sum())) / count if count else 1.0

    def metal_concentration(self, liquid: np.ndarray) -> np.ndarray:
        """C_i = (old_i / tau + D sum theta w c C_j) / (1 / tau + D sum theta w c)."""
        inflow = self.rate * self.weight * self.p.box(self.bonds * liquid)
        value = (self.old_metal / self.tau + inflow) / (1.0 / self.tau + self.outflow)
        return np.where(self.p.box_metal, value, 0.0)

    def through_metal(self, liquid: np.ndarray) -> np.ndarray:
        """What liquid values send to each node by way of the metal (weights of the metal in)."""
        inflow = self.rate * self.p.box(self.bonds * liquid)
        return self.p.box(self._responses() * inflow)

    def offered(self, metal: np.ndarray, liquid) -> np.ndarray:
        """Interface inflow of the free liquid nodes with theta = 1, for given values."""
        return self.p.box_free_volume * (
            self.to_refreshed(metal) - self.rate * self.seen_metal * liquid
        )

    def to_refreshed(self, metal: np.ndarray, box: NonlocalSum | None = None) -> np.ndarray:
        """Interface inflow per relative volume of liquid held at zero."""
        return self.rate * (box or self.p.box)(self.p.box_metal_volume * self.weight * metal)

    def diagonal(self) -> np.ndarray:
        """The liquid's own share of its outflow into the metal."""
        return self.theta * self.p.box_free_volume * self.rate * self.seen_metal

    def correct(self, metal: np.ndarray, change: np.ndarray, saturated: float) -> np.ndarray:
        """Metal after the flux of the active nodes changed by `change` in theta."""
        p = self.p
        bonds = change * p.box_free_volume
        flux = self.rate * self.weight * p.box(bonds) * (metal - saturated)
        return np.where(p.box_metal, metal - self.tau * flux, 0.0)


def _relative_change(discrete: Discrete, change: np.ndarray, expected: np.ndarray) -> float:
    """Difference of the metal's change from the expected one, node by node, over their loss."""
    total, metal = discrete.processes.total, discrete.metal
    volume = discrete.capacity[metal]
    progress = total(float((volume * np.abs(change[metal])).sum()))
    # What the solver's tolerance moves says nothing about the rate.
    if progress <= 0.1 * discrete.tolerance * discrete.balance.metal_scale:
        return 0.0
    return total(float((volume * np.abs(change - expected)[metal]).sum())) / progress


def late_exposure(p: Phases, old: np.ndarray, new: np.ndarray) -> float:
    """Share of the interface that a step should have opened before its end.

    A node that falls below C_sat within a step exposes others at its end only; the share of
    the step that this is late (C taken as exponential in time) weighs its bonds.
    """
    before, after = p.take(old)[p.box_metal], p.take(new)[p.box_metal]
    limit = p.scene.saturation_concentration
    late = np.zeros(p.box.padded_shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.log(limit / after) / np.log(before / after)
    late[p.box_metal] = np.where((after < limit) & (before > after), share, 0.0)
    total = p.processes.total
    if not p.processes.any(late.any()):
        return 0.0
    staying = np.where(late > 0, 0.0, p.box_metal_volume * p.take(new))
    opened = float((staying * p.box(late.clip(0.0, 1.0) * p.box_metal_volume)).sum())
    whole = p.box_metal_volume * p.take(old) * p.box(p.box_liquid_volume)
    whole = total(float(whole.sum()))
    return total(opened) / whole if whole > 0 else 0.0
