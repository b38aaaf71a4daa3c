"""The extreme scenes of corrosion as one table: python -m tests.extreme.corrosion_table"""

from __future__ import annotations

import time

import numpy as np

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.run import corrode
from peri.engine.march.marching import TimeStepping
from tests.extreme.test_corrosion_extreme import SHAPES, SOLID, YEAR, box_scene
from tests.peri.corrosion.scenes import pin
from tests.peri.corrosion.test_run import check_invariants


def block(shape, low, high, **options):
    """A scene with a rectangular block of metal."""
    metal = np.zeros(shape, bool)
    metal[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return box_scene(metal, **options)


def fixed(step):
    return TimeStepping("sdirk2", step=step)


def cases():
    """Name, scene, end (s), time stepping."""
    for interface in (1e-17, 1e-12):
        for liquid in (1e-12, 1e-7):
            name = f"D_int {interface:.0e}, D_liq {liquid:.0e} m2/s, 10 years"
            yield name, pin(2, 10, interface_diffusivity=interface,
                            liquid_diffusivity=liquid), 10 * YEAR, None  # fmt: skip
    for saturated in (1e-5, 0.33):
        scene = pin(2, 10, saturation_concentration=saturated * SOLID, interface_diffusivity=1e-13)
        yield f"C_sat {saturated:g} C_solid, a year", scene, YEAR, None
    stiff = pin(2, 10, interface_diffusivity=1e-12, liquid_diffusivity=1e-7)
    yield "5 steps of 1 s, D_liq dt/dx2 = 10", stiff, 5.0, fixed(1.0)
    yield "5 steps of 1 year, D_liq dt/dx2 = 3e8", stiff, 5 * YEAR, fixed(YEAR)
    jump = pin(2, 10, interface_diffusivity=1e-15, liquid_diffusivity=1e-7)
    yield "diffusivity jump of 1e8, a year", jump, YEAR, None
    yield "immersion of 0 s", jump, 0.0, None
    gone = pin(2, 10, kinetics=ConstantRate(), interface_diffusivity=1e-11)
    yield "complete dissolution, a year", gone, YEAR, None
    gone = pin(2, 10, kinetics=ConstantRate(), interface_diffusivity=1e-11, dissolution="faradaic")
    yield "the same under Faraday's law", gone, YEAR, None
    for name in ("isolated node in 3D", "wall one node thick"):
        yield f"{name}, a year", box_scene(SHAPES[name]), YEAR, None
    yield "no liquid, a year", box_scene(np.ones((5, 6))), YEAR, None
    yield "no metal, a year", box_scene(np.zeros((5, 6, 4))), YEAR, None
    for text, horizon in (("ellipsoidal", (2e-4, 5e-3)), ("spherical", 5e-3)):
        scene = block((30, 7), (10, 2), (20, 5), spacing=(1e-4, 2.5e-3), horizon=horizon)
        yield f"spacing 25:1, {text} horizon", scene, YEAR / 50, None
    for ratio in (1, 2, 4, 8):
        scene = block((24, 24), (9, 9), (15, 15), horizon=ratio * 1e-4, boundary="no_flux")
        yield f"horizon of {ratio} spacings", scene, YEAR / 50, None


def rows():
    """Name, V_L, worst balance error, lowest and highest C / C_solid, steps, seconds."""
    for name, scene, end, stepping in cases():
        started = time.perf_counter()
        result = corrode(scene, [end], stepping)
        seconds = time.perf_counter() - started
        check_invariants(scene, result)
        share = result.concentration / scene.solid_concentration
        balance = np.abs(result.history["balance_error"]).max()
        steps = result.history["time"].size - 1
        yield name, result.volume_loss[-1], balance, share.min(), share.max(), steps, seconds


if __name__ == "__main__":
    print("| case | V_L | balance error | C / C_solid | steps | s |\n|---|---|---|---|---|---|")
    for name, loss, balance, low, high, steps, seconds in rows():
        print(
            f"| {name} | {100 * loss:.4g} % | {balance:.0e} | {low:.1g} to {high:.6g} "
            f"| {steps} | {seconds:.2f} |"
        )
