"""Metal-liquid exchange of one stage: what a law has to offer, on the box around the metal."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from peri.corrosion.phases import Phases
from peri.engine.operators import NonlocalSum
from peri.engine.processes import OneProcess


class Exchange(ABC):
    """Metal-liquid exchange of one stage, its metal unknowns eliminated.

    A law derives from it.  All arrays are padded ones of the box; `liquid` and `metal` are
    concentrations, mol/m^3.

    theta : saturation factors.  rate : of the bonds, m^2/s times whatever the law multiplies it
    with.  local : each metal node's share of the rate.  weight : the same, 0 where its
    bonds are off.
    emptied : metal nodes that the stage empties; their content is then their liquid's.
    gained : what emptied nodes receive in the rest of the stage.  couples : whether the metal's
    loss depends on the liquid, so that the liquid's matrix has the metal's share.
    """

    couples = True
    emptied: np.ndarray | None = None
    gained: np.ndarray | float = 0.0
    theta: np.ndarray
    rate: float
    local: np.ndarray | float
    weight: np.ndarray

    def __init__(self, phases: Phases, old: np.ndarray, tau: float) -> None:
        self.p, self.tau = phases, tau
        self.old_metal = phases.take(old)
        self.weight = phases.box_metal.astype(float)

    @property
    def storage_share(self) -> float:
        """Mean share of a metal node's response that is storage, for the preconditioner."""
        return 1.0

    def turnover(self) -> float:
        """How often a metal node of this process exchanges its content in the stage, at most."""
        return np.inf

    @abstractmethod
    def set(self, theta: np.ndarray, rate: float, local: np.ndarray | float = 1.0) -> None:
        """Fix the saturation factors, the interface diffusivity (m^2/s) and the nodes' shares."""

    @abstractmethod
    def metal_concentration(self, liquid: np.ndarray) -> np.ndarray:
        """The metal at the stage's end, for liquid concentrations."""

    @abstractmethod
    def offered(self, metal: np.ndarray, liquid: np.ndarray | float) -> np.ndarray:
        """Interface inflow of the free liquid nodes with theta = 1 (times their volume)."""

    @abstractmethod
    def to_refreshed(self, metal: np.ndarray, box: NonlocalSum | None = None) -> np.ndarray:
        """Interface inflow per relative volume of liquid held at zero.

        box : the box's sum on the rows that are wanted; all of them by default.
        """

    def liquid_gain(self, liquid: np.ndarray) -> np.ndarray:
        """Net interface inflow of the free liquid nodes for given liquid values."""
        return self.theta * self.offered(self.metal_concentration(liquid), liquid)

    def through_metal(self, liquid: np.ndarray) -> np.ndarray:
        """What liquid values send to each node by way of the metal, over theta and rate."""
        return np.zeros_like(liquid)

    def diagonal(self) -> np.ndarray:
        """The liquid's own share of its outflow into the metal."""
        return np.zeros_like(self.theta)

    @abstractmethod
    def correct(self, metal: np.ndarray, change: np.ndarray, saturated: float) -> np.ndarray:
        """Metal after the flux of the active nodes changed by `change` in theta."""

    def switch_off(self, saturated_volume: np.ndarray) -> None:
        """Saturation "as_published": no exchange for metal nodes that see saturated liquid.

        For laws that go with it (InterfaceLaw.saturations).
        """
        raise ValueError("saturation: 'as_published' does not go with these bonds")

    def switch(self) -> np.ndarray | None:
        """Which metal nodes exchange with the liquid (0: held back), where the law knows."""
        return None

    def hold_back(self, metal: np.ndarray) -> bool:
        """No exchange for metal nodes that would take solute back; whether there are new ones.

        Dissolution is irreversible.  Bounded liquid never exceeds the metal, so this concerns
        liquid without a bound (saturation "none", and "as_published" within a step).
        """
        return False

    def late(self) -> float:
        """Share of the flux whose time is an estimate: none where bonds follow the content."""
        return 0.0


class FixedPoint:
    """Values that a stage's rounds have to agree with, by relaxed iteration (Irons and Tuck 1969).

    The relaxation follows from the last two residuals, so that feedback of either sign settles
    where plain iteration would swing or creep.
    """

    def __init__(self, processes: OneProcess) -> None:
        self.processes = processes
        self.value: np.ndarray | None = None
        self._residual: np.ndarray | None = None
        self._factor = 1.0

    def settle(self, found: np.ndarray | None) -> tuple[np.ndarray | None, float]:
        """The values to use next, and the largest residual relative to the largest value.

        found : what the present values lead to; None where there is nothing to agree with.
        """
        if found is None:
            return None, 0.0
        if self.value is None:
            self.value = found
            return found, np.inf
        residual = found - self.value
        scale = self.processes.largest(float(np.abs(found).max(initial=0.0)))
        off = self.processes.largest(float(np.abs(residual).max(initial=0.0)))
        if self._residual is not None:
            total, change = self.processes.total, residual - self._residual
            moved = total(float((change * change).sum()))
            if moved > 0:
                along = total(float((self._residual * change).sum()))
                self._factor = float(np.clip(-self._factor * along / moved, 0.05, 4.0))
        self._residual = residual
        self.value = np.maximum(0.0, self.value + self._factor * residual)
        return self.value, off / scale if scale > 0 else 0.0
