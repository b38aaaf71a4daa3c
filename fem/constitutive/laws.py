"""The materials of a solid as the kernels read them, and which of them each cell is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fem.constitutive.material import Material


@dataclass
class Laws:
    """k materials and the row of each cell.

    The hardening parameters of material m are `hardening[starts[m] : starts[m + 1]]`.
    """

    parameters: np.ndarray  # (k, p), indices in `gurson`
    kinds: np.ndarray  # (k,) of hardening
    starts: np.ndarray  # (k + 1,)
    hardening: np.ndarray
    of_cell: np.ndarray  # (nc,) rows

    @classmethod
    def of(cls, materials: Sequence[Material], of_cell: np.ndarray) -> Laws:
        """materials: k of them; of_cell: (nc,) numbers below k."""
        hardening = [material.hardening.parameters() for material in materials]
        return cls(
            np.array([material.parameters() for material in materials]),
            np.array([material.hardening.kind for material in materials], np.int64),
            np.cumsum([0, *map(len, hardening)]),
            np.concatenate(hardening),
            np.ascontiguousarray(of_cell, np.int64),
        )

    def per_cell(self, index: int) -> np.ndarray:
        """One parameter of each cell, (nc, 1)."""
        return self.parameters[self.of_cell, index][:, None]


def checked_materials(
    materials: Sequence[Material], of_cell: np.ndarray | None, cells: int
) -> np.ndarray:
    """Row of the material of each of `cells` cells, (cells,); ValueError for what names none."""
    if of_cell is None and len(materials) == 1:
        return np.zeros(cells, np.int64)
    if of_cell is None or not len(materials):
        raise ValueError(
            f"{len(materials)} materials are given; material_of_cell must say which cell has which"
        )
    rows = np.asarray(of_cell)
    if rows.shape != (cells,) or rows.dtype.kind not in "iu":
        raise ValueError(
            f"material_of_cell is {rows.dtype} of shape {rows.shape}; it must be whole numbers of "
            f"shape ({cells},)"
        )
    if rows.min() < 0 or rows.max() >= len(materials):
        raise ValueError(
            f"material_of_cell runs from {rows.min()} to {rows.max()}; it must lie in 0 to "
            f"{len(materials) - 1}"
        )
    return rows.astype(np.int64)
