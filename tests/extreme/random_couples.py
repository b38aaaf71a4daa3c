"""Random scenes of localised corrosion: `python -m tests.extreme.random_couples 1000`.

Of these 4 in 10 are couples, 3 in 10 couples whose ions are followed, 3 in 10 pits (random_pits).
Bounds: what there is of metal, ions, salt and what has left is conserved to 1e-10 of the metal, the
charge to 1e-12, and the currents of each pool balance to 1e-10; 0 <= C <= C_sat in the liquid and
0 <= C <= C_solid in the metal, which only loses; all that is reported is finite.

Lattices of one to three axes, spacings and horizons of many sizes, conductivities of 1e-3 to
10 S/m, slopes of 5 mV to 1 V, polarization resistances of 1e-6 to 1e3 ohm m2, electrodes up to 2 V
off, blobs of metal that may be one node, touch, enclose liquid or be cut apart as they dissolve.
"""

import sys
import time
from collections import Counter
from dataclasses import replace

import numpy as np
from scipy import ndimage

from peri.corrosion.polarization import ButlerVolmerCurve, TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, Renewal, corrode
from peri.coupled.galvanic_ions import Ions
from peri.engine.constants import FARADAY
from peri.engine.lattice import Lattice
from peri.transport.potential.conductivity import IonConductivity
from peri.transport.potential.polarization import LinearPolarization
from tests.extreme.random_pits import check_pit


def random_law(rng, anodic: bool):
    """A law of either branch, or one of both."""
    kind = rng.integers(3)
    rest = rng.uniform(-2.0, 2.0)
    if kind == 0:
        return LinearPolarization(rest, 10.0 ** rng.uniform(-6, 3))
    if kind == 1:
        return ButlerVolmerCurve(10.0 ** rng.uniform(-4, 2), rest, 2.0, 0.5, 0.5, 298.15)
    slope = 10.0 ** rng.uniform(np.log10(5e-3), 0)
    return TafelCurve(10.0 ** rng.uniform(-4, 2), slope if anodic else -slope, rest)


def random_scene(seed: int) -> tuple[GalvanicScene, float]:
    """A scene, and a time in which much of its metal would go."""
    rng = np.random.default_rng(seed)
    d = int(rng.integers(1, 4))
    shape = tuple(int(n) for n in rng.integers(8, {1: 60, 2: 22, 3: 12}[d], d))
    spacing = 10.0 ** rng.uniform(-6, -2)
    lattice = Lattice((0.0,) * d, (spacing,) * d, shape)
    blobs = ndimage.gaussian_filter(rng.normal(size=shape), rng.uniform(0.5, 2.5))
    order = np.argsort(blobs.ravel())
    few = max(1, int(blobs.size * rng.uniform(0.01, 0.4)))
    metals, count = [], int(rng.integers(2, 4))
    nodes = [order[:few], order[-few:], order[few : few + max(1, few // 4)]]
    for n in range(count):
        mask = np.zeros(blobs.size, bool)
        mask[nodes[n] if rng.uniform() > 0.1 else nodes[n][:1]] = True
        dissolves = n == 0 or rng.uniform() < 0.3
        metals.append(
            Metal(
                f"m{n}", mask.reshape(shape), random_law(rng, n == 0),
                10.0 ** rng.uniform(3, 5.2) if dissolves else None,
                float(rng.uniform(1, 3)) if dissolves else None,
                self_corrosion=float(rng.uniform() < 0.2) * dissolves * 10.0 ** rng.uniform(-3, 1),
            )
        )  # fmt: skip
    scene = GalvanicScene(
        lattice, spacing * float(rng.choice([1.0, 2.0, 3.0])), tuple(metals),
        10.0 ** rng.uniform(-3, 1),
    )  # fmt: skip
    return scene, 10.0 ** rng.uniform(2, 8)


def with_ions(scene: GalvanicScene, seed: int) -> GalvanicScene:
    """The scene with ions of any diffusivity and saturation, some of its liquid renewed."""
    rng = np.random.default_rng([seed, 1])
    law = IonConductivity(float(scene.conductivity), 2.0, 10.0 ** rng.uniform(-10, -8))
    most = 10.0 ** rng.uniform(-2, 4) if rng.uniform() < 0.7 else None
    renewed = rng.uniform(size=scene.lattice.shape) < 0.2 if rng.uniform() < 0.5 else None
    return replace(scene, ions=Ions(10.0 ** rng.uniform(-11, -7), law, most, renewed))


def check_ions(seed: int) -> str:
    """As `check`, with ions that are followed."""
    return check(seed, ions=True)


def check(seed: int, ions: bool = False) -> str:
    """March one scene; what became of it. AssertionError where a bound is broken."""
    scene, end = random_scene(seed)
    if ions:
        scene = with_ions(scene, seed)
    try:
        result = corrode(scene, [0.3 * end, end], Renewal(1.0, longest=end / 3, conductivity=1.0))
    except ValueError as error:
        assert "needs a sink" in str(error), (seed, error)
        return "no sink"
    history, fields = result.history, result.fields
    assert np.abs(history["imbalance"]).max() < 1e-10, (seed, history["imbalance"])
    assert np.abs(history["faraday_error"]).max() < 1e-12, (seed, history["faraday_error"])
    solid = scene.solid_concentrations()
    concentration = fields["concentration"]
    assert (concentration >= 0).all() and (concentration <= solid).all(), seed
    assert (concentration[1] <= concentration[0]).all(), seed
    assert (np.diff(history["metal_amount"]) <= 1e-15 * history["metal_amount"][0]).all(), seed
    assert np.isfinite([history[name] for name in history]).all(), seed
    if scene.ions is not None:
        # round-off of steps that are 1e6 times as long as a node's diffusion
        assert np.abs(history["balance_error"]).max() < 1e-10, (seed, history["balance_error"])
        dissolved, salt = fields["ions"], fields["salt"]
        most = scene.ions.saturation_concentration or np.inf
        assert dissolved.min() >= 0.0 and dissolved.max() <= most, seed
        assert (dissolved[salt > 0] == most).all(), seed
        assert not dissolved[fields["metal"]].any(), seed
        assert np.nanmin(fields["conductivity"]) >= float(scene.conductivity) * (1 - 1e-12), seed
    alone = sum(m.self_corrosion for m in scene.metals)
    charges = {m.charge_number for m in scene.metals if m.charge_number}
    if len(charges) == 1 and not alone:
        lost = history["metal_amount"][0] - history["metal_amount"][-1]
        whole = charges.pop() * FARADAY * history["metal_amount"][0]
        assert abs(history["charge"][-1] / whole - lost / history["metal_amount"][0]) < 1e-12, seed
    return "used up" if not concentration[1].any() else "marched"


KINDS = ((4, check), (3, check_ions), (3, check_pit))
"""How many in ten, and what marches and checks one."""


if __name__ == "__main__":
    outcomes = Counter()
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    started = time.process_time()
    todo = [(n, one) for share, one in KINDS for n in range(share * count // 10)]
    for number, one in todo:
        try:
            outcomes[one(number)] += 1
        except Exception as error:  # every kind is a finding
            outcomes[type(error).__name__] += 1
            print(one.__name__, number, type(error).__name__, str(error)[:200], flush=True)
    spent = time.process_time() - started
    print(f"{len(todo)} scenes, {spent:.0f} s of processor time: {dict(outcomes)}")
