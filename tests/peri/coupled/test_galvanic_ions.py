"""Couples whose liquid carries ions and conducts by them: closed forms, conservation, bounds."""

from dataclasses import replace

import numpy as np
import pytest

from peri.coupled.galvanic import GalvanicScene, Metal, Renewal, corrode
from peri.coupled.galvanic_ions import Ions, IonTransport
from peri.coupled.wagner import corrode_lean, couple_omissions, ions_bound
from peri.engine.constants import FARADAY
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.transport.potential.conductivity import IonConductivity, TabulatedConductivity
from peri.transport.potential.polarization import LinearPolarization
from peri.transport.potential.pools import label_pools

D, LENGTH, MEDIUM = 1e-9, 2e-3, 0.5
LAW = IonConductivity(MEDIUM, 2.0, 0.7e-9)


def cell(
    cells=40, ratio=2, resistance=0.1, voltage=2.0, most=None, is_open=False, law=LAW, thick=None
):
    """Plates 2 mm apart; with `is_open` the last horizon of a liquid as much longer is renewed."""
    h = LENGTH / cells
    before = thick or ratio + 1 + cells // 10
    more = ratio if is_open else 0
    x = (np.arange(before + cells + more + ratio + 1) - before + 0.5) * h
    metals = (
        Metal("anode", x < 0, LinearPolarization(0.0, resistance), 1e5, 2.0),
        Metal("cathode", x > LENGTH + more * h, LinearPolarization(voltage, resistance)),
    )
    renewed = (x > LENGTH) & (x < LENGTH + more * h) if is_open else None
    lattice = Lattice((x[0],), (h,), x.shape)
    return GalvanicScene(
        lattice, ratio * h, metals, MEDIUM, ions=Ions(D, law, most, renewed)
    )  # fmt: skip


def balanced(result):
    """Metal + ions + what left, Faraday's law and the currents close to round-off."""
    for name in ("balance_error", "faraday_error", "imbalance"):
        # measured at most 7e-15
        assert np.abs(result.history[name]).max() < 5e-14, name
    return result


@pytest.mark.parametrize(("cells", "within", "off"), [(40, 4e-4, 0.03), (80, 1e-4, 0.02)])
def test_the_drop_is_the_integral_of_current_over_conductivity(cells, within, off):
    """A closed cell with a steady flux at one side, whose concentration is a known series."""
    scene, resistance, voltage = cell(cells), 0.1, 2.0
    times = np.array([200.0, 1000.0, 3000.0])
    result = balanced(corrode(scene, times, Renewal(conductivity=0.05)))
    x = scene.lattice.axis(0)
    wet, h = (x > 0) & (x < LENGTH), x[1] - x[0]
    for k, t in enumerate(times):
        current = np.interp(t, result.history["time"], result.history["current_anode"])
        kappa, ions = (result.fields[n][k][wet] for n in ("conductivity", "ions"))
        drop = voltage - 2 * resistance * current
        assert drop < 0.9 * current * LENGTH / MEDIUM  # the ions matter
        across = current * ((h / kappa).sum() + result.depths()[k] / kappa[0])
        # measured 2.3e-4 and 5.7e-5: second order in the spacing
        assert drop == pytest.approx(across, rel=within)
        flux, n = current / (2 * FARADAY), np.arange(1, 200)[:, None]
        to_wall = LENGTH - x[wet]
        series = (
            (-1.0) ** n / n**2 * np.exp(-D * (n * np.pi / LENGTH) ** 2 * t)
            * np.cos(n * np.pi * to_wall / LENGTH)
        ).sum(axis=0)  # fmt: skip
        known = flux / D * (
            D * t / LENGTH + (3 * to_wall**2 - LENGTH**2) / (6 * LENGTH)
            - 2 * LENGTH / np.pi**2 * series
        )  # fmt: skip
        # measured 1.4 and 1.1 % after 200 s, then less: first order in the step
        np.testing.assert_allclose(ions, known, rtol=0, atol=off * known.max())


def test_an_open_cell_at_rest_has_the_logarithm_of_its_ends():
    """C falls along a straight line to renewed liquid: drop = i / (s N / D) ln(kappa_1 / kappa_0).

    A layer held one horizon wide acts like a plane 0.323 horizons behind its face (1D, m = 2).
    """
    scene = cell(80, is_open=True)
    result = balanced(corrode(scene, [2e4]))
    current, h = result.history["current_anode"][-1], LENGTH / 80
    slope = LAW.slope * current / (2 * FARADAY) / D
    length = LENGTH + 0.3232 * 2 * h
    behind = 2 * h - (length - LENGTH)
    known = current * (np.log1p(slope * length / MEDIUM) / slope + behind / MEDIUM)
    # measured 0.26 % (0.29 % with 40 nodes)
    assert 2.0 - 0.2 * current == pytest.approx(known, rel=5e-3)
    assert known < 0.4 * current * LENGTH / MEDIUM
    history = result.history
    assert history["released_amount"][-1] > 0.89 * (
        history["metal_amount"][0] - history["metal_amount"][-1]
    )


def test_above_saturation_ions_are_salt():
    """A steady flux above what diffusion carries from C_sat: the rest piles up as salt."""
    most, times = 50.0, [2e4, 4e4]
    scene = cell(80, most=most, is_open=True)
    result = balanced(corrode(scene, times))
    history = result.history
    current, h = history["current_anode"][-1], LENGTH / 80
    carried = D * most / (LENGTH + 0.3232 * 2 * h)
    salt = np.interp(times, history["time"], history["salt_amount"])
    rate = current / (2 * FARADAY) - carried
    assert 0 < carried < 0.7 * current / (2 * FARADAY)
    # measured 1.0 % low: saturated liquid is a spacing wide, which carries more
    assert np.diff(salt) / 2e4 == pytest.approx(rate, rel=0.02)
    assert history["highest_ions"][-1] == most
    salted = result.fields["salt"] > 0
    assert salted.any() and (result.fields["ions"][salted] == most).all()


def test_salt_dissolves_when_its_metal_is_gone():
    scene = cell(20, most=50.0, is_open=True, thick=1)
    result = balanced(corrode(scene, [1e5, 2e5, 4e5], Renewal(0.5)))
    assert result.history["metal_amount"][-1] == 0.0
    assert result.history["salt_amount"].max() > 1e-2 * result.history["metal_amount"][0]
    assert not result.fields["salt"][-1].any()
    amount = result.history["metal_amount"][0]
    assert result.history["released_amount"][-1] == pytest.approx(amount, rel=1e-2)


@pytest.mark.parametrize("resistance", [0.1, 1e-3])
@pytest.mark.parametrize("end", [5.0, 200.0])
def test_what_ions_change_is_within_its_bound(resistance, end):
    scene = cell(resistance=resistance, voltage=0.5)
    currents = [
        corrode(s, [end]).history["current_anode"][-1] for s in (replace(scene, ions=None), scene)
    ]
    bound, reason = ions_bound(scene, end)
    assert 0 < currents[1] / currents[0] - 1 < bound, (currents, reason)
    # one pair of electrodes: the liquid's share of the whole resistance
    ohmic = LENGTH / MEDIUM
    assert f"at most {ohmic / (ohmic + 2 * resistance):.2g}" in reason


def test_ions_are_left_out_within_a_tolerance_and_checked_at_the_end():
    dilute = cell(most=0.01)
    found, omissions = corrode_lean(dilute, [3000.0], tolerance=1e-2, refused=["potential"])
    said = {o.name: o for o in omissions}
    assert said["ions"].applied and said["renewal"].applied and said["ions"].bound < 1e-2
    assert "ions" not in found.fields and "balance_error" not in found.history
    kept, omissions = corrode_lean(dilute, [3000.0], tolerance=1e-2, refused=["potential", "ions"])
    said = {o.name: o for o in omissions}
    assert not said["ions"].applied and not said["renewal"].applied
    assert kept.history["highest_ions"][-1] == 0.01
    ratio = kept.history["charge"][-1] / found.history["charge"][-1]
    assert abs(ratio - 1) < 1e-2
    # without an end nothing but saturation bounds them
    assert couple_omissions(cell())[2].bound == np.inf
    points = TabulatedConductivity((0.0, 1.0), (MEDIUM, 1.0))
    assert "ends below" in ions_bound(cell(law=points), 3000.0)[1]


def test_a_march_with_ions_goes_on_from_its_checkpoint_to_the_last_bit(tmp_path):
    scene, times, file = cell(20, most=30.0), [500.0, 2000.0, 4000.0], tmp_path / "march.h5"
    whole = corrode(scene, times)

    class Stop(Exception):
        pass

    def stop(share, text):
        if share > 0.5:
            raise Stop

    with pytest.raises(Stop):
        corrode(scene, times, checkpoint=file, checkpoint_every=0.0, progress=stop)
    rest = corrode(scene, times, checkpoint=file, resume=True)
    for name, values in (*whole.fields.items(), *whole.history.items()):
        got = rest.fields.get(name, rest.history.get(name))
        np.testing.assert_array_equal(got, values, err_msg=name)


def test_steps_follow_the_conductivity():
    """Charge after 200 s by the change allowed in a step; halving it halves what is off."""
    charges = [
        corrode(cell(resistance=1e-3, voltage=0.1), [200.0], Renewal(conductivity=c)).history[
            "charge"
        ][-1]
        for c in (0.2, 0.1, 0.05, 0.0125)
    ]
    off = np.abs(np.array(charges[:3]) / charges[3] - 1)
    # measured
    assert off[0] > off[1] > off[2] and off[1] < 0.02


def test_refusals():
    scene = cell()
    ions, shape = scene.ions, scene.lattice.shape
    with pytest.raises(ValueError, match="ions: diffusivity is 0.0"):
        replace(ions, diffusivity=0.0)
    with pytest.raises(ValueError, match="ions: saturation_concentration is -1.0"):
        replace(ions, saturation_concentration=-1.0)
    with pytest.raises(ValueError, match="0.5 S/m without any by their law"):
        replace(scene, conductivity=1.0)
    with pytest.raises(ValueError, match="ions: conductivity is a field"):
        replace(scene, conductivity=np.full(shape, 0.5))
    with pytest.raises(ValueError, match="ions: renewed is of"):
        replace(scene, ions=replace(ions, renewed=np.zeros(3, bool)))
    with pytest.raises(ValueError, match="mirror nodes take no ions"):
        replace(scene, robin="as_published")
    with pytest.raises(ValueError, match="conductivity: 2; it must be above 0 and at most 1"):
        Renewal(conductivity=2)
    points = TabulatedConductivity((0.0, 10.0), (MEDIUM, 1.0))
    with pytest.raises(ValueError, match="the law's points end at 10 mol/m"):
        corrode(cell(law=points), [3000.0])


def transport(most=None, is_open=False, seed=0):
    """Ions in a random liquid of several pools, what its nodes hold, and the dense matrix of A."""
    rng = np.random.default_rng(seed)
    lattice = Lattice((0.0, 0.0), (1e-5, 1e-5), (9, 14))
    liquid = rng.uniform(size=lattice.shape) < 0.45
    renewed = rng.uniform(size=lattice.shape) < 0.1 if is_open else None
    ions = Ions(D, LAW, most, renewed)
    moves = IonTransport(ions, lattice, diffusion_stencil(lattice, 1e-5))
    content = np.where(liquid, 10.0 ** rng.uniform(-9, 3, lattice.shape), 0.0)
    moves.step(content, None, liquid, 1.0)
    nodes = np.flatnonzero(moves.sum.pad(liquid))
    columns = []
    for node in nodes:
        one = np.zeros(moves.sum.padded_shape)
        one.flat[node] = 1.0
        columns.append(-moves._brought(one).flat[nodes])
    matrix = np.array(columns).T
    pools = label_pools(moves.sum, liquid)
    assert pools.max() > 3
    return moves, content, liquid, matrix - np.diag(matrix.sum(axis=0)), pools


@pytest.mark.parametrize("stiffness", [1e-8, 1.0, 1e6, 1e12])
@pytest.mark.parametrize("is_open", [False, True])
def test_a_step_of_any_length_is_that_of_the_dense_matrix(stiffness, is_open):
    """Pools from 1e-9 to 1e3 mol/m^3, each to its own digits; renewed liquid leaves 1e-12 of it."""
    moves, content, liquid, matrix, pools = transport(is_open=is_open)
    step = stiffness * 1e-10 / D
    after, left = moves.step(content, None, liquid, step)
    assert after.min() >= 0.0
    fixed = moves.ions.renewed[liquid] if is_open else np.zeros(liquid.sum(), bool)
    for pool in range(1, pools.max() + 1):
        here = pools == pool
        free = (pools[liquid] == pool) & ~fixed
        values, modes = np.linalg.eigh(matrix[np.ix_(free, free)])
        # without its round-off, which long steps would multiply
        values[values < 1e-9 * values.max(initial=0.0)] = 0.0
        known = modes @ (modes.T @ content[liquid][free] / (1.0 + step * values))
        # measured at most 2e-12
        assert np.abs(after[liquid][free] - known).max(initial=0.0) <= 1e-10 * content[here].max()
        if not fixed[pools[liquid] == pool].any():
            assert after[here].sum() == pytest.approx(content[here].sum(), rel=1e-14)
    whole = content.sum() * moves.volume
    assert after.sum() * moves.volume + left == pytest.approx(whole, rel=1e-14)
    assert is_open or left == 0.0


@pytest.mark.parametrize("is_open", [False, True])
def test_salt_and_its_pools_keep_what_they_have(is_open):
    """Steps up to 1e13 of a node's diffusion: nothing negative, saturated where salt is left."""
    moves, content, liquid, _, pools = transport(30.0, is_open)
    whole, left = content.sum(), 0.0
    assert (content > 30.0).any()
    for stiffness in (1e-6, 1e-2, 1.0, 1e3, 1e9, 1e13):
        content, gone = moves.step(content, None, liquid, stiffness * 1e-10 / D)
        left += gone / moves.volume
        assert content.min() >= 0.0 and gone >= 0.0
        assert content.sum() + left == pytest.approx(whole, rel=1e-13)
    assert (left > 0.0) == is_open
    full = np.unique(pools[content > 30.0 * (1 + 1e-9)])
    assert is_open or full.size
    for pool in full:
        # a closed pool that has salt after a long step is saturated
        np.testing.assert_allclose(moves.ions.dissolved(content)[pools == pool], 30.0, rtol=1e-10)


def test_renewed_liquid_is_flushed_to_the_smallest_number():
    """What a solver leaves of a step is none of the next one's ions."""
    moves, content, liquid, _, pools = transport(is_open=True)
    open_pools = np.unique(pools[moves.ions.renewed & liquid])
    flushed, before = np.isin(pools, open_pools) & liquid, np.inf
    for _ in range(60):
        content, left = moves.step(content, None, liquid, 1e9 * 1e-10 / D)
        assert 0.0 <= left and content.min() >= 0.0
        now = content[flushed].sum()
        assert now < max(1e-5 * before, 1e-200)
        before = now
    assert before < 1e-200
