"""Bi-material peridynamic corrosion: the spatial problem and its implicit stage.

dC_i/dt = sum_j D_ij w_ij c_j (C_j - C_i), with D_ij = D_liq between liquid nodes, D_int g theta_j
across the interface (g the kinetics' factor, theta_j the liquid node's saturation factor) and 0
between metal nodes; c_j is the relative volume of a cell (dissertation 2.3.3, 5.2.1).  The form
is symmetric, so the amount sum_i c_i C_i changes only by what reaches the refreshed nodes.

A metal node exchanges with liquid nodes only, so it is eliminated exactly: each stage solves for
the liquid alone.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion import saturation
from peri.corrosion.blocks import block_scene
from peri.corrosion.faradaic import FaradaicInterface
from peri.corrosion.interface import FixedPoint, Interface
from peri.corrosion.kinetics import Exposed
from peri.corrosion.scene import CorrosionScene
from peri.engine import kernels
from peri.engine.operators import NonlocalSum
from peri.engine.problem import BoundsError
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.engine.solvers import ConvergenceError, DiffusionSystem

log = logging.getLogger(__name__)

_MAXIMUM_ROUNDS = 60
_LOSS_TOLERANCE = 1e-9
_DRIFT = 1e-7
"""How well a stage has to know the liquid that the kinetics sees, relative."""
_ROUND_REDUCTION = 0.1


@dataclass
class Stage:
    """Solution of one implicit stage Y = old + tau F(Y)."""

    concentration: np.ndarray
    theta: np.ndarray
    volume_loss: float
    release_rate: float
    iterations: int
    rounds: int
    emptied: np.ndarray | None = None
    """Metal nodes that are empty (Faraday's law only); what they hold is their liquid's."""
    late: float = 0.0
    """Share of the interface flux whose time is an estimate (FaradaicInterface.late)."""


class BiMaterial:
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
        scene: CorrosionScene,
        solver_tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self.processes = processes
        self.scene = scene = block_scene(scene, processes)
        self.tolerance = solver_tolerance
        lattice, stencil = scene.lattice, scene.stencil
        self.sum = NonlocalSum(stencil, lattice.shape, scene.domain, processes=processes)
        fixed = scene.refreshed()
        self.fixed = self.sum.pad(fixed) > 0
        self._open = processes.any(fixed.any())
        self.domain = self.sum.pad(scene.domain) > 0
        self.capacity = self.sum.pad(scene.capacity())
        self.metal = self.sum.pad(scene.metal) > 0
        self.initial_metal = self.metal.copy()
        self.initial_concentration = np.where(self.metal, scene.solid_concentration, 0.0)
        metal_volume = processes.total(float(self.capacity[self.metal].sum()))
        self.metal_scale = metal_volume * scene.solid_concentration
        """sum over the initial metal of c C_solid (in cells)."""
        self.faradaic = scene.dissolution == "faradaic"
        self.liquid_below = 0.0 if self.faradaic else scene.saturation_concentration
        """Metal with no more than this is liquid, mol/m^3."""
        self._loss_scale = metal_volume * (scene.solid_concentration - self.liquid_below)
        self.base_diffusivity = scene.base_interface_diffusivity()
        self.surface: dict[str, np.ndarray | float] = {}
        """What surrounds the metal as the kinetics sees it (potential, age), set before a stage:
        padded box arrays or numbers."""
        self._system: DiffusionSystem | None = None
        self._make_box()
        self.update_phase()

    # --- phases ---------------------------------------------------------------------------

    def _make_box(self) -> None:
        """The part of the lattice within reach of the initial metal, with its own arrays."""
        interior = self.metal[self.sum.interior]
        largest = self.processes.largest
        window = []
        for a, (reach, start) in enumerate(zip(self.sum.reach, self.processes.start, strict=True)):
            present = np.flatnonzero(interior.any(axis=tuple(b for b in range(3) if b != a)))
            first = -largest(-(present[0] + start) if present.size else -np.inf)
            last = largest(present[-1] + start if present.size else -np.inf)
            if first > last:
                self.box = None
                return
            # A block that lies off the metal takes part with one layer of nodes.
            n = interior.shape[a]
            low = min(max(0, int(first) - reach - start), n - 1)
            window.append(slice(low, max(low + 1, min(n, int(last) + reach + 1 - start))))
        padded = [
            slice(w.start + r, w.stop + r) for w, r in zip(window, self.sum.reach, strict=True)
        ]
        self.window = tuple(padded)
        shape = tuple(w.stop - w.start for w in window)[3 - self.sum.stencil.dimension :]
        self.box = NonlocalSum(
            self.sum.stencil, shape, processes=self.processes, window=tuple(window)
        )
        # Like `sum`, but on the rows of the box only.
        rows = np.zeros(self.sum.shape, bool)
        rows[tuple(window)] = True
        rows = rows.reshape(self.sum.lattice_shape)
        self.near = NonlocalSum(self.sum.stencil, rows.shape, rows, processes=self.processes)

    def take(self, values: np.ndarray) -> np.ndarray:
        """The box's part of a padded field, padded itself."""
        out = np.zeros(self.box.padded_shape)
        out[self.box.interior] = values[self.window]
        return out

    def put(self, values: np.ndarray) -> np.ndarray:
        """A padded field that is zero but for the box's padded values."""
        out = np.zeros(self.sum.padded_shape)
        out[self.window] = values[self.box.interior]
        return out

    def update_phase(self) -> None:
        """Recompute what depends on which nodes are metal."""
        liquid = self.domain & ~self.metal
        self.free = liquid & ~self.fixed
        self.liquid_volume = np.where(liquid, self.capacity, 0.0)
        self.free_volume = np.where(self.free, self.capacity, 0.0)
        self.neighbour_liquid = self.sum(self.liquid_volume)
        self._system = self._rates = None
        if self.box is not None:
            self.box_metal = self.take(self.metal) > 0
            self.box_metal_volume = self.take(np.where(self.metal, self.capacity, 0.0))
            self.box_liquid_volume = self.take(self.liquid_volume)
            self.box_free_volume = self.take(self.free_volume)
            self.box_neighbour_liquid = self.take(self.neighbour_liquid)

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._system = None

    def dissolve(self, concentration: np.ndarray, emptied: np.ndarray | None = None) -> int:
        """Turn metal nodes below C_sat (or emptied ones) into liquid; returns how many."""
        gone = emptied
        if not self.faradaic:
            gone = self.metal & (concentration < self.liquid_below)
        elif gone is None:
            return 0
        count = int(self.processes.total(int(gone.sum())))
        if count:
            self.metal = self.metal & ~gone
            self.update_phase()
        return count

    # --- measures -------------------------------------------------------------------------

    def volume_loss(self, concentration: np.ndarray) -> float:
        """V_L = 1 - sum_metal c (C - C_sat) / sum_initial metal c (C_solid - C_sat).

        A node below C_sat is no metal any more and counts as 0, so V_L does not jump back when
        it changes phase.
        """
        if self._loss_scale == 0:
            return 0.0
        values = np.maximum(concentration[self.metal] - self.liquid_below, 0.0)
        left = self.processes.total(float((values * self.capacity[self.metal]).sum()))
        return min(1.0, max(0.0, 1.0 - left / self._loss_scale))

    def amounts(self, concentration: np.ndarray) -> tuple[float, float]:
        """Amount in the metal and in the free liquid, mol (per m or m^2 in 2D, 1D)."""
        volume = self.scene.lattice.cell_volume
        contents = self.capacity * concentration
        metal, liquid = (float(contents[nodes].sum()) for nodes in (self.metal, self.free))
        return volume * self.processes.total(metal), volume * self.processes.total(liquid)

    def fastest_rate(self) -> float:
        """Largest row sum of the operator at zero volume loss, 1/s (bound of its spectrum / 2)."""
        return max(self.fastest_rates())

    def fastest_rates(self, concentration: np.ndarray | None = None) -> tuple[float, float]:
        """The same of free liquid and of metal apart; both may grow as nodes dissolve.

        concentration : padded array, for kinetics that look at the liquid.
        """
        if self._rates is None or not self.scene.kinetics.is_global:
            liquid = np.where(self.free, self.neighbour_liquid, 0.0)
            rates, in_metal = liquid * self.scene.liquid_diffusivity, 0.0
            if self.box is not None:
                known = None
                if concentration is not None:
                    known = self.seen_liquid(self.take(np.where(self.metal, 0.0, concentration)))
                g, local = self.interface_rate(0.0, known)
                metal = self.box(self.box_metal_volume * local)
                seen = np.where(self.box_free_volume > 0, metal, 0.0)
                rates[self.window] += (g * seen)[self.box.interior]
                seen = (local * self.box(self.box_liquid_volume))[self.box_metal]
                in_metal = g * float(seen.max(initial=0.0))
            largest = self.processes.largest
            self._rates = largest(float(rates.max())), largest(in_metal)
        return self._rates

    def seen_liquid(self, liquid: np.ndarray) -> np.ndarray | None:
        """Mean concentration over the bonds of each metal node to liquid, where laws look at it.

        liquid : padded box array.
        """
        if "concentration" not in self.scene.kinetics.needs:
            return None
        inflow, bonds = self.box(self.box_liquid_volume * liquid), self.box_neighbour_liquid
        seeing = self.box_metal & (bonds > 0)
        return np.divide(inflow, bonds, out=np.zeros_like(bonds), where=seeing)

    def interface_rate(
        self, volume_loss: float, seen_liquid: np.ndarray | None = None
    ) -> tuple[float, np.ndarray | float]:
        """The interface diffusivity, m^2/s, and each metal node's share of it (or 1 for all).

        seen_liquid : as `seen_liquid` gives it (None: clean liquid).
        """
        law = self.scene.kinetics
        if law.is_global:
            return self.base_diffusivity * law.rate(Exposed(volume_loss)), 1.0
        seen: dict[str, np.ndarray | float] = dict(self.surface)
        if "concentration" in law.needs:
            clean = np.zeros(self.box.padded_shape)
            seen["concentration"] = clean if seen_liquid is None else seen_liquid
        at = Exposed(volume_loss, **{n: v for n, v in seen.items() if n in law.needs})
        return self.base_diffusivity, np.where(self.box_metal, law.rate(at), 0.0)

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

    # --- implicit stage -------------------------------------------------------------------

    def implicit_stage(
        self,
        old: np.ndarray,
        tau: float,
        guess: np.ndarray,
        theta: np.ndarray | None,
        volume_loss: float,
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

        Raises
        ------
        ConvergenceError
            When the linear solver or the active set does not settle (a shorter step will).
        """
        if self.box is None:
            return self._liquid_only_stage(old, tau, guess)
        scene, total = self.scene, self.processes.total
        saturated = scene.saturation_concentration
        y = np.where(self.free, guess, 0.0)
        state = (FaradaicInterface if self.faradaic else Interface)(self, old, tau)
        if scene.saturation == "as_published":
            state.switch_off(np.where(self.free & (old >= saturated), self.capacity, 0.0))
        complementary = scene.saturation == "complementarity"
        if theta is None or not complementary:
            theta = (self.box_liquid_volume > 0).astype(float)
        active = np.zeros(self.box.padded_shape, bool)
        if complementary:
            active = (theta < 1.0) & (self.box_free_volume > 0)
        total_iterations, rounds, settled, stall = 0, 0, False, saturation.Stall()
        seen = FixedPoint(self.processes)
        while rounds < _MAXIMUM_ROUNDS:
            rounds += 1
            liquid = self.take(y)
            guessed, drift = seen.settle(self.seen_liquid(liquid))
            volume_loss = self._settle_rate(state, theta, volume_loss, liquid, guessed)
            view = y[self.window]
            view[active[self.box.interior]] = saturated
            iterations, solved = self._solve_liquid(y, old, tau, state, active)
            total_iterations += iterations
            metal = state.metal_concentration(self.take(y))
            loss = self._loss_of(metal)
            settled = solved and abs(loss - volume_loss) <= _LOSS_TOLERANCE and drift <= _DRIFT
            volume_loss = loss
            if complementary:
                needed, available = self._interface_balance(y, old, tau, state, metal, active)
                new_active, new_theta = saturation.next_active_set(
                    active, self.take(y), needed, available, saturated
                )
                new_theta = np.where(self.box_liquid_volume > 0, new_theta, 0.0)
                bonds_on = np.maximum(new_theta, 0.0)
                mismatch = tau * total(float((np.abs(bonds_on - theta) * available)[active].sum()))
                changed = self.processes.any(not np.array_equal(new_active, active))
                settled &= not changed and mismatch <= 1e-9 * self.metal_scale * max(1e-3, loss)
                if settled:
                    # Judged by its amount: `available` grows with D_int without limit.
                    shortfall = total(-float(needed[active].clip(max=0.0).sum()))
                    if tau * shortfall > 1e-9 * self.metal_scale:
                        raise BoundsError("saturation: the stage would need a negative inflow")
                    break
                if stall.after(int(total(int((new_active != active).sum()))), mismatch):
                    break
                active, theta = new_active, bonds_on
            elif state.hold_back(metal):
                settled = False
            elif settled:
                break
        if not settled:
            raise ConvergenceError(
                f"saturation: the active set did not settle in {rounds} rounds at a "
                f"step of {tau:.3g} s"
            )
        release = self._release_rate(y, state, metal)
        # What an active node takes in is what the metal loses, to round-off.
        if complementary and self.processes.any(active.any()):
            metal = state.correct(metal, np.where(active, new_theta - theta, 0.0), saturated)
            volume_loss, theta = self._loss_of(metal), bonds_on
        result = np.where(self.free, y, 0.0)
        view = result[self.window]
        view[self.box_metal[self.box.interior]] = (metal + state.gained)[self.box_metal]
        self._close_balance(result, old, tau * release, active)
        emptied = None if state.emptied is None else self.put(state.emptied) > 0
        return Stage(
            result,
            theta,
            volume_loss,
            release,
            total_iterations,
            rounds,
            emptied,
            state.late(),
        )

    def _close_balance(self, result, old, released: float, active) -> None:
        """Scale the liquid (or the metal) so that the stage's amounts add up to round-off.

        What is missing is the sum of the linear solver's residual, which would add up over the
        steps (and is the solver's round-off, not its tolerance, for very stiff ones).  The factor
        differs from 1 by no more than that.  Where the liquid is too clean to hold it, or all of
        it is held at C_sat, what the metal loses takes it (or, at rest, less than 1e-9 of the
        metal), so that no node rises above its old value.
        """
        total = self.processes.total
        held = self.put(active) > 0
        solved = self.free & ~held
        content = self.capacity * result
        liquid = total(float(content[solved].sum()))
        change = content - self.capacity * np.where(self.free | self.metal, old, 0.0)
        missing = -total(float(change.sum())) - released / self.scene.lattice.cell_volume
        if liquid > 0 and abs(missing) <= 1e-6 * liquid:
            result[solved] *= 1.0 + missing / liquid
            return
        metal = total(float(content[self.metal].sum()))
        lost = -total(float(change[self.metal].sum()))
        if lost > 0 and abs(missing) <= 1e-3 * lost:
            result[self.metal] += missing / lost * (old - result)[self.metal]
        elif missing < 0 and -missing <= 1e-9 * metal:
            result[self.metal] *= 1.0 + missing / metal

    def explicit_step(
        self, old: np.ndarray, step: float, volume_loss: float
    ) -> tuple[np.ndarray, float, np.ndarray | None]:
        """One forward Euler step (Eq. 3.10): new concentration, release rate (mol/s), theta.

        Conservative and within the bounds up to the step 1 / fastest_rate(); under
        complementarity theta_j lets in just what brings node j to C_sat.
        """
        scene = self.scene
        liquid = np.where(self.metal, 0.0, old)
        gain = self.sum(self.liquid_volume * liquid)
        transport = scene.liquid_diffusivity * (gain - self.neighbour_liquid * liquid)
        new = np.where(self.free, old + step * transport, 0.0)
        theta, metal, state = None, None, None
        if self.box is not None:
            state = Interface(self, old, np.inf)
            if scene.saturation == "as_published":
                full = self.free & (old >= scene.saturation_concentration)
                state.switch_off(np.where(full, self.capacity, 0.0))
            theta = (self.box_liquid_volume > 0).astype(float)
            box_liquid = self.take(liquid)
            rate, local = self.interface_rate(volume_loss, self.seen_liquid(box_liquid))
            state.set(theta, rate, local)
            drawn = rate * state.weight * self.box(state.bonds * box_liquid)
            state.hold_back(state.old_metal + step * (drawn - state.outflow * state.old_metal))
            seen = self.box(self.box_metal_volume * state.weight * state.old_metal)
            inflow = step * rate * (seen - state.seen_metal * box_liquid)
            inflow = np.where(self.box_free_volume > 0, inflow, 0.0)
            if scene.saturation == "complementarity":
                room = np.maximum(scene.saturation_concentration - self.take(new), 0.0)
                full = inflow > room
                theta[full] = room[full] / inflow[full]
            state.set(theta, rate, local)
            new[self.window] += (theta * inflow)[self.box.interior]
            drawn = rate * state.weight * self.box(state.bonds * box_liquid)
            metal = state.old_metal + step * (drawn - state.outflow * state.old_metal)
            view = new[self.window]
            view[self.box_metal[self.box.interior]] = metal[self.box_metal]
            metal = state.old_metal
        return new, self._release_rate(liquid, state, metal), theta

    def _settle_rate(self, state, theta, volume_loss, liquid, seen_liquid) -> float:
        """V_L that agrees with the rate it causes, for given liquid concentrations.

        The metal's loss falls as V_L grows in the kinetics, so there is one such V_L in [0, 1]: a
        secant kept inside its bracket.  (The plain fixed point jumps between two wrong values
        where a step dissolves more than about l.)
        """
        low, high, last = 0.0, 1.0, None
        for _ in range(_MAXIMUM_ROUNDS):
            state.set(theta, *self.interface_rate(volume_loss, seen_liquid))
            loss = self._loss_of(state.metal_concentration(liquid))
            excess = loss - volume_loss
            if abs(excess) <= 0.1 * _LOSS_TOLERANCE:
                break
            low, high = (volume_loss, high) if excess > 0 else (low, volume_loss)
            trial = loss
            if last is not None and excess != last[1]:
                trial = volume_loss - excess * (volume_loss - last[0]) / (excess - last[1])
            last = volume_loss, excess
            volume_loss = trial if low < trial < high else 0.5 * (low + high)
        return volume_loss

    def _loss_of(self, box_metal_concentration: np.ndarray) -> float:
        values = np.maximum(box_metal_concentration[self.box_metal] - self.liquid_below, 0.0)
        left = float((values * self.box_metal_volume[self.box_metal]).sum())
        return min(1.0, max(0.0, 1.0 - self.processes.total(left) / self._loss_scale))

    def _liquid_only_stage(self, old, tau, guess) -> Stage:
        y = np.where(self.free, guess, 0.0)
        iterations, _ = self._solve_liquid(y, old, tau, None, None)
        return Stage(y, None, 0.0, self._release_rate(y, None, None), iterations, 1)

    def _solve_liquid(self, y, old, tau, state, active) -> tuple[int, bool]:
        """Improve the liquid concentrations y in place; active nodes keep their value.

        While there are active nodes a round only has to shrink the residual it starts with: the
        next round changes the right side again.  Returns the iterations and whether the
        tolerance itself was reached.
        """
        held = active is not None and self.processes.any(active.any())
        system = self._linear_system(tau, state, active)
        r = self.sum(self.liquid_volume * y)
        squares = kernels.stage_residual(
            y, old, r, system.weight, system.diagonal, self.scene.liquid_diffusivity, tau,
            self.sum.low, self.sum.high, self.sum.reach,
        )  # fmt: skip
        scale = math.sqrt(self.processes.total(float(squares.sum()))) / tau
        if state is not None:
            source = state.liquid_gain(self.take(y))
            scale += self._norm(source)
            source *= self.take(system.mask)
            r[self.window] += source[self.box.interior]
        wanted = self.tolerance * scale
        enough = max(wanted, _ROUND_REDUCTION * self._norm(r)) if held else wanted
        return system.solve(y, r, enough), enough <= wanted

    def _norm(self, values: np.ndarray) -> float:
        return math.sqrt(self.processes.total(float(kernels.inner_product(values, values).sum())))

    def _linear_system(self, tau, state, active) -> DiffusionSystem:
        d, key = self.scene.liquid_diffusivity, (tau, None if active is None else active.tobytes())
        if self.processes.any(self._system is None or self._system_key != key):
            weight = self.free_volume.copy()
            if active is not None:
                weight[self.window][active[self.box.interior]] = 0.0
            diagonal = 1.0 / tau + d * self.neighbour_liquid
            sink = weight * (diagonal - d * self.sum(weight))
            extra_diagonal = None
            if state is not None:
                extra_diagonal = (weight > 0) * self.put(state.diagonal())
                sink = sink + extra_diagonal * state.storage_share
            self._system = DiffusionSystem(
                self.sum, weight, diagonal, d, sink, extra_diagonal=extra_diagonal
            )
            self._system_key = key
        coupled = state is not None and not self.faradaic
        self._system.extra = self._coupling(state) if coupled else None
        return self._system

    def _coupling(self, state):
        """The metal's share of the liquid's matrix (it is eliminated), as an in-place update."""
        unknown = self.take(self._system.weight)

        def add(u, y):
            box_u = np.where(unknown > 0, self.take(u), 0.0)
            through = state.through_metal(box_u)
            share = state.diagonal() * (unknown > 0) * box_u
            share -= state.theta * unknown * state.rate * through
            y[self.window] += share[self.box.interior]
            return float(kernels.inner_product(share, box_u).sum())

        return add

    def _interface_balance(self, y, old, tau, state, metal, active):
        """Inflow that each active node needs to stay at C_sat, and what theta = 1 would bring."""
        d = self.scene.liquid_diffusivity
        available = state.offered(metal, self.scene.saturation_concentration)
        gain, here = self.take(self.near(self.liquid_volume * y)), self.take(y)
        needed = (here - self.take(old)) / tau - d * (gain - self.box_neighbour_liquid * here)
        return np.where(active, self.box_free_volume * needed, 0.0), np.maximum(available, 0.0)

    def _release_rate(self, y, state, metal) -> float:
        """Amount that reaches the refreshed nodes per second, mol/s."""
        if not self._open:
            return 0.0
        gain = self.sum(self.liquid_volume * y)
        rate = self.scene.liquid_diffusivity * float((gain * self.capacity)[self.fixed].sum())
        if state is not None:
            fixed = self.take(np.where(self.fixed, self.capacity, 0.0))
            rate += float((state.to_refreshed(metal) * fixed).sum())
        return self.processes.total(rate) * self.scene.lattice.cell_volume
