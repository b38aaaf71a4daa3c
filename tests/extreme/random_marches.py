"""Random small scenes, marched and checked by the thousand: python -m tests.extreme.random_marches

Every seed is one scene: a lattice of one to three axes with any pattern of metal, liquid and
nothing, any law of the rate and of the bonds, saturation model, boundary and scheme, D_int/D_liq
from 1e-8 to 1e8.  Its march has to end within a number of steps that its size gives, to keep its
bounds and its balance, or to be refused in one clear sentence.
"""

from __future__ import annotations

import argparse
import collections
import sys
import time
import traceback
import warnings
from dataclasses import dataclass

import numpy as np

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.choices import BOUNDARIES, SATURATION_MODELS
from peri.corrosion.kinetics import ButlerVolmer, ConstantRate, Exposed, Tafel, VolumeLossLaw
from peri.corrosion.laws import INTERFACE_LAWS
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.engine.march.stepping import SCHEMES

SOLID = 6e4
"""C_solid of all scenes, mol/m^3."""
BOUNDS = 1e-12
"""How far below 0 or above its highest value a concentration may be, over C_solid."""
BALANCE = 1e-10
"""How well the fields and what has been released add up to the initial metal, relative."""
REFUSALS = ("step:", "scheme:", "saturation:")
"""A march may be refused in one sentence that begins with the field it is about."""


class Endless(Exception):
    """A march takes more steps than its size gives."""


@dataclass(frozen=True)
class March:
    """A scene, the time to march to (s) and how."""

    scene: CorrosionScene
    end: float
    stepping: TimeStepping

    @property
    def steps(self) -> int:
        """The number of steps that must do.

        Explicit ones: `random_march` counts its time in 100 stable ones, each of which the
        accuracy may share out among 1 / rate_change.  A fixed one is shortened where the metal
        turns liquid within it, a controlled one shares each node's life out, too.
        """
        how, nodes = self.stepping, int(self.scene.metal.sum())
        if how.scheme == "forward_euler":
            return int(100 / how.rate_change) + 2
        if how.step is not None:
            return round(self.end / how.step) + 2 + 20 * nodes
        tenfold = 3 if "concentration" in self.scene.needs else 0  # the acid speeds itself up
        return int((20 + 2 * nodes + 20 * tenfold) / how.rate_change)

    def __str__(self) -> str:
        s = self.scene
        ratio = s.interface_diffusivity / s.liquid_diffusivity
        how = "controlled" if self.stepping.controlled else f"step {self.stepping.step}"
        return (
            f"{s.lattice.shape} {s.dissolution.name} {type(s.kinetics).__name__} {s.saturation} "
            f"{s.boundary} {self.stepping.scheme} {how} D_int/D_liq {ratio:.2g} "
            f"C_sat/C_solid {s.saturation_concentration / SOLID:.2g} metal {int(s.metal.sum())} "
            f"end {self.end:.3g} s"
        )


def random_march(seed: int) -> March:
    """The march of a seed."""
    rng = np.random.default_rng(seed)
    scene = _scene(rng)
    discrete = BiMaterial(scene)
    in_liquid, in_metal = discrete.fastest_rates()
    # From a thousandth of the time that the fastest metal node takes to a thousand times that.
    pace = in_metal if in_metal > 0 else in_liquid
    end = 10.0 ** rng.uniform(-3.0, 3.0) / pace if pace > 0 else 1e6
    scheme = str(rng.choice(_schemes(scene)))
    if scheme == "forward_euler":
        # Time is counted in its steps, which follow the fastest rate that there may be: that of
        # a node among liquid alone, in liquid that is full.
        end = min(end, 100.0 / max(_fastest(scene), 1e-300))
        return March(scene, end, TimeStepping(scheme))
    if rng.random() < 0.5 or scene.saturation == "as_published":
        return March(scene, end, TimeStepping(scheme, step=end / int(rng.integers(1, 20))))
    return March(scene, end, TimeStepping(scheme, rate_change=float(rng.choice([0.05, 0.2]))))


def _fastest(scene: CorrosionScene) -> float:
    """A bound of the bonds' rates whatever dissolves, 1/s."""
    full = Exposed(0.0, concentration=np.array(scene.saturation_concentration))
    rate = float(scene.kinetics.rate(full))
    strength = scene.stencil.total * float(scene.capacity().max())
    return strength * max(scene.liquid_diffusivity, rate * scene.interface_diffusivity)


def _schemes(scene: CorrosionScene) -> list[str]:
    without = "sdirk2" if scene.saturation == "as_published" else ""
    return [s for s in SCHEMES if s in scene.dissolution.schemes and s != without]


def _scene(rng: np.random.Generator) -> CorrosionScene:
    longest = [(40,), (10, 10), (5, 5, 5)][rng.integers(3)]
    shape = tuple(int(rng.integers(1, n + 1)) for n in longest)
    spacing = np.full(len(shape), 1e-4)
    spacing[rng.integers(len(shape))] *= rng.choice([1.0, 1.0, 2.5, 25.0])
    horizon = rng.choice([1.0, 2.0, 3.0, 3.3]) * spacing
    domain = rng.random(shape) < rng.choice([1.0, 1.0, 0.8])
    metal = domain & (rng.random(shape) < rng.choice([0.1, 0.5, 0.9]))
    fraction = None
    if rng.random() < 0.4:
        partly = rng.uniform(0.0, 0.5, shape) * (rng.random(shape) < 0.5)
        fraction = np.where(metal, rng.uniform(0.2, 1.0, shape), partly)
    dissolution = str(rng.choice(list(INTERFACE_LAWS)))
    allowed = SATURATION_MODELS if dissolution == "proportional" else ("complementarity", "none")
    saturated = SOLID * 10.0 ** rng.uniform(-5.0, -0.2)
    kinetics = [
        ConstantRate(),
        VolumeLossLaw(10.0 ** rng.uniform(-2.5, 0.0)),
        Tafel(float(rng.uniform(-0.3, 0.3)), 0.1),
        ButlerVolmer(float(rng.uniform(0.0, 0.1))),
        AcidityLaw(min(saturated, 5.6e3)),  # the range that it was fitted in
    ][rng.integers(5)]
    liquid = 10.0 ** rng.uniform(-12.0, -8.0)
    return CorrosionScene(
        Lattice((0.0,) * len(shape), tuple(spacing), shape),
        tuple(horizon),
        metal,
        domain,
        fraction,
        boundary=str(rng.choice(BOUNDARIES)),
        solid_concentration=SOLID,
        saturation_concentration=saturated,
        liquid_diffusivity=liquid,
        interface_diffusivity=liquid * 10.0 ** rng.uniform(-8.0, 8.0),
        dissolution=dissolution,
        kinetics=kinetics,
        kernel_exponent=float(rng.choice([0.0, -0.5, 0.5])),
        saturation=str(rng.choice(allowed)),
    )


def run(march: March) -> tuple[CorrosionResult, int]:
    """March; the result and its number of steps.  Endless where there are more than must do."""
    taken = -1  # the first report is that of the start

    def count(fraction: float, text: str) -> None:
        nonlocal taken
        taken += 1
        if taken > march.steps:
            raise Endless(f"{taken} steps lead to {fraction:.3g} of the time")

    times = [0.4 * march.end, march.end]
    return corrode(march.scene, times, march.stepping, progress=count), taken


def faults(scene: CorrosionScene, result: CorrosionResult) -> list[str]:
    """What a result breaks, each with its measure; empty for a sound one."""
    history, capacity = result.history, scene.capacity()
    initial = float((capacity * SOLID)[scene.metal].sum())
    open_water = scene.domain & ~scene.refreshed()
    found = []
    for n, moment in enumerate(result.times):
        share = result.concentration[n] / SOLID
        step = int(np.flatnonzero(history["time"] <= moment * (1 + 1e-12))[-1])
        there = float((capacity * result.concentration[n])[open_water].sum())
        left = history["released_amount"][step] / scene.lattice.cell_volume
        measures = {
            "lowest C / C_solid": (-share.min(), BOUNDS),
            "highest C / C_solid above 1": (share.max() - 1.0, BOUNDS),
            "balance": (abs(there + left - initial) / initial if initial else there, BALANCE),
            "V_L above 1": (result.volume_loss[n] - 1.0, 0.0),
        }
        if scene.saturation == "complementarity":
            liquid = result.concentration[n][~result.metal[n]].max(initial=0.0)
            # beyond the metal's reach it is the solver's tolerance that holds the liquid down
            measures["liquid above C_sat"] = (liquid / scene.saturation_concentration - 1, 1e-8)
        found += [f"{name} {value:.2g}" for name, (value, most) in measures.items() if value > most]
        if not np.isfinite(share).all():
            found.append("not finite")
    fallen = float(np.diff(history["volume_loss"]).min(initial=0.0))
    if fallen < -1e-9:  # a stage knows V_L to that
        found.append(f"V_L falls by {-fallen:.2g}")
    return found


def check(seed: int) -> tuple[str, str]:
    """The outcome of a seed's march, `ended`, `refused` or what is wrong, and the march in words.

    A warning is wrong, too: an invalid division, an overflow.
    """
    march = random_march(seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result, _ = run(march)
    except ValueError as error:
        text = str(error)
        clear = text.startswith(REFUSALS) and "\n" not in text and len(text) < 250
        return ("refused" if clear else f"unclear error: {text}"), str(march)
    except Endless as error:
        return f"endless: {error}", str(march)
    except Exception as error:  # whatever else comes out of a march is a fault of it
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {where.name}:{where.lineno}: {error}", str(march)
    wrong = faults(march.scene, result)
    return (", ".join(wrong) or "ended"), str(march)


def main(arguments: list[str] | None = None) -> int:
    """Check as many seeds as asked for; 1 if something is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=1000, help="how many (1000)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="first seed (0)")
    asked = parser.parse_args(arguments)
    started, outcomes = time.process_time(), collections.Counter[str]()
    for seed in range(asked.first, asked.first + asked.count):
        outcome, march = check(seed)
        outcomes[outcome if outcome in ("ended", "refused") else "wrong"] += 1
        if outcome not in ("ended", "refused"):
            print(f"seed {seed}: {outcome}\n    {march}", flush=True)
    counts = ", ".join(f"{outcomes[name]} {name}" for name in ("ended", "refused", "wrong"))
    print(f"{asked.count} marches in {time.process_time() - started:.0f} s: {counts}")
    return 1 if outcomes["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
