"""One implicit stage of a bi-material problem: liquid, metal, kinetics and saturation together.

A stage goes in rounds: settle the rate with the volume loss that it causes, solve the liquid
(the metal is eliminated exactly), and see which liquid nodes have to be held at C_sat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.corrosion.interface import saturation
from peri.corrosion.interface.exchange import Exchange, FixedPoint
from peri.corrosion.nodes.liquid_system import LiquidSystem, Right
from peri.corrosion.nodes.pores import Pores
from peri.corrosion.nodes.rates import InterfaceRates
from peri.corrosion.settling import settled_loss
from peri.engine import kernels
from peri.engine.march.problem import BoundsError
from peri.engine.solvers import ConvergenceError

_MAXIMUM_ROUNDS = 60
_LOSS_TOLERANCE = 1e-9
"""How well a stage knows its volume loss."""
_DRIFT = 1e-7
"""How well the rates of a stage have to agree with the liquid that they lead to, relative."""
_ROUND_REDUCTION = 0.1
_ROUND_OFF = 4 * np.finfo(float).eps
"""Of a sum over bonds relative to its largest terms: no residual is known better."""


@dataclass
class Stage:
    """Solution of one implicit stage Y = old + tau F(Y)."""

    concentration: np.ndarray
    theta: np.ndarray | None
    volume_loss: float
    release_rate: float
    iterations: int
    rounds: int
    emptied: np.ndarray | None = None
    """Metal nodes that are empty (laws that empty them); what they hold is their liquid's."""
    late: float = 0.0
    """Share of the interface flux whose time is an estimate (Exchange.late)."""
    switch: np.ndarray | None = None
    """Which metal nodes exchange with the liquid, padded box array (0: held back)."""
    pores: np.ndarray | None = None
    """What the emptied share of each metal node holds, mol/m^3, padded."""


class StageSolver:
    """Solves stages of the problem `whole`; keeps one preconditioner between the rounds.

    d : the problem as a stage sees it, with a box no larger than the law of the bonds needs.
    """

    def __init__(self, whole: InterfaceRates) -> None:
        self.d = self.whole = whole
        self.liquid = LiquidSystem()

    def solve(
        self,
        old: np.ndarray,
        tau: float,
        guess: np.ndarray,
        theta: np.ndarray | None,
        volume_loss: float,
        pores: np.ndarray | None = None,
        near: bool = True,
    ) -> Stage:
        """See BiMaterial.implicit_stage; near: on a box no larger than the law of the bonds needs.

        Where such a stage empties metal that exposes nodes off its box, it is solved on the whole.
        """
        whole = self.whole
        d = self.d = self._part(old) if near else whole
        start, loss_at_start = theta, volume_loss
        if theta is not None:
            theta = whole.to_part(d, theta)
        filled = None
        if pores is not None and d.box is not None:
            filled = Pores(d, d.take(d.initial_concentration), pores)
        right = Right(old, tau, filled)
        y = np.where(d.free, guess, 0.0)
        if d.box is None:
            iterations, _ = self._solve_liquid(y, right, None, None)
            return Stage(y, None, 0.0, d.balance.release_rate(y, None, None), iterations, 1)
        exchange = d.scene.dissolution.exchange(d, old, tau)
        saturated = d.scene.saturation_concentration
        if d.scene.saturation == "as_published":
            exchange.switch_off(np.where(d.free & (old >= saturated), d.capacity, 0.0))
        if d.scene.saturation != "complementarity":
            theta = None
        held = _Held(self, right, exchange, theta)
        iterations, rounds, settled = 0, 0, False
        seen = FixedPoint(d.processes)
        # Of the beginning: with that of the end a step in which an active node loses more than a
        # film stands has two solutions, and rounds may end in the one whose film is broken.
        gone = d.lost(exchange.old_metal)
        known, _ = seen.settle(d.seen_liquid(d.take(y)))
        # What pores hold follows from the metal of the round before, as rates do from its loss.
        by_loss, agreed = "volume_loss" in d.scene.needs, False
        by_loss |= filled is not None and exchange.couples
        while rounds < _MAXIMUM_ROUNDS:
            rounds += 1
            liquid = d.take(y)
            volume_loss = self._settle_rate(exchange, held.theta, volume_loss, liquid, known, gone)
            if d is not whole and exchange.emptied is not None:
                if d.processes.any((exchange.emptied & d.box_far).any()):
                    self.liquid.forget()
                    return self.solve(old, tau, guess, start, loss_at_start, pores, near=False)
            view = y[d.window]
            view[held.active[d.box.interior]] = saturated
            if filled is not None:
                filled.fill(exchange.metal_concentration(liquid))
            count, solved = self._solve_liquid(y, right, exchange, held.active, held.gain)
            iterations += count
            liquid = d.take(y)
            metal = exchange.metal_concentration(liquid)
            loss = d.balance.loss_of(metal)
            if solved or not agreed:
                found = d.seen_liquid(liquid)
                agreed = self._rates_hold(exchange, loss, found, gone)
                if not agreed:
                    known, _ = seen.settle(found)
            same_loss = not by_loss or abs(loss - volume_loss) <= _LOSS_TOLERANCE
            settled = solved and same_loss and agreed
            volume_loss = loss
            if d.scene.saturation == "complementarity":
                settled, stalled = held.next(y, metal, loss, settled)
                if settled or stalled:
                    break
            elif exchange.hold_back(metal):
                settled = False
            elif settled:
                break
        if not settled:
            raise ConvergenceError(
                f"saturation: the active set did not settle in {rounds} rounds at a "
                f"step of {tau:.3g} s"
            )
        release = d.balance.release_rate(y, exchange, metal, held.gain)
        kept, more = None, 0.0
        if filled is not None:
            kept = filled.holds(d.take(y))
            more = d.processes.total(float((d.box_metal_volume * (kept - d.take(pores))).sum()))
        # What an active node takes in is what the metal loses, to round-off.
        if d.processes.any(held.active.any()):
            metal = exchange.correct(metal, held.change(), saturated)
            volume_loss, held.theta = d.balance.loss_of(metal), held.bonds_on
        result = np.where(d.free, y, np.where(d.metal, old, 0.0))
        view = result[d.window]
        view[d.box_metal[d.box.interior]] = (metal + exchange.gained)[d.box_metal]
        emptied = None if exchange.emptied is None else d.put(exchange.emptied) > 0
        release += d.balance.close(result, old, tau * release, held.active, more, emptied) / tau
        if kept is not None and emptied is not None:
            # An emptied node opens with what its pores hold.
            kept = d.put(kept)
            result += np.where(emptied, kept, 0.0)
            kept = np.where(emptied, 0.0, kept)
        switch = exchange.switch()
        if switch is not None:
            switch = whole.from_part(d, switch, whole.box_metal)
        theta = whole.from_part(d, held.theta, whole.box_liquid_volume > 0)
        late = exchange.late()
        return Stage(
            result, theta, volume_loss, release, iterations, rounds, emptied, late, switch, kept
        )

    def _part(self, old: np.ndarray) -> InterfaceRates:
        """The problem with the box that the stage from `old` needs."""
        if self.whole.box is None:
            return self.whole
        part = self.whole.beside_liquid()
        if part is not self.whole:
            part.balance.leave_out(old)
        return part

    def alone(self, old: np.ndarray, tau: float, volume_loss: float) -> Stage:
        """The metal's stage in liquid that stays clean: all that the metal loses is released."""
        d = self.d = self.whole
        if d.box is None:
            return Stage(np.zeros_like(old), None, 0.0, 0.0, 0, 1)
        exchange = d.scene.dissolution.exchange(d, old, tau)
        clean = np.zeros_like(exchange.old_metal)
        on = (d.box_liquid_volume > 0).astype(float)
        known, gone = d.seen_liquid(clean), d.lost(exchange.old_metal)
        self._settle_rate(exchange, on, volume_loss, clean, known, gone)
        metal = exchange.metal_concentration(clean)
        loss = d.balance.loss_of(metal)
        lost = ((exchange.old_metal - metal) * d.box_metal_volume)[d.box_metal].sum()
        release = d.processes.total(float(lost)) * d.scene.lattice.cell_volume / tau
        result = np.zeros_like(old)
        result[d.window][d.box_metal[d.box.interior]] = metal[d.box_metal]
        emptied = None if exchange.emptied is None else d.put(exchange.emptied) > 0
        return Stage(result, None, loss, release, 0, 1, emptied, exchange.late())

    # --- kinetics -------------------------------------------------------------------------

    def _settle_rate(
        self,
        exchange: Exchange,
        theta: np.ndarray,
        volume_loss: float,
        liquid: np.ndarray,
        seen_liquid: np.ndarray | None,
        lost: np.ndarray | None,
    ) -> float:
        """Set the rate; V_L that agrees with it where it goes by V_L, for given liquid."""
        d = self.d

        def loss_at(loss: float) -> float:
            exchange.set(theta, *d.interface_rate(loss, seen_liquid, lost))
            return d.balance.loss_of(exchange.metal_concentration(liquid))

        if "volume_loss" not in d.scene.needs:  # the rate is that, whatever is lost
            exchange.set(theta, *d.interface_rate(volume_loss, seen_liquid, lost))
            return volume_loss
        return settled_loss(loss_at, volume_loss, 0.1 * _LOSS_TOLERANCE, _MAXIMUM_ROUNDS)

    def _rates_hold(
        self,
        exchange: Exchange,
        volume_loss: float,
        seen_liquid: np.ndarray | None,
        lost: np.ndarray | None,
    ) -> bool:
        """Whether the nodes' rates are those of the liquid that they lead to.

        Not the liquid itself: off the ramp of a film it may change without any rate doing so.
        """
        if seen_liquid is None:
            return True
        local = np.asarray(self.d.interface_rate(volume_loss, seen_liquid, lost)[1])
        off, most = np.abs(local - exchange.local).max(), local.max()
        largest = self.d.processes.largest
        return largest(float(off)) <= _DRIFT * largest(float(most))

    # --- liquid ---------------------------------------------------------------------------

    def _solve_liquid(
        self,
        y: np.ndarray,
        right: Right,
        exchange: Exchange | None,
        active: np.ndarray | None,
        gain: np.ndarray | None = None,
    ) -> tuple[int, bool]:
        """Improve the liquid concentrations y in place; active nodes keep their value.

        gain : sum over the bonds of what the liquid holds, where the caller has it; overwritten.

        While there are active nodes a round only has to shrink the residual it starts with: the
        next round changes the right side again.  Returns the iterations and whether the
        tolerance itself was reached.
        """
        d, tau = self.d, right.tau
        held = active is not None and d.processes.any(active.any())
        system, share = self.liquid.at(d, right, exchange, active)
        r = d.flow(d.liquid_volume * y) if gain is None else gain
        squares = kernels.stage_residual(
            y, right.old, r, system.weight, system.diagonal, d.scene.liquid_diffusivity, tau,
            *d.flow.rows,
        )  # fmt: skip
        scale = math.sqrt(d.processes.total(float(squares.sum()))) / tau
        if d.walls is not None:
            r += system.mask * d.walls.flow(y)
        if right.pores is not None:
            stored = right.pores.volume * d.take(y) - right.pores.before
            r[d.window] -= (d.take(system.mask) * stored / tau)[d.box.interior]
        if exchange is not None:
            source = exchange.liquid_gain(d.take(y))
            scale += self._norm(source)
            source *= d.take(system.mask)
            r[d.window] += source[d.box.interior]
        wanted = d.tolerance * scale
        rounding = _ROUND_OFF * d.scene.liquid_diffusivity * d.largest_sum
        floor = 0.0
        if rounding * tau > 1e-3 * d.tolerance:  # else the floor is far below
            floor = rounding * self._norm(system.weight * y)
        wanted = max(wanted, floor)
        enough = max(wanted, _ROUND_REDUCTION * self._norm(r)) if held else wanted
        if share is not None and enough > wanted:
            share.roughly()
        iterations = system.solve(y, r, enough)
        if 0 < wanted == floor and not held:
            if not d.is_open:
                self._level(y, right, exchange)
            elif rounding * self._norm(system.weight * y) < 0.1 * floor:
                # The rounding is that of the solution, which is far cleaner than the guess was.
                more, settled = self._solve_liquid(y, right, exchange, active)
                return iterations + more, settled
        return iterations, enough <= wanted

    def _level(self, y: np.ndarray, right: Right, exchange: Exchange | None) -> None:
        """Scale closed liquid (in place) so that the amounts add up, where round-off hides that.

        In a step far longer than diffusion takes, the level of the liquid is known by its storage
        alone, which the rounding of the bonds' sums exceeds.
        """
        d, total = self.d, self.d.processes.total
        now = follows = total(float((d.free_volume * y).sum()))
        before = total(float((d.free_volume * right.old).sum()))
        if exchange is not None:
            metal, alone = (exchange.metal_concentration(d.take(v)) for v in (y, np.zeros_like(y)))
            now += total(float((d.box_metal_volume * (metal + exchange.gained)).sum()))
            follows += total(float((d.box_metal_volume * (metal - alone)).sum()))
            before += total(float((d.box_metal_volume * exchange.old_metal).sum()))
        if right.pores is not None:
            stored = total(float((right.pores.volume * d.take(y)).sum()))
            now, follows = now + stored, follows + stored
            before += total(float(right.pores.before.sum()))
        if follows > 0:
            y[d.free] *= min(2.0, max(0.5, 1.0 + (before - now) / follows))

    def _norm(self, values: np.ndarray) -> float:
        squares = float(kernels.inner_product(values, values).sum())
        return math.sqrt(self.d.processes.total(squares))


class _Held:
    """Liquid nodes held at C_sat and the saturation factors of all, round by round.

    theta : factors that the last solution used.  active : nodes that it held.  gain : sum over the
    bonds of what the last solution's liquid holds (padded), until something changes it.
    """

    def __init__(
        self, solver: StageSolver, right: Right, exchange: Exchange, theta: np.ndarray | None
    ) -> None:
        self.d, self.right, self.exchange = solver.d, right, exchange
        if theta is None:
            theta = (self.d.box_liquid_volume > 0).astype(float)
        self.theta = self.bonds_on = self._wanted = theta
        self.active = (theta < 1.0) & (self.d.box_free_volume > 0)
        self._stall = saturation.Stall()
        self.gain: np.ndarray | None = None

    def next(
        self, y: np.ndarray, metal: np.ndarray, loss: float, settled: bool
    ) -> tuple[bool, bool]:
        """The next set and factors; whether the stage is settled with the present ones, or stalls.

        settled : whether everything else in the stage is.
        """
        d, tau, total = self.d, self.right.tau, self.d.processes.total
        needed, available = self._balance(y, metal)
        new_active, wanted = saturation.next_active_set(
            self.active, d.take(y), needed, available, d.scene.saturation_concentration
        )
        self._wanted = np.where(d.box_liquid_volume > 0, wanted, 0.0)
        self.bonds_on = np.maximum(self._wanted, 0.0)
        off = (np.abs(self.bonds_on - self.theta) * available)[self.active]
        mismatch = tau * total(float(off.sum()))
        changed = d.processes.any(not np.array_equal(new_active, self.active))
        settled &= not changed and mismatch <= d.tolerance * d.balance.metal_scale * max(1e-3, loss)
        if settled:
            # Judged by its amount: `available` grows with D_int without limit.
            shortfall = total(-float(needed[self.active].clip(max=0.0).sum()))
            if tau * shortfall > d.tolerance * d.balance.metal_scale:
                raise BoundsError("saturation: the stage would need a negative inflow")
            return True, False
        if self._stall.after(int(total(int((new_active != self.active).sum()))), mismatch):
            return False, True
        if changed:
            self.active, self.gain = new_active, None  # those that join are moved to C_sat
        self.theta = self.bonds_on
        return False, False

    def change(self) -> np.ndarray:
        """What the active nodes' factors still want to change by."""
        return np.where(self.active, self._wanted - self.theta, 0.0)

    def _balance(self, y: np.ndarray, metal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inflow that each active node needs to stay at C_sat, and what theta = 1 would bring."""
        d, diffusivity = self.d, self.d.scene.liquid_diffusivity
        available = self.exchange.offered(metal, d.scene.saturation_concentration)
        self.gain = d.flow(d.liquid_volume * y)
        gain, here = d.take(self.gain), d.take(y)
        spread = diffusivity * (gain - d.box_neighbour_liquid * here)
        needed = (here - d.take(self.right.old)) / self.right.tau - spread
        needed = d.box_free_volume * needed
        if d.walls is not None:
            needed = needed - d.take(d.walls.flow(y))
        if self.right.pores is not None:
            pores = self.right.pores
            needed = needed + (pores.volume * here - pores.before) / self.right.tau
        return np.where(self.active, needed, 0.0), np.maximum(available, 0.0)
