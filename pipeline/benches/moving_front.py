"""Rows of `bench cut-cells` for surfaces that move: bodies dissolved to a third in clean liquid.

The ball has three horizons' radius; the reference is the same nonlocal model in radial shells.
Errors are the largest over 10, 20, 33, 50 and 67 % of V_L, medians over positions of the lattice.
A cube of three horizons and a cylinder as wide and high have edges and no reference: their V_L is
compared with that of delta/4, the largest difference over five times up to V_L = 0.8.  A plate of
three horizons loses V_L = t/1.5 by Faraday's law, whatever the horizon, until it is one thick; it
lies along the lattice and across it twice, by layers (without edges), and at delta/2 as a body,
wide enough for its middle to see no edge.  Steel that saturates its liquid at once, its mouth held
at zero, has Stefan's front 2 lambda sqrt(D t) but for the horizon.  A ball of
two horizons in liquid that it saturates (C_sat = C_solid/100, held clean beyond 3.5 horizons, D =
20 in units of horizon times flux over C_solid) has both limits at once: delta/2 against delta/3.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.layers import LayeredScene, plate_layers
from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.surface.rate_classes import CellExposure, cell_exposure
from peri.engine.surface.triangles import Surface
from peri.reference.moving_ball import dissolving_ball
from pipeline.benches.result import Result
from pipeline.geometry.cell_shares import cell_shares

Array = NDArray[np.float64]

RADIUS, WIDTH = 3.0, 3.0
"""Of the ball; of cube and cylinder; in horizons."""
LOSSES = np.array([0.1, 0.2, 0.33, 0.5, 0.667])
LAWS = {"proportional": 1e-5, "faradaic": 1e-5}
"""C_sat/C_solid by law."""
NORMALS = ((1, 0), (1, 1), (2, 1))
"""Of the plates, in x and y."""
_STEEL = {
    "solid_concentration": 143e3, "saturation_concentration": 5.1e3, "liquid_diffusivity": 8.5e-10,
}  # fmt: skip
"""304 steel in its own salt: mol/m3 and m2/s."""
_STEFAN, _SECONDS = 0.13516, 100.0
"""Lambda of its front 2 lambda sqrt(D t), and the time."""


def moving_balls(
    surface: Surface, ratios: tuple[int, ...], positions: int, rate_change: float
) -> list[Result]:
    """Errors of V_L; surface: of a ball of radius 1."""
    ball = Surface(RADIUS * surface.vertices, surface.facets)
    results = []
    for law, saturated in LAWS.items():
        times, loss, _ = dissolving_ball(
            RADIUS, None if law == "faradaic" else saturated, RADIUS - 1.0, 400
        )
        moments = np.interp(LOSSES, loss, times)
        for ratio in ratios:
            errors, balance, seconds = [], [], []
            for shift in np.random.default_rng(ratio).random((positions, 3)):
                scene = _in_clean_liquid(ball, ratio, shift, law, saturated)
                start = time.process_time()
                found = corrode(scene, moments, TimeStepping(rate_change=rate_change))
                seconds.append(time.process_time() - start)
                errors.append(np.abs(found.volume_loss / LOSSES - 1).max())
                balance.append(np.abs(found.history["balance_error"]).max())
            name = f"dissolving ball, {law}, delta/{ratio}"
            target = {4: "<= 6e-3"}.get(ratio)
            results += [
                Result(f"{name}: error of V_L", float(np.median(errors)), "1", target),
                Result(f"{name}: balance", float(max(balance)), "1", "<= 1e-12"),
                Result(f"{name}: march", float(np.median(seconds)), "s processor"),
            ]
    return results


def edged_bodies(ratios: tuple[int, ...], rate_change: float) -> list[Result]:
    """Differences of V_L from that of delta/4, which `ratios` end with."""
    results = []
    for body, surface in (("cube", _prism(4)), ("cylinder", _prism(64))):
        for law, end in (("proportional", 3.0), ("faradaic", 0.56)):
            times = end * np.array([0.1, 0.3, 0.5, 0.75, 1.0])
            found = []
            for ratio in ratios:
                shift = np.random.default_rng(ratio).random(3)
                scene = _in_clean_liquid(surface, ratio, shift, law, LAWS[law])
                found.append(corrode(scene, times, TimeStepping(rate_change=rate_change)))
            for ratio, coarse in zip(ratios[:-1], found, strict=False):
                off = float(np.abs(coarse.volume_loss / found[-1].volume_loss - 1).max())
                name = f"dissolving {body}, {law}, delta/{ratio} against delta/{ratios[-1]}"
                results.append(Result(name, off, "1"))
    return results


def moving_plates(ratios: tuple[int, ...], rate_change: float) -> list[Result]:
    """Errors of V_L in the middle of plates under Faraday's law, by their normal; one position."""
    results = []
    thick = 0.5 * WIDTH
    for across, along in NORMALS:
        plate = plate_of(across, along)
        for ratio in ratios:
            shift = np.random.default_rng(ratio).random(3)
            scene = _in_clean_liquid(plate, ratio, shift, "faradaic", LAWS["faradaic"])
            box = (scene.lattice.origin, scene.lattice.spacing, scene.lattice.shape)
            fraction = cell_shares(plate.vertices, plate.facets, *box)
            start = time.process_time()
            found = corrode(scene, thick * LOSSES, TimeStepping(rate_change=rate_change))
            seconds = time.process_time() - start
            middle = middle_of(scene.lattice, across, along, ratio)
            share = np.where(middle, fraction, 0.0)
            left = (found.concentration * share).sum(axis=(1, 2, 3)) / share.sum()
            name = f"dissolving plate, normal ({across} {along} 0), delta/{ratio}"
            off = float(np.abs((1 - left) / LOSSES - 1).max())
            target = {4: "<= 6e-3"}.get(ratio)
            results += [
                Result(f"{name}: error of V_L", off, "1", target),
                Result(f"{name}: march", seconds, "s processor"),
            ]
    return results


def layered_plates(ratios: tuple[int, ...], positions: int, rate_change: float) -> list[Result]:
    """Errors of V_L of plates under Faraday's law, by their normal, over places in a cell.

    The mean over the places is what no place of the lattice takes away; the spread is the range.
    """
    results = []
    thick = 0.5 * WIDTH
    for normal in NORMALS:
        for ratio in ratios:
            start = time.process_time()
            found = [
                corrode(
                    layered_plate(normal, ratio, place), thick * LOSSES,
                    TimeStepping(rate_change=rate_change),
                )
                for place in (np.arange(positions) + 0.5) / positions
            ]  # fmt: skip
            seconds = (time.process_time() - start) / positions
            off = np.array([march.volume_loss / LOSSES - 1 for march in found])
            balance = max(np.abs(march.history["balance_error"]).max() for march in found)
            name = f"dissolving plate, normal ({normal[0]} {normal[1]} 0), delta/{ratio}"
            target = {4: "<= 6e-3"}.get(ratio)
            worst = float(np.median(np.abs(off).max(axis=1)))
            results += [
                Result(f"{name}: error of V_L", worst, "1", target),
                Result(f"{name}: mean over places", float(np.abs(off.mean(axis=0)).max()), "1"),
                Result(f"{name}: spread over places", float(np.ptp(off, axis=0).max()), "1"),
                Result(f"{name}: balance", float(balance), "1", "<= 1e-12"),
                Result(f"{name}: march", seconds, "s processor"),
            ]
    return results


def layered_plate(normal: tuple[int, int], ratio: int, place: float) -> LayeredScene:
    """A plate in liquid held at zero, by layers; place: of its face in a layer, 0 to 1."""
    spacing = 1.0 / ratio
    apart = spacing / float(np.hypot(*normal))
    count = np.ceil(np.array([1.0, WIDTH + 1.0]) / apart).astype(int) + 3
    depth = (np.arange(-count[0], count[1]) + place) * apart
    seen = plate_layers(depth, WIDTH, spacing, 1.0, normal)
    fraction = seen.metal.fraction
    held = np.where(fraction < 1, 1.0, 0.0)
    return LayeredScene(
        Lattice((0.0,) * 3, (spacing,) * 3, fraction.shape), 1.0, fraction > 0,
        solid_concentration=1.0, saturation_concentration=LAWS["faradaic"],
        liquid_diffusivity=1e8, dissolution_flux=1.0, dissolution="faradaic",
        kinetics=ConstantRate(), exposure=CellExposure(seen.metal, seen.liquid, None, held),
        normal=normal,
    )  # fmt: skip


def stefan_fronts(ratios: tuple[int, ...], rate_change: float, positions: int = 1) -> list[Result]:
    """The front of steel that saturates its liquid, a horizon of 10 um, against its own limit.

    The limit is what the two finest ratios extrapolate to at second order, the face half-way
    between layers; the others are medians over places of it.  The order is that of the horizon
    against Stefan's front, from 20, 10 and 5 um at four spacings.
    """
    exact = 2 * _STEFAN * np.sqrt(_STEEL["liquid_diffusivity"] * _SECONDS)
    coarse, fine = sorted(ratios)[-2:]
    depth = {m: stefan_depth(1e-5, m, rate_change) for m in (coarse, fine)}
    limit = depth[fine] + (depth[fine] - depth[coarse]) / ((fine / coarse) ** 2 - 1)
    name, results = "Stefan front, horizon 10 um", []
    for m in sorted(ratios):
        places = (np.arange(positions) + 0.5) / positions
        found = (
            [depth[m]] if m in depth
            else [stefan_depth(1e-5, m, rate_change, place=place) for place in places]
        )  # fmt: skip
        off = np.array(found) / limit - 1
        off_limit = abs(float(np.median(off)))
        results.append(Result(f"{name}, delta/{m}: off its limit", off_limit, "1", "<= 3e-3"))
        if off.size > 1:
            spread = f"{name}, delta/{m}: spread over places"
            results.append(Result(spread, float(np.ptp(off)), "1"))
    results.append(Result(f"{name}: limit off Stefan's", limit / exact - 1, "1"))
    off = [stefan_depth(horizon, 4, rate_change) / exact - 1 for horizon in (2e-5, 1e-5, 5e-6)]
    for wide, order in zip((20, 10), -np.diff(np.log2(off)), strict=True):
        words = f"Stefan front, delta/4: order in the horizon from {wide} um"
        results.append(Result(words, float(order), "1", "0.9 to 1.3"))
    return results


def stefan_depth(
    horizon: float, ratio: int, rate_change: float, normal: tuple[int, int] = (1, 0),
    place: float = 0.5,
) -> float:  # fmt: skip
    """Metal lost per area and C_solid (m) of steel whose mouth is held at zero, after 100 s.

    place: of the mouth in a layer, 0 to 1.
    """
    spacing, deep = horizon / ratio, 1.2e-4
    apart = spacing / float(np.hypot(*normal))
    count = np.ceil(np.array([horizon + 2 * spacing, deep + 2 * horizon]) / apart).astype(int)
    depth = (np.arange(-count[0], count[1]) + place) * apart
    seen = plate_layers(depth, 10 * deep, spacing, horizon, normal)
    shape = seen.metal.fraction.shape
    inside = plate_layers(depth + horizon, 10 * deep, spacing, horizon, normal).metal.fraction
    held = np.minimum(inside, 1.0 - seen.metal.fraction)
    scene = LayeredScene(
        Lattice((0.0,) * 3, (spacing,) * 3, shape), horizon, seen.metal.fraction > 0,
        interface_diffusivity=1e3 * _STEEL["liquid_diffusivity"], kinetics=ConstantRate(),
        exposure=CellExposure(seen.metal, seen.liquid, inside, held), normal=normal, **_STEEL,
    )  # fmt: skip
    amount = corrode(scene, [_SECONDS], TimeStepping(rate_change=rate_change)).history[
        "metal_amount"
    ]
    return float(amount[0] - amount[-1]) / (scene.solid_concentration * spacing**3) * apart


def plate_of(across: int, along: int) -> Surface:
    """A plate of normal (across, along, 0), six horizons wide.

    Half of that holds half the middle, what an edge loses, and the horizon that sees the edge.
    """
    long, half = float(np.hypot(across, along)), 0.5 * WIDTH
    axes = np.array([[-along, across, 0], [0, 0, long], [across, along, 0]]) / long
    prism = _prism(4)
    return Surface(prism.vertices * (np.array([3.0, 3.0, half]) / half) @ axes, prism.facets)


def middle_of(lattice: Lattice, across: int, along: int, ratio: int) -> NDArray[np.bool_]:
    """Cells about the middle of a plate, whole periods of the lattice along it (about a horizon).

    Periods hold each depth alike, so that what such cells hold of the metal is what the plate does.
    """
    i, j, k = np.indices(lattice.shape)
    period = across**2 + along**2
    wide = max(1, round(ratio / np.sqrt(period))) * period
    here = across * j - along * i
    x, y, z = (-o / s for o, s in zip(lattice.origin, lattice.spacing, strict=True))
    first = round(across * y - along * x - 0.5 * wide)
    low = round(z - 0.5 * ratio)
    return (here >= first) & (here < first + wide) & (k >= low) & (k < low + ratio)


def saturated_balls(surface: Surface, rate_change: float) -> list[Result]:
    """Differences of V_L where the liquid limits, too; surface: of a ball of radius 1."""
    results = []
    for law, end in (("proportional", 4.0), ("faradaic", 3.0)):
        times = end * np.array([0.1, 0.3, 1.0])
        found = []
        for ratio in (2, 3):
            scene = in_own_liquid(surface, ratio, np.random.default_rng(ratio).random(3), law)
            found.append(corrode(scene, times, TimeStepping(rate_change=rate_change)))
        name = f"ball that saturates its liquid, {law}"
        off = found[0].volume_loss / found[1].volume_loss - 1
        balance = max(np.abs(march.history["balance_error"]).max() for march in found)
        results += [
            Result(f"{name}: delta/2 against delta/3", float(np.abs(off).max()), "1"),
            Result(f"{name}: V_L at the end", float(found[1].volume_loss[-1]), "1"),
            Result(f"{name}: balance", float(balance), "1", "<= 1e-12"),
        ]
    return results


def in_own_liquid(
    surface: Surface, ratio: int, shift: Array, law: str,
    free: float = 3.5, diffusivity: float = 20.0, saturated: float = 0.01,
) -> CorrosionScene:  # fmt: skip
    """A ball of two horizons in liquid up to `free`, held at zero for a horizon beyond it."""
    spacing, edge = 1.0 / ratio, free + 1.0
    half = int(np.ceil(edge * ratio)) + 2
    origin = tuple(float(s - half) * spacing for s in shift)
    lattice = Lattice(origin, (spacing,) * 3, (2 * half + 1,) * 3)
    box = (lattice.origin, lattice.spacing, lattice.shape)
    fraction, clear, inside = (
        cell_shares(radius * surface.vertices, surface.facets, *box) for radius in (2.0, free, edge)
    )
    ball = Surface(2.0 * surface.vertices, surface.facets)
    seen = cell_exposure(lattice, ball, 1.0, fraction)
    shares = CellExposure(seen.metal, seen.liquid, inside, np.maximum(inside - clear, 0.0))
    return CorrosionScene(
        lattice, 1.0, fraction > 0, domain=inside > 0, solid_concentration=1.0,
        saturation_concentration=saturated, liquid_diffusivity=diffusivity, dissolution_flux=1.0,
        dissolution=law, kinetics=ConstantRate(), exposure=shares,
    )  # fmt: skip


def _prism(sides: int) -> Surface:
    """A prism three horizons high over a regular polygon of a square's or circle's area."""
    half = 0.5 * WIDTH
    area = WIDTH**2 if sides == 4 else np.pi * half**2
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    radius = np.sqrt(2 * area / (sides * np.sin(2 * np.pi / sides)))
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.vstack(
        [np.column_stack([ring, np.full(sides, z)]) for z in (-half, half)]
        + [[[0.0, 0.0, -half], [0.0, 0.0, half]]]
    )
    i, low, high = np.arange(sides), 2 * sides, 2 * sides + 1
    j, ends = (i + 1) % sides, np.ones(sides, int)
    corners = (
        (i, j, j + sides), (i, j + sides, i + sides),
        (j, i, low * ends), (i + sides, j + sides, high * ends),
    )  # fmt: skip
    return Surface(vertices, np.vstack([np.column_stack(three) for three in corners]))


def lattice_about(surface: Surface, ratio: int, shift: Array) -> Lattice:
    """A cube of cells about a body and a horizon of liquid; shift: of the lattice, in spacings."""
    spacing = 1.0 / ratio
    half = int(np.ceil((np.abs(surface.vertices).max() + 1.0) * ratio)) + 2
    origin = tuple(float(s - half) * spacing for s in shift)
    return Lattice(origin, (spacing,) * 3, (2 * half + 1,) * 3)


def _in_clean_liquid(
    surface: Surface, ratio: int, shift: Array, law: str, saturated: float
) -> CorrosionScene:
    """A body in liquid held at zero; horizon, flux and C_solid are 1."""
    lattice = lattice_about(surface, ratio, shift)
    fraction = cell_shares(
        surface.vertices, surface.facets, lattice.origin, lattice.spacing, lattice.shape
    )
    seen = cell_exposure(lattice, surface, 1.0, fraction)
    held = CellExposure(seen.metal, seen.liquid, None, np.where(fraction < 1, 1.0, 0.0))
    return CorrosionScene(
        lattice, 1.0, fraction > 0, solid_concentration=1.0, saturation_concentration=saturated,
        liquid_diffusivity=1e8, dissolution_flux=1.0, dissolution=law, kinetics=ConstantRate(),
        exposure=held,
    )  # fmt: skip
