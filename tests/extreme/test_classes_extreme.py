"""Rate classes at their limits: what is thinner than a cell, stiff, tiny, or gone to the end."""

from dataclasses import replace

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate, VolumeLossLaw
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.surface.rate_classes import CellExposure, RateClasses, cell_exposure
from tests.peri.bodies import box
from tests.peri.corrosion.classes.test_cells import random_classes
from tests.peri.corrosion.test_local_kinetics import Inhibited, Passivating
from tests.peri.engine.surface.test_rate_classes import share_of_box

LAWS = ("proportional", "faradaic")


def of_boxes(boxes, horizon=1.0, spacing=0.5, n=9, classes=3, **options):
    """Cuboids (low, high) of metal that may meet within a cell; C_solid 100, C_sat 1."""
    start = -0.5 * spacing * (n - 1) + 0.07
    lattice = Lattice((start, start + 0.03, start - 0.1), (spacing,) * 3, (n, n, n))
    fraction, parts = np.zeros(lattice.shape), []
    liquid = np.zeros(lattice.shape)
    for low, high in boxes:
        share = share_of_box(lattice, np.array(low), np.array(high))
        seen = cell_exposure(lattice, box(low, high), horizon, share, classes)
        fraction, liquid = fraction + share, liquid + seen.liquid
        parts.append(seen.metal)
    cell, volume, exposure = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("cell", "volume", "exposure")
    )
    order = np.argsort(cell, kind="stable")
    metal = RateClasses(cell[order], volume[order], exposure[order], fraction)
    settings = {
        "boundary": "refreshed", "solid_concentration": 100.0, "saturation_concentration": 1.0,
        "liquid_diffusivity": 1.0, "dissolution_flux": 1.0, "kinetics": ConstantRate(),
        **options,
    }  # fmt: skip
    return CorrosionScene(
        lattice, horizon, fraction > 0, exposure=CellExposure(metal, liquid), **settings
    )


WALL = [((-0.9, -0.8, 0.02), (0.9, 0.8, 0.12))]
THREAD = [((-0.9, 0.01, 0.02), (0.9, 0.11, 0.1))]
TWO = [((-0.9, -0.8, -0.5), (0.9, 0.8, 0.02)), ((-0.9, -0.8, 0.1), (0.9, 0.8, 0.6))]
BLOCK = [((-0.7, -0.8, -0.6), (0.8, 0.7, 0.9))]
CASES = {
    "wall in one cell": (WALL, {}),
    "thread thinner than a cell": (THREAD, {}),
    "two surfaces in a cell": (TWO, {}),
    "five classes": (BLOCK, {"classes": 5}),
    "one class": (BLOCK, {"classes": 1}),
    # the last cell was asked for all that cells around it had handed on, and lasted
    "five classes, three spacings": (BLOCK, {"classes": 5, "spacing": 1 / 3, "n": 13}),
    "horizon of one spacing": (BLOCK, {"horizon": 0.5}),
    "interface without end": (BLOCK, {"dissolution_flux": 1e9}),
    "closed and slow": (BLOCK, {"boundary": "no_flux", "liquid_diffusivity": 1e-3}),
    "kinetics that stops": (TWO, {"kinetics": VolumeLossLaw(0.05)}),
}


def checked(scene, times):
    """March and look at what must always hold."""
    found = corrode(scene, times, TimeStepping(rate_change=0.2))
    assert np.abs(found.history["balance_error"]).max() < 1e-11
    assert np.all(np.diff(found.history["volume_loss"]) >= -1e-12)
    assert found.concentration.min() >= -1e-10
    liquid = found.concentration[:, ~scene.metal]
    assert liquid.max() <= scene.saturation_concentration * (1 + 1e-6)
    assert found.concentration.max() <= scene.solid_concentration * (1 + 1e-12)
    return found


QUICK = ("closed and slow", "kinetics that stops", "thread thinner than a cell")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES]
)
def test_what_always_holds(name, law):
    boxes, options = CASES[name]
    scene = of_boxes(boxes, dissolution=law, **options)
    life = 1.0 if law == "faradaic" else np.log(100.0)
    found = checked(scene, life * np.array([3.0, 30.0, 300.0]))
    assert found.volume_loss[0] > 0.02
    if name in ("closed and slow", "kinetics that stops"):
        assert 0.1 < found.volume_loss[-1] < 0.3
    else:  # all of it goes, without a remainder that lasts
        assert found.volume_loss[-1] == pytest.approx(1.0, abs=1e-9) and not found.metal[-1].any()


def test_stiff_classes_stay_second_order():
    # One fast class among slow ones (lambda g step beyond 2.41) in clean liquid: no step falls
    # back to first order, no class turns negative, and the amounts add up.
    lattice = Lattice((0.0,) * 3, (0.5,) * 3, (7, 7, 7))
    fraction = np.zeros(lattice.shape)
    fraction[3, 3, 3] = 1.0
    cell = np.full(3, int(np.flatnonzero(fraction)[0]))
    metal = RateClasses(cell, np.array([0.1, 0.3, 0.6]), np.array([40.0, 0.4, 0.2]), fraction)
    held = np.where(fraction > 0, 0.0, 1.0)
    scene = CorrosionScene(
        lattice, 1.0, fraction > 0, solid_concentration=100.0, saturation_concentration=1e-40,
        liquid_diffusivity=1e3, interface_diffusivity=1.0,
        exposure=CellExposure(metal, np.full(lattice.shape, 1.0), None, held),
    )  # fmt: skip
    rates = 3 / np.pi * metal.exposure
    losses = []
    for step in (0.2, 0.1):
        assert rates[0] * step > 2.41
        found = corrode(scene, [1.0], TimeStepping("sdirk2", step=step))
        assert np.abs(found.history["balance_error"]).max() < 1e-13
        losses.append(found.volume_loss[0])
    exact = 1.0 - float(metal.volume @ np.exp(-rates))
    first, second = (abs(loss - exact) for loss in losses)
    # measured 2.42e-5 and 6.03e-6; a first-order step among them errs by 1e-3
    assert second < 0.3 * first and second < 1e-4 * exact


def random_scene(seed):
    """Random classes and shares (test_cells) under a random law, kinetics and liquid."""
    rng = np.random.default_rng(1000 + seed)
    law = LAWS[seed % 2]
    kinetics = (
        ConstantRate(), VolumeLossLaw(10 ** rng.uniform(-3, 1)),
        Inhibited(10 ** rng.uniform(-3, 2)), Passivating(10 ** rng.uniform(-2, 4)),
    )  # fmt: skip
    free = law == "faradaic" and rng.random() < 0.3
    return random_classes(
        seed, dissolution=law, boundary=("refreshed", "no_flux")[(seed // 2) % 2],
        liquid_diffusivity=10.0 ** rng.uniform(-6, 6),
        dissolution_flux=10.0 ** rng.uniform(-6, 4),
        saturation_concentration=10.0 ** rng.uniform(-4, 1.9),
        kinetics=kinetics[rng.integers(4)],
        saturation="none" if free else "complementarity",
    ), 10.0 ** rng.uniform(-2, 6)  # fmt: skip


@pytest.mark.parametrize("seed", [155, pytest.param(210, marks=pytest.mark.slow)])
def test_closed_vessels_that_saturate_end(seed):
    """155: new liquid dilutes its cell in every step; 210: liquid that is mixed in every step."""
    scene, end = random_scene(seed)
    found = corrode(scene, [0.1 * end, end], TimeStepping(rate_change=0.3))
    assert np.abs(found.history["balance_error"]).max() < 1e-11
    assert np.diff(found.history["volume_loss"]).min() > -1e-9
    assert found.history["saturated_nodes"].max() > 100
    # it crept on in ever shorter steps, thousands of them; measured 54 and 124
    assert found.history["time"].size < 250
    lasting = found.volume_loss[1] - found.volume_loss[0]
    assert found.volume_loss[1] > 0.015 and abs(lasting) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1.0, 1.5])
def test_random_scenes_with_random_classes(horizon):
    ended, moved = 0, 0
    for seed in range(40):
        scene, end = random_scene(seed)
        scene = replace(scene, horizon=horizon)
        try:
            found = corrode(scene, [0.1 * end, end], TimeStepping(rate_change=0.3))
        except ValueError as error:
            # what liquid without saturation is refused for
            assert scene.saturation == "none" and "the liquid fills beyond" in str(error)
            continue
        ended += 1
        moved += 0.01 < found.volume_loss[-1]
        assert np.abs(found.history["balance_error"]).max() < 1e-11, seed
        # of a stage known to 1e-9
        assert np.diff(found.history["volume_loss"]).min() > -1e-9, seed
        assert found.history["time"].size < 1000, seed
        most = scene.saturation_concentration
        most = scene.solid_concentration if scene.saturation == "none" else most
        assert found.concentration.min() >= -1e-10, seed
        assert found.concentration[:, ~scene.metal].max() <= most * (1 + 1e-6), seed
    assert ended >= 35 and moved >= 15
