"""Metal and liquid in one cell: the bonds of rate classes and the implicit stage that solves them.

Cell i holds metal classes p of relative volume v_ip and a share c_i of liquid of one
concentration.  With G_ip = K Lambda_ip the bond sum that class p sees in truth (rate_classes),

    v_ip dC_ip/dt = -k sum_j theta_j M_ip,j (C_ip - C_j),           k = D_int g(V_L),
    c_j  dC_j/dt  = D_liq sum_k w_jk c_j c_k (C_k - C_j) + k theta_j sum_ip M_ip,j (C_ip - C_j),
    M_ip,j = v_ip mu_ip w_ij c_j nu_j >= 0,

with C_solid in place of C_ip - C_j under Faraday's law, until the class is empty.
mu and nu are balanced so that each class and each liquid cell has its own exposure,
sum_j w_ij c_j nu_j mu_ip = G_ip (exact, last) and nu_j sum_ip v_ip mu_ip w_ij = G_j^liquid (of its
liquid's mean, moved towards its middle's value: `at_middles`; where the surface has moved,
`_seen`).  M is one number a pair: the form is symmetric, conserves the amount and keeps
0 <= C_j <= C_sat.  In clean liquid a class obeys C' = -k G_ip C, whatever the lattice.

Where the surface moves (columns.py has how the classes of a cell go).  The cell's flux X_i
follows from the shares of metal and liquid alone (share_flux.py).  At first it is the surface's
exact one; what that differs by, d_i, is forgotten as the cell sees more liquid and with the share
v_i that is left of its metal:

    X_i(t) + s_i d_i + handed_i,     s_i = v_i min(1, max(0, 2 - E_i(t)/E_i(0))),

E_i = sum_j k_ij (1 - f_j).  d is mostly what one layer of cells has too much and the next too
little, so that a front gains or loses by forgetting the one before the other.  From three spacings
per horizon on (ShareBonds.handed) d is parted into its mean over the horizon, which is forgotten,
and the rest, which adds up to nothing: what is forgotten of that is handed to the metal around in
proportion to its flux.  There is no memory but the volumes, so nothing drifts; edges, walls and
fronts that meet are the sum's affair.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.blocks import block_scene
from peri.corrosion.classes.columns import Columns
from peri.corrosion.classes.share_flux import ShareFlux
from peri.corrosion.kinetics import Exposed
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import closed_constant, closed_strength
from peri.engine.operators import NonlocalSum
from peri.engine.processes import ONE_PROCESS, OneProcess, box_in_reach
from peri.engine.solvers import DiffusionSystem
from peri.engine.surface.flat_front import FlatFront

_SMALLEST_SHARE = 1e-3
"""Cells with a smaller share of liquid hold none (of a thousandth of a cell's flux)."""
_THINNEST = 1e-18
"""Of a class: less than that of it is none; what its cell's liquid takes for it is round-off."""
_EMPTIED = 1e-6
"""Of C_solid: a class that holds less is empty, where metal ends empty.  Saturation factors, known
to 1e-9 of the metal, leave such rests, which are no metal."""
_NOTHING = 1e-12
"""Of the largest rate: cells that see less flux around hand nothing on."""
_HANDED = 0.5
"""Most that a cell's flux may change by what is handed to it.  All that is missing around the last
cell of a body would be taken from it, which then lasts."""
_BALANCING_ROUNDS = 8
"""Of mu and nu by turns; more change V_L by less than 1e-4 (the metal's condition is exact)."""
_TO_MIDDLE = 0.7
"""How far a liquid cell's mean bond sum moves to that of its middle.  What a point sees is convex
in its depth, so that with means liquid saturates too far out; with the middles' own values not far
enough, as the lattice's bonds reach farther.  Errs least for plates of six directions."""

Array = NDArray[np.float64]


class Volumes:
    """A scene with rate classes, discretised.

    Parameters
    ----------
    scene : CorrosionScene
        With an `exposure`; kinetics of one number.
    tolerance : float
        Residual norm relative to the sources at which a linear solution is accepted.
    processes : OneProcess or its like
        Who holds which block of the lattice; `self.scene` and all arrays are those of the block.

    columns : the classes in their order.  cell : (n,) each class's cell in the flattened padded
    lattice; place : (r,) each column's.  volume : (n,) relative, what is metal of a class.
    bond_sum : (n,) G, 1/m^2.  own : (n,) of it, what other cells do not carry as soon as the class
    is gone (what it draws, they do).  age : (n,) s since it first saw liquid, set before a stage.
    share : padded, c.  ends, gone : mol/m^3, what metal holds where it ends, and a class that is
    counted as gone.
    """

    def __init__(
        self,
        scene: CorrosionScene | None,
        tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self.processes, self.tolerance = processes, tolerance
        self.scene = scene = block_scene(scene, processes)
        lattice, exposed = scene.lattice, scene.exposure
        self.sum = NonlocalSum(scene.stencil, lattice.shape, scene.domain, processes=processes)
        places = np.arange(int(np.prod(self.sum.padded_shape))).reshape(self.sum.padded_shape)
        height = lattice.cell_volume ** (1 / 3) / scene.horizon
        front = FlatFront(scene.horizon, scene.kernel_exponent, scene.influence)
        strength = closed_strength(scene.horizon, scene.kernel_exponent, scene.influence)
        self._at_reach = strength / scene.horizon * front.at_reach(height)
        self.columns = Columns(exposed.metal, height, front, processes)
        self.cell = places[self.sum.interior].ravel()[self.columns.cell]
        self.place = np.zeros(self.columns.first.size, int)
        self.place[self.columns.row] = self.cell
        self.initial_volume = self.columns.volume
        self.initial_bond_sum = constant_of(scene) * self.columns.exposure
        self.liquid_bond_sum = self.sum.pad(constant_of(scene) * exposed.liquid)
        inside = scene.domain if exposed.inside is None else exposed.inside * scene.domain
        held = scene.refreshed() if exposed.held is None else exposed.held
        share = self.sum.pad(inside) - self.sum.pad(exposed.metal.fraction)
        self.held_share = np.clip(np.minimum(self.sum.pad(held), share), 0.0, 1.0)
        free = share - self.held_share
        self.initial_free = np.where(free < _SMALLEST_SHARE, 0.0, free)
        rows = self._reached()
        self.near = NonlocalSum(scene.stencil, lattice.shape, rows, processes=processes)
        self._bonds_at_first = self.near(self.scatter(self.initial_volume))
        self._next = NonlocalSum(scene.nearest_stencil(), lattice.shape, rows, processes=processes)
        self.liquid_bond_sum = self.at_middles(self.liquid_bond_sum)
        self._shares: ShareFlux | None = None
        self.cells_of_metal = processes.total(float(self.initial_volume.sum()))
        solid, self.ends = scene.solid_concentration, scene.dissolution.liquid_below(scene)
        # What a class holds when it is gone: no more than its cell's liquid may.
        self.gone = self.ends or min(_EMPTIED * solid, scene.saturation_concentration)
        self.metal_scale = self.cells_of_metal * solid
        self._loss_scale = self.cells_of_metal * (solid - self.ends)
        self.base_diffusivity = scene.base_interface_diffusivity()
        self.age = np.zeros(self.cell.size)
        self.set_volumes(self.initial_volume)

    def _reached(self) -> NDArray[np.bool_]:
        """Lattice nodes within the stencil's reach of a cell with metal (a box)."""
        held = self.scene.exposure.metal.fraction.reshape(self.sum.shape) > 0
        rows = np.zeros(self.sum.shape, bool)
        window = box_in_reach(held, self.sum.reach, self.processes)
        assert window is not None  # a scene with an exposure has metal
        rows[window] = True
        return rows.reshape(self.scene.lattice.shape)

    # --- bonds ----------------------------------------------------------------------------

    def gather(self, field: Array) -> Array:
        """A padded field at each class's cell."""
        return field.ravel()[self.cell]

    def scatter(self, values: Array) -> Array:
        """Sum of the classes' values in each cell, padded."""
        size = int(np.prod(self.sum.padded_shape))
        # counts of nothing are whole numbers
        return np.bincount(self.cell, values, size).astype(float).reshape(self.sum.padded_shape)

    def set_volumes(self, volume: Array, ahead: Array | None = None) -> None:
        """Take what is metal of the classes; bonds and shares follow.

        ahead : the volumes that the rates are for, if those of another time.
        """
        self.volume, self.ahead = volume, volume if ahead is None else ahead
        grown = self.scatter(self.initial_volume - volume)
        self.free_share = self.initial_free + grown
        self.free = self.free_share > 0
        self.share = self.free_share + self.held_share
        self.neighbour_share = self.sum(self.share)
        self.bond_sum = self.own = self.initial_bond_sum
        wanted = self.share * self.liquid_bond_sum
        if self.processes.any(grown.any()):
            self.bond_sum, self.own = self._moved(volume, self._seen_metal(self.ahead))
            # Old liquid sees less metal as that goes; new liquid what lies within the horizon.
            metal, before = self.scatter(self.ahead), self._bonds_at_first
            now = self.near(metal)
            new = np.divide(grown, self.share, out=np.zeros_like(grown), where=self.share > 0)
            left = np.divide(now, before, out=np.zeros_like(now), where=before > 0)
            new, left = np.minimum(new, 1.0), np.clip(left, 0.0, 1.0)
            wanted = (1.0 - new) * left * wanted + new * self.share * self._seen(metal, now)
        self._balance(wanted)

    def _seen(self, metal: Array, bonds: Array) -> Array:
        """What liquid sees where the surface has moved, 1/m^2; shares of metal, sums over bonds.

        Liquid saturates wherever it sees metal, so that the pace of a front follows the last layer
        that does.  The lattice's bonds reach half a cell beyond the horizon, and metal is spread
        over its cells, half a cell more: their sum is what a point sees, spread over two boxes as
        wide as a cell.  What it is at one horizon from a flat front is taken off, so that liquid
        sees metal as far as its middle lies within the horizon.  Liquid beside metal sees it all,
        however little that is.
        """
        beside = metal + self._next(metal) > 0
        return np.where(beside, bonds, np.maximum(bonds - self._at_reach, 0.0))

    def at_middles(self, seen: Array) -> Array:
        """Bond sums of the liquid moved from the means of its cells towards their middles' values.

        `_TO_MIDDLE` of h^2/24 times the second differences, along bonds between next cells by the
        shares of liquid of both, so that the sum over the liquid stays.
        """
        share, near = self.initial_free + self.held_share, self._next
        differences = near(share * seen) - near(share) * seen
        return np.maximum(seen - _TO_MIDDLE / 24.0 * differences, 0.0)

    def _by_shares(self) -> ShareFlux:
        """The flux by shares; at first also what that of the first surface differs by."""
        if self._shares is None:
            front = self.columns.front
            self._shares = shares = ShareFlux(self.scene, front, self._reached(), self.processes)
            metal = self.scatter(self.initial_volume)
            self._at_first = shares.seen(metal)
            flux = metal * np.maximum(shares.total - self._at_first, 0.0) + shares.drawn(metal)
            exact = self.scatter(self.initial_volume * self.initial_bond_sum)
            self._missed, self._first_flux = exact - flux, np.maximum(flux, exact)
            self._uneven = shares.handed * (
                self._missed - self._spread(self._missed, self._first_flux)
            )
        return self._shares

    def _seen_metal(self, volume: Array) -> Array:
        """sum_j k_ij f_j by weights for cut cells, 1/m^2, padded."""
        return self._by_shares().seen(self.scatter(volume))

    def _spread(self, amount: Array, flux: Array) -> Array:
        """Amounts of cells (padded), handed to those around in proportion to their flux."""
        around = self.near(flux)
        there = around > _NOTHING * self._by_shares().total
        each = np.divide(amount, around, out=np.zeros_like(amount), where=there)
        return flux * self.near(each)

    def moved(self, volume: Array) -> Array:
        """G (n,) of the classes once only `volume` (n,) of them is metal, 1/m^2; nothing is set."""
        return self._moved(volume, self._seen_metal(volume))[0]

    def _moved(self, volume: Array, seen_metal: Array) -> tuple[Array, Array]:
        """G of the classes where the surface has moved, and of it what is not drawn."""
        columns, shares = self.columns, self._by_shares()
        front, total = columns.front, shares.total
        seen, before = (np.maximum(total - field, 0.0) for field in (seen_metal, self._at_first))
        before[before < 1e-9 * total] = 0.0
        ratio = np.divide(seen, before, out=np.full_like(seen, np.inf), where=before > 0)
        kept = np.clip(2.0 - ratio, 0.0, 1.0)
        left, whole = self.scatter(volume), self.scatter(self.initial_volume)
        stays = kept * np.divide(left, whole, out=np.zeros_like(left), where=whole > 0)
        drawn = shares.drawn(left)
        flux = np.maximum(left * seen + drawn, 0.0)
        gone = (1.0 - stays) * self._uneven
        if self.processes.any(gone.any()):
            # As it once lay first, so that nothing is left of what is all forgotten.
            handed = self._spread(self._spread(gone, self._first_flux), flux)
            flux += np.clip(handed, -_HANDED * flux, _HANDED * flux)
        flux = np.maximum(flux + stays * self._missed, 0.0)
        strength = closed_strength(front.horizon, front.kernel_exponent, front.influence)
        strength /= front.horizon
        lent = np.divide(drawn, flux, out=np.zeros_like(flux), where=(drawn > 0) & (flux > 0))
        flux, kept, lent = (field.ravel()[self.place] for field in (flux, kept, lent))
        rates = columns.rates(volume, flux, strength, kept, self.initial_bond_sum)
        return rates, rates * (1.0 - np.minimum(lent, 1.0))[columns.row]

    def _balance(self, wanted_liquid: Array) -> None:
        """mu of the classes and nu of the liquid cells (which should see `wanted`), by turns."""
        flux = self.processes.total(float((self.volume * self.bond_sum).sum()))
        total = self.processes.total(float(wanted_liquid.sum()))
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

    def dropped(self) -> float:
        """Share of the flux into clean liquid of classes that no bond reaches."""
        seen = self.mu > 0
        flux, total = self.volume * self.bond_sum, self.processes.total
        whole = total(float(flux.sum()))
        return total(float(flux[~seen].sum())) / whole if whole > 0 else 0.0

    def steady_bound(self) -> Array | None:
        """The liquid's steady state under the classes' first inflow, mol/m^3, on the lattice.

        It bounds the liquid's concentration at every time where the kinetics never speeds up;
        None where no liquid is held, or classes have rates of their own.
        """
        if not (self.held_share.any() and self.scene.one_rate):
            return None
        d, rate = self.scene.liquid_diffusivity, self.interface_rate(0.0)[0]
        inflow = self.free_share * self.pull * rate * self.scene.solid_concentration
        sink = self.free_share * d * self.sum(self.held_share)
        system = DiffusionSystem(self.sum, self.free_share, d * self.neighbour_share, d, sink)
        steady = np.zeros(self.sum.padded_shape)
        system.solve(steady, inflow.copy(), 1e-8 * float(np.linalg.norm(inflow)))
        return np.maximum(self.sum.crop(steady), 0.0)

    # --- measures -------------------------------------------------------------------------

    def volume_loss(self, classes: Array) -> float:
        """V_L = 1 - sum v (C - C_end) / sum_initial v (C_solid - C_end), C_end where metal ends."""
        above = np.maximum(classes - self.ends, 0.0)
        left = self.processes.total(float(self.volume @ above))
        return min(1.0, max(0.0, 1.0 - left / self._loss_scale))

    def amounts(self, liquid: Array, classes: Array) -> tuple[float, float]:
        """Amount in the metal and in the free liquid, mol."""
        cell, total = self.scene.lattice.cell_volume, self.processes.total
        metal = total(float(self.volume @ classes))
        return cell * metal, cell * total(float((self.free_share * liquid).sum()))

    def coat(self, share: float) -> None:
        """Let the interface carry a share of what it carries bare, from now on."""
        self.base_diffusivity = share * self.scene.base_interface_diffusivity()

    def interface_rate(
        self, volume_loss: float, seen: Array | None = None
    ) -> tuple[float, Array | float]:
        """k = D_int g, m^2/s, and each class's share of it (1 for all where it is one number).

        seen : (n,) concentration of the liquid that each class sees (None: clean liquid).
        """
        kinetics = self.scene.kinetics
        if self.scene.one_rate:
            return self.base_diffusivity * float(kinetics.rate(Exposed(volume_loss))), 1.0
        clean = np.zeros(self.cell.size)
        known = {"concentration": clean if seen is None else seen, "age": self.age}
        at = Exposed(volume_loss, **{n: known[n] for n in kinetics.needs if n in known})
        return self.base_diffusivity, np.asarray(kinetics.rate(at), float)

    def seen_liquid(self, liquid: Array) -> Array | None:
        """Mean concentration over the bonds of each class, where the kinetics looks at it."""
        if "concentration" not in self.scene.needs:
            return None
        bonds = self.gather(self.near(self.share * self.nu))
        inflow = self.gather(self.near(self.free_share * self.nu * liquid))
        return np.divide(inflow, bonds, out=np.zeros_like(bonds), where=bonds > 0)

    def left(self, classes: Array, life: Array) -> Array:
        """Volumes (n,) that are left of the classes."""
        solid, volume, ends = self.scene.solid_concentration, self.volume, self.ends
        left = self.columns.thinned(volume, life)
        # What is left keeps what the class holds above C_end, so that it stays below C_solid; a
        # class is gone when it holds no more than that, or next to nothing.
        held = np.clip((classes - ends) / (solid - ends), 0.0, 1.0)
        left = np.maximum(left, volume * held)
        there = (classes > self.gone) & (left > _THINNEST * self.initial_volume)
        left = np.where(there, left, 0.0)
        grown = self.initial_free + self.scatter(self.initial_volume - left)
        return np.where(self.gather(grown) < _SMALLEST_SHARE, volume, left)

    def dissolve(self, liquid: Array, classes: Array, life: Array, ahead: float) -> int:
        """What is gone of the classes becomes liquid of their cells; how many end with it.

        Each part that goes takes C_end with it, the last one what its class still holds.  All
        three arrays change in place.  ahead : how many steps like the one that led here the
        rates are for.
        """
        left, before = self.left(classes, life), self.volume
        if not self.processes.any(not np.array_equal(left, before)):
            return 0
        gone = (before > 0) & (left == 0)
        moved = (before - left) * np.where(gone, classes, self.ends)
        content = self.free_share * liquid + self.scatter(moved)
        ratio = np.divide(before, left, out=np.zeros_like(left), where=left > 0)
        thinner = left < before
        classes[thinner] = np.where(gone, 0.0, self.ends + (classes - self.ends) * ratio)[thinner]
        life[thinner] *= ratio[thinner]
        self.set_volumes(left, np.maximum(left - ahead * (before - left), 0.0))
        liquid[:] = np.divide(
            content, self.free_share, out=np.zeros_like(content), where=self.free_share > 0
        )
        return int(self.processes.total(int(gone.sum())))


def class_bond_sums(scene: CorrosionScene) -> Array:
    """G = K Lambda of each class of a scene, 1/m^2; times D_int its rate in clean liquid."""
    return constant_of(scene) * scene.exposure.metal.exposure


def constant_of(scene: CorrosionScene) -> float:
    """K, by which an exposure becomes a bond sum, 1/m^2."""
    return float(closed_constant(3, scene.horizon, scene.kernel_exponent, scene.influence))
