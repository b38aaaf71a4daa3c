"""What the metal's kinetics reads of the liquid: pH, ions and minerals beside each metal node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from peri.corrosion.inhibition import Inhibited
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.coupled.surroundings import Surroundings
from peri.engine.processes import OneProcess
from peri.engine.solvers import ConvergenceError
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidState
from peri.transport.mixing import Mixing

AGREED = 1e-7
"""Largest difference of a node's rate by what was read and by what is there, of the fastest
node's: far below the error of a controlled step (1e-3)."""

_ROUNDS = 40
_HALVINGS = 8
_VOLT = 0.025
"""V that change a rate about as much as one unit of pH."""

Seen = dict[str, np.ndarray]
Rates = Callable[[Seen, float], Sequence[np.ndarray] | np.ndarray]

OF_THE_LIQUID = frozenset({"ph", "chloride", "magnesium", "inhibitor", "layer"})
"""Quantities of peri.corrosion.kinetics.Exposed that come from here."""

COMPONENTS = {"chloride": "Cl", "magnesium": "Mg"}
"""Quantities that are totals of a component."""


def components_of(scene: CorrosionScene, medium: Solution) -> dict[str, str]:
    """COMPONENTS, and the inhibitor that the scene's law names.

    Raises ValueError for an inhibitor that is no component of the medium's chemistry, or several.
    """
    laws = [scene.law_of(solid) for solid in scene.solids]
    names = {law.inhibitor for law in laws if isinstance(law, Inhibited)}
    if len(names) > 1:
        raise ValueError(f"inhibitor: {' and '.join(sorted(names))}; all solids must name one")
    for name in names - set(medium.chemistry.components):
        raise ValueError(
            f"inhibitor: '{name}' is no component of the liquid; it must be one of "
            f"{', '.join(medium.chemistry.components)}"
        )
    return {**COMPONENTS, **dict.fromkeys(("inhibitor",) * len(names), *names)}


def medium_beside(
    medium: Solution, components: Mapping[str, str] = COMPONENTS
) -> dict[str, np.ndarray | float]:
    """What metal in fresh medium sees: no magnesium but the medium's own, no layer."""
    totals = {name: _total(medium, component) for name, component in components.items()}
    return {"ph": float(medium.ph[0]), **totals, "layer": 0.0}


def _total(medium: Solution, component: str) -> float:
    names = medium.chemistry.components
    return float(medium.totals[names.index(component), 0]) if component in names else 0.0


def beside_metal(
    around: Surroundings,
    state: LiquidState,
    amounts: np.ndarray,
    components: Mapping[str, str] = COMPONENTS,
) -> dict[str, np.ndarray | float]:
    """The mean over each metal node's bonds to liquid, as padded fields of the box around it.

    state : of the liquid;  amounts : (M, n) minerals, mol/m3;  components : of the quantities that
    are totals of one (components_of).  The layer's thickness is the volume
    of the minerals per volume of liquid times the width of a cell, the liquid cell being what
    stands in front of the metal.  `liquid_potential` is phi, V.
    """
    discrete, space, liquid = around.discrete, around.space, around.liquid
    if discrete.box is None:
        return {}
    chemistry = liquid.chemistry
    volume = discrete.take(space.all_volume)
    bonds = discrete.box(volume)
    sees = bonds > 0

    def mean(values: np.ndarray, held: float) -> np.ndarray:
        field = discrete.take(space.all_volume * space.spread(values, held))
        return np.divide(discrete.box(field), bonds, out=np.full(bonds.shape, held), where=sees)

    totals = chemistry.stoichiometry.T @ state.concentration
    edge = chemistry.stoichiometry.T @ liquid.edge
    h = chemistry.components.index("H")
    # The refreshed layer's pH is the medium's, moved by what it holds of H now.
    fresh = float(liquid.medium.concentration[h, 0])
    held = float(liquid.medium.ph[0]) + float(np.log10(fresh / liquid.edge[h]))
    found: dict[str, np.ndarray | float] = {"ph": mean(liquid.ph(state), held)}
    for name, component in components.items():
        if component in chemistry.components:
            e = chemistry.components.index(component)
            found[name] = mean(totals[e], float(edge[e]))
    width = float(np.prod(around.discrete.scene.lattice.spacing)) ** (
        1.0 / around.discrete.scene.lattice.dimension
    )
    thickness = np.zeros(space.n)
    for mineral, amount in zip(chemistry.minerals, amounts, strict=True):
        thickness += mineral.molar_volume * amount * width
    found["layer"] = mean(thickness, 0.0)
    found["liquid_potential"] = mean(liquid.thermal_voltage * state.psi, 0.0)
    return found


class Agreement:
    """Rounds until the liquid that the metal reads is the one that its release makes.

    discrete : the metal;  seen : what its kinetics reads, by name, padded box arrays to begin with;
    rates : of the nodes by that and the volume loss, by default those of the kinetics;  safe : what
    the liquid surely has a state for, to go back towards where it has none.

    A liquid that resists change (the pH of one without a buffer follows the release at once) makes
    the plain rounds diverge, so they are mixed; a mixture below zero is not taken.
    """

    def __init__(
        self,
        discrete: BiMaterial,
        seen: Seen,
        rates: Rates | None = None,
        safe: Seen | None = None,
    ) -> None:
        self.discrete, self.seen, self._safe, self._backwards = discrete, seen, safe, 0
        self._processes = discrete.processes
        self._sees = discrete.box_metal & (discrete.box_neighbour_liquid > 0)
        self._rates = rates or self._own_rates
        self._mixing = Mixing(self._processes)
        self._rounds = 0

    def with_(self, found: dict[str, np.ndarray | float], volume_loss: float) -> bool:
        """Whether the metal's rates are those by `found`; else `seen` is moved towards it.

        Raises ConvergenceError after too many rounds.
        """
        self._safe, self._backwards = self._safe and self.seen, 0
        there = {n: np.broadcast_to(found[n], self._sees.shape) for n in self.seen}
        before, after = (
            np.asarray(self._rates(values, volume_loss))[..., self._sees]
            for values in (self.seen, there)
        )
        apart = _largest(self._processes, after - before)
        fastest = _largest(self._processes, after)
        if apart <= AGREED * fastest:
            return True
        self._rounds += 1
        if self._rounds >= _ROUNDS:
            raise ConvergenceError(
                f"kinetics: the rate by what the metal reads of the liquid still changes by "
                f"{apart / fastest:.2g} after {_ROUNDS} rounds; a shorter step will do"
            )
        self.seen = self._mixed(there)
        return False

    def go_back(self) -> bool:
        """Go half the way back to what had a state; whether there is such a way."""
        self._backwards += 1
        if self._safe is None or self._backwards > _HALVINGS:
            return False
        self.seen = {n: 0.5 * (values + self._safe[n]) for n, values in self.seen.items()}
        self._mixing = Mixing(self._processes)
        return True

    def _own_rates(self, seen: Seen, volume_loss: float) -> np.ndarray:
        self.discrete.surface |= seen
        share = self.discrete.interface_rate(volume_loss)[1]
        return np.broadcast_to(share, self._sees.shape)

    def _mixed(self, there: Seen) -> Seen:
        scale = {
            n: _scale(n, _largest(self._processes, values[self._sees]))
            for n, values in there.items()
        }
        old, new = (
            np.concatenate([values[n][self._sees] / scale[n] for n in self.seen])
            for values in (self.seen, there)
        )
        mixed = self._mixing.next(old, new)
        parts = dict(zip(self.seen, np.split(mixed, len(self.seen)), strict=True))
        below = any((parts[n] < 0).any() for n in parts if n in _POSITIVE)
        if self._processes.any(below):
            self._mixing = Mixing(self._processes)
            return {n: values.copy() for n, values in there.items()}
        out = {}
        for n, values in there.items():
            out[n] = values.copy()
            out[n][self._sees] = scale[n] * parts[n]
        return out


_POSITIVE = frozenset({"chloride", "magnesium", "inhibitor", "layer"})


def _largest(processes: OneProcess, values: np.ndarray) -> float:
    """The largest size of any value on any process."""
    return processes.largest(float(np.abs(values).max(initial=0.0)))


def _scale(name: str, largest: float) -> float:
    """What counts as much as one unit of pH: all of an amount."""
    if name == "potential":
        return _VOLT
    return largest if name in _POSITIVE and largest > 0 else 1.0
