"""Error against run time of localised corrosion: couples, the crevice as a film, pits.

Each study prints Markdown tables; what is compared with a published number stands beside it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from peri.corrosion.run import corrode as corrode_pit
from peri.corrosion.scene import CorrosionScene
from peri.coupled.galvanic import ROBIN, GalvanicScene, Renewal, corrode, potential
from peri.coupled.galvanic_ions import Ions
from peri.coupled.wagner import ions_bound
from peri.engine.march.marching import TimeStepping, march
from peri.omissions.thin_gap import ThinGapProblem
from peri.transport.potential.conductivity import IonConductivity
from pipeline.scenes import couples, crevice_lattice, crevices, implants, pits, pits_2d
from pipeline.scenes.couples import CHARGE_NUMBER, CONDUCTIVITY, ae44_scene
from pipeline.scenes.files import read_scene
from pipeline.scenes.keys import Given
from pipeline.scenes.registry import path_of
from pipeline.studies.rates import table_line

DAY, HOUR = 86400.0, 3600.0
COMSOL = {1.0: 0.2369, 1e-4: 0.2611}
"""Depth of AE44 at the joint with AA6063 after 3 d by the largest step of its mesh (mm): published
for steps of 1 and 1e-4 mm (Zhao et al. 2021, Table C1)."""
FIRST_CURRENT = {"mild-steel": 0.4120, "AA6063": 0.05141}
"""A/m, of AE44 with each cathode at the start, by finite volumes."""
BRUCITE = 0.21
"""mol/m3 of magnesium over brucite in 0.142 mol/L of NaCl (tests/peri/transport/chemistry)."""
SALT_ONSET = 1002.349
"""s, exact moving boundary, 304 steel at 5,100 A/m2."""
_SCALES = ((0.4, 0.4), (0.4, 0.2), (0.4, 0.1), (0.8, 0.2), (0.2, 0.05), (4.0, 1.0))
"""Horizons and spacings, mm; the last is what section 5 of the source prints (4 and 1 mm)."""

T = TypeVar("T")


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    """What work gives, and the processor time that it took, s."""
    started = time.process_time()
    return work(), time.process_time() - started


def _head(columns: Sequence[str]) -> None:
    print("\n" + table_line(list(columns)), flush=True)
    print(table_line(["---:"] * len(columns)))


# --- couples --------------------------------------------------------------------------------


def couple_row(scene: GalvanicScene, travel: float) -> tuple[list[str], dict[str, np.ndarray]]:
    """Currents, depths (mm) and processor time of three days; and the history of the march."""
    found, seconds = _timed(lambda: corrode(scene, [3 * DAY], Renewal(travel)))
    depth = 1e3 * found.depths()[-1]
    x = 1e3 * scene.lattice.axis(0) - 10.0
    current = found.history["current_AE44"]
    at = np.interp([1, 2, 5, 9], x, depth)
    row = [
        f"{current[0]:.5f}", f"{current[-1]:.4f}", f"{depth[x > 0][0]:.4f}", f"{depth.max():.4f}",
        *(f"{d:.4f}" for d in at), f"{depth[x > 0].mean():.4f}",
        str(found.history["time"].size - 1), f"{seconds:.1f}",
    ]  # fmt: skip
    return row, found.history


_COUPLE = [
    "I, 0 d [A/m]", "3 d", "joint [mm]", "deepest", "1 mm", "2", "5", "9", "mean", "steps", "s",
]  # fmt: skip


def print_galvanic() -> None:
    """AE44 beside steel and AA6063 after 3 days: renewal, spacing, horizon, printed slopes."""
    for cathode in ("mild-steel", "AA6063"):
        print(f"\nAE44 beside {cathode}, 3 d. Renewal of the potential by the travel of the")
        print("fastest patch in spacings (0.2 mm, horizon 0.4 mm).")
        _head(["travel", *_COUPLE])
        for travel in (1.0, 0.5, 0.25, 0.1, 0.05):
            row = couple_row(ae44_scene(cathode, 0.2e-3), travel)[0]
            print(table_line([f"{travel:g}", *row]), flush=True)
        print("\nSpacing, with the horizon held (0.4 mm), and horizon, with four spacings to it.")
        _head(["horizon [mm]", "spacing [mm]", *_COUPLE])
        for horizon, spacing in _SCALES:
            scene = ae44_scene(cathode, spacing * 1e-3, horizon * 1e-3)
            row = couple_row(scene, 0.1 if spacing > 0.05 else 0.2)[0]
            print(table_line([f"{horizon:g}", f"{spacing:g}", *row]), flush=True)
        print("\nThe slopes as printed (Table 3), 0.2 mm, horizon 0.4 mm.")
        _head(["law", *_COUPLE])
        for name, printed in (("joined", False), ("as printed", True)):
            try:
                row = couple_row(ae44_scene(cathode, 0.2e-3, as_published=printed), 0.1)[0]
            except ArithmeticError as error:
                row = [str(error)]
            print(table_line([name, *row]), flush=True)
        print_robin(cathode)
        print_ions(cathode)
    print_titanium()
    steps = ", ".join(f"{depth:g} mm for {step:g} mm" for step, depth in COMSOL.items())
    print(f"\nPublished for AA6063 at the joint, by the step of a mesh: {steps}.")


def print_robin(cathode: str) -> None:
    """The conservative form beside the published mirror nodes, at two spacings."""
    print("\nHow the law meets the liquid, horizon 0.4 mm: the error of the first current against")
    print("finite volumes, and the largest share by which the currents do not balance.")
    _head(["spacing [mm]", "robin", "error, 0 d [%]", "open [%]", *_COUPLE])
    for spacing in (0.4, 0.2):
        for robin in ROBIN:
            scene = ae44_scene(cathode, spacing * 1e-3, robin=robin)
            row, found = couple_row(scene, 0.25)
            off = 100 * (found["current_AE44"][0] / FIRST_CURRENT[cathode] - 1)
            left = 100 * np.abs(found["imbalance"]).max()
            cells = [f"{spacing:g}", robin, f"{off:+.3f}", f"{left:.2g}", *row]
            print(table_line(cells), flush=True)


def print_ions(cathode: str) -> None:
    """What the ions of AE44 change where they stay dissolved up to C_sat, and its bound."""
    print("\nIons of AE44 in a cell renewed at its top (D 7e-10 m2/s, with chloride), 0.2 mm,")
    print("horizon 0.4 mm: kappa(C) up to a saturation, and the bound of leaving them out.")
    _head(["C_sat [mol/m3]", "bound [%]", "highest kappa [S/m]", *_COUPLE])
    clean = ae44_scene(cathode, 0.2e-3)
    law = IonConductivity(CONDUCTIVITY, CHARGE_NUMBER, 7e-10)
    height = clean.lattice.coordinates()[1]
    top = np.broadcast_to(height > height.max() - 0.4e-3, clean.lattice.shape)
    for most in (None, BRUCITE, 100.0):
        scene, bound = clean, ""
        if most is not None:
            scene = replace(clean, ions=Ions(7e-10, law, most, top))
            bound = f"{100 * ions_bound(scene, 3 * DAY)[0]:.2g}"
        row, found = couple_row(scene, 0.25)
        kappa = found.get("highest_conductivity", np.full(1, CONDUCTIVITY))[-1]
        shown = "not followed" if most is None else f"{most:g}"
        print(table_line([shown, bound, f"{kappa:.3f}", *row]), flush=True)


def print_titanium() -> None:
    """What the first current of a screw in a titanium plate depends on."""
    scene = read_scene(path_of("screw-in-titanium-plate"))
    given = Given(dict(scene.values), scene.name)
    print("\nFirst current of the screw in a titanium plate (100 um), whose numbers are assumed.")
    _head(["changed", "I [uA]", "times"])
    rows: dict[str, Callable[[], GalvanicScene]] = {"nothing": lambda: couples.build(given)[0]}
    rows |= implants.sensitivities_of(given)
    first = None
    for name, made in rows.items():
        couple = made()
        screw = next(n for n, m in enumerate(couple.metals) if m.solid_concentration)
        current = 1e6 * potential(couple).current(screw)
        first = first or current
        print(table_line([name, f"{current:.3f}", f"{current / first:.3f}"]), flush=True)


# --- crevice --------------------------------------------------------------------------------


def crevice_row(seed: float, published: bool, charge: float, nodes: int = 508) -> list[str]:
    """What 72 h make of a seed (m)."""
    factors = (
        (crevices.PUBLISHED_DIFFUSIVITY_FACTOR, crevices.PUBLISHED_CURRENT_FACTOR)
        if published
        else (1.0, 1.0)
    )
    scene = crevices.crevice_625(seed, nodes, *factors, charge_number=charge)
    times = [4 * HOUR, 24 * HOUR, 30 * HOUR, 72 * HOUR]
    done, seconds = _timed(
        lambda: march(ThinGapProblem(scene), times, TimeStepping(rate_change=0.1))
    )
    history = done.history
    site = np.interp(times, history["time"], history["active_site"])
    alive = history["saturated_share"][-1] > 0
    return [
        "ignites" if alive else "dies out",
        *(f"{1e3 * s:.2f}" if alive else "" for s in site),
        f"{1e6 * history['deepest'][-1]:.2f}",
        f"{1e9 * history['lost'][-1]:.3f}",
        f"{seconds:.1f}",
    ]


def ignition_length(published: bool, charge: float, nodes: int = 254) -> float:
    """The shortest seed (m, to 25 um) that is alive after 72 h; what ignites is monotone in it."""
    low, high = 0.1e-3, 4e-3
    while high - low > 25e-6:
        middle = 0.5 * (low + high)
        if crevice_row(middle, published, charge, nodes)[0] == "ignites":
            high = middle
        else:
            low = middle
    return high


def print_crevice() -> None:
    """Seeds from 0.1 to 4 mm, z from 2 to 3, right and as on the printed lattice, after 72 h."""
    print("\nShortest seed that ignites, and its active site after 72 h (254 nodes).")
    _head(["calibration", "z", "seed [mm]", "active site, 72 h [mm]", "lost [um mm]"])
    for published in (False, True):
        for charge in (2.0, 2.5, 3.0):
            seed = ignition_length(published, charge)
            row = crevice_row(seed, published, charge, 254)
            name = "as published" if published else "right"
            cells = [name, f"{charge:g}", f"{1e3 * seed:.3f}", row[4], row[6]]
            print(table_line(cells), flush=True)
    print_crevice_lattices()
    columns = [
        "seed [mm]", "", "active site, 4 h [mm]", "24 h", "30 h", "72 h", "deepest [um]",
        "lost [um mm]", "s",
    ]  # fmt: skip
    for published in (False, True):
        text = "as on the printed lattice (0.2176 D, 7.57 i)" if published else "right constants"
        for charge in (2.0, 2.5, 3.0):
            print(f"\nCrevice of alloy 625 after 72 h, {text}, z = {charge:g}.")
            _head(columns)
            seeds = (0.1, 0.3, 0.4, 0.5, 1.0, 4.0) if published else (
                0.1, 0.5, 1.0, 2.0, 2.5, 3.0, 4.0
            )  # fmt: skip
            for seed in seeds:
                row = crevice_row(seed * 1e-3, published, charge)
                print(table_line([f"{seed:g}", *row]), flush=True)
    print(
        "\nPublished: about 0.5 mm is the shortest seed that ignites; the active site moves to the"
        "\nmouth and stops after about 30 h."
    )


def print_crevice_lattices() -> None:
    """The crevice on lattices beside the film equation, with liquid in emptied metal and without.

    Without it a cell opens when its metal is gone, and the gap is narrower by what has begun to go.
    """
    print("\nOn a lattice, 25 um along: 6 mm to the closed end, seed 3 mm, 12 h; against the film.")
    _head(["pores", "across [um]", "m", "area lost [%]", "active site [%]", "steps", "s"])
    for pores, ratio, across in (
        (False, 4, 1.0), (False, 4, 0.5), (True, 2, 1.0), (True, 4, 1.0), (True, 4, 0.5),
    ):  # fmt: skip
        scene = crevice_lattice.crevice_on_lattice(
            3e-3, (25e-6, across * 1e-6), ratio, length=6e-3, pores=pores
        )
        times = [6 * HOUR, 12 * HOUR]
        found, seconds = _timed(lambda s=scene, t=times: crevice_lattice.compare(s, t))
        areas = [float(found.lost(depth)[-1]) for depth in (found.lattice, found.film)]
        sites = [found.site(depth) for depth in (found.lattice, found.film)]
        lost, site = (100 * (a[0] / a[1] - 1) for a in (areas, sites))
        steps = str(found.result.history["time"].size - 1)
        name = "liquid" if pores else "none"
        row = [name, f"{across:g}", str(ratio), f"{lost:+.2f}", f"{site:+.2f}", steps]
        print(table_line([*row, f"{seconds:.1f}"]), flush=True)


# --- pits -----------------------------------------------------------------------------------


def print_pitting() -> None:
    """Onset of the salt layer by spacing, horizon and step; a lacy cover by step, C_crit, i_p."""
    print("\nPencil electrode of 304 steel, 5,100 A/m2: onset of the salt layer, error in %.")
    print("Steps of the time in which the flux fills an emptied node, and of twice and half that.")
    _head(["spacing [um]", "m", "step", "onset [s]", "error [%]", "depth [um]", "s"])
    for spacing, ratio, share in (
        (20e-6, 2, 1.0), (10e-6, 2, 1.0), (5e-6, 2, 1.0), (2.5e-6, 2, 1.0),
        (5e-6, 1, 1.0), (5e-6, 4, 1.0), (5e-6, 2, 2.0), (5e-6, 2, 0.5),
    ):  # fmt: skip
        scene = pits.pencil_scene(spacing, ratio, depth=260e-6)
        stepping = TimeStepping(step=share * pits.unfilled_step(scene))
        done, seconds = _timed(lambda s=scene, t=stepping: corrode_pit(s, [1200.0], t))
        moment, depth = pits.onset(scene, done.history)
        found = "none" if math.isinf(moment) else f"{100 * (moment / SALT_ONSET - 1):+.2f}"
        print(
            table_line(
                [f"{1e6 * spacing:g}", str(ratio), f"{share:g}", f"{moment:.1f}", found,
                 f"{1e6 * depth:.2f}", f"{seconds:.1f}"]
            ),
            flush=True,
        )  # fmt: skip
    print("\nPit under a lacy cover, 40 s, by step, critical concentration and passive current.")
    _head(
        ["step [s]", "C_crit/C_sat", "i_pass/i", "depth [um]", "width", "surface", "lost [%]", "s"]
    )
    for step, critical, passive in (
        (0.4, 0.7, 1e-3), (0.2, 0.7, 1e-3), (0.1, 0.7, 1e-3), (0.05, 0.7, 1e-3),
        (0.1, 0.5, 1e-3), (0.1, 0.6, 1e-3), (0.1, 0.8, 1e-3), (0.1, 0.7, 0.0), (0.1, 0.7, 1e-2),
    ):  # fmt: skip
        scene = pits_2d.lacy_scene(2.5e-6, critical=critical, passive=passive, rupture=None)
        row = _lacy_row(scene, step, 40.0)
        print(table_line([f"{step:g}", f"{critical:g}", f"{passive:g}", *row]), flush=True)
    print("\nThe same with a film that breaks where a node has lost a share of its metal, 83 s.")
    _head(["step [s]", "breaks at", "depth [um]", "width", "surface", "lost [%]", "s"])
    for step, rupture in ((0.2, None), (0.2, pits_2d.RUPTURE), (0.1, pits_2d.RUPTURE)):
        row = _lacy_row(pits_2d.lacy_scene(2.5e-6, rupture=rupture), step, 83.0)
        share = "never" if rupture is None else f"{rupture[0]:g}"
        print(table_line([f"{step:g}", share, *row]), flush=True)


def _lacy_row(scene: CorrosionScene, step: float, end: float) -> list[str]:
    """Depth, width and opening of a pit (um), what is lost (%), processor time (s)."""
    done, seconds = _timed(lambda: corrode_pit(scene, [end], TimeStepping(step=step)))
    sizes = pits_2d.shape_of(scene, done.metal[-1])
    lost = 100 * float(done.volume_loss[-1])
    return [*(f"{1e6 * v:.1f}" for v in sizes), f"{lost:.2f}", f"{seconds:.1f}"]
