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
from scipy.optimize import brentq

from peri.corrosion.classes.volumes import Volumes

Array = NDArray[np.float64]


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
        weight = (theta * cells.free_share + cells.held_share) * cells.nu
        self._open = cells.gather(cells.near(weight))

    def set_rate(self, volume_loss: float) -> None:
        """Take the kinetics at a volume loss."""
        self.rate, local = self.cells.interface_rate(volume_loss, self.liquid)
        self.own = np.ndim(local) > 0
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
        cells = self.cells
        self.draw(liquid)

        def excess(loss: float) -> float:
            self.set_rate(loss)
            return cells.volume_loss(self.value()) - loss

        low, high = 0.0, 1.0
        for guess in (start - 1e-6, start + 1e-6):
            if 0.0 < guess < 1.0:
                low, high = (guess, high) if excess(guess) > 0 else (low, guess)
        loss = low
        if excess(low) > 0 >= excess(high):
            loss = float(brentq(excess, low, high, xtol=1e-13, rtol=1e-13))
        elif excess(high) > 0:
            loss = high
        self.set_rate(loss)
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
        cells = self.cells
        drawn = cells.near(self.theta * cells.free_share * cells.nu * liquid)
        self.drawn = cells.gather(drawn)

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
        self.storage_share = float(np.mean(self.response)) / self.tau
        self.pulled = self.pull()
        self.diagonal = self.rate * self.theta * cells.free_share * self.pulled

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
        drawn = cells.near(self.theta * cells.free_share * cells.nu * liquid)
        inflow = self.mu * cells.gather(drawn)
        values = cells.volume * self.mu * self.response * self.rate * inflow
        out = cells.near(cells.scatter(values))
        return self.rate * self.theta * cells.free_share * cells.nu * out

    def correct(self, classes: Array, change: Array, saturated: float) -> Array:
        """See Bonds.correct."""
        cells = self.cells
        seen = self.mu * cells.gather(cells.near(change * cells.free_share * cells.nu))
        return classes - self.tau * self.rate * seen * (classes - saturated)
