"""Rate classes under Faraday's law: a bond carries k M C_solid, whatever its class still holds.

What a class could not give any more in a stage is given by those that still can: the others of its
cell first, then the cells around, in proportion to their flux and along their own bonds.  Each part
has a metal that loses it and a liquid that receives it, so the amounts add up, and a stage of
constant rates delivers the whole flux while there is metal to carry it.  A class takes on of it
what its own bonds are open for: with all of it, liquid at C_sat would get more than it needs
however small its factors are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.bonds import Bonds

Array = NDArray[np.float64]

_ROUNDS = 40
_NOTHING = 1e-13
"""Of the metal: amounts below it are not handed on any more."""


class FaradaicBonds(Bonds):
    """A bond carries k M C_solid until its class is empty.

    on : (n,) what each class carries over what its bonds would: below 1 where it is emptied, above
    where it carries for others.
    """

    by_class = False
    ahead = 0.0  # what a class lacks within a step others give already

    _left: Array | None = None

    def set_rate(self, volume_loss: float) -> None:
        """See Bonds.set_rate."""
        super().set_rate(volume_loss)
        self._left = None

    def settle(self, liquid: Array, start: float) -> float:
        """See Bonds.settle; a constant rate needs no search."""
        if self.cells.scene.kinetics.needs:
            return super().settle(liquid, start)
        self.set_rate(start)
        return self.cells.volume_loss(self.value())

    def draw(self, liquid: Array) -> None:
        """Nothing: the liquid plays no part but for its factors."""

    def settled(self) -> None:
        """Nothing follows from the rate alone."""

    def value(self) -> Array:
        """old - on tau k C_solid mu b, >= 0; the liquid plays no part."""
        if self._left is not None:
            return self._left
        demand = self.tau * self.rate * self.cells.scene.solid_concentration * self.seen
        own = np.minimum(demand, self.old)
        given = np.minimum(own + self._open_share() * (self._given(demand) - own), self.old)
        full = (self.old > 0).astype(float)
        self.on = np.divide(given, demand, out=full, where=demand > 0)
        self._left = self.old - given
        return self._left

    def _open_share(self) -> Array:
        """(n,) what saturation leaves of each class's bonds, 0..1."""
        whole = self.cells.bond_sum
        seen = self.cells.mu * self._open
        return np.minimum(np.divide(seen, whole, out=np.zeros_like(seen), where=whole > 0), 1.0)

    def _given(self, demand: Array) -> Array:
        """What each class gives, mol/m^3, if each should give `demand` and none what it lacks."""
        cells, columns = self.cells, self.cells.columns
        total, anywhere = cells.processes.total, cells.processes.any
        volume, old = cells.volume, self.old
        given = np.minimum(demand, old)
        over = columns.total(volume * (demand - given))
        least = _NOTHING * total(float(volume @ old))
        for _ in range(_ROUNDS):
            if total(float(over.sum())) <= least:
                break
            room = volume * (old - given)
            pull = np.where(room > _NOTHING * volume * old, volume * demand, 0.0)
            in_cell = columns.total(pull)
            if not anywhere(in_cell.any()):
                break  # all the metal that sees liquid is used up
            whole = in_cell[columns.row]
            share = np.divide(pull, whole, out=np.zeros_like(pull), where=whole > 0)
            taken = np.minimum(share * over[columns.row], room)
            given = given + np.divide(taken, volume, out=np.zeros_like(taken), where=volume > 0)
            over = over - columns.total(taken)
            stuck = np.where(in_cell > 0, 0.0, over)
            if anywhere(stuck.any()):
                over = np.maximum(over + self._around(stuck, in_cell) - stuck, 0.0)
        return np.minimum(given, old)

    def _around(self, amount: Array, pull: Array) -> Array:
        """Amounts of the columns, handed to those around in proportion to their pull."""
        cells = self.cells
        shape, place = cells.sum.padded_shape, cells.place
        pull = pull / cells.processes.largest(float(pull.max(initial=0.0)))
        field = np.zeros(shape)
        field.ravel()[place] = pull
        reached = cells.near(field).ravel()[place]
        field.ravel()[place] = np.divide(
            amount, reached, out=np.zeros_like(amount), where=reached > _NOTHING
        )
        return pull * cells.near(field).ravel()[place]

    def ageing(self, classes: Array) -> Array:
        """Of C / C_solid."""
        return (classes - self.old) / (self.tau * self.cells.scene.solid_concentration)

    def arriving(self, classes: Array) -> Array:
        """See Bonds.arriving."""
        cells = self.cells
        flux = cells.near(cells.scatter(cells.volume * self.mu * self.on))
        return self.rate * cells.scene.solid_concentration * cells.nu * flux

    def offered(self, classes: Array, liquid: Array | float) -> Array:
        """See Bonds.offered."""
        return self.cells.free_share * self.arriving(classes)

    def correct(self, classes: Array, change: Array, saturated: float) -> Array:
        """See Bonds.correct.

        What a cell at C_sat needs may be negative by round-off; the metal then gains it.
        """
        cells = self.cells
        seen = self.mu * cells.gather(cells.near(change * cells.free_share * cells.nu))
        flux = self.rate * cells.scene.solid_concentration * self.on * seen
        return np.maximum(classes - self.tau * flux, 0.0)
