"""Conductances of bonds against sums over every pair, in plain Python, and what they conserve."""

import numpy as np
import pytest

from peri.engine import compiled as compilation
from peri.engine.operators import Convolution, ConvolutionSum, NonlocalSum, signed_bonds
from peri.schemes import bond_kernels
from peri.schemes.bonds import (
    Exponential,
    Harmonic,
    geometric_conductances,
    mean_conductances,
    square_root_fluxes,
)
from peri.schemes.broken import BrokenBonds, BrokenSum
from peri.schemes.stored import BondTable, StoredBonds
from tests.peri.schemes.pairs import (
    CASES,
    pair_values,
    plain,
    random_nodes,
    signed_weight,
    stencil_of,
)

COEFFICIENT = 0.7


def bernoulli(x):
    return 1.0 if x == 0 else x / np.expm1(x)


KINDS = {
    # name: (operator of sum, field, there, unknown), k_ij and k_ji of the field's values a_i, a_j
    "mean": (
        lambda s, f, there, on: mean_conductances(s, f * there, on, COEFFICIENT),
        lambda a, b: 0.5 * (a + b),
        lambda a, b: 0.5 * (a + b),
    ),
    "geometric": (
        lambda s, f, there, on: geometric_conductances(s, f * there, on, COEFFICIENT),
        lambda a, b: np.sqrt(a * b),
        lambda a, b: np.sqrt(a * b),
    ),
    "harmonic": (
        lambda s, f, there, on: Harmonic(s, f * there, on, COEFFICIENT),
        lambda a, b: 2 * a * b / (a + b),
        lambda a, b: 2 * a * b / (a + b),
    ),
    "harmonic, stored": (
        lambda s, f, there, on: Harmonic(s, f * there, on, COEFFICIENT, stored=True),
        lambda a, b: 2 * a * b / (a + b),
        lambda a, b: 2 * a * b / (a + b),
    ),
    "square root": (
        lambda s, f, there, on: square_root_fluxes(s, f, there, on, COEFFICIENT),
        lambda a, b: np.exp(0.5 * (b - a)),
        lambda a, b: np.exp(0.5 * (a - b)),
    ),
    "exponential": (
        lambda s, f, there, on: Exponential(s, f, there, on, COEFFICIENT, stored=False),
        lambda a, b: bernoulli(a - b),
        lambda a, b: bernoulli(b - a),
    ),
    "exponential, stored": (
        lambda s, f, there, on: Exponential(s, f, there, on, COEFFICIENT),
        lambda a, b: bernoulli(a - b),
        lambda a, b: bernoulli(b - a),
    ),
}


def example(case, kind, rng, bond_sum=None, broken_pairs=None):
    """An operator, its pairs' values k_ij and d_i (zero off existing nodes), there, unknown."""
    shape = CASES[case][0]
    stencil = stencil_of(case)
    there, unknown = random_nodes(shape, rng)
    field = rng.uniform(0.2, 3.0, shape)
    bond_sum = bond_sum or NonlocalSum(stencil, shape)
    make, inward, outward = KINDS[kind]
    operator = make(*(bond_sum, bond_sum.pad(field), bond_sum.pad(there), bond_sum.pad(unknown)))

    def pairs(rule):
        def value(i, j, offset):
            on = there[i] and there[j] and not (broken_pairs and frozenset((i, j)) in broken_pairs)
            weight = signed_weight(stencil, offset) if on else 0.0
            return COEFFICIENT * weight * rule(field[i], field[j]) if weight else 0.0

        return pair_values(shape, value, stencil.reach)

    return operator, pairs(inward), pairs(outward).sum(axis=1), there, unknown


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("kind", KINDS)
def test_against_every_pair(case, kind):
    rng = np.random.default_rng(1)
    operator, inward, outflow, there, unknown = example(case, kind, rng)
    shape, s = there.shape, operator.sum
    values = rng.normal(size=shape) * there
    free = values * unknown
    scale = np.abs(inward).sum(axis=1).max() or 1.0
    assert scale > 0.1 or np.prod(shape) == 1
    expected = np.where(unknown.ravel(), inward @ values.ravel(), 0.0).reshape(shape)
    gained = s.crop(operator.gain(s.pad(values), np.full(s.padded_shape, 7.0)))
    # round-off: measured 5e-16 of the sum of the absolute values
    np.testing.assert_allclose(gained * unknown, expected, rtol=0, atol=1e-14 * scale)
    expected = np.where(unknown.ravel(), outflow * free.ravel() - inward @ free.ravel(), 0.0)
    out = np.zeros(s.padded_shape)
    product = operator.apply(s.pad(free), out)
    np.testing.assert_allclose(s.crop(out).ravel(), expected, rtol=0, atol=2e-14 * scale)
    assert product == pytest.approx(free.ravel() @ expected, abs=1e-12 * scale)
    diagonal = np.where(unknown.ravel(), outflow, 0.0)
    np.testing.assert_allclose(s.crop(operator.diagonal()).ravel(), diagonal, rtol=1e-12)
    on = unknown.ravel()
    sums = np.where(on, outflow - inward @ on, 0.0)
    np.testing.assert_allclose(
        s.crop(operator.row_sums()).ravel(), sums, rtol=0, atol=2e-14 * scale
    )
    block = inward[np.ix_(on, on)]
    assert operator.symmetric == (kind not in ("square root",) and "exponential" not in kind)
    if operator.symmetric:
        np.testing.assert_allclose(block, block.T, rtol=1e-14)


@pytest.mark.parametrize("kind", ["square root", "exponential", "exponential, stored"])
@pytest.mark.parametrize("step", [0.1, 1.0, 10.0, 100.0])
def test_nothing_moves_in_equilibrium(kind, step):
    """C = exp(-s) for steps of s from 0.1 to 100 over a spacing, uniform field."""
    shape = (6,)
    bond_sum = NonlocalSum(stencil_of("1D"), shape)
    drift = bond_sum.pad(step * np.arange(6.0))
    there = bond_sum.pad(np.ones(shape))
    operator = KINDS[kind][0](bond_sum, drift, there, there)
    concentration = np.exp(-drift) * there
    out = np.zeros(bond_sum.padded_shape)
    operator.apply(concentration, out)
    terms = operator.diagonal() * concentration
    # of what leaves a node: measured 4e-16
    assert np.abs(out).max() <= 1e-14 * terms.max()
    assert terms.max() > 0


def test_the_square_root_flux_is_symmetric_in_another_unknown():
    """exp(s_i/2) A exp(-s_j/2) is the convolution that the docstring names."""
    rng = np.random.default_rng(2)
    shape = (9, 8)
    bond_sum = NonlocalSum(stencil_of("2D"), shape)
    there, unknown = (bond_sum.pad(m) for m in random_nodes(shape, rng))
    drift = bond_sum.pad(rng.normal(size=shape))
    operator = square_root_fluxes(bond_sum, drift, there, unknown, COEFFICIENT)
    up, down = np.exp(0.5 * drift), np.exp(-0.5 * drift) * there
    diagonal = COEFFICIENT * up * bond_sum(down)
    other = Convolution(bond_sum, unknown, there, diagonal, COEFFICIENT, symmetric=True)
    y = bond_sum.pad(rng.normal(size=shape)) * unknown
    one, two = (np.zeros(bond_sum.padded_shape) for _ in range(2))
    operator.apply(np.exp(-0.5 * drift) * y, one)
    other.apply(y, two)
    assert np.abs(two).max() > 1
    # round-off: measured 1e-15
    np.testing.assert_allclose(up * one * unknown, two * unknown, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", ["mean", "geometric", "harmonic", "square root", "exponential"])
def test_closed_boxes_conserve(kind):
    """Columns sum to zero over all nodes: what leaves one arrives at another."""
    rng = np.random.default_rng(3)
    shape = (7, 9)
    bond_sum = NonlocalSum(stencil_of("2D"), shape)
    there = bond_sum.pad(rng.random(shape) < 0.8)
    field = bond_sum.pad(rng.uniform(0.2, 3.0, shape))
    operator = KINDS[kind][0](bond_sum, field, there, there)
    u = bond_sum.pad(rng.normal(size=shape)) * there
    out = np.zeros(bond_sum.padded_shape)
    operator.apply(u, out)
    assert np.abs(out).max() > 0.1
    assert abs(out.sum()) <= 1e-13 * np.abs(out).sum()  # round-off: measured 4e-17


def test_the_drift_s_range_is_bounded():
    bond_sum = NonlocalSum(stencil_of("1D"), (5,))
    ones = bond_sum.pad(np.ones(5))
    with pytest.raises(ValueError, match="drift: spans 800 over the nodes; at most 600"):
        square_root_fluxes(bond_sum, bond_sum.pad(200.0 * np.arange(5)), ones, ones)


def test_sums_of_convolutions_refuse_other_nodes():
    bond_sum = NonlocalSum(stencil_of("1D"), (5,))
    one, other = bond_sum.pad(np.ones(5)), bond_sum.pad([1, 1, 1, 1, 0])
    with pytest.raises(ValueError, match="they differ"):
        ConvolutionSum([Convolution(bond_sum, one), Convolution(bond_sum, other)], True)
    with pytest.raises(ValueError, match="none"):
        ConvolutionSum([], True)


@pytest.mark.parametrize("case", ["1D", "2D, stretched", "3D, thin"])
def test_stored_bonds_take_any_values(case):
    rng = np.random.default_rng(4)
    shape = CASES[case][0]
    bond_sum = NonlocalSum(stencil_of(case), shape)
    unknown = bond_sum.pad(rng.random(shape) < 0.6)
    listed = BondTable(
        bond_sum, unknown, np.zeros((int(unknown.sum()), len(signed_bonds(bond_sum)[0])))
    )
    table = rng.normal(size=listed.table.shape)
    operator = StoredBonds(bond_sum, unknown, table, bond_sum.pad(np.full(shape, 2.0)))
    number = {tuple(o): c for c, o in enumerate(listed.offsets[:, 3 - len(shape) :].tolist())}
    row = np.cumsum(bond_sum.crop(unknown).ravel()).reshape(shape).astype(int) - 1
    on = bond_sum.crop(unknown) > 0

    def value(i, j, offset):
        return table[row[i], number[offset]] if on[i] and offset in number else 0.0

    u = rng.normal(size=shape) * on
    expected = np.where(on.ravel(), 2.0 * u.ravel() - pair_values(shape, value) @ u.ravel(), 0.0)
    out = np.zeros(bond_sum.padded_shape)
    operator.apply(bond_sum.pad(u), out)
    # round-off: measured 4e-15
    np.testing.assert_allclose(bond_sum.crop(out).ravel(), expected, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="table: shape"):
        StoredBonds(bond_sum, unknown, table[:, 1:])


@pytest.mark.parametrize("case", ["1D", "2D", "3D", "3D, thin"])
@pytest.mark.parametrize("kind", ["mean", "square root", "harmonic, stored", "exponential, stored"])
def test_with_broken_bonds(case, kind):
    """A third of all bonds broken, all of one node's and most of another's."""
    rng = np.random.default_rng(5)
    shape = CASES[case][0]
    broken = BrokenBonds(stencil_of(case), shape)
    pairs = set()
    nodes = [tuple(n) for n in np.ndindex(*shape)]
    for i in nodes:
        for offset in broken.offsets[:, 3 - len(shape) :].tolist():
            j = tuple(a + o for a, o in zip(i, offset, strict=True))
            if j in nodes and (rng.random() < 0.15 or i == nodes[3]):
                pairs.add(frozenset((i, j)))
    ends = [sorted(p) for p in pairs]
    assert broken.break_pairs([e[0] for e in ends], [e[1] for e in ends]) == len(pairs)
    assert broken.count == len(pairs) > 10
    bond_sum = BrokenSum(stencil_of(case), shape, broken)
    operator, inward, outflow, there, unknown = example(case, kind, rng, bond_sum, pairs)
    u = rng.normal(size=shape) * unknown
    expected = np.where(unknown.ravel(), outflow * u.ravel() - inward @ u.ravel(), 0.0)
    out = np.zeros(bond_sum.padded_shape)
    operator.apply(bond_sum.pad(u), out)
    scale = np.abs(inward).sum(axis=1).max()
    # round-off of the whole sum: measured 5e-16 of it
    np.testing.assert_allclose(
        bond_sum.crop(out).ravel(), expected, rtol=0, atol=1e-13 * max(1.0, scale)
    )
    isolated = np.ravel_multi_index(nodes[3], shape)
    assert bond_sum.crop(out).ravel()[isolated] == 0.0  # exactly
    for faces in operator.faces():
        assert faces.min() >= 0


def test_rules_of_bonds_do_not_forget_broken_ones():
    broken = BrokenBonds(stencil_of("1D"), (9,))
    bond_sum = BrokenSum(stencil_of("1D"), (9,), broken)
    ones = bond_sum.pad(np.ones(9))
    with pytest.raises(ValueError, match="stored: False"):
        Harmonic(bond_sum, ones, ones)


@pytest.mark.parametrize("threaded", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_compiled_sums_are_the_plain_python_sums(monkeypatch, threaded):
    monkeypatch.setattr(compilation, "_THREADED_FROM", 0 if threaded else 10**9)
    rng = np.random.default_rng(6)
    shape = (3, 5, 6)
    bond_sum = NonlocalSum(stencil_of("3D"), shape)
    offsets = signed_bonds(bond_sum)[0]
    weights = rng.uniform(0.5, 1.0, len(offsets))
    u = bond_sum.pad(rng.normal(size=shape))
    field = bond_sum.pad(rng.uniform(0.5, 2.0, shape))
    field[field == 0] = np.inf
    drift = bond_sum.pad(rng.normal(size=shape))
    table = BondTable(bond_sum, u, rng.normal(size=(90, len(offsets))))
    broken = BrokenBonds(bond_sum.stencil, shape)
    broken.break_where(lambda offset: rng.random(shape) < 0.3)
    assert broken.count > 50
    place = (bond_sum.tiles, *bond_sum.rows, offsets, weights)
    calls = {
        "harmonic_gain": (field, *place),
        "exponential_gain": (drift, 1.0, *place),
        "stored_gain": (table.nodes, table.shifts, table.table),
        "take_out_broken": (
            broken.bits, broken.corners, broken.edges, broken.shape, broken.reach, offsets,
            broken.shifts, weights,
        ),
    }  # fmt: skip
    compiled = {}
    for name, arguments in calls.items():
        compiled[name] = np.ones(bond_sum.padded_shape)
        getattr(bond_kernels, name)(u, compiled[name], *arguments)
    for helper in ("fitted_share", "count_bits", "lowest_bit", "partners"):
        monkeypatch.setattr(bond_kernels, helper, getattr(bond_kernels, helper).py_func)
    for name, arguments in calls.items():
        interpreted = np.ones(bond_sum.padded_shape)
        with np.errstate(over="ignore"):  # 64-bit words wrap around
            plain(getattr(bond_kernels, name))(u, interpreted, *arguments)
        assert np.abs(interpreted - 1).max() > 1
        # fused multiply-add: measured 1e-15
        np.testing.assert_allclose(compiled[name], interpreted, rtol=1e-13, atol=1e-13)
