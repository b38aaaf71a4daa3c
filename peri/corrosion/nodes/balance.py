"""Amounts of a bi-material problem: what the metal has lost, what a stage has to add up to."""

from __future__ import annotations

import copy

import numpy as np

from peri.corrosion.interface.exchange import Exchange
from peri.corrosion.phases import Phases

_ROUND_OFF = 1e-10
"""Share of C_sat by which liquid may lie above it: of full liquid what the solver left open, which
the next stage holds at C_sat again."""


class Balance:
    """Volume loss, amounts and their balance.

    metal_scale : sum over the initial metal of c C_solid (in cells).  liquid_below : metal with
    no more than this is liquid, mol/m^3.  beyond : what metal off the box holds above that (in
    cells of this process).
    """

    beyond = 0.0

    def __init__(self, phases: Phases) -> None:
        self.phases, scene = phases, phases.scene
        self.liquid_below = scene.dissolution.liquid_below(scene)
        volumes = phases.volumes()
        contents = [solid.concentration for solid in scene.solids]
        self.metal_scale = sum(v * c for v, c in zip(volumes, contents, strict=True))
        self._loss_scale = sum(
            v * (c - self.liquid_below) for v, c in zip(volumes, contents, strict=True)
        )

    def of(self, part: Phases) -> Balance:
        """The same for phases that have a smaller box."""
        other = copy.copy(self)
        other.phases = part
        return other

    def leave_out(self, old: np.ndarray) -> None:
        """Take what metal off the box holds, which does not change, from a padded array."""
        p = self.phases
        values = np.where(p.metal, np.maximum(old - self.liquid_below, 0.0) * p.capacity, 0.0)
        self.beyond = float(values.sum() - values[p.window].sum())

    def volume_loss(self, concentration: np.ndarray) -> float:
        """V_L = 1 - sum_metal c (C - C_sat) / sum_initial metal c (C_solid - C_sat).

        A node below C_sat is no metal any more and counts as 0, so V_L does not jump back when
        it changes phase.
        """
        p = self.phases
        if self._loss_scale == 0:
            return 0.0
        values = np.maximum(concentration[p.metal] - self.liquid_below, 0.0)
        left = p.processes.total(float((values * p.capacity[p.metal]).sum()))
        return min(1.0, max(0.0, 1.0 - left / self._loss_scale))

    def loss_of(self, box_metal_concentration: np.ndarray) -> float:
        """V_L for metal concentrations on the box."""
        p = self.phases
        values = np.maximum(box_metal_concentration[p.box_metal] - self.liquid_below, 0.0)
        left = float((values * p.box_metal_volume[p.box_metal]).sum()) + self.beyond
        return min(1.0, max(0.0, 1.0 - p.processes.total(left) / self._loss_scale))

    def amounts(
        self, concentration: np.ndarray, pores: np.ndarray | None = None
    ) -> tuple[float, float]:
        """Amount in the metal and in the free liquid, mol (per m or m^2 in 2D, 1D).

        pores : what the metal's emptied share holds, mol/m^3; the liquid's.
        """
        p = self.phases
        volume = p.scene.lattice.cell_volume
        contents = p.capacity * concentration
        metal, liquid = (float(contents[nodes].sum()) for nodes in (p.metal, p.free))
        if pores is not None:
            liquid += float((p.capacity * pores)[p.metal].sum())
        return volume * p.processes.total(metal), volume * p.processes.total(liquid)

    def close(
        self,
        result: np.ndarray,
        old: np.ndarray,
        released: float,
        active: np.ndarray,
        more: float = 0.0,
        emptied: np.ndarray | None = None,
    ) -> float:
        """Scale the liquid (or the metal) so that the stage's amounts add up to round-off.

        What is missing is the sum of the linear solver's residual, which would add up over the
        steps (and is the solver's round-off, not its tolerance, for very stiff ones).  The factor
        differs from 1 by no more than that.  Where the liquid is too clean to hold it, or would
        rise above C_sat by more than round-off, what the metal loses takes it, so that no node
        rises above its old value or falls below zero; at rest the metal itself does, by 1e-9 of it
        at most and up to its C_solid; where there is no metal either, what is released does, or
        the room that the liquid has below C_sat.

        released : mol.  more : that pores hold more than before, mol/m^3 times cells.  emptied :
        metal that the stage empties, padded; while other metal is left it takes nothing, since it
        is liquid at C_sat at most.  Returns what is to be added to what is released.
        """
        p = self.phases
        total = p.processes.total
        held = p.put(active) > 0
        solved = p.free & ~held
        content = p.capacity * result
        liquid = total(float(content[solved].sum()))
        change = content - p.capacity * np.where(p.free | p.metal, old, 0.0)
        passed = released / p.scene.lattice.cell_volume
        missing = -total(float(change.sum())) - more - passed
        factor = 1.0 + missing / liquid if liquid > 0 else 1.0
        small = liquid > 0 and abs(missing) <= 1e-6 * liquid
        highest = p.processes.largest(float(result[solved].max(initial=0.0)))
        most = p.scene.saturation_concentration
        bound = p.scene.saturation == "complementarity" and factor > 1.0
        if small and not (bound and factor * highest > (1.0 + _ROUND_OFF) * most):
            result[solved] *= factor
            return 0.0
        left = p.metal if emptied is None else p.metal & ~emptied
        if not p.processes.any(left.any()):
            left = p.metal
        metal = total(float(content[left].sum()))
        lost = -total(float(change[left].sum()))
        # Where liquid is full, the metal takes back what it lost, which it did not by its law.
        if 0 < missing <= (lost + 1e-12 * metal if small else 1e-3 * lost):
            result[left] += min(1.0, missing / lost if lost > 0 else 0.0) * (old - result)[left]
        elif missing < 0 and -missing <= min(max(1e-3 * lost, 1e-9 * metal), 1e-3 * metal):
            result[left] *= 1.0 + missing / metal
        elif 0 < missing <= 1e-9 * metal:
            full = p.of_solids([solid.concentration for solid in p.scene.solids])
            self._fill(result, left, full, missing)
        elif abs(missing) <= min(1e-3 * passed, max(1e-6 * passed, 1e-9 * self.metal_scale)):
            return missing * p.scene.lattice.cell_volume
        elif small:
            self._fill(result, solved, most, missing)
        return 0.0

    def _fill(
        self, result: np.ndarray, nodes: np.ndarray, full: np.ndarray | float, missing: float
    ) -> None:
        """Add an amount (mol/m^3 times cells) to nodes, in place, in proportion to their room."""
        p = self.phases
        room = np.maximum(full - result, 0.0)[nodes]
        space = p.processes.total(float((p.capacity[nodes] * room).sum()))
        result[nodes] += min(1.0, missing / space) * room if space > 0 else 0.0

    def release_rate(
        self,
        liquid: np.ndarray,
        exchange: Exchange | None,
        metal: np.ndarray | None,
        gain: np.ndarray | None = None,
    ) -> float:
        """Amount that reaches the refreshed nodes per second, mol/s.

        gain : sum over the bonds of what the liquid holds, where the caller has it.
        """
        p = self.phases
        if not p.is_open:
            return 0.0
        if gain is None:
            gain = p.flow(p.liquid_volume * liquid)
        rate = p.scene.liquid_diffusivity * float((gain * p.capacity)[p.fixed].sum())
        if p.walls is not None:
            rate += float(p.walls.flow(liquid)[p.fixed].sum())
        if exchange is not None and metal is not None:
            inflow = exchange.to_refreshed(metal, p.box_of_fixed)
            rate += float((inflow * p.box_fixed_volume).sum())
        return p.processes.total(rate) * p.scene.lattice.cell_volume
