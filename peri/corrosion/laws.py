"""What a bond between metal and liquid carries: the laws by name, and what each has to say.

A law is one file with a class and its `Exchange`, and a row in INTERFACE_LAWS.  Names can be read
without loading a law, and nothing here needs more than the standard library.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Protocol

from peri.corrosion.choices import SATURATION_MODELS

if TYPE_CHECKING:
    import numpy as np

    from peri.corrosion.metal.solids import Solid
    from peri.engine.march.problem import Attempt, Fields, Stage
    from peri.engine.operators import NonlocalSum
    from peri.engine.processes import OneProcess

INTERFACE_LAWS = {
    "proportional": "peri.corrosion.interface.proportional.Proportional",
    "faradaic": "peri.corrosion.interface.faradaic.Faradaic",
}
"""Where each law is."""


class Scene(Protocol):
    """What a law may look at of a scene (corrosion.scene.CorrosionScene)."""

    solid_concentration: float
    saturation_concentration: float
    saturation: str
    solids: tuple[Solid, ...]

    @property
    def highest_concentration(self) -> float:
        """The largest C_solid, mol/m^3."""


class Amounts(Protocol):
    """Its amounts (corrosion.nodes.balance.Balance)."""

    liquid_below: float
    metal_scale: float


class Discrete(Protocol):
    """What a law may look at of the discrete problem (corrosion.nodes.rates.InterfaceRates).

    Padded arrays of the lattice; box : None without metal.
    """

    scene: Scene
    processes: OneProcess
    balance: Amounts
    tolerance: float
    metal: np.ndarray
    capacity: np.ndarray
    box: NonlocalSum | None


class InterfaceLaw(ABC):
    """A law of the bonds across the interface.

    name : as scenes and files say it.  saturations, schemes : what it goes with, and why not
    with the others (`only`).  reaches : of the bonds, how far around the metal that sees liquid a
    stage looks at first: one, and another where a node that it empties exposes others.  reduces :
    whether in clean liquid every metal node obeys C' = -lambda g C, which peri.omissions rests on.
    by_layers : whether metal goes layer by layer, so that the bonds of cells that a surface cuts
    are those for that (engine.surface.share_weights); where it goes over a horizon's depth, a
    ball errs by more with them (peri/MEASURED.md).
    """

    name: ClassVar[str]
    saturations: ClassVar[tuple[str, ...]] = SATURATION_MODELS
    schemes: ClassVar[tuple[str, ...]] = ("forward_euler", "backward_euler", "sdirk2")
    only: ClassVar[str] = ""
    reaches: ClassVar[int] = 1
    reduces: ClassVar[bool] = False
    by_layers: ClassVar[bool] = False

    def key(self) -> dict[str, object]:
        """What determines the law, for the mark of a checkpoint."""
        return {"law": type(self).__qualname__, **vars(self)}

    @abstractmethod
    def liquid_below(self, scene: Scene) -> float:
        """Metal with no more than this is liquid, mol/m^3."""

    @abstractmethod
    def lifetime(self, scene: Scene) -> float:
        """How long a node of the shortest-lived solid lasts in clean liquid, over 1/lambda."""

    @abstractmethod
    def share_of(self, solid: Solid, scene: Scene) -> float:
        """The rate of a solid's bonds over that of the scene's, for its flux to be `solid.rate`."""

    @abstractmethod
    def exchange(self, discrete: Discrete, old: np.ndarray, tau: float) -> object:
        """The Exchange of one stage (tau in s) from the right side `old` (padded)."""

    # --- the march: what a step may do, and how its rates changed ---------------------------

    @abstractmethod
    def gone(
        self, discrete: Discrete, concentration: np.ndarray, emptied: np.ndarray | None
    ) -> np.ndarray | None:
        """Metal nodes that an accepted step turns liquid."""

    def check(self, discrete: Discrete, concentration: np.ndarray, time: float) -> None:
        """ValueError where the law's physics ends; it goes on everywhere unless a law says so."""
        return None

    def continues(self, discrete: Discrete, first: Stage, right: Fields) -> bool:
        """Whether a second-order step may go on from its first stage to this right side."""
        return True

    def admissible(self, discrete: Discrete, stages: Sequence[Stage]) -> bool:
        """Whether a second-order step is positive as far as the law goes."""
        return True

    @abstractmethod
    def change(self, discrete: Discrete, attempt: Attempt) -> float:
        """Relative change of the metal's loss rate in a step."""


def interface_law(law: str | InterfaceLaw) -> InterfaceLaw:
    """A law by its name (or itself).

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if isinstance(law, InterfaceLaw):
        return law
    if law not in INTERFACE_LAWS:
        raise ValueError(f"dissolution: {law!r}; allowed: {', '.join(INTERFACE_LAWS)}")
    module, _, name = INTERFACE_LAWS[law].rpartition(".")
    return getattr(importlib.import_module(module), name)()
