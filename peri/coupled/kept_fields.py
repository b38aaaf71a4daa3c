"""What a checkpoint keeps of metal and liquid: whole fields, whatever the processes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from peri.corrosion.nodes.problem import CorrosionProblem
from peri.coupled.liquid_fields import LiquidFields
from peri.coupled.surroundings import Surroundings
from peri.engine.march.problem import Fields, State

LAYOUT = 2
"""Of what is kept, part of a march's key: with another one earlier checkpoints are refused."""

_ROWS = ("minerals", "content")
"""Fields of several padded lattices."""


class KeptFields(CorrosionProblem):
    """A CorrosionProblem whose states have a liquid's fields, too.

    surroundings : the liquid of the present phases.
    """

    surroundings: Surroundings

    @property
    def on_nodes(self) -> LiquidFields:
        """The fields of a state on the liquid's nodes."""
        return LiquidFields(self.surroundings)

    def pack(self, name: str, values: np.ndarray) -> np.ndarray:
        """The whole lattice's field on the root; of the liquid's scalars, its nodes'."""
        if name == "bath":  # the same on all processes
            return values
        if name.startswith("liquid_"):
            return self.on_nodes.pack(values)
        if name in _ROWS:
            rows = [super(KeptFields, self).pack(name, row) for row in values]
            return np.array(rows).reshape(len(rows), *(rows[0].shape if rows else (0,)))
        return super().pack(name, values)

    def unpack(self, name: str, stored: np.ndarray | None) -> np.ndarray:
        """This process's field."""
        if name == "bath":
            return self.processes.from_root(stored)
        if name.startswith("liquid_"):
            return self.on_nodes.unpack(stored)
        if name in _ROWS:
            count = self.processes.from_root(None if stored is None else len(stored))
            rows = [
                super(KeptFields, self).unpack(name, None if stored is None else stored[n])
                for n in range(count)
            ]
            return np.array(rows).reshape(count, *self.discrete.sum.padded_shape)
        return super().unpack(name, stored)

    def unpack_fields(self, stored: Mapping[str, np.ndarray | None]) -> Fields:
        """The metal first: it says which nodes the liquid's fields are on."""
        of_liquid = {n: values for n, values in stored.items() if n.startswith("liquid_")}
        fields = super().unpack_fields({n: stored[n] for n in stored if n not in of_liquid})
        if of_liquid and not self.processes.whole:
            self.restore(State(0.0, fields))
        return fields | super().unpack_fields(of_liquid)
