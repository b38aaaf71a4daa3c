"""Liquid in the emptied share of metal nodes: amounts, bounds, conduction, resumption, refusals."""

import numpy as np
import pytest

from peri.corrosion.kinetics import ConstantRate
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.nodes.pores import Pores
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping

SOLID, MOST = 1e4, 2e3
BACKWARD = TimeStepping("backward_euler", rate_change=0.1)


def gap(**more) -> CorrosionScene:
    """Liquid 6 rows high over metal, closed at one end; 10 : 1."""
    shape, spacing = (24, 12), (10e-6, 1e-6)
    lattice = Lattice((0.0, 0.0), spacing, shape)
    row = np.broadcast_to(np.arange(shape[1]), shape)
    mouth = np.zeros(shape, bool)
    mouth[:3] = True
    given = dict(
        horizon=(30e-6, 3e-6),
        metal=(row >= 6) & ~mouth,
        domain=~((row >= 6) & mouth),
        renewed=mouth & (row < 6),
        walls=True,
        pores=True,
        solid_concentration=SOLID,
        saturation_concentration=MOST,
        liquid_diffusivity=1e-9,
        dissolution_flux=1e-5,
        flux_calibration="every_axis",
        dissolution="faradaic",
        kinetics=ConstantRate(),
    )
    return CorrosionScene(lattice, **{**given, **more})


@pytest.mark.parametrize("closed", [False, True])
def test_amounts_and_bounds(closed):
    scene = gap(boundary="no_flux", renewed=None) if closed else gap()
    done = corrode(scene, [1e3, 3e3], BACKWARD)
    history, last = done.history, done.concentration[-1]
    assert np.abs(history["balance_error"]).max() < 1e-12  # 3e-16 measured
    assert history["saturated_nodes"].max() > 0
    assert (history["released_amount"][-1] > 0) is not closed
    assert last.min() >= 0
    assert last[~done.metal[-1]].max() <= MOST * (1 + 1e-9)
    if closed:
        # All that there is room for, in the gap and where metal was: V (f + lost) C_sat.
        volume, metal = (~scene.metal & scene.domain).sum(), scene.metal.sum()
        lost = volume * MOST / (metal * (SOLID - MOST))
        assert done.volume_loss[-1] == pytest.approx(lost, rel=1e-6)
    else:
        assert history["dissolved_nodes"].sum() > 5


def test_a_resumed_march_is_the_same(tmp_path):
    scene, file = gap(), tmp_path / "state"
    whole = corrode(scene, [1e3, 2e3], BACKWARD)
    corrode(scene, [1e3, 2e3], BACKWARD, checkpoint=file, checkpoint_every=0.0)
    again = corrode(scene, [1e3, 2e3], BACKWARD, checkpoint=file, resume=True)
    np.testing.assert_array_equal(whole.concentration, again.concentration)
    np.testing.assert_array_equal(whole.history["balance_error"], again.history["balance_error"])


def test_what_they_hold_and_conduct():
    """Half of a layer gone: liquid nodes store and conduct half a cell more per column, in sum."""
    scene = gap()
    d = BiMaterial(scene)
    field = d.initial_concentration.copy()
    row = np.broadcast_to(np.arange(12), scene.lattice.shape)
    field[d.sum.pad((row == 6) & scene.metal) > 0] = 0.5 * SOLID
    pores = Pores(d, d.take(d.initial_concentration), np.zeros_like(field))
    pores.fill(d.take(field))
    columns = scene.metal.any(axis=1).sum()
    assert pores.volume.sum() == pytest.approx(0.5 * columns, rel=1e-12)
    liquid = d.take(np.where(d.free, 700.0, 0.0))
    held = pores.holds(liquid)
    assert held.max() == pytest.approx(350.0, rel=1e-12)
    assert held.sum() == pytest.approx((pores.volume * liquid).sum(), rel=1e-12)
    # A uniform gradient along the gap carries the current of its whole section.
    x = d.sum.pad(np.broadcast_to(scene.lattice.axis(0)[:, None], scene.lattice.shape))
    before = _current(d, x)
    d.open_walls(field)
    middle = 14
    gained = (_current(d, x) - before)[middle]
    assert gained == pytest.approx(0.5 * scene.liquid_diffusivity / 10e-6, rel=2e-3)


def _current(d: BiMaterial, u: np.ndarray) -> np.ndarray:
    """What the walls' links carry from each column to the next."""
    out = np.zeros(d.scene.lattice.shape[0])
    near, far, face, _ = d.walls.links[0]
    flow = face * (u.ravel()[far] - u.ravel()[near])
    column = d.sum.pad(np.broadcast_to(np.arange(out.size)[:, None], d.scene.lattice.shape))
    np.add.at(out, column.ravel()[near].astype(int), flow)
    return out


def test_refusals():
    with pytest.raises(ValueError, match="pores: they need walls and dissolution 'faradaic'"):
        gap(walls=False)
    with pytest.raises(ValueError, match="pores: they need walls"):
        gap(dissolution="proportional")
    with pytest.raises(ValueError, match="pores: given with detached 'dissolve'"):
        gap(detached="dissolve")
    with pytest.raises(ValueError, match="scheme: 'sdirk2' with pores; use backward_euler"):
        corrode(gap(), [10.0], TimeStepping())
    d = BiMaterial(gap())
    old = d.initial_concentration
    with pytest.raises(ValueError, match="pores: this march does not carry"):
        d.implicit_stage(old, 1.0, old, None, 0.0)
