"""Couples that corrode: closed forms, Faraday's law, finite volumes, extreme geometries."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.polarization import PiecewiseTafelCurve, TafelCurve
from peri.coupled.galvanic import GalvanicScene, Metal, Renewal, corrode, potential
from peri.engine.constants import FARADAY
from peri.engine.lattice import Lattice
from peri.engine.march.checkpoints import CheckpointError
from peri.reference.fronts import flat_front_profile
from peri.transport.potential.patches import surface_patches
from peri.transport.potential.polarization import Insulated, LinearPolarization

DAY = 86400.0
AE44 = PiecewiseTafelCurve(
    (
        TafelCurve(0.014, 0.022018951276110654, -1.55),
        TafelCurve(21.145, 0.15944576128865037, -1.48),
        TafelCurve(58.107, 0.400, -1.41),
    ),
    (-1.48, -1.41),
)
STEEL = TafelCurve(0.00125, -0.153, -0.58)
AA6063 = TafelCurve(0.142, -0.0701, -1.363)


def slab(spacing=2e-3, ratio=2, resistance=1e-12):
    """An anode (0.1 V) and a cathode (0.6 V) 0.1 m apart: Zhao et al. 2021, Table 1."""
    liquid, anode = round(0.1 / spacing), round(20e-3 / spacing)
    x = np.arange(anode + liquid + ratio + 1)
    metals = (
        Metal("anode", x < anode, LinearPolarization(0.1, resistance), 143e3, 2.0),
        Metal("cathode", x >= anode + liquid, LinearPolarization(0.6, resistance)),
    )
    return GalvanicScene(Lattice((0.0,), (spacing,), x.shape), ratio * spacing, metals, 2.5)


def couple(cathode, spacing=0.25e-3, ratio=2, width=20e-3, height=15e-3, metal=5e-3):
    """AE44 right of the middle, the cathode left of it, liquid above."""
    shape = (round(width / spacing), round(height / spacing))
    lattice = Lattice((0.5 * spacing,) * 2, (spacing,) * 2, shape)
    x, y = lattice.coordinates()
    solid = np.broadcast_to(y < metal, shape)
    metals = (
        Metal("cathode", solid & (x < 0.5 * width), cathode),
        Metal("AE44", solid & (x > 0.5 * width), AE44, 67860.0, 2.0),
    )
    return GalvanicScene(lattice, ratio * spacing, metals, 2.5)


def test_a_slab_dissolves_by_the_closed_form():
    """Eq. 35 with the root over both terms; second order in the travel of a step."""
    times = np.array([10, 30, 100]) * DAY
    exact = np.sqrt(2 * 2.5 * times * 0.5 / (2 * FARADAY * 143e3) + 0.1**2) - 0.1
    np.testing.assert_allclose(1e3 * exact, [0.390615, 1.167321, 3.840050], atol=1e-6)
    off = []
    for travel in (0.2, 0.1, 0.05):
        result = corrode(slab(), times, Renewal(travel))
        assert result.history["current_anode"][0] == pytest.approx(12.5, rel=1e-9)
        off.append(result.depths() / exact - 1)
    # measured 1.2e-4, 3.9e-5, 1.1e-5 (3.0e-5, 9.9e-6, 2.7e-6 with half the travel): the lattice
    # adds nothing
    assert (np.abs(off[-1]) < 1.5e-4).all() and abs(off[-1][2]) < 2e-5
    orders = np.log2(np.abs(off[0] / off[1])), np.log2(np.abs(off[1] / off[2]))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def test_mirror_nodes_march():
    """Between plates they are exact; their surface stays where its nodes are until these are gone.

    So the gap grows by whole spacings, half a spacing late on the mean.
    """
    scene = slab(spacing=2e-3, resistance=1e-3)
    times = np.array([100, 365]) * DAY
    bonds = corrode(scene, times, Renewal(0.1))
    mirror = corrode(replace(scene, robin="as_published"), times, Renewal(0.1))
    exact = 0.5 / (2 * 1e-3 + 0.1 / 2.5)
    for found in (bonds, mirror):
        assert found.history["current_anode"][0] == pytest.approx(exact, rel=1e-9)
        assert np.abs(found.history["faraday_error"]).max() < 1e-12
        assert np.abs(found.history["imbalance"]).max() < 1e-9
    off = mirror.depths() / bonds.depths() - 1
    assert bonds.depths()[-1].sum() > 10e-3  # six spacings
    # measured 1.2 %
    assert 0.0 < off[-1].max() < 0.02


def test_mirror_nodes_refuse_what_they_do_not_have():
    scene = slab(spacing=5e-3)
    kappa, held = np.full(scene.lattice.shape, 2.5), np.full(scene.lattice.shape, np.nan)
    for changes, words in (
        ({"robin": "mirror"}, "it must be one of conservative, as_published"),
        ({"conductivity": kappa}, "mirror nodes take one conductivity"),
        ({"held": held}, "mirror nodes take no held nodes"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(scene, **{"robin": "as_published", **changes})


@pytest.mark.parametrize(
    ("cathode", "total", "end", "depths"),
    [
        # Total by finite volumes.  The depths of AA6063 (1, 2, 5, 9 mm from the joint) are those
        # of a finite-volume march; those of steel march on faces that a staircase overcounts
        # (1.457, 1.244, 0.767, 0.623), so only the far ones are compared.
        (AA6063, 0.05141, 0.0514, [0.159, 0.125, 0.0865, 0.0734]),
        pytest.param(STEEL, 0.4120, 0.45, [np.nan, np.nan, 0.767, 0.623], marks=pytest.mark.slow),
    ],
    ids=["AA6063", "steel"],
)
def test_a_couple_with_ae44_after_three_days(cathode, total, end, depths):
    scene = couple(cathode)
    result = corrode(scene, [0.0, 3 * DAY], Renewal(0.2))
    history, mass = result.history, result.history["metal_amount"]
    assert potential(scene).current(1) == history["current_AE44"][0]
    assert history["current_AE44"][0] == pytest.approx(total, rel=3e-3)
    assert history["current_AE44"][-1] == pytest.approx(end, rel=0.05)
    np.testing.assert_allclose(history["current_AE44"], -history["current_cathode"], rtol=1e-12)
    # Faraday's law by two sums of its own, to round-off.
    lost = mass[0] - mass[-1]
    assert lost > 0.01 * mass[0]
    assert history["charge"][-1] == pytest.approx(2 * FARADAY * lost, rel=1e-12)
    assert np.abs(history["faraday_error"]).max() < 1e-14
    # and by the time integral of the current that was written, to its trapezoidal error
    charge = trapezoid(history["current_AE44"], history["time"])
    assert charge == pytest.approx(history["charge"][-1], rel=5e-3)
    depth = 1e3 * result.depths()[-1]
    x = 1e3 * scene.lattice.axis(0) - 10.0
    found = np.interp([1, 2, 5, 9], x, depth)
    # measured: AA6063 within 3 %; steel 4 and 2 % low
    np.testing.assert_allclose(found, np.where(np.isnan(depths), found, depths), rtol=0.05)
    assert depth[x < 0].max() == 0.0
    assert abs(x[depth.argmax()]) < 1.0  # deepest beside the joint


def test_flat_fronts_draw_by_the_published_profile():
    """Shares behind a patch add up to one and follow f(z) of Eqs 18 to 20."""
    scene = couple(STEEL, spacing=0.1e-3, ratio=8, width=6e-3, height=4e-3, metal=2e-3)
    from peri.engine.operators import NonlocalSum

    bonds = NonlocalSum(scene.stencil, scene.lattice.shape)
    patches = surface_patches(bonds, ~scene.metal(), [scene.metal()])
    np.testing.assert_allclose(patches.drawn.sum(axis=1), 1.0, rtol=1e-14)
    middle = np.flatnonzero(patches.node[:, 0] == 30)
    assert middle.size == 1
    column = patches.drawn[middle[0]].toarray().reshape(scene.lattice.shape)[30, :20][::-1]
    depth = (np.arange(8) + 0.5) * 0.1e-3
    profile = flat_front_profile(depth, 0.8e-3) * 0.1e-3
    # measured 0.008 of a profile that starts at 0.25
    np.testing.assert_allclose(column[:8], profile, atol=0.012)


def test_a_march_goes_on_from_its_checkpoint_to_the_last_bit(tmp_path):
    scene, renewal, times = couple(AA6063, 1e-3), Renewal(0.2), [DAY, 9 * DAY, 20 * DAY]
    whole = corrode(scene, times, renewal)
    file = tmp_path / "march.h5"

    class Stop(Exception):
        pass

    def stop(share, text):
        if share > 0.5:
            raise Stop

    with pytest.raises(Stop):
        corrode(scene, times, renewal, checkpoint=file, checkpoint_every=0.0, progress=stop)
    rest = corrode(scene, times, renewal, checkpoint=file, resume=True)
    for name, values in whole.fields.items():
        np.testing.assert_array_equal(rest.fields[name], values, err_msg=name)
    for name, values in whole.history.items():
        np.testing.assert_array_equal(rest.history[name], values, err_msg=name)
    with pytest.raises(CheckpointError):
        corrode(couple(STEEL, 1e-3), times, renewal, checkpoint=file, resume=True)


def test_metal_that_is_used_up_ends_the_current():
    """A thin anode dissolves altogether; what is left of the couple is at rest."""
    shape, h = (24, 16), 1e-3
    lattice = Lattice((0.5 * h,) * 2, (h, h), shape)
    x, y = lattice.coordinates()
    cathode = np.broadcast_to(y < 3 * h, shape) & (x < 12 * h)
    anode = np.broadcast_to(y < 1 * h, shape) & (x > 12 * h) & (x < 18 * h)
    metals = (
        Metal("cathode", cathode, LinearPolarization(-0.6, 0.05)),
        Metal("anode", anode, LinearPolarization(-1.5, 0.01), 7e4, 2.0),
    )
    scene = GalvanicScene(lattice, 2 * h, metals, 2.5)
    result = corrode(scene, [DAY, 1000 * DAY], Renewal(0.5))
    history = result.history
    assert 0 < history["metal_amount"][1] < history["metal_amount"][0]
    assert history["metal_amount"][-1] == 0.0
    assert history["charge"][-1] == pytest.approx(2 * FARADAY * history["metal_amount"][0])
    assert history["current_anode"][-1] == history["current_cathode"][-1] == 0.0
    assert not result.fields["metal"][-1][anode].any()


def test_islands_are_cut_off():
    """What a thinner neck leaves behind keeps its metal: it has no lead."""
    shape, h = (26, 12), 1e-3
    lattice = Lattice((0.5 * h,) * 2, (h, h), shape)
    i, j = np.indices(shape)
    anode = (j < 4) & (i >= 8) & ((i < 14) | (i > 15) | (j == 0))
    metals = (
        Metal("cathode", (j < 4) & (i < 8), LinearPolarization(-0.6, 0.02)),
        Metal("anode", anode, LinearPolarization(-1.5, 0.01), 7e4, 2.0),
    )
    scene = GalvanicScene(lattice, 2 * h, metals, 2.5)
    result = corrode(scene, [20 * DAY, 25 * DAY, 300 * DAY], Renewal(0.5))
    sides = [anode & part for part in (i < 14, i > 15)]
    amount = np.array([[c[s].sum() for s in sides] for c in result.fields["concentration"]])
    assert (amount[0] > 0).all(), amount
    # One side is cut off in the first 20 days and stays; the other one dissolves.
    stays = amount[0] == amount[1]
    assert stays.sum() == 1, amount
    np.testing.assert_array_equal(amount[2], np.where(stays, amount[0], 0.0))
    assert np.abs(result.history["faraday_error"]).max() < 1e-14
    assert result.history["current_anode"][-1] == 0.0


def test_refusals():
    scene = couple(STEEL, 0.5e-3)
    lattice, nodes = scene.lattice, scene.metals[1].nodes
    with pytest.raises(ValueError, match="charge_number: none is given for 'AE44'"):
        Metal("AE44", nodes, AE44, 67860.0)
    with pytest.raises(ValueError, match="solid_concentration: -1.0 of 'AE44'"):
        Metal("AE44", nodes, AE44, -1.0, 2.0)
    with pytest.raises(ValueError, match="conductivity: 0.0 S/m"):
        GalvanicScene(lattice, 1e-3, scene.metals, 0.0)
    with pytest.raises(ValueError, match="nodes belong to two of"):
        GalvanicScene(lattice, 1e-3, (*scene.metals, Metal("third", nodes, STEEL)), 2.5)
    with pytest.raises(ValueError, match="each needs its own name"):
        GalvanicScene(lattice, 1e-3, (scene.metals[1],) * 2, 2.5)
    with pytest.raises(ValueError, match="'none' has no node"):
        GalvanicScene(lattice, 1e-3, (Metal("none", nodes & False, STEEL),), 2.5)
    with pytest.raises(ValueError, match="travel: 1.5"):
        Renewal(1.5)
    with pytest.raises(ValueError, match="a current needs a sink"):
        corrode(GalvanicScene(lattice, 1e-3, (scene.metals[1],), 2.5), [DAY])
    with pytest.raises(ValueError, match="times"):
        corrode(scene, [])


def test_self_corrosion_adds_to_the_couple_and_obeys_its_law():
    """A flat front alone: V_L = l log10(1 + t/tau); with a couple both add up."""
    gap = slab(spacing=1e-3)
    x = np.arange(gap.lattice.shape[0])
    law = VolumeLossLaw(0.05)
    alone = Metal(
        "anode", gap.metals[0].nodes, Insulated(), 143e3, 2.0, self_corrosion=2.0, kinetics=law
    )
    rest = Metal("cathode", gap.metals[1].nodes, Insulated())
    scene = GalvanicScene(gap.lattice, gap.horizon, (alone, rest), 2.5)
    result = corrode(scene, [10 * DAY], Renewal(0.02, longest=0.25 * DAY))
    thickness = alone.nodes.sum() * 1e-3
    tau = 0.05 * np.log(10) ** -1 / (2.0 / (2 * FARADAY * 143e3) / thickness)
    exact = 0.05 * np.log10(1 + 10 * DAY / tau)
    loss = result.depths()[-1] / thickness
    assert loss == pytest.approx(exact, rel=2e-3) and 1e-4 < exact < 0.05
    assert result.history["charge"][-1] == 0.0 == result.history["current_anode"][-1]
    assert np.abs(result.history["faraday_error"]).max() < 1e-14

    both = Metal(
        "anode", alone.nodes, LinearPolarization(0.1, 1e-12), 143e3, 2.0, self_corrosion=2.0
    )
    coupled = corrode(GalvanicScene(gap.lattice, gap.horizon, (both, gap.metals[1]), 2.5), [DAY])
    amount = coupled.history["metal_amount"]
    lost = 2 * FARADAY * (amount[0] - amount[-1])
    charge = coupled.history["charge"][-1]
    assert charge == pytest.approx(12.5 * DAY, rel=1e-3)
    assert lost == pytest.approx(charge + 2.0 * DAY, rel=1e-12)
    with pytest.raises(ValueError, match="which does not dissolve"):
        Metal("cathode", x > 5, Insulated(), self_corrosion=1.0)
    with pytest.raises(ValueError, match="self_corrosion: -1.0"):
        Metal("anode", x > 5, Insulated(), 1e5, 2.0, self_corrosion=-1.0)
