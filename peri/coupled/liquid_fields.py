"""The liquid of a march: what its nodes hold as padded fields of the march's state, and back."""

from __future__ import annotations

import numpy as np

from peri.coupled.surroundings import Surroundings
from peri.engine.march.problem import Attempt, Fields
from peri.engine.processes import ONE_PROCESS, OneProcess
from peri.transport.liquid import LiquidState

TRACE = 0.01
"""Of what the metal loses in a step: minerals that change by less do not shorten it."""

_SCALARS = ("ln_component", "release", "extents", "migrated", "rates", "psi")
_SMOOTH = ("ln_component", "release", "extents", "migrated", "psi")
_LARGEST_CHANGE = 1.0
"""Of ln of a free component: what changes by more in a step (one that comes in) has no trend."""


class LiquidFields:
    """Fields of a state on the nodes of the liquid around the metal."""

    def __init__(self, around: Surroundings) -> None:
        self.around = around

    def at(self, field: np.ndarray) -> np.ndarray:
        """(..., n) on the liquid's nodes from padded fields (..., lattice)."""
        metal = self.around.discrete.metal
        lead = field.shape[: field.ndim - metal.ndim]
        return field.reshape(*lead, metal.size)[..., self.around.space.index]

    def put(self, field: np.ndarray, values: np.ndarray) -> np.ndarray:
        """A copy of padded fields with the values of the liquid's nodes replaced."""
        new, metal = field.copy(), self.around.discrete.metal
        lead = field.shape[: field.ndim - metal.ndim]
        new.reshape(*lead, metal.size)[..., self.around.space.index] = values
        return new

    def read(self, fields: Fields, composed: bool = True) -> LiquidState:
        """The liquid that `write` put into a state's fields, of which it is a view.

        composed : fill in the concentrations, which a start of a solution can do without
        """
        liquid, n = self.around.liquid, self.around.space.n
        scalars = {name: fields[f"liquid_{name}"] for name in _SCALARS}
        active = [row > 0 for row in fields["liquid_active"]]
        shape = (len(liquid.chemistry.names), n)
        concentration, charge = np.broadcast_to(np.nan, shape), np.broadcast_to(np.nan, n)
        if composed:
            concentration = liquid.composer.concentrations(scalars["ln_component"], liquid.b)
            charge = liquid.chemistry.charge @ concentration
        return LiquidState(concentration=concentration, net_charge=charge, active=active, **scalars)

    def pack(self, values: np.ndarray) -> np.ndarray:
        """Rows (k, n) of all processes on the root, in the order of the lattice's nodes.

        No columns of a state of other nodes: it is only looked back on, and there is no trend.
        """
        space = self.around.space
        if space.processes.any(values.shape[-1] != space.n):
            return values[..., :0]
        if space.processes.whole:
            return values
        where, rows = self._on_root(np.ones(space.n)) > 0, np.atleast_2d(values)
        found = [self._on_root(row)[where] for row in rows]
        return np.array(found).reshape(*values.shape[:-1], int(where.sum()))

    def _on_root(self, row: np.ndarray) -> np.ndarray:
        """The whole lattice's array of values (n,), 0 elsewhere."""
        space = self.around.space
        return space.processes.gather(space.crop(row, elsewhere=0.0))

    def unpack(self, stored: np.ndarray | None) -> np.ndarray:
        """This process's part of what the root packed."""
        space, processes = self.around.space, self.around.space.processes
        if processes.whole:
            assert stored is not None
            return stored
        *lead, count = processes.from_root(None if stored is None else stored.shape)
        if not count:
            return np.zeros((*lead, 0))
        where = self._on_root(np.ones(space.n)) > 0
        rows = np.empty((int(np.prod(lead)), space.n))
        for r in range(len(rows)):
            field = np.zeros(where.shape)
            if stored is not None:
                field[where] = stored.reshape(len(rows), count)[r]
            rows[r] = space.gather(space.sum.pad(processes.scatter(field)))
        return rows.reshape(*lead, space.n)

    def write(self, state: LiquidState) -> Fields:
        """Fields `liquid_...` that later solutions start from."""
        fields = {f"liquid_{name}": getattr(state, name) for name in _SCALARS}
        rows = np.array(state.active, float).reshape(len(state.active), self.around.space.n)
        return {**fields, "liquid_active": rows}

    def change(self, attempt: Attempt, lost: float) -> float:
        """Difference of each mineral's change from the expected one, over that change.

        lost : what the metal loses in the step, mol/m3 times cells.  A mineral that takes or gives
        less than TRACE of it counts as if it took that much.
        """
        space, worst = self.around.space, 0.0

        def moved(amount: np.ndarray) -> float:
            return space.processes.total(float(space.volume @ np.abs(amount)))

        before, after, expected = (
            self.at(fields["minerals"])
            for fields in (attempt.old.fields, attempt.stages[-1].fields, attempt.expected)
        )
        for mine, foretold in zip(after - before, expected, strict=True):
            scale = max(moved(mine), TRACE * lost)
            if scale > 0:
                worst = max(worst, attempt.share * moved(mine - foretold) / scale)
        return worst


def foreseen_liquid(
    now: Fields, before: Fields, factor: float, processes: OneProcess = ONE_PROCESS
) -> Fields:
    """Fields `liquid_...` as their last change goes on; none where there is none to go by.

    now, before : of the present state and of the one before;  factor : how far ahead, in last steps
    """
    if not factor or "liquid_release" not in before:
        return {}
    grown = any(now[f"liquid_{n}"].shape != before[f"liquid_{n}"].shape for n in _SMOOTH)
    if processes.any(grown) or not processes.any(before["liquid_release"].any()):
        return {}  # nodes have turned liquid, or it was at rest
    found = {}
    for name in (f"liquid_{n}" for n in _SMOOTH):
        change = now[name] - before[name]
        if name == "liquid_ln_component":
            change[np.abs(change) > _LARGEST_CHANGE] = 0.0
        found[name] = now[name] + factor * change
    return found
