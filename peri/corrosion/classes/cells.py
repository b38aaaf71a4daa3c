"""Metal and liquid in one cell: the bonds of rate classes and the implicit stage that solves them.

Cell i holds metal classes p of relative volume v_ip and a share c_i of liquid of one
concentration.  With G_ip = K Lambda_ip the bond sum that class p sees in truth (rate_classes),

    v_ip dC_ip/dt = -k sum_j theta_j M_ip,j (C_ip - C_j),           k = D_int g(V_L),
    c_j  dC_j/dt  = D_liq sum_k w_jk c_j c_k (C_k - C_j) + k theta_j sum_ip M_ip,j (C_ip - C_j),
    M_ip,j = v_ip mu_ip w_ij c_j nu_j >= 0.

mu and nu are balanced so that each class and each liquid cell has its own exposure,
sum_j w_ij c_j nu_j mu_ip = G_ip (exact, last) and nu_j sum_ip v_ip mu_ip w_ij = G_j^liquid.  M is
one number a pair: the form is symmetric, conserves the amount and keeps 0 <= C_j <= C_sat.  In
clean liquid a class obeys C' = -k G_ip C, whatever the lattice.

A class that falls below C_sat is liquid of its cell from then on.  What others then see grows by
what the lattice says, in the continuum's strength of a front,

    G_ip(t) = G_ip(0) + s (E_i(t) - E_i(0)),   E_i = sum_j w_ij c_j + 2 w(h) c_i,
    s = (3/delta) / S                  (of q = 0, omega = 1; S: the stencil's mean strength).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from peri.corrosion.interface import saturation
from peri.corrosion.kinetics import Exposed
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import closed_constant, closed_strength
from peri.engine.march.problem import BoundsError
from peri.engine.operators import NonlocalSum
from peri.engine.solvers import ConvergenceError, DiffusionSystem

_SMALLEST_SHARE = 1e-3
"""Cells with a smaller share of liquid hold none (of a thousandth of a cell's flux)."""
_BALANCING_ROUNDS = 8
"""Of mu and nu by turns; more change V_L by less than 1e-4 (the metal's condition is exact)."""
_ROUNDS = 60
_LOSS_TOLERANCE = 1e-9
_ROUND_REDUCTION = 0.1

Array = NDArray[np.float64]


@dataclass
class CellStage:
    """Solution of one implicit stage: liquid and theta (padded), classes (n,), and measures.

    classes, liquid : mol/m^3.  release_rate : mol/s.
    """

    liquid: Array
    classes: Array
    theta: Array
    volume_loss: float
    release_rate: float
    iterations: int
    rounds: int


class Cells:
    """A scene with rate classes, discretised.

    Parameters
    ----------
    scene : CorrosionScene
        With an `exposure`; proportional law, complementarity, kinetics of one number.
    tolerance : float
        Residual norm relative to the sources at which a linear solution is accepted.

    cell : (n,) each class's cell in the flattened padded lattice.  volume : (n,) relative, 0 of a
    class that is liquid.  bond_sum : (n,) G, 1/m^2.  share : padded, c.
    """

    def __init__(self, scene: CorrosionScene, tolerance: float = 1e-9) -> None:
        self.scene, self.tolerance = scene, tolerance
        lattice, exposed = scene.lattice, scene.exposure
        self.sum = NonlocalSum(scene.stencil, lattice.shape, scene.domain)
        places = np.arange(int(np.prod(self.sum.padded_shape))).reshape(self.sum.padded_shape)
        self.cell = places[self.sum.interior].ravel()[exposed.metal.cell]
        self.initial_volume = exposed.metal.volume
        self.initial_bond_sum = class_bond_sums(scene)
        self.liquid_bond_sum = self.sum.pad(constant_of(scene) * exposed.liquid)
        inside = scene.domain if exposed.inside is None else exposed.inside * scene.domain
        held = scene.refreshed() if exposed.held is None else exposed.held
        share = self.sum.pad(inside) - self.sum.pad(exposed.metal.fraction)
        self.held_share = np.clip(np.minimum(self.sum.pad(held), share), 0.0, 1.0)
        free = share - self.held_share
        self.initial_free = np.where(free < _SMALLEST_SHARE, 0.0, free)
        self.near = NonlocalSum(scene.stencil, lattice.shape, self._reached())
        stencil = scene.stencil
        nearest = [stencil.octant[tuple(row)] for row in np.eye(3, dtype=int)]
        self.own_weight = 2.0 * float(max(nearest))
        strength = closed_strength(scene.horizon, scene.kernel_exponent, scene.influence)
        self.strength = strength / stencil.mean_strength()
        self.cells_of_metal = float(self.initial_volume.sum())
        solid, saturated = scene.solid_concentration, scene.saturation_concentration
        self.metal_scale = self.cells_of_metal * solid
        self._loss_scale = self.cells_of_metal * (solid - saturated)
        self.base_diffusivity = scene.base_interface_diffusivity()
        self.set_volumes(self.initial_volume)

    def _reached(self) -> NDArray[np.bool_]:
        """Lattice nodes within the stencil's reach of a cell with metal (a box)."""
        held = np.zeros(self.sum.shape, bool)
        held[self.scene.exposure.metal.fraction.reshape(self.sum.shape) > 0] = True
        rows = np.zeros(self.sum.shape, bool)
        window = []
        for a, reach in enumerate(self.sum.reach):
            present = np.flatnonzero(held.any(axis=tuple(b for b in range(3) if b != a)))
            window.append(slice(max(0, present[0] - reach), present[-1] + reach + 1))
        rows[tuple(window)] = True
        return rows.reshape(self.scene.lattice.shape)

    # --- bonds ----------------------------------------------------------------------------

    def gather(self, field: Array) -> Array:
        """A padded field at each class's cell."""
        return field.ravel()[self.cell]

    def scatter(self, values: Array) -> Array:
        """Sum of the classes' values in each cell, padded."""
        size = int(np.prod(self.sum.padded_shape))
        return np.bincount(self.cell, values, size).reshape(self.sum.padded_shape)

    def set_volumes(self, volume: Array) -> None:
        """Take which classes are metal; bonds and shares follow."""
        self.volume = volume
        grown = self.scatter(self.initial_volume - volume)
        self.free_share = self.initial_free + grown
        self.free = self.free_share > 0
        self.share = self.free_share + self.held_share
        self.neighbour_share = self.sum(self.share)
        self.bond_sum = self.initial_bond_sum
        if grown.any():
            seen = self.near(grown) + self.own_weight * grown
            self.bond_sum = self.bond_sum + self.strength * np.maximum(self.gather(seen), 0.0)
        self._balance(grown)
        self._system: DiffusionSystem | None = None

    def _balance(self, grown: Array) -> None:
        """mu of the classes and nu of the liquid cells, by turns."""
        wanted_liquid = self.share * self.liquid_bond_sum
        flux = float((self.volume * self.bond_sum).sum())
        if grown.any():
            # New liquid sees the metal that is left as the lattice says.
            lattice_says = self.strength * self.near(self.scatter(self.volume))
            new = np.minimum(
                np.divide(grown, self.share, out=np.zeros_like(grown), where=self.share > 0), 1.0
            )
            wanted_liquid = self.share * ((1 - new) * self.liquid_bond_sum + new * lattice_says)
        total = float(wanted_liquid.sum())
        wanted_liquid = wanted_liquid * (flux / total) if total > 0 else wanted_liquid
        nu = (self.share > 0).astype(float)
        for turn in range(_BALANCING_ROUNDS + 1):
            seen = self.gather(self.near(self.share * nu))
            self.mu = np.divide(self.bond_sum, seen, out=np.zeros_like(seen), where=seen > 0)
            if turn == _BALANCING_ROUNDS:
                break
            arrives = self.share * self.near(self.scatter(self.volume * self.mu))
            nu = np.divide(wanted_liquid, arrives, out=np.zeros_like(nu), where=arrives > 0)
        self.nu = nu
        self.pull = nu * self.near(self.scatter(self.volume * self.mu))
        """nu_j sum_ip v_ip mu_ip w_ij."""

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._system = None

    def dropped(self) -> float:
        """Share of the flux into clean liquid of classes that no bond reaches."""
        seen = self.mu > 0
        flux = self.volume * self.bond_sum
        return float(flux[~seen].sum() / flux.sum()) if flux.any() else 0.0

    def steady_bound(self) -> Array | None:
        """The liquid's steady state under the classes' first inflow, mol/m^3, on the lattice.

        It bounds the liquid's concentration at every time where the kinetics never speeds up;
        None where no liquid is held.
        """
        if not self.held_share.any():
            return None
        d, rate = self.scene.liquid_diffusivity, self.rate(0.0)
        inflow = self.free_share * self.pull * rate * self.scene.solid_concentration
        sink = self.free_share * d * self.sum(self.held_share)
        system = DiffusionSystem(self.sum, self.free_share, d * self.neighbour_share, d, sink)
        steady = np.zeros(self.sum.padded_shape)
        system.solve(steady, inflow.copy(), 1e-8 * float(np.linalg.norm(inflow)))
        return np.maximum(self.sum.crop(steady), 0.0)

    # --- measures -------------------------------------------------------------------------

    def volume_loss(self, classes: Array) -> float:
        """V_L = 1 - sum v (C - C_sat) / sum_initial v (C_solid - C_sat)."""
        above = np.maximum(classes - self.scene.saturation_concentration, 0.0)
        return min(1.0, max(0.0, 1.0 - float(self.volume @ above) / self._loss_scale))

    def amounts(self, liquid: Array, classes: Array) -> tuple[float, float]:
        """Amount in the metal and in the free liquid, mol."""
        cell = self.scene.lattice.cell_volume
        return cell * float(self.volume @ classes), cell * float((self.free_share * liquid).sum())

    def coat(self, share: float) -> None:
        """Let the interface carry a share of what it carries bare, from now on."""
        self.base_diffusivity = share * self.scene.base_interface_diffusivity()

    def rate(self, volume_loss: float) -> float:
        """k = D_int g(V_L), m^2/s."""
        return self.base_diffusivity * float(self.scene.kinetics.rate(Exposed(volume_loss)))

    def dissolve(self, liquid: Array, classes: Array) -> int:
        """Classes below C_sat become liquid of their cells, with what they hold; how many."""
        gone = (self.volume > 0) & (classes < self.scene.saturation_concentration)
        if not gone.any():
            return 0
        moved = np.where(gone, self.volume, 0.0)
        content = self.free_share * liquid + self.scatter(moved * classes)
        classes[gone] = 0.0
        self.set_volumes(np.where(gone, 0.0, self.volume))
        liquid[:] = np.divide(
            content, self.free_share, out=np.zeros_like(content), where=self.free_share > 0
        )
        return int(gone.sum())

    # --- implicit stage -------------------------------------------------------------------

    def stage(
        self, old: Array, old_classes: Array, tau: float, guess: Array, theta: Array | None,
        volume_loss: float,
    ) -> CellStage:  # fmt: skip
        """Solve Y = old + tau F(Y), kinetics and saturation included; see BiMaterial."""
        saturated = self.scene.saturation_concentration
        y = np.where(self.free, guess, 0.0)
        reached = self.free & (self.pull > 0)
        if theta is None:
            theta = np.ones(y.shape)
        active = (theta < 1.0) & reached
        iterations, stall = 0, saturation.Stall()
        for rounds in range(1, _ROUNDS + 1):
            y[active] = saturated
            bonds = _Bonds(self, theta, old_classes, tau)
            volume_loss = bonds.settle(y, volume_loss)
            count, solved = self._solve(y, old, tau, bonds, active)
            iterations += count
            classes = bonds.classes(y)
            loss = self.volume_loss(classes)
            settled = solved and abs(loss - volume_loss) <= _LOSS_TOLERANCE
            volume_loss = loss
            needed = np.where(active, self._needed(y, old, tau), 0.0)
            available = np.where(reached, np.maximum(bonds.offered(classes, saturated), 0.0), 0.0)
            new_active, new_theta = saturation.next_active_set(
                active, np.where(reached, y, 0.0), needed, available, saturated
            )
            bonds_on = np.maximum(new_theta, 0.0)
            mismatch = tau * float((np.abs(bonds_on - theta) * available)[active].sum())
            changes = int((new_active != active).sum())
            small = 1e-9 * self.metal_scale * max(1e-3, loss)
            if settled and not changes and mismatch <= small:
                if -tau * float(needed[active].clip(max=0.0).sum()) > 1e-9 * self.metal_scale:
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
        if active.any():
            # What an active cell takes in is what the metal loses, to round-off.
            change = np.where(active, new_theta - theta, 0.0)
            classes = bonds.correct(classes, change, saturated)
            theta = bonds_on
        self._close(y, classes, old, old_classes, tau * release, active)
        loss = self.volume_loss(classes)
        return CellStage(y, classes, theta, loss, release, iterations, rounds)

    def _flow(self, y: Array) -> Array:
        """D_liq sum_k w_jk c_k (C_k - C_j) per relative volume; held cells at zero."""
        d = self.scene.liquid_diffusivity
        return d * (self.sum(self.free_share * y) - self.neighbour_share * y)

    def _needed(self, y: Array, old: Array, tau: float) -> Array:
        return self.free_share * ((y - old) / tau - self._flow(y))

    def _solve(self, y, old, tau, bonds, active) -> tuple[int, bool]:
        """Improve y in place on the cells that are not active."""
        weight = np.where(active, 0.0, self.free_share)
        unknown = weight > 0
        d = self.scene.liquid_diffusivity
        diagonal = 1.0 / tau + d * self.neighbour_share
        extra_diagonal = np.where(unknown, bonds.diagonal, 0.0)
        key = (tau, active.tobytes())
        if self._system is None or self._key != key:
            sink = weight * (diagonal - d * self.sum(weight))
            sink += extra_diagonal * bonds.storage_share
            self._system = DiffusionSystem(
                self.sum, weight, diagonal, d, sink, extra_diagonal=extra_diagonal
            )
            self._key = key

        def add(u: Array, out: Array) -> float:
            u = np.where(unknown, u, 0.0)
            share = np.where(unknown, bonds.diagonal * u - bonds.through(u), 0.0)
            out += share
            return float((share * u).sum())

        self._system.extra = add
        gain = bonds.theta * bonds.offered(bonds.classes(y), y)
        r = np.where(unknown, gain - self._needed(y, old, tau), 0.0)
        scale = float(np.linalg.norm(self.free_share * old)) / tau + float(np.linalg.norm(gain))
        wanted = self.tolerance * scale
        enough = max(wanted, _ROUND_REDUCTION * float(np.linalg.norm(r)))
        enough = enough if active.any() else wanted
        return self._system.solve(y, r, enough), enough <= wanted

    def _released(self, y: Array, bonds: _Bonds, classes: Array) -> float:
        """Amount that reaches the held cells per second, mol/s."""
        d, held = self.scene.liquid_diffusivity, self.held_share
        if not held.any():
            return 0.0
        rate = d * float((self.sum(self.free_share * y) * held).sum())
        rate += float((bonds.arriving(classes) * held).sum())
        return rate * self.scene.lattice.cell_volume

    def _close(self, y, classes, old, old_classes, released, active) -> None:
        """Scale liquid (or the metal's loss) so that the amounts add up to round-off."""
        content = self.free_share * y
        missing = float((self.free_share * old).sum()) - float(content.sum())
        missing += float(self.volume @ (old_classes - classes))
        missing -= released / self.scene.lattice.cell_volume
        solved = self.free & ~active
        liquid = float(content[solved].sum())
        lost = float(self.volume @ (old_classes - classes))
        if liquid > 0 and abs(missing) <= 1e-6 * liquid:
            y[solved] *= 1.0 + missing / liquid
        elif lost > 0 and abs(missing) <= 1e-3 * lost:
            classes += missing / lost * (old_classes - classes)


class _Bonds:
    """The metal's side of a stage: classes eliminated, for given saturation factors."""

    def __init__(self, cells: Cells, theta: Array, old: Array, tau: float) -> None:
        self.cells, self.theta, self.old, self.tau = cells, theta, old, tau
        self.weight = (theta * cells.free_share + cells.held_share) * cells.nu
        self.seen = cells.mu * cells.gather(cells.near(self.weight))

    def settle(self, liquid: Array, start: float) -> float:
        """V_L that agrees with the rate it causes, for given liquid; sets the rate."""
        cells = self.cells
        self._drawn(liquid)

        def excess(loss: float) -> float:
            self.rate = cells.rate(loss)
            return cells.volume_loss(self._value(self.inflow)) - loss

        low, high = 0.0, 1.0
        for guess in (start - 1e-6, start + 1e-6):
            if 0.0 < guess < 1.0:
                low, high = (guess, high) if excess(guess) > 0 else (low, guess)
        loss = low
        if excess(low) > 0 >= excess(high):
            loss = float(brentq(excess, low, high, xtol=1e-13, rtol=1e-13))
        elif excess(high) > 0:
            loss = high
        self.rate = cells.rate(loss)
        decay = 1.0 / self.tau + self.rate * self.seen
        self.response = np.divide(1.0, decay, out=np.zeros_like(decay), where=decay > 0)
        self.storage_share = float(np.mean(self.response)) / self.tau
        self.diagonal = self.rate * self.theta * cells.free_share * cells.pull
        return loss

    def _drawn(self, liquid: Array) -> None:
        cells = self.cells
        self.inflow = cells.mu * cells.gather(
            cells.near(self.theta * cells.free_share * cells.nu * liquid)
        )

    def _value(self, inflow: Array) -> Array:
        return (self.old / self.tau + self.rate * inflow) / (1.0 / self.tau + self.rate * self.seen)

    def classes(self, liquid: Array) -> Array:
        """C_ip = (old/tau + k mu a) / (1/tau + k mu b)."""
        self._drawn(liquid)
        return self._value(self.inflow)

    def arriving(self, classes: Array) -> Array:
        """What reaches liquid held at zero, theta = 1, per relative volume."""
        cells = self.cells
        flux = cells.near(cells.scatter(cells.volume * cells.mu * classes))
        return self.rate * cells.nu * flux

    def offered(self, classes: Array, liquid) -> Array:
        """Inflow of the free cells with theta = 1."""
        cells = self.cells
        return cells.free_share * (self.arriving(classes) - self.rate * cells.pull * liquid)

    def through(self, liquid: Array) -> Array:
        """What liquid values send to each cell by way of the metal."""
        cells = self.cells
        inflow = cells.mu * cells.gather(
            cells.near(self.theta * cells.free_share * cells.nu * liquid)
        )
        values = cells.volume * cells.mu * self.response * self.rate * inflow
        out = cells.near(cells.scatter(values))
        return self.rate * self.theta * cells.free_share * cells.nu * out

    def correct(self, classes: Array, change: Array, saturated: float) -> Array:
        """Classes after the flux of the active cells changed by `change` in theta."""
        cells = self.cells
        seen = cells.mu * cells.gather(cells.near(change * cells.free_share * cells.nu))
        return classes - self.tau * self.rate * seen * (classes - saturated)


def class_bond_sums(scene: CorrosionScene) -> Array:
    """G = K Lambda of each class of a scene, 1/m^2; times D_int its rate in clean liquid."""
    return constant_of(scene) * scene.exposure.metal.exposure


def constant_of(scene: CorrosionScene) -> float:
    """K, by which an exposure becomes a bond sum, 1/m^2."""
    return float(closed_constant(3, scene.horizon, scene.kernel_exponent, scene.influence))
