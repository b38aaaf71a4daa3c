"""A march with rate classes as fields of nodes, which damage maps, exports and pictures read.

A cell that the surface cuts may hold a sliver of metal while its node lies in the liquid.  Taken as
a node of metal such a sliver, of which most is gone early, would stand for the whole space about
its node: the mesh then loses 4 % (Mg-5Gd) and 12 % (Mg-10Gd) more than the lattice in the first
week.  What such cells hold is handed to their neighbours whose nodes lie in the metal, as it is
where a node has one rate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.run import CorrosionResult
from peri.engine.cells import hand_over

_ROUND_OFF = 1e-12
"""Of C_solid: a smaller loss of a cell is that of the mean of its classes."""


def by_nodes(result: CorrosionResult, inside: NDArray[np.bool_]) -> CorrosionResult:
    """The result with metal at the nodes that lie in the solid only; its amount is kept.

    inside: which nodes lie in the solid.  A cell without a neighbour there loses what it holds
    (1.5e-5 of the reference screw at half a horizon).  A node that is liquid takes the mean
    concentration of the liquid cells about it.
    """
    scene = result.scene
    metal, share = inside & scene.metal, scene.metal_fraction
    assert share is not None  # a scene with rate classes has it

    def handed(amount: NDArray[np.float64]) -> NDArray[np.float64]:
        kept = np.where(metal, amount, 0.0)
        return kept + hand_over(np.where(scene.metal & ~metal, amount, 0.0), metal)

    held, slivers, liquid = handed(share), scene.metal & ~metal, scene.domain & ~scene.metal
    count = hand_over(liquid.astype(float), slivers)
    fields = []
    for values in result.concentration:
        about = np.divide(
            hand_over(np.where(liquid, values, 0.0), slivers), count,
            out=np.zeros_like(values), where=count > 0,
        )  # fmt: skip
        # What is gone is handed over, less the round-off of a cell's mean: whole metal is whole.
        gone = scene.solid_concentration - values
        gone = handed(share * np.where(gone > _ROUND_OFF * scene.solid_concentration, gone, 0.0))
        gone = np.divide(gone, held, out=np.zeros_like(held), where=held > 0)
        inner = np.where(metal, scene.solid_concentration - gone, values)
        fields.append(np.where(slivers, about, inner))
    return replace(
        result,
        scene=replace(scene, exposure=None, metal=metal, domain=scene.domain | metal),
        concentration=np.array(fields),
        metal=result.metal & metal,
    )
