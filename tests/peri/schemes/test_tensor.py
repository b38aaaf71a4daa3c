"""Odd weights and the tensor of bond directions against every pair, and rigid motions."""

import numpy as np
import pytest

from peri.engine import kernels
from peri.engine.influence import Stencil
from peri.engine.operators import NonlocalSum
from peri.schemes.broken import BrokenBonds
from peri.schemes.tensor import TensorConvolution, tensor_stencils
from tests.peri.schemes.pairs import CASES, pair_values, plain, signed_weight, stencil_of


@pytest.mark.parametrize("method", ["direct", "fft"])
@pytest.mark.parametrize("case", CASES)
def test_odd_weights_against_every_pair(case, method):
    """All parities of random octants, a sum over pairs as reference."""
    rng = np.random.default_rng(1)
    shape = CASES[case][0]
    reach = np.array(stencil_of(case).reach)
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, len(shape))
    offsets = index[None, :, :] - index[:, None, :]
    for parity in np.ndindex(*(2,) * len(shape)):
        signs = tuple(1 - 2 * p for p in parity)
        octant = rng.normal(size=[r + 1 for r in reach])
        octant.flat[0] = 0.0
        for a, sign in enumerate(signs):
            if sign < 0:
                octant[(slice(None),) * a + (0,)] = 0.0
        stencil = Stencil(octant, (1.0,) * len(shape), signs)
        bond_sum = NonlocalSum(stencil, shape, method=method)
        field = rng.normal(size=shape)
        inside = np.all(np.abs(offsets) <= reach, axis=2)
        place = np.where(inside[..., None], offsets, 0) + reach
        weights = stencil.dense()[tuple(np.moveaxis(place, 2, 0))] * inside
        expected = weights @ field.ravel()
        result = bond_sum.crop(bond_sum(bond_sum.pad(field)))
        # round-off of at most 342 terms of size one: measured 1e-14
        np.testing.assert_allclose(result.ravel(), expected, rtol=0, atol=1e-12)
        # the full stencil, read above, holds each weight with its sign
        assert stencil.dense()[tuple(reach + 1)] == pytest.approx(
            signed_weight(stencil, (1,) * len(shape))
        )
        assert stencil.dense()[tuple(reach - 1)] == pytest.approx(
            signed_weight(stencil, (-1,) * len(shape))
        )


def test_odd_weights_by_the_interpreter(monkeypatch):
    stencil = tensor_stencils(stencil_of("3D"))[0, 2]
    assert stencil.parity == (-1, 1, -1)
    shape = (4, 6, 7)
    bond_sum = NonlocalSum(stencil, shape)
    field = bond_sum.pad(np.random.default_rng(2).normal(size=shape))
    compiled = bond_sum(field)
    for helper in ("_convolve_tile", "_sum_rows", "_combine_shells"):
        monkeypatch.setattr(kernels, helper, getattr(kernels, helper).py_func)
    interpreted = np.zeros(bond_sum.padded_shape)
    plain(kernels.convolve)(field, interpreted, bond_sum.tiles, *bond_sum.rows, *bond_sum._shells)
    assert np.abs(compiled).max() > 0.1
    # fused multiply-add: measured 3e-17
    np.testing.assert_allclose(interpreted, compiled, rtol=0, atol=1e-14)


def test_odd_weights_must_vanish_on_their_plane():
    with pytest.raises(ValueError, match="odd along axis 1 must vanish"):
        Stencil(np.ones((2, 2)), (1.0, 1.0), (1, -1))


def tensor_matrix(stencil, shape, capacity, broken=frozenset()):
    """A of TensorConvolution, (d N, d N), component by component, from every pair."""
    d = len(shape)
    h = np.array(stencil.spacing)
    blocks = []
    for a in range(d):
        row = []
        for b in range(d):

            def value(i, j, o, a=a, b=b):
                if frozenset((i, j)) in broken:
                    return 0.0
                xi = h * o
                w = signed_weight(stencil, o) * capacity[i] * capacity[j]
                return w * xi[a] * xi[b] / (xi @ xi)

            k = pair_values(shape, value, stencil.reach)
            row.append(np.diag(k.sum(axis=1)) - k)
        blocks.append(row)
    return np.block(blocks)


@pytest.mark.parametrize("case", ["1D", "2D", "2D, stretched", "3D", "3D, thin"])
@pytest.mark.parametrize("cracked", [False, True])
def test_tensor_against_every_pair(case, cracked):
    rng = np.random.default_rng(3)
    shape, stencil = CASES[case][0], stencil_of(case)
    d = len(shape)
    capacity = np.where(rng.random(shape) < 0.85, rng.uniform(0.5, 1.0, shape), 0.0)
    broken, pairs = None, set()
    if cracked:
        broken = BrokenBonds(stencil, shape)
        nodes = set(np.ndindex(*shape))
        for i in nodes:
            for o in broken.offsets[:, 3 - d :].tolist():
                j = tuple(np.add(i, o).tolist())
                if j in nodes and rng.random() < 0.1:
                    pairs.add(frozenset((i, j)))
        ends = [sorted(p) for p in pairs]
        broken.break_pairs([e[0] for e in ends], [e[1] for e in ends])
    operator = TensorConvolution(stencil, shape, capacity, broken)
    pad, crop = operator.sum.pad, operator.sum.crop
    u = rng.normal(size=(d, *shape))
    out = np.zeros((d, *operator.sum.padded_shape))
    operator.apply(np.array([pad(part) for part in u]), out)
    matrix = tensor_matrix(stencil, shape, capacity, pairs)
    expected = (matrix @ u.ravel()).reshape(u.shape)
    assert np.abs(expected).max() > 0.1
    found = np.array([crop(part) for part in out])
    # round-off: measured 9e-16
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    diagonal = operator.diagonal_blocks()
    n = int(np.prod(shape))
    for a in range(d):
        for b in range(d):
            expected = np.diag(matrix[a * n : (a + 1) * n, b * n : (b + 1) * n])
            np.testing.assert_allclose(crop(diagonal[a, b]).ravel(), expected, rtol=0, atol=1e-13)


def test_rigid_motions_cost_nothing():
    """Translations and small rotations of a free body with a hole: no force anywhere."""
    shape, stencil = CASES["3D"][0], stencil_of("3D")
    capacity = np.ones(shape)
    capacity[2:4, 3:6, 2:4] = 0.0
    operator = TensorConvolution(stencil, shape, capacity)
    x = np.stack(np.meshgrid(*[np.arange(float(n)) for n in shape], indexing="ij"))
    motions = [
        np.ones((3, *shape)),
        np.stack([-x[1], x[0], 0 * x[0]]),
        np.stack([x[2], 0 * x[0], -x[0]]),
    ]
    for motion in motions:
        out = np.zeros((3, *operator.sum.padded_shape))
        operator.apply(np.array([operator.sum.pad(part) for part in motion]), out)
        # cancellation of forces up to 9 x 3: measured 2e-14
        assert np.abs(out).max() < 1e-12
    stretch = np.stack([x[0], 0 * x[1], 0 * x[2]])
    operator.apply(np.array([operator.sum.pad(part) for part in stretch]), out)
    assert np.abs(out).max() > 0.1
