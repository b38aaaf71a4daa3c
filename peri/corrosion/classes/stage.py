"""One implicit stage of cells with rate classes: liquid, metal, kinetics, saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.bonds import Bonds
from peri.corrosion.classes.laws import CLASS_BONDS
from peri.corrosion.classes.volumes import Volumes
from peri.corrosion.interface import saturation
from peri.corrosion.interface.exchange import FixedPoint
from peri.engine.march.problem import BoundsError
from peri.engine.solvers import ConvergenceError, DiffusionSystem

_ROUNDS = 60
_LOSS_TOLERANCE = 1e-9
_DRIFT = 1e-7
"""How well a stage has to know the liquid that the kinetics sees, relative."""
_ROUND_REDUCTION = 0.1
_ROUND_OFF = 2.0**-52
_NOTHING = 1e-30
"""Of the metal: liquid that washes out is not solved for below it, down to where numbers end."""

Array = NDArray[np.float64]


@dataclass
class CellStage:
    """Solution of one implicit stage: liquid and theta (padded), classes (n,), and measures.

    classes, liquid : mol/m^3.  ageing : (n,) of the classes' life, 1/s.  release_rate : mol/s.
    """

    liquid: Array
    classes: Array
    ageing: Array
    theta: Array
    volume_loss: float
    release_rate: float
    iterations: int
    rounds: int


class StageSolver:
    """Solves stages of `cells`; keeps one preconditioner between the rounds."""

    def __init__(self, cells: Volumes) -> None:
        self.cells = cells
        self._system: DiffusionSystem | None = None
        self._key: tuple[float, bytes] | None = None

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._system = None

    def solve(
        self, old: Array, old_classes: Array, tau: float, guess: Array, theta: Array | None,
        volume_loss: float, owed: Array | None = None,
    ) -> CellStage:  # fmt: skip
        """Solve Y = old + tau F(Y), kinetics and saturation included; see BiMaterial."""
        saturated = self.cells.scene.saturation_concentration
        total, anywhere = self.cells.processes.total, self.cells.processes.any
        y = np.where(self.cells.free, guess, 0.0)
        bounded = self.cells.scene.saturation == "complementarity"
        reached = self.cells.free & (self.cells.pull > 0) & bounded
        if theta is None:
            theta = np.ones(y.shape)
        old, returned = self._repaid(old, owed, theta)
        active = (theta < 1.0) & reached
        law = CLASS_BONDS[self.cells.scene.dissolution.name]
        stiffness = tau * self.cells.scene.liquid_diffusivity * self.cells.neighbour_share
        iterations, stall = 0, saturation.Stall()
        whole: Array | None = None  # what all cells need, where nothing changed since
        seen = FixedPoint(self.cells.processes)
        for rounds in range(1, _ROUNDS + 1):
            if anywhere(np.any(y[active] != saturated)):
                y[active], whole = saturated, None
            guessed, drift = seen.settle(self.cells.seen_liquid(y))
            bonds = law(self.cells, theta, old_classes, tau, guessed)
            volume_loss = bonds.settle(y, volume_loss)
            level = saturated if anywhere(active.any()) else 0.0
            whole = self._needed(y, old, tau, level) if whole is None else whole
            count, solved = self._solve(y, old, tau, bonds, active, whole, stall.idle > 0)
            iterations += count
            classes = bonds.classes(y)
            loss = self.cells.volume_loss(classes)
            settled = solved and abs(loss - volume_loss) <= _LOSS_TOLERANCE and drift <= _DRIFT
            volume_loss = loss
            whole = self._needed(y, old, tau, level)
            needed = np.where(active, whole, 0.0)
            available = np.where(reached, np.maximum(bonds.offered(classes, saturated), 0.0), 0.0)
            new_active, new_theta = saturation.next_active_set(
                active, np.where(reached, y, 0.0), needed, available, saturated, stiffness
            )
            bonds_on = np.maximum(new_theta, 0.0)
            off = (np.abs(bonds_on - theta) * available)[active]
            mismatch = tau * total(float(off.sum()))
            changes = int(total(int((new_active != active).sum())))
            small = 1e-9 * self.cells.metal_scale * max(1e-3, loss)
            if settled and not changes and mismatch <= small:
                shortfall = total(-float(needed[active].clip(max=0.0).sum()))
                if tau * shortfall > 1e-9 * self.cells.metal_scale:
                    raise BoundsError("saturation: the stage would need a negative inflow")
                break
            if stall.after(changes, mismatch):
                rounds = _ROUNDS
                break
            active, theta = new_active, bonds_on
        else:
            rounds = _ROUNDS
        if rounds == _ROUNDS:
            raise ConvergenceError(
                f"saturation: the active set did not settle at a step of {tau:.3g} s"
            )
        release = self._released(y, bonds, classes)
        if anywhere(active.any()):
            # What an active cell takes in is what the metal loses, to round-off.
            change = np.where(active, new_theta - theta, 0.0)
            classes = bonds.correct(classes, change, saturated)
            theta = bonds_on
        ageing = bonds.ageing(classes)
        unclosed = self._close(y, classes, old, old_classes, tau * release, active)
        loss = self.cells.volume_loss(classes)
        release += (unclosed - returned) / tau
        return CellStage(y, classes, ageing, theta, loss, release, iterations, rounds)

    def _repaid(self, old: Array, owed: Array | None, theta: Array) -> tuple[Array, float]:
        """The liquid's right side without what the classes got back, and held cells' share, mol.

        owed : (n,) mol/m^3 that the right side of the classes was raised by.  It comes back from
        where it went, along the bonds of the class, so that the amounts add up.
        """
        cells = self.cells
        if owed is None:
            return old, 0.0
        weight = (theta * cells.free_share + cells.held_share) * cells.nu
        seen = cells.gather(cells.near(weight))
        back = np.divide(cells.volume * owed, seen, out=np.zeros_like(seen), where=seen > 0)
        back = cells.near(cells.scatter(back)) * cells.nu
        old = old - np.where(cells.free, theta * back, 0.0)
        returned = cells.processes.total(float((cells.held_share * back).sum()))
        return old, returned * cells.scene.lattice.cell_volume

    def _flow(self, y: Array, level: float) -> Array:
        """D_liq sum_k w_jk c_k (C_k - C_j) per relative volume; held cells at zero.

        level : from which concentrations are counted: C_sat where cells are held at it, so that
        round-off makes no flow between those.
        """
        cells, above = self.cells, y - level
        flow = cells.sum(cells.free_share * above) - cells.neighbour_share * above
        if level and cells.processes.any(cells.held_share.any()):
            flow -= level * cells.sum(cells.held_share)
        return cells.scene.liquid_diffusivity * flow

    def _needed(self, y: Array, old: Array, tau: float, level: float) -> Array:
        return self.cells.free_share * ((y - old) / tau - self._flow(y, level))

    def _solve(self, y, old, tau, bonds, active, needed, wholly) -> tuple[int, bool]:
        """Improve y in place on the cells that are not active; needed: of all cells, for y.

        wholly : to the tolerance, where rounds of the active set that know the liquid roughly
        have begun to come back to the same sets.
        """
        weight = np.where(active, 0.0, self.cells.free_share)
        unknown = weight > 0
        d = self.cells.scene.liquid_diffusivity
        diagonal = 1.0 / tau + d * self.cells.neighbour_share
        extra_diagonal = np.where(unknown, bonds.diagonal, 0.0)
        key = (tau, active.tobytes())
        anywhere = self.cells.processes.any
        if anywhere(self._system is None or self._key != key):
            sink = weight * (diagonal - d * self.cells.sum(weight))
            sink += extra_diagonal * bonds.storage_share
            self._system = DiffusionSystem(
                self.cells.sum, weight, diagonal, d, sink, extra_diagonal=extra_diagonal
            )
            self._key = key

        def add(u: Array, out: Array) -> float:
            share = unknown * (bonds.diagonal * u - bonds.through(u))
            out += share
            return float(np.vdot(share, u))

        system = self._system
        assert system is not None
        system.extra = add
        gain = bonds.theta * bonds.offered(bonds.value(), y)
        r = np.where(unknown, gain - needed, 0.0)
        scale = self._norm(self.cells.free_share * old) / tau + self._norm(gain)
        least = _NOTHING * self.cells.metal_scale / tau
        wanted = self.cells.tolerance * max(scale, least)
        # No liquid written in floating point comes closer.
        wanted = max(wanted, _ROUND_OFF * self._norm(weight * diagonal * y))
        enough = max(wanted, _ROUND_REDUCTION * self._norm(r))
        enough = enough if anywhere(active.any()) and not wholly else wanted
        return system.solve(y, r, enough), enough <= wanted

    def _norm(self, values: Array) -> float:
        return math.sqrt(self.cells.processes.total(float(np.vdot(values, values))))

    def _released(self, y: Array, bonds: Bonds, classes: Array) -> float:
        """Amount that reaches the held cells per second, mol/s."""
        d, held = self.cells.scene.liquid_diffusivity, self.cells.held_share
        if not self.cells.processes.any(held.any()):
            return 0.0
        rate = d * float((self.cells.sum(self.cells.free_share * y) * held).sum())
        rate += float((bonds.arriving(classes) * held).sum())
        return self.cells.processes.total(rate) * self.cells.scene.lattice.cell_volume

    def _close(self, y, classes, old, old_classes, released, active) -> float:
        """Scale liquid (or the metal's loss) so that the amounts add up to round-off.

        The metal stays within its bounds: where it is emptied, what is released takes the rest (the
        result, mol).
        """
        total = self.cells.processes.total
        content = self.cells.free_share * y
        missing = float((self.cells.free_share * old).sum()) - float(content.sum())
        lost = float(self.cells.volume @ (old_classes - classes))
        missing = total(missing + lost) - released / self.cells.scene.lattice.cell_volume
        solved = self.cells.free & ~active
        liquid, lost = total(float(content[solved].sum())), total(lost)
        if liquid > 0 and abs(missing) <= 1e-6 * liquid:
            grown = 1.0 + missing / liquid
            if missing <= 0 or self._takes(grown * y[solved]):
                y[solved] *= grown
            else:
                self._fill(y, classes, missing, solved)
        elif lost > 0 and abs(missing) <= 1e-3 * lost:
            room = np.minimum(old_classes - classes, classes)
            whole = total(float(self.cells.volume @ room))
            if abs(missing) >= 1e-3 * whole:
                return missing * self.cells.scene.lattice.cell_volume
            classes += missing / whole * room
        return 0.0

    def _takes(self, liquid: Array) -> bool:
        """Whether liquid of these concentrations is not above C_sat, where that bounds it."""
        scene = self.cells.scene
        if scene.saturation != "complementarity":
            return True
        over = liquid > scene.saturation_concentration * (1.0 + 1e-12)
        return not self.cells.processes.any(over.any())

    def _fill(self, y: Array, classes: Array, missing: float, solved: Array) -> None:
        """Add an amount to liquid as far as C_sat, and what is left to the metal that lost most."""
        cells, total = self.cells, self.cells.processes.total
        saturated, solid = cells.scene.saturation_concentration, cells.scene.solid_concentration
        room = np.where(solved, np.maximum(saturated - y, 0.0), 0.0)
        whole = total(float((cells.free_share * room).sum()))
        share = min(1.0, missing / whole) if whole > 0 else 0.0
        y += share * room
        lost = np.where(cells.volume > 0, np.maximum(solid - classes, 0.0), 0.0)
        there = total(float(cells.volume @ lost))
        if there > 0:
            classes += (missing - share * whole) / there * lost
