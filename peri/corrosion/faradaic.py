"""Dissolution at the rate of Faraday's law: every interface bond carries a given flux.

dC_i/dt = -k sum_j w_ij c_j theta_j over the liquid j, k = D_int C_solid g: the flux of a bond
does not depend on what its metal node still holds (Zhao et al. 2021, Eqs 16 to 20, with the sum
over the actual family in the place of its flat-front value f(z), so that each amount has a node
that receives it).  A flat front anywhere delivers i/(zF), and travels at i/(zF C_solid); under
the proportional law it is slower by ln(C_solid/C_sat) (reference.fronts.front_speed_ratio).

A node is metal until it is empty.  A stage that empties nodes treats each one as liquid for the
share of the stage that is left: without saturation a step of up to a layer is exact for a flat
front, because rates are constant between two such events.
"""

from __future__ import annotations

import numpy as np

from peri.corrosion.interface import Interface

_ROUNDS = 200
_TOLERANCE = 1e-12


class FaradaicInterface(Interface):
    """Metal-liquid exchange of one stage whose bonds carry a given flux.

    exposed : share of the stage that an emptied node spends as liquid (limited by what it can
    hold up to C_sat).  gained : what it receives then, mol/m^3.
    """

    def set(self, theta: np.ndarray, rate: float, local: np.ndarray | float = 1.0) -> None:
        """Fix the saturation factors, D_int and the nodes' shares; find when each node is empty."""
        p, scene = self.p, self.p.scene
        self.theta = theta
        self.rate = rate * scene.solid_concentration
        self.bonds = theta * p.box_liquid_volume
        self.local = local
        drawn = self.tau * self.rate
        bounded = scene.saturation == "complementarity"
        self.exposed = np.zeros_like(theta)
        for _ in range(_ROUNDS):
            demand = drawn * local * p.box(self.bonds + p.box_metal_volume * self.exposed)
            short = p.box_metal & (demand > self.old_metal)
            self.on = p.box_metal.astype(float)
            self.on[short] = self.old_metal[short] / demand[short]
            if not p.processes.any(short.any()):
                self.gained = np.zeros_like(theta)
                break
            inflow = drawn * p.box(p.box_metal_volume * self.on * local)
            exposed = np.where(short, 1.0 - self.on, 0.0)
            if bounded:
                room = np.full_like(inflow, np.inf)
                np.divide(scene.saturation_concentration, inflow, out=room, where=inflow > 0)
                exposed = np.minimum(exposed, room)
            change = float(np.abs(exposed - self.exposed).max())
            self.gained = self.exposed * inflow
            if p.processes.largest(change) <= _TOLERANCE:
                break
            self.exposed = exposed
        self.demand, self.weight = demand, self.on * local
        self.emptied = short
        self.storage_share = 1.0

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

    def offered(self, metal: np.ndarray, liquid) -> np.ndarray:
        """Interface inflow of the free liquid nodes with theta = 1."""
        p = self.p
        return p.box_free_volume * self.rate * p.box(p.box_metal_volume * self.weight)

    def to_refreshed(self, metal: np.ndarray) -> np.ndarray:
        """Interface inflow of the box's nodes per relative volume."""
        return self.rate * self.p.box(self.p.box_metal_volume * self.weight)

    def through_metal(self, liquid: np.ndarray) -> np.ndarray:
        """Nothing: the metal's loss does not depend on the liquid."""
        return np.zeros_like(liquid)

    def diagonal(self) -> np.ndarray:
        """Nothing, for the same reason."""
        return np.zeros_like(self.theta)

    def correct(self, metal: np.ndarray, change: np.ndarray, saturated: float) -> np.ndarray:
        """Metal after the flux of the active nodes changed by `change` in theta."""
        p = self.p
        flux = self.rate * self.local * p.box(change * p.box_free_volume)
        return np.where(self.emptied, 0.0, np.clip(metal - self.tau * flux, 0.0, self.old_metal))
