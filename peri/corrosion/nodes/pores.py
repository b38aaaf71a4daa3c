"""Liquid in the emptied share of metal nodes: a wall that recedes by less than a cell.

A node is metal until it is empty, and with bonds across the interface several layers empty at a
time: a flat front of horizon delta has dissolved 0.26 delta that is not open yet.  In a gap of a
few horizons that is a good part of the section.  Here the share 1 - C_i / C_solid of a metal node
is pore space, filled with liquid of the mean concentration over its bonds to liquid nodes,

    q_i = (1 - C_i / C_solid) sum_j a_ij C_j,   a_ij = w_ij c_j / sum_k w_ik c_k,

so that a liquid node stores (c_j + P_j) C_j, P_j = sum_i c_i a_ij (1 - C_i / C_solid), and conducts
along the wall with P_j beside its own c_j (engine.walls).  What pores hold is kept with the metal
node, which takes it along when it opens: amounts add up to round-off.
"""

from __future__ import annotations

import numpy as np

from peri.corrosion.phases import Phases


class Pores:
    """The pores of one stage, on padded arrays of the box.

    Parameters
    ----------
    phases : Phases
        With metal.
    full : padded box array
        C_solid of each metal node, mol/m^3.
    held : padded array
        q of each metal node at the stage's start, mol/m^3.

    before : what each free liquid node finds in its pores, mol/m^3 times relative volume.
    volume : P_j at the end (`fill`).
    """

    def __init__(self, phases: Phases, full: np.ndarray, held: np.ndarray) -> None:
        self.p, self._full = phases, full
        seen = phases.box(phases.box_free_volume)
        self._sees = phases.box_metal & (seen > 0)
        self._seen = np.where(self._sees, seen, 1.0)
        self.before = self._shared(phases.take(held))
        self.volume = np.zeros_like(seen)

    def _shared(self, of_metal: np.ndarray) -> np.ndarray:
        """Amounts of metal nodes shared out among the free liquid that they see."""
        p = self.p
        amount = np.where(self._sees, p.box_metal_volume * of_metal / self._seen, 0.0)
        return p.box_free_volume * p.box(amount)

    def fill(self, metal: np.ndarray) -> None:
        """Take the metal's concentrations at the stage's end."""
        gone = np.divide(self._full - metal, self._full, out=np.zeros_like(metal), where=self._sees)
        self._gone = np.clip(gone, 0.0, 1.0)
        self.volume = self._shared(self._gone)

    def holds(self, liquid: np.ndarray) -> np.ndarray:
        """q of each metal node for concentrations of the liquid."""
        mean = self.p.box(self.p.box_free_volume * liquid) / self._seen
        return self._gone * np.where(self._sees, mean, 0.0)

    def behind(self, metal: np.ndarray) -> np.ndarray:
        """Pore volume of each liquid node over that of a cell, for concentrations of the metal."""
        self.fill(metal)
        free = self.p.box_free_volume
        return np.divide(self.volume, free, out=np.zeros_like(free), where=free > 0)
