"""Broken bonds: cracks by rule, the index of damage, where bits are kept, refusals."""

import numpy as np
import pytest

from peri.engine.operators import NonlocalSum
from peri.engine.solvers import DiffusionSystem
from peri.schemes.broken import BrokenBonds, BrokenSum
from tests.peri.schemes.pairs import CASES, pair_values, signed_weight, stencil_of


def cut_at(first_behind, axis, shape):
    """Rule that breaks all bonds across a plane normal to an axis."""
    place = np.arange(shape[axis]).reshape([-1 if a == axis else 1 for a in range(len(shape))])

    def rule(offset):
        there = place + offset[axis]
        return np.broadcast_to((place < first_behind) != (there < first_behind), shape)

    return rule


@pytest.mark.parametrize(("case", "axis"), [("1D", 0), ("2D", 1), ("2D, stretched", 0), ("3D", 1)])
def test_a_plane_cuts_a_body_in_two(case, axis):
    """Nothing crosses a cut; the bonds are counted once; a second cut there breaks nothing."""
    shape, stencil = CASES[case][0], stencil_of(case)
    broken = BrokenBonds(stencil, shape)
    half = shape[axis] // 2
    rule = cut_at(half, axis, shape)
    across = pair_values(
        shape,
        lambda i, j, o: (i[axis] < half) != (j[axis] < half) and signed_weight(stencil, o) != 0,
    )
    assert broken.break_where(rule) == across.sum() / 2 == broken.count > 3
    assert broken.break_where(rule) == 0
    bond_sum = BrokenSum(stencil, shape, broken)
    side = np.zeros(shape)
    side[(slice(None),) * axis + (slice(0, half),)] = 1.0
    seen = bond_sum.crop(bond_sum(bond_sum.pad(side)))
    # a node that has lost less than half of its bonds subtracts: measured 1e-16 of the whole sum
    np.testing.assert_allclose(seen[side == 0], 0.0, rtol=0, atol=1e-15 * stencil.total)
    bonds = pair_values(shape, lambda i, j, o: float(signed_weight(stencil, o) != 0))
    index = across.sum(axis=1) / bonds.sum(axis=1)
    np.testing.assert_allclose(broken.damage_index().ravel(), index, rtol=0, atol=1e-15)


def test_bits_are_kept_where_bonds_are_broken():
    shape = (64, 64)
    broken = BrokenBonds(stencil_of("2D"), shape)
    assert broken.bits.nbytes == 0
    rule = cut_at(32, 0, shape)
    column = np.arange(64) < 20
    broken.break_where(lambda offset: rule(offset) & column & (offset[1] == 0))
    # tiles of 8 x 16 nodes: rows 24 to 40, columns 0 to 32
    assert len(broken.corners) == 4
    assert broken.bits.shape == (4, 128, 1)
    assert broken.count == 3 * 20  # bonds of one and two spacings across the cut
    index = broken.damage_index()
    assert (index[30:34, :20] > 0).all() and index[:30].max() == index[:, 20:].max() == 0


def test_the_solver_does_not_see_through_a_crack():
    """Steady diffusion with a source on either side of a full cut: dense, pair by pair."""
    shape, stencil = (14, 13), stencil_of("2D")
    broken = BrokenBonds(stencil, shape)
    broken.break_where(cut_at(6, 0, shape))
    bond_sum = BrokenSum(stencil, shape, broken)
    ones = bond_sum.pad(np.ones(shape))
    diagonal = 0.01 + bond_sum(ones)
    system = DiffusionSystem(bond_sum, ones, diagonal, 1.0, 0.01 * ones)
    source = np.zeros(shape)
    source[2, 3] = 1.0
    x = np.zeros(bond_sum.padded_shape)
    iterations = system.solve(x, bond_sum.pad(source), 1e-11)
    whole = pair_values(shape, lambda i, j, o: signed_weight(stencil, o))
    crossing = pair_values(shape, lambda i, j, o: float((i[0] < 6) != (j[0] < 6)))
    matrix = -whole * (1 - crossing)
    matrix += np.diag(0.01 - matrix.sum(axis=1))
    expected = np.linalg.solve(matrix, source.ravel()).reshape(shape)
    assert expected[2, 3] > 0.5 and np.abs(expected[6:]).max() < 1e-12
    # the tolerance over the smallest eigenvalue 0.01: measured 4e-12
    np.testing.assert_allclose(bond_sum.crop(x), expected, rtol=0, atol=1e-8)
    assert 5 <= iterations <= 20  # measured 17


def test_the_fft_takes_broken_bonds_too():
    shape, stencil = CASES["3D"][0], stencil_of("3D")
    broken = BrokenBonds(stencil, shape)
    broken.break_where(cut_at(3, 2, shape))
    field = np.random.default_rng(1).normal(size=shape)
    results = []
    for method in ("direct", "fft"):
        bond_sum = BrokenSum(stencil, shape, broken, method=method)
        results.append(bond_sum.crop(bond_sum(bond_sum.pad(field))))
    # round-off: measured 2e-16 of the whole sum
    np.testing.assert_allclose(results[0], results[1], rtol=0, atol=1e-14 * stencil.total)


def test_refusals():
    broken = BrokenBonds(stencil_of("2D"), (9, 21))
    with pytest.raises(ValueError, match=r"no bond from node \[0, 0\] to \[5, 0\]"):
        broken.break_pairs([[0, 0]], [[5, 0]])
    with pytest.raises(ValueError, match=r"no bond from node \[0, 0\] to \[-1, 0\]"):
        broken.break_pairs([[0, 0]], [[-1, 0]])
    with pytest.raises(ValueError, match="broken: bonds of"):
        BrokenSum(stencil_of("2D"), (9, 20), broken)


def test_whole_bonds_cost_nothing():
    """Without broken bonds the sum is the plain one, bit by bit."""
    shape, stencil = CASES["3D"][0], stencil_of("3D")
    broken = BrokenBonds(stencil, shape)
    field = np.random.default_rng(2).normal(size=shape)
    one, other = NonlocalSum(stencil, shape), BrokenSum(stencil, shape, broken)
    np.testing.assert_array_equal(one(one.pad(field)), other(other.pad(field)))
    assert all(other.intact(a) is None for a in range(3))
