"""The lattice of a scene file: spacing, horizon, box."""

from __future__ import annotations

from collections.abc import Sequence

from peri.engine.lattice import Lattice, box_lattice
from pipeline.scene.units import format_length
from pipeline.scenes.keys import Given, Key, positive

LATTICE_KEYS: dict[str, Key] = {
    "lattice.spacing": positive("length", "distance of the nodes", "0.1mm"),
    "lattice.horizon": positive("length", "reach of the bonds (two spacings)", "0.4mm"),
}
MOST_NODES = 2e7
"""Nodes of a lattice beyond which a scene is refused: 10 GB and more."""


def horizon_of(given: Given) -> float:
    """The horizon, m; two spacings where it is left out.

    Raises ValueError for one below the spacing.
    """
    spacing = given.number("lattice.spacing")
    horizon = given.otherwise("lattice.horizon", 2 * spacing, "m", "two spacings")
    assert isinstance(horizon, float)
    if horizon < spacing * (1 - 1e-9):
        raise ValueError(
            f"{given.file}: lattice.horizon is {format_length(horizon)}; it must be at least the "
            f"spacing of {format_length(spacing)}"
        )
    return horizon


def lattice_between(given: Given, low: Sequence[float], high: Sequence[float]) -> Lattice:
    """The lattice of a box (m).

    Raises ValueError for an empty box, or one of more than MOST_NODES nodes.
    """
    spacing = given.number("lattice.spacing")
    nodes = 1.0
    for axis, (a, b) in enumerate(zip(low, high, strict=True)):
        if not b - a >= spacing * (1 - 1e-9):
            raise ValueError(
                f"{given.file}: the box reaches from {a:g} m to {b:g} m along axis {axis + 1}; it "
                f"must be at least one spacing of {format_length(spacing)} long"
            )
        nodes *= (b - a) / spacing
    check_count(given, nodes)
    return box_lattice(low, high, spacing)


def check_count(given: Given, nodes: float) -> None:
    """ValueError where a lattice has too many nodes for a machine."""
    if nodes > MOST_NODES:
        raise ValueError(
            f"{given.file}: lattice.spacing makes {nodes:.3g} nodes; it must make at most "
            f"{MOST_NODES:.3g}"
        )
