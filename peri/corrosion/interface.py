"""Metal-liquid exchange of one implicit or explicit stage, on the box around the metal."""

from __future__ import annotations

import numpy as np

from peri.corrosion import saturation
from peri.engine.processes import OneProcess


class Interface:
    """Metal-liquid exchange of one stage on the box around the metal.

    on : switch of each metal node's bonds, 0 or 1.  weight : the same times the node's own rate
    (kinetics that differ from node to node).
    """

    local: np.ndarray | float = 1.0
    emptied = None  # metal nodes that the stage empties; their content is then their liquid's
    gained = 0.0

    def __init__(self, problem, old: np.ndarray, tau: float) -> None:
        self.p, self.tau = problem, tau
        self.old_metal = problem.take(old)
        self.on = self.weight = problem.box_metal.astype(float)
        self.seen_metal = problem.box(problem.box_metal_volume)

    def late(self) -> float:
        """Share of the flux whose time is an estimate: none, bonds follow the content."""
        return 0.0

    def switch_off(self, saturated_volume: np.ndarray) -> None:
        """Algorithm 1: no exchange for metal nodes that see saturated liquid."""
        p = self.p
        neighbours = p.box(p.take(saturated_volume))
        self.on = saturation.published_switch(neighbours, p.box_metal).astype(float)
        self.seen_metal = p.box(p.box_metal_volume * self.on)

    def hold_back(self, metal: np.ndarray) -> bool:
        """No exchange for metal nodes that would take solute back; whether there are new ones.

        Dissolution is irreversible.  Bounded liquid never exceeds the metal, so this concerns
        liquid without a bound (saturation "none", and "as_published" within a step).
        """
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
        decay = 1.0 / self.tau + self.outflow
        self.response = np.divide(self.weight**2, decay, out=np.zeros_like(decay), where=decay > 0)
        metal = p.box_metal
        decay = 1.0 / self.tau + self.outflow[metal]
        stored = np.divide(1.0 / self.tau, decay, out=np.ones_like(decay), where=decay > 0)
        count = p.processes.total(stored.size)
        self.storage_share = p.processes.total(float(stored.sum())) / count if count else 1.0

    def metal_concentration(self, liquid: np.ndarray) -> np.ndarray:
        """C_i = (old_i / tau + D sum theta w c C_j) / (1 / tau + D sum theta w c)."""
        inflow = self.rate * self.weight * self.p.box(self.bonds * liquid)
        value = (self.old_metal / self.tau + inflow) / (1.0 / self.tau + self.outflow)
        return np.where(self.p.box_metal, value, 0.0)

    def through_metal(self, liquid: np.ndarray) -> np.ndarray:
        """What liquid values send to each node by way of the metal (weights of the metal in)."""
        inflow = self.rate * self.p.box(self.bonds * liquid)
        return self.p.box(self.p.box_metal_volume * self.response * inflow)

    def liquid_gain(self, liquid: np.ndarray) -> np.ndarray:
        """Net interface inflow of the free liquid nodes for given liquid values."""
        return self.theta * self.offered(self.metal_concentration(liquid), liquid)

    def offered(self, metal: np.ndarray, liquid) -> np.ndarray:
        """Interface inflow of the free liquid nodes with theta = 1, for given values."""
        return self.p.box_free_volume * (
            self.to_refreshed(metal) - self.rate * self.seen_metal * liquid
        )

    def to_refreshed(self, metal: np.ndarray) -> np.ndarray:
        """Interface inflow per relative volume of liquid held at zero."""
        return self.rate * self.p.box(self.p.box_metal_volume * self.weight * metal)

    def diagonal(self) -> np.ndarray:
        """The liquid's own share of its outflow into the metal."""
        return self.theta * self.p.box_free_volume * self.rate * self.seen_metal

    def correct(self, metal: np.ndarray, change: np.ndarray, saturated: float) -> np.ndarray:
        """Metal after the flux of the active nodes changed by `change` in theta."""
        p = self.p
        bonds = change * p.box_free_volume
        flux = self.rate * self.weight * p.box(bonds) * (metal - saturated)
        return np.where(p.box_metal, metal - self.tau * flux, 0.0)


class FixedPoint:
    """Values that a stage's rounds have to agree with, by relaxed iteration (Irons and Tuck 1969).

    The relaxation follows from the last two residuals, so that feedback of either sign settles
    where plain iteration would swing or creep.
    """

    def __init__(self, processes: OneProcess) -> None:
        self.processes = processes
        self.value: np.ndarray | None = None
        self._residual: np.ndarray | None = None
        self._factor = 1.0

    def settle(self, found: np.ndarray | None) -> tuple[np.ndarray | None, float]:
        """The values to use next, and the largest residual relative to the largest value.

        found : what the present values lead to; None where there is nothing to agree with.
        """
        if found is None:
            return None, 0.0
        if self.value is None:
            self.value = found
            return found, np.inf
        residual = found - self.value
        scale = self.processes.largest(float(np.abs(found).max()))
        off = self.processes.largest(float(np.abs(residual).max()))
        if self._residual is not None:
            total, change = self.processes.total, residual - self._residual
            moved = total(float((change * change).sum()))
            if moved > 0:
                along = total(float((self._residual * change).sum()))
                self._factor = float(np.clip(-self._factor * along / moved, 0.05, 4.0))
        self._residual = residual
        self.value = np.maximum(0.0, self.value + self._factor * residual)
        return self.value, off / scale if scale > 0 else 0.0


def late_exposure(p, old: np.ndarray, new: np.ndarray) -> float:
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
