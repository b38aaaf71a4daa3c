"""Random pits and their bounds, a part of `python -m tests.extreme.random_couples`.

Sheets in one to three dimensions, with liquid on one or both sides (a pit may go through), closed
or refreshed, clean or not; bare, or passive below a critical concentration but for nuclei, films
that break; two phases, or grains of several rates with boundaries of another metal; walls that
conduct along themselves, with and without pores; islands that stay or dissolve; C_sat/C_solid from
1e-6 to 0.9, currents over six decades, one step or many.
"""

from dataclasses import replace

import numpy as np

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.metal.bond_damage import BondDamage
from peri.corrosion.metal.microstructure import BOUNDARY, polycrystal
from peri.corrosion.metal.solids import Solid
from peri.corrosion.passivity import Repassivation, Rupture
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping

SOLID = 1e5


def random_pit(seed: int) -> tuple[CorrosionScene, float, TimeStepping]:
    """A scene, a time in which some layers of it would go, and how to march there."""
    rng, more = np.random.default_rng(seed), np.random.default_rng([seed, 2])
    d = 3 if more.uniform() < 0.15 else int(rng.integers(1, 3))
    shape = tuple(int(n) for n in rng.integers(*{1: (12, 60), 2: (12, 24), 3: (10, 13)}[d], d))
    spacing = 10.0 ** rng.uniform(-7, -4)
    lattice = Lattice((0.0,) * d, (spacing,) * d, shape)
    depth = np.broadcast_to(np.arange(shape[-1]), shape)
    below = int(rng.integers(0, 5)) if rng.uniform() < 0.5 else 0  # liquid behind the sheet, too
    metal = (depth >= below) & (depth < shape[-1] - int(rng.integers(3, 7)))
    saturated = SOLID * 10.0 ** rng.uniform(-6, np.log10(0.9))
    flux = 10.0 ** rng.uniform(-6, 0)
    film = Repassivation(
        saturated * float(rng.uniform(0.2, 0.95)), saturated, float(rng.choice([0.0, 1e-3, 0.5]))
    )
    other = np.random.default_rng([seed, 1])
    if other.uniform() < 0.4:
        film = Rupture(
            film.critical_concentration, saturated, film.passive_share, None,
            float(other.uniform(0.05, 0.9)),
        )  # fmt: skip
    solids = (
        Solid(SOLID, kinetics=film if rng.uniform() < 0.5 else ConstantRate()),
        Solid(SOLID, rate=10.0 ** rng.uniform(-2, 0), kinetics=ConstantRate()),
    )
    phase = np.where(metal, 1 + (rng.uniform(size=shape) < rng.choice([0.05, 0.5])), 0)
    scene = CorrosionScene(
        lattice,
        spacing * float(rng.choice([1.0, 2.0, 3.0])),
        np.ascontiguousarray(metal),
        boundary=str(rng.choice(["refreshed", "no_flux"])),
        solid_concentration=SOLID,
        saturation_concentration=saturated,
        liquid_diffusivity=10.0 ** rng.uniform(-11, -8),
        dissolution_flux=flux,
        dissolution="faradaic",
        solids=solids,
        phase=phase.astype(np.uint8),
        detached="dissolve" if other.uniform() < 0.3 else "keep",
    )
    if more.uniform() < 0.3:
        scene = with_grains(scene, film, more)
    if more.uniform() < 0.4:
        scene = replace(scene, walls=True, pores=scene.detached == "keep" and more.uniform() < 0.5)
    if more.uniform() < 0.3:
        scene = replace(scene, liquid=saturated * more.uniform(size=shape) ** 4)
    end = float(rng.uniform(0.5, 8)) * spacing * SOLID / flux
    scheme = "backward_euler" if scene.pores else "sdirk2"
    return scene, end, TimeStepping(scheme, step=end / int(rng.choice([1, 7, 30])))


def with_grains(scene: CorrosionScene, film, rng) -> CorrosionScene:
    """The scene's metal as a polycrystal: four rates of grains, and boundaries with less metal."""
    spacing = max(scene.lattice.spacing)
    structure = polycrystal(
        scene.lattice, spacing * float(rng.uniform(4, 8)), 2 * spacing, int(rng.integers(1000))
    )
    rates = 10.0 ** rng.uniform(-1, 0, 4)
    least = max(0.6 * SOLID, 1.05 * scene.saturation_concentration)
    solids = (
        *(Solid(SOLID, rate=float(rate), kinetics=ConstantRate()) for rate in rates),
        Solid(float(rng.uniform(least, SOLID)), kinetics=film),
    )
    grain = 1 + (4 * structure.draw).astype(int)[structure.grain]
    phase = np.where(scene.metal, np.where(structure.phase == BOUNDARY, 5, grain), 0)
    return replace(scene, solids=solids, phase=phase.astype(np.uint8))


def check_pit(seed: int) -> str:
    """March one pit; what became of it. AssertionError where a bound is broken."""
    scene, end, stepping = random_pit(seed)
    result = corrode(scene, [0.4 * end, end], stepping)
    history = result.history
    assert np.abs(history["balance_error"]).max() < 1e-10, (seed, history["balance_error"])
    assert all(np.isfinite(values).all() for values in history.values()), seed
    most = scene.saturation_concentration
    for concentration, metal in zip(result.concentration, result.metal, strict=True):
        assert concentration.min() >= 0.0, (seed, concentration.min())
        liquid = concentration[scene.domain & ~metal]
        # measured at most 5e-10 (seed 161 of 300)
        assert liquid.max(initial=0.0) <= most * (1 + 1e-8), (seed, liquid.max() / most - 1)
        assert concentration.max() <= SOLID * (1 + 1e-12), seed
    assert not (result.metal[1] & ~result.metal[0]).any(), seed
    assert (np.diff(history["volume_loss"]) >= -1e-9).all(), seed
    damage = BondDamage(scene.lattice, scene.horizon, scene.metal, SOLID, most, seed)
    share = [
        np.where(metal, damage.corroded(c), 1.0)
        for c, metal in zip(result.concentration, result.metal, strict=True)
    ]
    index = [damage.damage_index(s) for s in share]
    assert all((i >= 0).all() and (i <= 1).all() for i in index), seed
    through = scene.metal.any() and not result.metal[1].all(axis=-1).any()
    islands = bool(damage.detached(share[1]).any())
    return "pit with islands" if islands else "pit through" if through else "pit"
