"""Bi-material peridynamic corrosion: the spatial problem and its steps.

dC_i/dt = sum_j D_ij w_ij c_j (C_j - C_i), with D_ij = D_liq between liquid nodes, D_int g theta_j
across the interface (g the kinetics' rate, theta_j the liquid node's saturation factor) and 0
between metal nodes; c_j is the relative volume of a cell (dissertation 2.3.3, 5.2.1).  The form
is symmetric, so the amount sum_i c_i C_i changes only by what reaches the refreshed nodes.

A metal node exchanges with liquid nodes only, so it is eliminated exactly: each stage solves for
the liquid alone.  The parts: phases and their arrays (phases), rates (rates), amounts (balance),
implicit stages (stage), and what a bond across the interface carries (laws).
"""

from __future__ import annotations

import numpy as np

from peri.corrosion.nodes.pores import Pores
from peri.corrosion.nodes.rates import InterfaceRates
from peri.corrosion.nodes.stage import Stage, StageSolver
from peri.corrosion.scene import CorrosionScene
from peri.engine.processes import ONE_PROCESS, OneProcess


class BiMaterial(InterfaceRates):
    """The discrete corrosion problem on padded arrays.

    Parameters
    ----------
    scene : CorrosionScene
    solver_tolerance : float
        Residual norm relative to the sources at which a linear solution is accepted.
    processes : OneProcess or its like
        Who holds which block of the lattice; `scene` and all arrays are those of the block.
    """

    def __init__(
        self,
        scene: CorrosionScene | None,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self._solver = StageSolver(self)
        super().__init__(scene, solver_tolerance, processes)

    def update_phase(self) -> None:
        """Recompute what depends on which nodes are metal."""
        super().update_phase()
        self.forget()

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._solver.liquid.forget()

    def set_aside(self) -> None:
        """Give the preconditioner's memory back until the next stage."""
        self._solver.liquid.set_aside()

    def volume_loss(self, concentration: np.ndarray) -> float:
        """See Balance.volume_loss."""
        return self.balance.volume_loss(concentration)

    def amounts(
        self, concentration: np.ndarray, pores: np.ndarray | None = None
    ) -> tuple[float, float]:
        """See Balance.amounts."""
        return self.balance.amounts(concentration, pores)

    def open_walls(self, concentration: np.ndarray) -> None:
        """Let the liquid in emptied metal conduct along the walls; `concentration` is padded."""
        if self.box is None or self.walls is None:
            return
        pores = Pores(self, self.take(self.initial_concentration), np.zeros_like(concentration))
        self.walls.open(self.sum.crop(self.put(pores.behind(self.take(concentration)))))

    # --- steps ----------------------------------------------------------------------------

    def implicit_stage(
        self,
        old: np.ndarray,
        tau: float,
        guess: np.ndarray,
        theta: np.ndarray | None,
        volume_loss: float,
        pores: np.ndarray | None = None,
    ) -> Stage:
        """Solve Y = old + tau F(Y), kinetics and saturation included.

        Parameters
        ----------
        old : padded array
            Right side, mol/m^3.
        tau : float
            s.
        guess : padded array
            Starting value of Y.
        theta : padded box array or None
            Starting value of the saturation factors.
        volume_loss : float
            Starting value of V_L.
        pores : padded array, optional
            What the emptied share of each metal node holds at the start, for scenes with `pores`.

        Raises
        ------
        ConvergenceError
            When the linear solver or the active set does not settle (a shorter step will).
        """
        if self.scene.pores and pores is None:
            raise ValueError("pores: this march does not carry what they hold")
        return self._solver.solve(old, tau, guess, theta, volume_loss, pores)

    def stage_alone(self, old: np.ndarray, tau: float, volume_loss: float) -> Stage:
        """The same for the metal alone, in liquid that stays clean."""
        return self._solver.alone(old, tau, volume_loss)

    def explicit_step(
        self, old: np.ndarray, step: float, volume_loss: float
    ) -> tuple[np.ndarray, float, np.ndarray | None]:
        """One forward Euler step (Eq. 3.10): new concentration, release rate (mol/s), theta.

        Conservative and within the bounds up to the step 1 / fastest_rate(); under
        complementarity theta_j lets in just what brings node j to C_sat.
        """
        scene = self.scene
        liquid = np.where(self.metal, 0.0, old)
        gain = self.flow(self.liquid_volume * liquid)
        transport = scene.liquid_diffusivity * (gain - self.neighbour_liquid * liquid)
        if self.walls is not None:
            share = np.where(self.free_volume > 0, self.free_volume, np.inf)
            transport = transport + self.walls.flow(liquid) / share
        new = np.where(self.free, old + step * transport, np.where(self.metal, old, 0.0))
        theta, state, before, part = None, None, None, self
        if self.box is not None:
            part = self.beside_liquid()
            state = scene.dissolution.exchange(part, old, np.inf)
            before = state.old_metal
            if scene.saturation == "as_published":
                full = self.free & (old >= scene.saturation_concentration)
                state.switch_off(np.where(full, self.capacity, 0.0))
            theta = (part.box_liquid_volume > 0).astype(float)
            here, at = part.take(liquid), part.rates_at(old, volume_loss)
            state.set(theta, at.rate, at.local)
            drawn = at.rate * state.weight * at.inflow
            metal = before + step * (drawn - state.outflow * before)
            changed = state.hold_back(metal)
            seen = part.box(part.box_metal_volume * state.weight * before)
            inflow = step * at.rate * (seen - state.seen_metal * here)
            inflow = np.where(part.box_free_volume > 0, inflow, 0.0)
            if scene.saturation == "complementarity":
                room = np.maximum(scene.saturation_concentration - part.take(new), 0.0)
                full = inflow > room
                theta[full] = room[full] / inflow[full]
                changed |= self.processes.any(full.any())
            if changed:
                state.set(theta, at.rate, at.local)
                drawn = at.rate * state.weight * part.box(state.bonds * here)
                metal = before + step * (drawn - state.outflow * before)
            new[part.window] += (theta * inflow)[part.box.interior]
            view = new[part.window]
            view[part.box_metal[part.box.interior]] = metal[part.box_metal]
            theta = self.from_part(part, theta, self.box_liquid_volume > 0)
        return new, part.balance.release_rate(liquid, state, before, gain), theta
