"""What became of every element over a march: given, taken up, held, precipitated, left."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from peri.transport.nernst_planck import QuasiSteadyLiquid


def element_error(
    liquid: QuasiSteadyLiquid,
    held: np.ndarray,
    amounts: np.ndarray,
    numbers: Mapping[str, float],
    stores: bool,
) -> float:
    """Largest error of a component's balance over a whole march, relative.

    given + s taken - carried = held + minerals + left, of what there is of the component, what was
    set free, and what an applied current carried, each positive; a liquid at rest holds nothing,
    then of what was taken up.

    Parameters
    ----------
    liquid : QuasiSteadyLiquid
    held : (E, n) totals dissolved, mol/m3
    amounts : (M, n) minerals, mol/m3
    numbers : of the state: `taken` (metal, mol), `left_...` and, with storage, `given_...` by
        component (mol): at first, and with the pores of nodes that turned liquid; `charge` (mol)
        that an applied current has carried through the metal
    stores : whether the liquid has a content
    """
    for mineral, amount in zip(liquid.minerals, amounts, strict=True):
        held = held + mineral.nu[:, None] * amount
    worst = 0.0
    chemistry = liquid.chemistry
    hydroxide = chemistry.stoichiometry[chemistry.index("OH")]
    for n, name in enumerate(liquid.chemistry.components):
        given = numbers.get(f"given_{name}", 0.0)
        released = float(liquid.released[n]) * numbers["taken"]
        carried = float(hydroxide[n]) * numbers.get("charge", 0.0)
        left = liquid.space.total(held[n]) + numbers[f"left_{name}"]
        error = given + released - carried - left
        scale = abs(given) + (abs(released) + abs(carried) if stores else numbers["taken"])
        worst = max(worst, abs(error) / scale if scale > 0 else abs(error))
    return worst
