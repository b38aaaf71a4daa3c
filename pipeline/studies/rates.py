"""What lattice, orientation and law do to the dissolution rate of a front, as tables.

Exact sums over the stencil and one exact event-driven front, no march: peri.reference.fronts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from peri.engine.influence import Stencil, diffusion_stencil
from peri.engine.lattice import Lattice
from peri.reference import fronts

RATIOS = (2, 3, 4, 5, 6, 7, 8)
ANGLES = (0.0, 30.0, 45.0)
SPHERE = 5.0
"""Radius of the sphere, in horizons."""

CONCENTRATION_RATIO = 1e5
"""C_solid / C_sat of the travelling front (Table 5.1: 66082.4 / 0.6608 for Mg-5Gd)."""

PUBLISHED = {2: 7.2, 4: 2.2, 8: 0.64, 16: 0.18}
"""Zhao et al. 2021, Table 2: error of the flux of a flat front, %, for m = delta/dx."""


@dataclass(frozen=True)
class FluxErrors:
    """Relative errors of the flux at zero volume loss against i/(zF), for one m = delta/dx.

    flat: by (dimension, degrees from a lattice axis); sphere: per area 4 pi R^2, R = 5 delta.
    """

    ratio: int
    flat: dict[tuple[int, float], float]
    sphere: float


def unit_stencil(dimension: int, ratio: int) -> Stencil:
    """The default stencil (q = 0, constant influence, discrete moments) with dx = 1."""
    lattice = Lattice((0.0,) * dimension, (1.0,) * dimension, (1,) * dimension)
    return diffusion_stencil(lattice, float(ratio))


def flux_errors(flux_calibration: str, ratios=RATIOS) -> list[FluxErrors]:
    """Errors with D_int derived for a front along the axes ("axis") or on average ("isotropic")."""
    found = []
    for m in ratios:
        flat = {}
        for dimension in (1, 2, 3):
            stencil = unit_stencil(dimension, m)
            wanted = _strength(stencil, flux_calibration)
            for angle in ANGLES if dimension > 1 else ANGLES[:1]:
                turn = math.radians(angle)
                normal = (math.cos(turn), math.sin(turn), 0.0)[:dimension]
                flat[dimension, angle] = fronts.directional_strength(stencil, normal) / wanted - 1
        sphere = fronts.sphere_strength(stencil, SPHERE * m, 1.0) / wanted - 1
        found.append(FluxErrors(m, flat, sphere))
    return found


def _strength(stencil: Stencil, flux_calibration: str) -> float:
    axis = flux_calibration == "axis"
    return stencil.front_strength() if axis else stencil.mean_strength()


def front_speeds(ratios=RATIOS) -> list[tuple[int, dict[int, float]]]:
    """(m, speed by dimension): travelling flat front over flux / C_solid, proportional law."""
    return [
        (
            m,
            {
                d: fronts.front_speed_ratio(unit_stencil(d, m), CONCENTRATION_RATIO)
                for d in (1, 2, 3)
            },
        )
        for m in ratios
    ]


def faradaic_front_speed(stencil: Stencil, layers: int = 60) -> float:
    """Speed of a travelling flat front over flux / C_solid, Faraday's law, between two events.

    A metal layer loses at the rate of the bonds that it has to liquid layers, whatever it still
    holds, and turns liquid when it is empty; as in fronts.front_speed_ratio nothing is discretised
    in time.
    """
    column = stencil.dense().sum(axis=tuple(range(1, stencil.dimension)))
    reach, h = stencil.reach[0], stencil.spacing[0]
    column = column[reach:]
    rate = np.array([column[k:].sum() for k in range(1, reach + 1)])
    left = np.ones(layers + reach)
    front, time, marks = 0, 0.0, []
    while front < layers:
        step = np.min(left[front : front + reach] / rate)
        left[front : front + reach] -= rate * step
        time += step
        while left[front] <= 1e-12:
            front += 1
        marks.append((time, h * front))
    (t0, x0), (t1, x1) = marks[len(marks) // 2], marks[-1]
    return (x1 - x0) / (t1 - t0) / stencil.front_strength()


def print_rates() -> None:
    """Print the tables as they stand in peri/MEASURED.md (Markdown)."""
    for calibration, text in (
        ("axis", 'D_int from a front along a lattice axis (flux_calibration="axis")'),
        ("isotropic", 'D_int from the mean over all orientations ("isotropic", the default)'),
    ):
        print(f"\nFlux at zero loss against i/(zF), error in %. {text}.\n")
        names = [f"{d}D {a:g}°" for d in (2, 3) for a in ANGLES]
        print(table_line(["m", "1D", *names, f"sphere, R = {SPHERE:g} δ"]))
        print(table_line(["---:"] * (len(names) + 3)))
        for entry in flux_errors(calibration):
            values = [*entry.flat.values(), entry.sphere]
            print(table_line([str(entry.ratio), *(_percent(v) for v in values)]))
    curvature = 100 * (fronts.sphere_curvature_factor(1.0, SPHERE) - 1)
    print(f"\nCurvature alone makes {curvature:.2f} % of the sphere's error (1 - δ²/36R²).")

    print("\nFlat-front profile summed over nodes, error in % (Zhao et al. 2021, Table 2).\n")
    print(table_line(["m", "here", "published"]))
    print(table_line(["---:"] * 3))
    for m in sorted({*RATIOS, *PUBLISHED}):
        here = -100 * fronts.flat_front_quadrature_error(m)
        print(table_line([str(m), f"{here:.3g}", f"{PUBLISHED[m]:g}" if m in PUBLISHED else ""]))

    slow = math.log(CONCENTRATION_RATIO)
    print(
        "\nSpeed of a travelling flat front over i/(zF C_solid). Expected on every lattice: 1 by "
        f"Faraday's law; {1 / slow:.5f}\n= 1/ln(C_solid/C_sat) by the proportional law, with "
        f"C_solid/C_sat = {CONCENTRATION_RATIO:.0e}.\n"
    )
    laws = ("Faraday", "proportional")
    print(table_line(["m", *(f"{law}, {d}D" for law in laws for d in (1, 2, 3))]))
    print(table_line(["---:"] * 7))
    for m, speeds in front_speeds():
        exact = [faradaic_front_speed(unit_stencil(d, m)) for d in (1, 2, 3)]
        print(table_line([str(m), *(f"{v:.5f}" for v in (*exact, *speeds.values()))]))


def table_line(entries: list[str]) -> str:
    """One line of a Markdown table."""
    return "| " + " | ".join(entries) + " |"


def _percent(value: float) -> str:
    text = f"{100 * value:+.2f}"
    return "0" if text in ("+0.00", "-0.00") else text
