"""Cells that are taken as torn where no increment, however small, finds equilibrium.

Metal that has nearly lost its strength to damage still flows without limit: the law knows no
fracture. A shred of it that is drawn out to several times its length, often on nodes of its own,
has many states of next to no force, and Newton's method none to settle in.
"""

from __future__ import annotations

import numpy as np

from fem.constitutive.laws import Laws
from fem.constitutive.material import strength_left
from fem.discretisation import Discretisation

STRENGTH_LEFT = 0.05
"""Largest share 1 - q1 f* of the strength that a torn cell may still have."""
STRETCH = 2.0
"""Principal stretch from which on a cell with at most STRENGTH_LEFT counts as torn; one point
of the cell suffices."""
STRETCH_ANY = 5.0
"""Principal stretch from which on every cell counts as torn, however strong: no metal is drawn out
to five times its length."""


def torn_cells(
    discretisation: Discretisation, displacement: np.ndarray, damage: np.ndarray, laws: Laws
) -> np.ndarray:
    """Local cells (nl,) bool to be taken as torn, at an equilibrium or where Newton ran away to.

    displacement (n, 3) [m]; damage (nl, nq).
    """
    d = discretisation
    moved = displacement[d.cells]
    gradient = np.eye(3) + np.einsum("cai,cqaj->cqij", moved, d.gradients, optimize=True)
    largest = np.linalg.eigvalsh(np.swapaxes(gradient, 2, 3) @ gradient)[..., -1].max(axis=1)
    left = strength_left(damage, laws.parameters, laws.of_cell)
    weak = (left <= STRENGTH_LEFT).all(axis=1)
    return largest > np.where(weak, STRETCH, STRETCH_ANY) ** 2
