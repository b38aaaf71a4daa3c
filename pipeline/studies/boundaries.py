"""What the edges of a lattice do to diffusion in the liquid, as tables; no march.

Exact sums and small dense solutions over the stencil, against local diffusion:
peri.reference.edges.
"""

from peri.reference import edges as surface_effect
from pipeline.studies.rates import RATIOS, table_line, unit_stencil

TUBE = 5.0
"""Radius of the tube, in horizons."""

WALLS = 10
"""Distance of the two walls of the decaying wave, in horizons."""

DIMENSIONS = (1, 2, 3)


def along_a_wall(ratio: int) -> list[float]:
    """Width lost, over delta: 2D, 3D, tube; 2D and 3D with scaled bonds."""
    flat = [surface_effect.lost_width(unit_stencil(d, ratio)) for d in (2, 3)]
    tube = surface_effect.lost_width_of_a_tube(unit_stencil(3, ratio), TUBE * ratio)
    scaled = [surface_effect.lost_width_with_scaled_bonds(unit_stencil(d, ratio)) for d in (2, 3)]
    return [width / ratio for width in (*flat, tube, *scaled)]


def between_walls(ratio: int) -> list[float]:
    """Errors of the decay rate of cos(pi x / L), L = 10 delta: with walls, and what they add."""
    rates = [surface_effect.mode_rates(unit_stencil(d, ratio), WALLS * ratio) for d in DIMENSIONS]
    return [walls - 1 for walls, _ in rates] + [walls - bulk for walls, bulk in rates]


def held_layers(ratio: int) -> list[float]:
    """Offset over delta of a held layer, delta wide and one spacing wide, in 1D, 2D, 3D."""
    return [
        surface_effect.held_layer_offset(unit_stencil(d, ratio), layers) / ratio
        for layers in (ratio, 1)
        for d in DIMENSIONS
    ]


def print_boundaries() -> None:
    """Print the tables as they stand in peri/MEASURED.md (Markdown)."""
    print("\nWidth that a no-flux wall takes from a flux along it, over δ.\n")
    names = ["flat, 2D", "flat, 3D", f"tube, R = {TUBE:g} δ", "2D, scaled", "3D, scaled"]
    _print_table(names, along_a_wall, "{:+.4f}")

    print(
        f"\nDecay of cos(πx/L) between no-flux walls, L = {WALLS} δ: error in %, and the part of "
        "it that an endless\nlattice does not have.\n"
    )
    names = [f"{d}D" for d in DIMENSIONS] + [f"walls alone, {d}D" for d in DIMENSIONS]
    _print_table(names, lambda m: [100 * v for v in between_walls(m)], "{:+.4f}")

    print("\nA held layer seems to hold its value this far beyond its inner face, over δ.\n")
    names = [f"{width}, {d}D" for width in ("δ wide", "one spacing") for d in DIMENSIONS]
    _print_table(names, held_layers, "{:.4f}")


def _print_table(names: list[str], values, form: str) -> None:
    print(table_line(["m", *names]))
    print(table_line(["---:"] * (len(names) + 1)))
    for m in RATIOS:
        print(table_line([str(m), *(form.format(v) for v in values(m))]))
