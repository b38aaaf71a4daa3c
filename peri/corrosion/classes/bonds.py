"""The metal's side of a stage: what the bonds of the classes carry, by law.

A law is a class here or beside it and a row in `laws.CLASS_BONDS`.  It solves for the
classes where the liquid is given, and says how fast their life goes (columns.py).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.volumes import Volumes
from peri.corrosion.settling import settled_loss

Array = NDArray[np.float64]

_SETTLED = 1e-13
"""How well V_L and the rate that it causes agree."""
_TRIALS = 60


class Bonds(ABC):
    """Classes eliminated, for given saturation factors and right side; a law derives from it.

    theta : padded factors.  old : (n,) right side of the classes, mol/m^3.  tau : s.
    by_class : whether a class's loss changes smoothly in time; else steps are judged by all
    metal's.  ahead : steps by which the volumes that the rates of the next step are for are ahead.
    liquid : (n,) that the kinetics sees.  rate : k = D_int g, m^2/s; mu has the classes' own share
    of it.  diagonal : the liquid's own share of its outflow into the metal.
    storage_share : mean share of a class's response that is storage, for the preconditioner.
    """

    by_class: ClassVar[bool] = True
    ahead: ClassVar[float] = 0.5
    storage_share = 1.0
    diagonal: Array | float = 0.0

    def __init__(
        self, cells: Volumes, theta: Array, old: Array, tau: float, liquid: Array | None = None
    ) -> None:
        self.cells, self.theta, self.old, self.tau = cells, theta, old, tau
        self.liquid = liquid
        self.weight = theta * cells.free_share * cells.nu
        self._open = cells.gather(cells.near(self.weight + cells.held_share * cells.nu))
        self.mu, self.seen = cells.mu, cells.mu * self._open

    def set_rate(self, volume_loss: float) -> None:
        """Take the kinetics at a volume loss."""
        self.rate, local = self.cells.interface_rate(volume_loss, self.liquid)
        self.own = np.ndim(local) > 0
        if self.own:
            self.mu = self.cells.mu * local
            self.seen = self.mu * self._open

    def pull(self) -> Array:
        """nu_j sum_ip v_ip mu_ip w_ij with the classes' own rates."""
        cells = self.cells
        if not self.own:
            return cells.pull
        return cells.nu * cells.near(cells.scatter(cells.volume * self.mu))

    @abstractmethod
    def ageing(self, classes: Array) -> Array:
        """How fast the classes' life goes (columns.py), <= 0, 1/s."""

    def settle(self, liquid: Array, start: float) -> float:
        """V_L that agrees with the rate it causes, for given liquid; sets the rate."""
        self.draw(liquid)

        def loss_at(loss: float) -> float:
            self.set_rate(loss)
            return self.cells.volume_loss(self.value())

        loss = settled_loss(loss_at, start, _SETTLED, _TRIALS)
        self.settled()
        return loss

    @abstractmethod
    def draw(self, liquid: Array) -> None:
        """Take what the classes draw from the liquid."""

    @abstractmethod
    def value(self) -> Array:
        """The classes, mol/m^3, for the rate and what was drawn last."""

    @abstractmethod
    def settled(self) -> None:
        """Set what follows from the rate."""

    def classes(self, liquid: Array) -> Array:
        """The classes for liquid concentrations."""
        self.draw(liquid)
        return self.value()

    @abstractmethod
    def arriving(self, classes: Array) -> Array:
        """What reaches liquid held at zero, theta = 1, per relative volume."""

    @abstractmethod
    def offered(self, classes: Array, liquid: Array | float) -> Array:
        """Inflow of the free cells with theta = 1."""

    def through(self, liquid: Array) -> Array:
        """What liquid values send to each cell by way of the metal."""
        return np.zeros_like(liquid)

    @abstractmethod
    def correct(self, classes: Array, change: Array, saturated: float) -> Array:
        """Classes after the flux of the active cells changed by `change` in theta."""


class ProportionalBonds(Bonds):
    """A bond carries k M (C_ip - C_j)."""

    def ageing(self, classes: Array) -> Array:
        """d ln C / dt over ln(C_solid / C_sat), by what the class sees and draws.

        Not by ln C itself, which an implicit step of a fast class falls short of.
        """
        scene = self.cells.scene
        drawn = np.divide(
            self.mu * self.drawn, classes, out=np.zeros_like(classes), where=classes > 0
        )
        whole = math.log(scene.solid_concentration / scene.saturation_concentration)
        return -self.rate / whole * np.maximum(self.seen - drawn, 0.0)

    def draw(self, liquid: Array) -> None:
        """sum_j w_ij c_j nu_j theta_j C_j."""
        self.drawn = self.cells.gather(self.cells.near(self.weight * liquid))

    def value(self) -> Array:
        """C_ip = (old/tau + k mu a) / (1/tau + k mu b)."""
        return (self.old / self.tau + self.rate * self.mu * self.drawn) / (
            1.0 / self.tau + self.rate * self.seen
        )

    def settled(self) -> None:
        """The classes' response to what they draw, and the liquid's diagonal."""
        cells = self.cells
        decay = 1.0 / self.tau + self.rate * self.seen
        self.response = np.divide(1.0, decay, out=np.zeros_like(decay), where=decay > 0)
        total = cells.processes.total
        responses = total(float(self.response.sum())), total(self.response.size)
        self.storage_share = responses[0] / responses[1] / self.tau
        self.pulled = self.pull()
        self.diagonal = self.rate * self.theta * cells.free_share * self.pulled
        self._passed_on = cells.volume * self.response * (self.rate * self.mu) ** 2

    def arriving(self, classes: Array) -> Array:
        """See Bonds.arriving."""
        cells = self.cells
        flux = cells.near(cells.scatter(cells.volume * self.mu * classes))
        return self.rate * cells.nu * flux

    def offered(self, classes: Array, liquid: Array | float) -> Array:
        """See Bonds.offered."""
        cells = self.cells
        return cells.free_share * (self.arriving(classes) - self.rate * self.pulled * liquid)

    def through(self, liquid: Array) -> Array:
        """See Bonds.through."""
        cells = self.cells
        drawn = cells.gather(cells.near(self.weight * liquid))
        return self.weight * cells.near(cells.scatter(self._passed_on * drawn))

    def correct(self, classes: Array, change: Array, saturated: float) -> Array:
        """See Bonds.correct."""
        cells = self.cells
        seen = self.mu * cells.gather(cells.near(change * cells.free_share * cells.nu))
        return classes - self.tau * self.rate * seen * (classes - saturated)
