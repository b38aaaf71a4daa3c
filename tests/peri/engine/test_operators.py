"""The fast nonlocal sums against a sum over every pair of nodes."""

import numpy as np
import pytest

from peri.engine import compiled as compilation
from peri.engine import kernels
from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import NonlocalSum
from tests.peri.dense import pair_matrix

RNG = np.random.default_rng(3)

CASES = {
    # shape, horizon over the smallest spacing, spacing: even and odd sizes, reach 1 to 8, boxes
    # thinner than the horizon, more rows than one tile of the kernel (16)
    "1D, reach 1": ((31,), 1.0, (1.0,)),
    "1D, reach 8": ((40,), 8.0, (1.0,)),
    "1D, single node": ((1,), 3.0, (1.0,)),
    "2D, reach 1": ((9, 14), 1.0, (1.0, 1.0)),
    "2D, reach 3, broken ratio": ((17, 12), 3.3, (1.0, 1.0)),
    "2D, reach 5": ((35, 20), 5.0, (1.0, 1.0)),
    "2D, 25:1": ((40, 5), 50.0, (1.0, 25.0)),
    "3D, reach 1": ((7, 8, 9), 1.0, (1.0, 1.0, 1.0)),
    "3D, reach 2": ((8, 19, 11), 2.0, (1.0, 1.0, 1.0)),
    "3D, reach 3": ((9, 10, 13), 3.0, (1.0, 1.0, 1.0)),
    "3D, reach 4, thin": ((3, 20, 17), 4.0, (1.0, 1.0, 1.0)),
    "3D, reach 6": ((9, 11, 12), 6.0, (1.0, 1.0, 1.0)),
    "3D, reach 8": ((9, 12, 17), 8.0, (1.0, 1.0, 1.0)),
    "3D, stretched": ((12, 8, 13), 4.0, (1.0, 2.0, 1.3)),
}


def stencil_of(name):
    shape, horizon, spacing = CASES[name]
    return diffusion_stencil(Lattice((0.0,) * len(shape), spacing, shape), horizon)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("method", ["direct", "fft"])
def test_sum_against_every_pair(name, method):
    shape = CASES[name][0]
    stencil = stencil_of(name)
    bond_sum = NonlocalSum(stencil, shape, method=method)
    field = RNG.normal(size=shape)
    expected = (pair_matrix(stencil, shape) @ field.ravel()).reshape(shape)
    assert np.abs(expected).max() > 0 or np.prod(shape) == 1
    result = bond_sum.crop(bond_sum(bond_sum.pad(field)))
    # round-off of at most 2552 terms of size total/2552: measured 5e-16 both ways
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-14 * stencil.total)


def test_reach_ends_with_the_lattice():
    """A horizon of 50 cells on 3 x 20 x 5 nodes: bonds that find no partner cost nothing."""
    shape, spacing = (3, 20, 5), (1.0, 1.0, 25.0)
    stencil = diffusion_stencil(Lattice((0.0,) * 3, spacing, shape), 50.0)
    assert stencil.bonds > 2e4
    for method in ("direct", "fft"):
        bond_sum = NonlocalSum(stencil, shape, method=method)
        assert bond_sum.reach == (2, 19, 2)
        field = RNG.normal(size=shape)
        expected = (pair_matrix(stencil, shape) @ field.ravel()).reshape(shape)
        result = bond_sum.crop(bond_sum(bond_sum.pad(field)))
        # the constants are those of the whole stencil; round-off: measured 1e-17 and 6e-17
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["1D, reach 8", "2D, reach 5", "3D, reach 3"])
def test_only_wanted_rows_are_computed_and_the_rest_is_left_alone(name):
    shape = CASES[name][0]
    stencil = stencil_of(name)
    wanted = RNG.random(shape) < 0.05
    wanted[..., :4] = False
    assert wanted.any()
    bond_sum = NonlocalSum(stencil, shape, wanted=wanted)
    field = RNG.normal(size=shape)
    out = np.full(bond_sum.padded_shape, 7.0)
    bond_sum(bond_sum.pad(field), out)
    expected = (pair_matrix(stencil, shape) @ field.ravel()).reshape(shape)
    result = bond_sum.crop(out)
    np.testing.assert_allclose(
        result[wanted], expected[wanted], rtol=0, atol=1e-14 * stencil.total
    )  # round-off as above
    np.testing.assert_array_equal(result[..., :4], 7.0)
    rows_without = ~wanted.any(axis=-1)
    np.testing.assert_array_equal(result[rows_without], 7.0)


@pytest.mark.parametrize("name", CASES)
def test_rows_and_nodes_of_a_sum_are_those_of_the_whole(name):
    shape = CASES[name][0]
    bond_sum = NonlocalSum(stencil_of(name), shape)
    nodes = bond_sum.pad(RNG.uniform(size=shape) < 0.05) > 0
    nodes.ravel()[np.flatnonzero(bond_sum.pad(np.ones(shape)))[-1]] = True
    field = bond_sum.pad(RNG.normal(size=shape))
    whole = bond_sum(field)
    tolerance = {"rtol": 0, "atol": 1e-14 * bond_sum.stencil.total}
    there = np.flatnonzero(nodes)
    near = bond_sum.around(there)
    reached = bond_sum(nodes.astype(float)) > 0
    inside = np.zeros(nodes.shape, bool)
    inside[bond_sum.interior] = True
    assert set(near) >= set(there)
    np.testing.assert_array_equal(np.flatnonzero(nodes | reached), near[inside.ravel()[near]])
    np.testing.assert_allclose(bond_sum.at(field, there), whole.ravel()[there], **tolerance)
    for around, wanted in ((False, nodes), (True, nodes | reached)):
        part = bond_sum.on_rows_of(nodes, around)
        found = part(field)
        np.testing.assert_allclose(found[wanted], whole[wanted], **tolerance)
        planes, rows, columns = part.reach
        for a, b in np.ndindex(part.low.shape):
            row = found[a + planes, b + rows, columns : columns + bond_sum.shape[2]]
            assert not row[: part.low[a, b]].any() and not row[part.high[a, b] :].any()
            if not around:
                held = np.flatnonzero(nodes[a + planes, b + rows, columns:])
                ends = (held[0], held[-1] + 1) if held.size else (0, 0)
                assert (part.low[a, b], part.high[a, b]) == ends


def test_nothing_wanted_computes_nothing():
    name = "3D, reach 2"
    shape = CASES[name][0]
    bond_sum = NonlocalSum(stencil_of(name), shape, wanted=np.zeros(shape, bool))
    out = np.full(bond_sum.padded_shape, 7.0)
    bond_sum(bond_sum.pad(np.ones(shape)), out)
    np.testing.assert_array_equal(out, 7.0)


@pytest.mark.parametrize("method", ["direct", "fft"])
def test_a_constant_field_gives_the_total_inside(method):
    name = "3D, reach 2"
    shape = (9, 10, 11)
    stencil = stencil_of(name)
    bond_sum = NonlocalSum(stencil, shape, method=method)
    result = bond_sum.crop(bond_sum(bond_sum.pad(np.ones(shape))))
    inside = result[2:-2, 2:-2, 2:-2]
    np.testing.assert_allclose(inside, stencil.total, rtol=1e-13)  # round-off of 80 terms
    assert result[0, 0, 0] < 0.5 * stencil.total


def test_the_operator_is_exact_for_quadratics():
    """Laplacian of x^2 + 3 y^2 - 2 z^2 + x y is 4, away from the edge, by the second moment."""
    lattice = Lattice((0.0,) * 3, (0.1, 0.2, 0.1), (19, 13, 19))
    stencil = diffusion_stencil(lattice, 0.4)
    x, y, z = lattice.coordinates()
    field = x**2 + 3 * y**2 - 2 * z**2 + x * y + 0 * z
    bond_sum = NonlocalSum(stencil, lattice.shape)
    result = bond_sum.crop(bond_sum(bond_sum.pad(field))) - stencil.total * field
    a, b, c = stencil.reach
    inside = result[a:-a, b:-b, c:-c]
    assert inside.size > 100
    # cancellation: total 127, field up to 25: measured 7e-13
    np.testing.assert_allclose(inside, 4.0, atol=1e-11)


def test_direct_and_fft_agree_on_a_larger_lattice():
    shape = (40, 41, 42)
    stencil = stencil_of("3D, reach 3")
    field = RNG.normal(size=shape)
    results = []
    for method in ("direct", "fft"):
        bond_sum = NonlocalSum(stencil, shape, method=method)
        results.append(bond_sum.crop(bond_sum(bond_sum.pad(field))))
    assert np.abs(results[0]).max() > 0.1 * stencil.total
    # round-off: measured 4e-16
    np.testing.assert_allclose(results[1], results[0], rtol=0, atol=1e-14 * stencil.total)


def test_pad_and_crop_are_inverse():
    bond_sum = NonlocalSum(stencil_of("2D, 25:1"), (40, 5))
    field = RNG.normal(size=(40, 5))
    padded = bond_sum.pad(field)
    assert padded.shape == (1, 40 + 2 * 39, 5 + 2 * 2)
    assert padded.sum() == pytest.approx(field.sum(), abs=1e-12)  # round-off; ghosts are zero
    np.testing.assert_array_equal(bond_sum.crop(padded), field)


@pytest.mark.parametrize("name", ["1D, reach 1", "2D, reach 1", "3D, reach 1"])
def test_crop_is_a_copy(name):
    """In 1D the interior is contiguous, and a view of it would follow the march."""
    shape = CASES[name][0]
    bond_sum = NonlocalSum(stencil_of(name), shape)
    padded = bond_sum.pad(np.ones(shape))
    cropped = bond_sum.crop(padded)
    padded[:] = 2.0
    np.testing.assert_array_equal(cropped, 1.0)


def plain(function):
    """The Python function behind a compiled kernel."""
    return getattr(function, "__wrapped__", None) or function.py_func


def test_compiled_sum_is_the_plain_python_sum(monkeypatch):
    """kernels.convolve and what it calls, run by the interpreter."""
    name = "3D, reach 2"
    shape = (4, 6, 7)
    bond_sum = NonlocalSum(stencil_of(name), shape)
    field = bond_sum.pad(RNG.normal(size=shape))
    compiled = bond_sum(field)
    for helper in ("_convolve_tile", "_sum_rows", "_combine_shells"):
        monkeypatch.setattr(kernels, helper, getattr(kernels, helper).py_func)
    interpreted = np.zeros(bond_sum.padded_shape)
    plain(kernels.convolve)(
        field,
        interpreted,
        bond_sum._tiles,
        bond_sum.low,
        bond_sum.high,
        bond_sum.reach,
        *bond_sum._shells,
    )
    assert np.abs(compiled).max() > 1
    # the compiler may fuse a*b+c: measured 1.4e-16 of the largest
    np.testing.assert_allclose(interpreted, compiled, rtol=0, atol=1e-14 * np.abs(compiled).max())


def test_threaded_sum_is_the_serial_sum(monkeypatch):
    shape = (20, 21, 22)
    bond_sum = NonlocalSum(stencil_of("3D, reach 2"), shape)
    field = bond_sum.pad(RNG.normal(size=shape))
    monkeypatch.setattr(compilation, "_THREADED_FROM", 10**9)
    serial = bond_sum(field)
    monkeypatch.setattr(compilation, "_THREADED_FROM", 0)
    threaded = bond_sum(field)
    assert np.abs(serial).max() > 1
    # every node is computed by one thread in one order
    np.testing.assert_array_equal(threaded, serial)


def test_refusals():
    stencil = stencil_of("2D, reach 1")
    with pytest.raises(ValueError, match="method: 'sparse'; allowed: direct, fft"):
        NonlocalSum(stencil, (5, 5), method="sparse")
    with pytest.raises(ValueError, match="shape"):
        NonlocalSum(stencil, (5, 5, 5))
