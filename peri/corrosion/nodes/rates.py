"""How fast the interface of a bi-material problem is: the kinetics on its nodes, and bounds."""

from __future__ import annotations

from dataclasses import dataclass
from operator import is_
from typing import Self

import numpy as np

from peri.corrosion.kinetics import Exposed
from peri.corrosion.nodes.balance import Balance
from peri.corrosion.phases import Phases
from peri.corrosion.scene import CorrosionScene
from peri.engine.processes import ONE_PROCESS, OneProcess


@dataclass(frozen=True)
class RatesAt:
    """The interface at given concentrations, on the box: what an explicit step looks at.

    asked : volume loss and D_int of then.  rate, local : as InterfaceRates.interface_rate.
    inflow : sum over the bonds of what the liquid holds.  seen_metal : sum of a node's bonds to
    metal times its share of the rate.
    """

    asked: tuple[float, float]
    rate: float
    local: np.ndarray | float
    inflow: np.ndarray
    seen_metal: np.ndarray


class InterfaceRates(Phases):
    """Phases with what their interface carries.

    Parameters
    ----------
    scene : CorrosionScene
    solver_tolerance : float
        Residual norm relative to the sources at which a linear solution is accepted.
    processes : OneProcess or its like

    balance : amounts.  base_diffusivity : D_int at zero volume loss, m^2/s.  surface : what
    surrounds the metal as the kinetics sees it (potential, age), set before a stage: padded box
    arrays or numbers.
    """

    def __init__(
        self,
        scene: CorrosionScene | None,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        super().__init__(scene, processes)
        self.tolerance = solver_tolerance
        self.initial_concentration = self.of_solids([s.concentration for s in self.scene.solids])
        self.initial_concentration += self.sum.pad(self.scene.start_liquid())
        self.balance = Balance(self)
        self.base_diffusivity = self.scene.base_interface_diffusivity()
        self.surface: dict[str, np.ndarray | float] = {}
        self._at: tuple[RatesAt, list[np.ndarray | float]] | None = None

    def coat(self, share: float) -> None:
        """Let the interface carry a share of what it carries bare, from now on."""
        self.base_diffusivity = share * self.scene.base_interface_diffusivity()
        self._rates = None

    def beside_liquid(self) -> Self:
        """See Phases.beside_liquid; with what the kinetics is told now."""
        part = super().beside_liquid()
        if part is not self:
            part.tolerance, part.base_diffusivity = self.tolerance, self.base_diffusivity
            part.balance = self.balance.of(part)
            part.surface = {
                name: self.to_part(part, values) if np.ndim(values) else values
                for name, values in self.surface.items()
            }
        return part

    def fastest_rate(self) -> float:
        """Largest row sum of the operator at zero volume loss, 1/s (bound of its spectrum / 2)."""
        return max(self.fastest_rates())

    def fastest_rates(self, concentration: np.ndarray | None = None) -> tuple[float, float]:
        """The same of free liquid and of metal apart; both may grow as nodes dissolve.

        concentration : padded array, for kinetics that look at the liquid.
        """
        if self._rates is None or not self.scene.one_rate:
            liquid = np.where(self.free, self.neighbour_liquid, 0.0)
            rates, in_metal = liquid * self.scene.liquid_diffusivity, 0.0
            if self.walls is not None:
                share = np.where(self.free_volume > 0, self.free_volume, np.inf)
                rates = rates + self.walls.diagonal / share
            if self.box is not None:
                part = self.beside_liquid()
                if concentration is None:
                    g, local = part.interface_rate(0.0)
                    metal = part.box(part.box_metal_volume * local)
                else:
                    at = part.rates_at(concentration, 0.0)
                    g, local, metal = at.rate, at.local, at.seen_metal
                seen = np.where(part.box_free_volume > 0, metal, 0.0)
                rates[part.window] += (g * seen)[part.box.interior]
                seen = (local * part.box_seen_liquid)[part.box_metal]
                in_metal = g * float(seen.max(initial=0.0))
            largest = self.processes.largest
            self._rates = largest(float(rates.max())), largest(in_metal)
        return self._rates

    def rates_at(self, concentration: np.ndarray, volume_loss: float) -> RatesAt:
        """The interface at concentrations, a padded array that stays as it is.

        The last answer is kept: an explicit step's limit and the step itself ask for the same.
        """
        if "volume_loss" not in self.scene.needs:
            volume_loss = 0.0
        asked = [concentration, self.metal, *self.surface.values()]
        if self._at is not None and len(asked) == len(self._at[1]):
            at, before = self._at
            if at.asked == (volume_loss, self.base_diffusivity) and all(map(is_, asked, before)):
                return at
        values = self.take(concentration)
        liquid = np.where(self.box_metal, 0.0, values)
        inflow = self.box(self.box_liquid_volume * liquid)
        known, gone = self.seen_liquid(liquid, inflow), self.lost(values)
        rate, local = self.interface_rate(volume_loss, known, gone)
        seen_metal = self.box_seen_metal
        if np.ndim(local):
            seen_metal = self.box(self.box_metal_volume * local)
        at = RatesAt((volume_loss, self.base_diffusivity), rate, local, inflow, seen_metal)
        self._at = at, asked
        return at

    def seen_liquid(
        self, liquid: np.ndarray, inflow: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Mean concentration over the bonds of each metal node to liquid, where laws look at it.

        liquid : padded box array.  inflow : its sum over the bonds, where the caller has it.
        """
        if "concentration" not in self.scene.needs:
            return None
        if inflow is None:
            inflow = self.box(self.box_liquid_volume * liquid)
        bonds = self.box_seen_liquid
        seeing = self.box_metal & (bonds > 0)
        return np.divide(inflow, bonds, out=np.zeros_like(bonds), where=seeing)

    def lost(self, metal: np.ndarray) -> np.ndarray | None:
        """Share of each metal node that is gone, where laws look at it; 0 off the metal.

        metal : concentrations, padded box array.
        """
        if "lost" not in self.scene.needs:
            return None
        whole = self.take(self.initial_concentration)
        gone = np.divide(whole - metal, whole, out=np.zeros_like(whole), where=self.box_metal)
        return np.clip(gone, 0.0, 1.0)

    def interface_rate(
        self,
        volume_loss: float,
        seen_liquid: np.ndarray | None = None,
        lost: np.ndarray | None = None,
    ) -> tuple[float, np.ndarray | float]:
        """The interface diffusivity, m^2/s, and each metal node's share of it (or 1 for all).

        seen_liquid, lost : as the methods of these names give them (None: clean liquid, all metal
        there).
        """
        scene = self.scene
        if scene.one_rate:
            return self.base_diffusivity * scene.kinetics.rate(Exposed(volume_loss)), 1.0
        seen = {**self.surface, "phase": self.box_phase}
        seen["concentration"] = np.zeros(self.box.padded_shape)
        if seen_liquid is not None:
            seen["concentration"] = seen_liquid
        seen["lost"] = np.zeros(self.box.padded_shape) if lost is None else lost
        at = Exposed(volume_loss, **{name: seen[name] for name in scene.needs if name in seen})
        share = np.zeros(self.box.padded_shape)
        for number, solid in enumerate(scene.solids, 1):
            rate = scene.dissolution.share_of(solid, scene) * scene.law_of(solid).rate(at)
            share = np.where(self.box_phase == number, rate, share)
        return self.base_diffusivity, share

    def metal_rates(self) -> np.ndarray:
        """lambda_i = D_int sum_{liquid j} w_ij c_j at zero loss, 1/s, on the lattice.

        In clean liquid (the well-stirred limit) a metal node obeys C' = -lambda g(V_L) C.
        """
        return self.base_diffusivity * self.metal_bond_sums()

    def metal_bond_sums(self) -> np.ndarray:
        """sum_{liquid j} w_ij c_j of every metal node, 1/m^2, on the lattice."""
        if self.box is None:
            return np.zeros(self.scene.lattice.shape)
        sums = self.box(self.box_liquid_volume)
        return self.sum.crop(self.put(np.where(self.box_metal, sums, 0.0)))
