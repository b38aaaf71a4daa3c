"""Stochastic bond damage by one hashed number a bond."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from peri.corrosion.metal.bond_damage import (
    BondDamage,
    cut_off,
    dissolve_islands,
    hashed_uniform,
)
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping
from peri.schemes.broken import BrokenBonds

SOLID, SATURATED = 140e3, 5.6e3
SIZE, RATIO = 40, 4


def plate(n=SIZE, seed=0, **more) -> BondDamage:
    lattice = Lattice((0.0, 0.0), (1e-6, 1e-6), (n, n))
    return BondDamage(lattice, RATIO * 1e-6, np.ones((n, n), bool), SOLID, SATURATED, seed, **more)


def layer(n: int, time: float) -> np.ndarray:
    """Corroded shares that grow from the right-hand side, at a time from 0 to 1."""
    depth = (n - 1 - np.arange(n)) / 6.0
    return np.ones((n, 1)) * np.clip(1.6 * time - depth, 0.0, 1.0)


def dense_bonds(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Every pair within the horizon plus half a cell, from all pairs of nodes."""
    place = np.argwhere(np.ones((n, n), bool))
    apart = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    near = np.triu(apart < (RATIO + 0.5) ** 2, 1)
    return np.nonzero(near)


def index_of(alive: np.ndarray, one: np.ndarray, other: np.ndarray, nodes: int) -> np.ndarray:
    total = np.bincount(one, minlength=nodes) + np.bincount(other, minlength=nodes)
    left = np.bincount(one, alive, nodes) + np.bincount(other, alive, nodes)
    return 1 - left / total


def published_procedure(n, steps, one, other, rng) -> np.ndarray:
    """Eq. 25: both ends of each bond draw in every step."""
    alive = np.ones(one.size, bool)
    before = np.zeros(n * n)
    for time in np.linspace(0, 1, steps + 1)[1:]:
        now = layer(n, time).ravel()
        chance = np.where(before < 1, (now - before) / np.maximum(1 - before, 1e-300), 0.0)
        alive &= rng.random(one.size) > chance[one]
        alive &= rng.random(one.size) > chance[other]
        before = now
    return index_of(alive, one, other, n * n).reshape(n, n)


@pytest.mark.parametrize("steps", [1, 20])
def test_law_is_that_of_the_published_procedure(steps):
    one, other = dense_bonds(SIZE)
    share = layer(SIZE, 1.0)
    within = (share > 0) & (share < 1)
    assert within.sum() >= 5 * SIZE
    rng = np.random.default_rng(steps)
    drawn = [published_procedure(SIZE, steps, one, other, rng) for _ in range(60)]
    drawn = np.array(drawn)[:, within]
    hashed = np.array([plate(seed=k).damage_index(share) for k in range(60)])[:, within]
    expected = plate().expected_index(share)[within]
    # 60 samples of 240 nodes with a scatter of 0.05 a node: 4e-4 if nodes were independent;
    # bonds are shared by two nodes, which makes it about twice as much.
    assert drawn.mean() == pytest.approx(expected.mean(), abs=3e-3)
    assert hashed.mean() == pytest.approx(expected.mean(), abs=3e-3)
    assert expected.mean() > share[within].mean() + 0.1  # either end may break a bond
    # A variance from 60 samples has a relative scatter of sqrt(2/59) = 18 % a node, 1 % over all.
    variance = hashed.var(axis=0).mean() / drawn.var(axis=0).mean()
    assert variance == pytest.approx(1.0, abs=0.06)


def test_index_pieces_and_closed_form_against_all_pairs():
    n = 14
    one, other = dense_bonds(n)
    share = layer(n, 0.9)
    damage = plate(n, seed=2**64 - 1)
    stands = (1 - share.ravel()[one]) * (1 - share.ravel()[other])
    alive = hashed_uniform(damage.seed, one, other, n * n) < stands
    assert 0.1 < alive.mean() < 0.9
    np.testing.assert_array_equal(damage.bonds.ravel(), np.bincount(np.r_[one, other]))
    # One division of the same integers.
    np.testing.assert_allclose(
        damage.damage_index(share).ravel(), index_of(alive, one, other, n * n), atol=1e-15
    )
    np.testing.assert_allclose(
        damage.expected_index(share).ravel(), index_of(stands, one, other, n * n), atol=1e-14
    )
    label = np.arange(n * n)
    while True:  # the smallest number spreads over intact bonds
        new = label.copy()
        np.minimum.at(new, one[alive], label[other[alive]])
        np.minimum.at(new, other[alive], label[one[alive]])
        if (new == label).all():
            break
        label = new
    pieces = damage.pieces(share).ravel()
    living = share.ravel() < 1
    assert ((pieces > 0) == living).all() and pieces.max() > 1
    for number in range(1, pieces.max() + 1):
        assert np.unique(label[pieces == number]).size == 1
    assert np.unique(label[living]).size == pieces.max()
    sizes = np.bincount(pieces)[1:]
    assert (np.diff(sizes) <= 0).all()


def test_hash_is_uniform_and_symmetric():
    one, other = dense_bonds(60)
    assert one.size > 90_000
    for seed in (0, 7, 2**64 - 1):
        u = hashed_uniform(seed, one, other, 3600)
        np.testing.assert_array_equal(u, hashed_uniform(seed, other, one, 3600))
        assert u.min() >= 0 and u.max() < 1
        # Four standard deviations of mean and variance of that many numbers.
        assert u.mean() == pytest.approx(0.5, abs=4 / np.sqrt(12 * u.size))
        assert 12 * u.var() == pytest.approx(1.0, abs=4 * np.sqrt(0.8 / u.size))
        counts = np.histogram(u, 100, (0, 1))[0]
        chi2 = ((counts - u.size / 100) ** 2 / (u.size / 100)).sum() / 99
        assert 0.5 < chi2 < 1.6  # 1 with a scatter of 0.14
    # Neighbouring seeds and neighbouring bonds have nothing in common.
    a, b = (hashed_uniform(seed, one, other, 3600) for seed in (0, 1))
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)
    assert abs(np.corrcoef(a[:-1], a[1:])[0, 1]) < 4 / np.sqrt(a.size)


def test_steps_threads_and_blocks_change_no_bit():
    damage = plate(seed=5)
    share = layer(SIZE, 1.0)
    whole = damage.damage_index(share)
    stepped = None
    for time in np.linspace(0, 1, 8)[1:]:
        concentration = SOLID - layer(SIZE, time) * (SOLID - SATURATED)
        stepped = damage.corroded(concentration, stepped)
    # The share goes through a concentration and back; the same for one step and for seven.
    once = damage.corroded(SOLID - share * (SOLID - SATURATED))
    np.testing.assert_array_equal(once, stepped)
    np.testing.assert_array_equal(damage.damage_index(once), damage.damage_index(stepped))
    most = numba.get_num_threads()
    for threads in {1, most}:
        numba.set_num_threads(threads)
        np.testing.assert_array_equal(damage.damage_index(share), whole)
    numba.set_num_threads(most)
    half = SIZE // 2
    for start, end in ((0, half + RATIO), (half - RATIO, SIZE)):
        box = (slice(start, end), slice(None))
        lattice = replace(damage.lattice, shape=(end - start, SIZE))
        part = replace(
            damage, lattice=lattice, solid=damage.solid[box], corner=(start, 0), whole=(SIZE, SIZE)
        ).damage_index(share[box])
        own = slice(0, half) if start == 0 else slice(RATIO, None)
        place = slice(0, half) if start == 0 else slice(half, None)
        np.testing.assert_array_equal(part[own], whole[place])


@pytest.mark.parametrize(("lost", "least"), [(0.5, 1000), (0.01, 10)])
def test_three_dimensions_and_the_list_of_broken_bonds_agree(lost, least):
    """Losses everywhere, and in few places: rows that have none, or none but at one end."""
    lattice = Lattice((0.0,) * 3, (1e-6,) * 3, (9, 8, 12))
    rng = np.random.default_rng(3)
    solid = rng.random(lattice.shape) < 0.8
    damage = BondDamage(lattice, 2e-6, solid, SOLID, SATURATED, 11)
    share = rng.random(lattice.shape) * (rng.random(lattice.shape) < lost)
    broken = BrokenBonds(diffusion_stencil(lattice, 2e-6), lattice.shape)
    assert broken.break_where(damage.broken(share)) > least
    found = damage.damage_index(share)
    assert 0.2 * lost < found[solid].mean() < 0.8 and not found[~solid].any()
    np.testing.assert_allclose(found, broken.damage_index(solid), atol=1e-15)


def test_islands_are_kept_or_dissolve_without_a_loss():
    n = 24
    damage = plate(n, seed=4)
    share = layer(n, 1.3)
    away = damage.detached(share)
    assert away.sum() >= 1 and not away[share == 0].any()
    np.testing.assert_array_equal(damage.detached(share, held=share == 0), away)
    everything = damage.detached(share, held=np.zeros((n, n), bool))
    np.testing.assert_array_equal(everything, share < 1)
    concentration = SOLID - share * (SOLID - SATURATED)
    concentration[share == 1] = 0.0
    islands = np.where(away, damage.pieces(share), 0)
    new, left = dissolve_islands(concentration, islands, share == 1, SATURATED)
    assert new.sum() + left == pytest.approx(concentration.sum(), rel=1e-14)
    assert (new[away] == SATURATED).all()
    assert new[share == 1].max() <= SATURATED and new[share == 1].sum() > 0
    metal = (share < 1) & ~away
    np.testing.assert_array_equal(new[metal], concentration[metal])
    # Without liquid nothing finds room.
    kept, left = dissolve_islands(concentration, islands, np.zeros((n, n), bool), SATURATED)
    assert left == pytest.approx(concentration[away].sum() - away.sum() * SATURATED, rel=1e-14)
    assert kept.sum() + left == pytest.approx(concentration.sum(), rel=1e-14)


def test_nearest_liquid_is_filled_first():
    field = np.array([0.0, 0.0, 0.0, 0.0, 11.0, 99.0, 0.0])
    islands = np.array([0, 0, 0, 0, 7, 0, 0])
    liquid = np.array([True, True, True, True, False, False, True])
    new, left = dissolve_islands(field, islands, liquid, 4.0)
    np.testing.assert_allclose(new, [0.0, 0.0, 0.0 + 3.0 - 0.0, 4.0, 4.0, 99.0, 0.0])
    assert left == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed: -1; it must be from 0"),
        ({"seed": 2**64}, "it must be from 0 to 2.64 - 1"),
        ({"saturation_concentration": SOLID}, "saturation_concentration: .* below the solid"),
        ({"solid": np.ones((3, 3), bool)}, r"solid: bool of \(3, 3\)"),
        ({"solid": np.ones((SIZE, SIZE))}, "solid: float64"),
        ({"corner": (1, 0)}, r"corner: \(1, 0\); a box"),
        ({"horizon": 1e-7}, "horizon"),
    ],
)
def test_refusals(change, message):
    with pytest.raises(ValueError, match=message):
        replace(plate(), **change)


def test_the_largest_part_of_each_piece_stays():
    metal = np.zeros((9, 12), bool)
    metal[1:4, 1:11] = metal[6:8, 2:5] = True
    left = metal.copy()
    left[:, 4] = False  # cuts the first piece in 3 and 6 columns, the second in 2 and none
    pieces = cut_off(metal, left)
    assert (pieces > 0)[1:4, 1:4].all() and not pieces[1:4, 5:].any() and not pieces[6:8].any()
    assert len(np.unique(pieces)) == 2
    assert not cut_off(metal, metal).any() and not cut_off(metal, np.zeros_like(metal)).any()
    left[2, 4] = True
    assert not cut_off(metal, left).any()


@pytest.mark.parametrize("detached", ["keep", "dissolve"])
def test_what_is_cut_off_in_a_march(detached):
    """A bar with a thin neck: its short end is cut off and stays, or turns liquid and debris."""
    spacing = 1e-6
    lattice = Lattice((0.0, 0.0), (spacing,) * 2, (26, 15))
    metal = np.zeros(lattice.shape, bool)
    metal[4:8, 4:11] = metal[11:22, 4:11] = metal[8:11, 7] = True
    scene = CorrosionScene(
        lattice, 2 * spacing, metal, dissolution_flux=7e-3, dissolution="faradaic",
        solid_concentration=7e4, saturation_concentration=700.0, liquid_diffusivity=1e-9,
        detached=detached,
    )  # fmt: skip
    result = corrode(scene, [12.0], TimeStepping("backward_euler", step=0.25))
    history, left = result.history, result.metal[-1]
    assert np.abs(history["balance_error"]).max() < 1e-12
    liquid = result.concentration[-1][~left]
    assert liquid.min() >= 0 and liquid.max() <= 700.0 * (1 + 1e-9)
    assert not left[8:11].any() and left[12:21].any()
    assert left[4:8].any() == (detached == "keep")
    assert (np.diff(history["metal_amount"]) <= 0).all()
    with pytest.raises(ValueError, match="detached: 'fall'; allowed: keep, dissolve"):
        replace(scene, detached="fall")
