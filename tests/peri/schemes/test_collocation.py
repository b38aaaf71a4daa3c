"""Collocation rows: exact for quadratics beside any boundary, against a plain fit, orders."""

import itertools

import numpy as np
import pytest

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.engine.operators import NonlocalSum
from peri.engine.solvers import LinearSystem
from peri.schemes.collocation import Collocation, laplacian_row
from tests.peri.schemes.pairs import pair_values, random_nodes

BOXES = {
    "1D": ((23,), 3.0, (0.1,)),
    "2D": ((12, 15), 2.0, (0.1, 0.1)),
    "2D, stretched": ((9, 12), (2.0, 6.0), (1.0, 3.0)),
    "3D": ((7, 8, 9), 2.0, (0.1, 0.1, 0.1)),
    "3D, thin": ((3, 9, 8), 3.0, (1.0, 1.0, 1.0)),
}


def operator_of(name, rng=None):
    shape, horizon, spacing = BOXES[name]
    lattice = Lattice((0.0,) * len(shape), spacing, shape)
    horizon = np.multiply(horizon, 1.0 if name != "1D" and spacing[0] == 1.0 else spacing)
    stencil = diffusion_stencil(lattice, horizon)
    there, unknown = np.ones(shape, bool), np.ones(shape, bool)
    if rng is not None:
        there, unknown = random_nodes(shape, rng)
        # nodes with too few neighbours are refused
        there |= np.indices(shape).sum(axis=0) % (3 if len(shape) == 1 else 2) < 2
        unknown &= there
    return lattice, stencil, there, unknown, Collocation(stencil, shape, there, unknown, 0.7)


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize("holes", [False, True])
def test_exact_for_quadratics(name, holes):
    """D lap(x^2 + 3 y^2 - 2 z^2 + x y + x - 2) at every node, the corners included."""
    lattice, _, there, unknown, operator = operator_of(
        name, np.random.default_rng(1) if holes else None
    )
    x = lattice.coordinates()
    field = x[0] ** 2 + x[0] - 2.0
    laplacian = 2.0
    if len(x) > 1:
        field, laplacian = field + 3 * x[1] ** 2 + x[0] * x[1], laplacian + 6.0
    if len(x) > 2:
        field, laplacian = field - 2 * x[2] ** 2 + x[1] * x[2], laplacian - 4.0
    field = np.broadcast_to(field, lattice.shape)
    pad, crop = operator.sum.pad, operator.sum.crop
    gain = operator.gain(pad(field), np.zeros(operator.sum.padded_shape))
    result = crop(gain - operator.diagonal() * pad(field))
    assert there.sum() > 15 and 0 <= operator.regular < unknown.sum()
    size = np.abs(operator.diagonal()).max() * np.abs(field).max()
    # cancellation in one-sided rows: measured 9e-13 of the largest term
    np.testing.assert_allclose(result[unknown], 0.7 * laplacian, rtol=0, atol=2e-11 * size)
    np.testing.assert_array_equal(result[~unknown], 0.0)


@pytest.mark.parametrize("name", ["1D", "2D", "3D, thin"])
def test_rows_are_those_of_a_plain_fit(name):
    """Every row by NumPy's least squares with the weight of Eq. 3.26 written out."""
    rng = np.random.default_rng(2)
    lattice, stencil, there, unknown, operator = operator_of(name, rng)
    shape, d = lattice.shape, lattice.dimension
    rows = {}
    for i in zip(*np.nonzero(unknown), strict=True):
        near = [
            j
            for j in zip(*np.nonzero(there), strict=True)
            if j != i
            and all(abs(a - b) <= r for a, b, r in zip(i, j, stencil.reach, strict=True))
            and stencil.octant[tuple(abs(a - b) for a, b in zip(i, j, strict=True))] > 0
        ]
        xi = (np.array([i, *near]) - i) * np.array(lattice.spacing)
        r = np.linalg.norm(xi, axis=1) / np.linalg.norm(xi, axis=1).max()
        weight = (1 - np.exp(64 - 16 * r**2)) / (1 - np.exp(64.0))
        powers = [p for p in itertools.product(range(3), repeat=d) if sum(p) <= 2]
        fit = np.stack([np.prod(xi**p, axis=1) for p in powers], axis=1)
        root = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(fit * root, np.diag(root[:, 0]), rcond=None)[0]
        second = [n for n, p in enumerate(powers) if max(p) == 2]
        rows[i] = dict(zip(near, 0.7 * 2 * coefficients[second].sum(axis=0)[1:], strict=True))
    u = rng.normal(size=shape) * there
    matrix = pair_values(shape, lambda i, j, o: rows.get(i, {}).get(j, 0.0))
    expected = (matrix @ u.ravel()).reshape(shape)
    found = operator.sum.crop(
        operator.gain(operator.sum.pad(u), np.zeros(operator.sum.padded_shape))
    )
    scale = np.abs(matrix).max()
    assert np.abs(matrix[:, :] - matrix.T).max() > 1e-3 * scale  # one-sided: not symmetric
    # least squares by two methods: measured 1e-11 of the largest entry
    np.testing.assert_allclose(found[unknown], expected[unknown], rtol=0, atol=1e-9 * scale)


def test_a_disc_of_held_values_converges_with_second_order():
    """-lap u = 4 sin-like source in a disc whose outside is held at the exact solution."""
    errors = []
    for cells in (16, 32, 64):
        h = 2.0 / cells
        lattice = Lattice((-1.0 - 0.5 * h,) * 2, (h, h), (cells + 2,) * 2)
        x, y = lattice.coordinates()
        there = np.ones(lattice.shape, bool)
        unknown = x**2 + y**2 < 0.8
        exact = np.sin(2 * x) * np.exp(y)  # lap = -3 u
        stencil = diffusion_stencil(lattice, 2 * h)
        operator = Collocation(stencil, lattice.shape, there, unknown)
        pad = operator.sum.pad
        held = pad(np.where(unknown, 0.0, exact))
        b = operator.gain(held, np.zeros(operator.sum.padded_shape))
        b += pad(np.where(unknown, 3 * exact, 0.0))
        system = LinearSystem(operator)
        u = np.zeros_like(b)
        iterations = system.solve(u, b.copy(), 1e-10 * float(np.linalg.norm(b)))
        assert 3 <= iterations <= 20  # measured 10 to 11, each two products
        errors.append(np.abs(operator.sum.crop(u) - exact)[unknown].max())
    orders = -np.diff(np.log2(errors))
    # measured 2.12 and 2.07, finest 7.0e-5
    assert np.all((orders > 1.7) & (orders < 2.3)) and errors[-1] < 1e-4


def test_too_few_neighbours_are_refused():
    lattice = Lattice((0.0, 0.0), (1.0, 1.0), (6, 6))
    stencil = diffusion_stencil(lattice, 1.0)  # a cross of five nodes: six monomials
    with pytest.raises(ValueError, match="there: .* nodes have . neighbours"):
        Collocation(stencil, lattice.shape, np.ones((6, 6), bool), np.ones((6, 6), bool))
    there = np.zeros((6, 6), bool)
    there[2] = True  # a line
    stencil = diffusion_stencil(lattice, 3.0)
    with pytest.raises(ValueError, match="there: .* nodes have .* neighbours"):
        Collocation(stencil, lattice.shape, there, there)
    with pytest.raises(ValueError, match="do not determine"):
        laplacian_row(np.array([[1.0], [2.0]])[:1])


def test_regular_nodes_share_one_even_stencil():
    lattice = Lattice((0.0, 0.0), (1.0, 1.0), (20, 20))
    stencil = diffusion_stencil(lattice, 2.0)
    operator = Collocation(stencil, lattice.shape, *(np.ones((20, 20), bool),) * 2)
    assert operator.regular == 16 * 16
    np.testing.assert_allclose(operator.sum.stencil.second_moment(), 2.0, rtol=1e-12)
    assert isinstance(operator.sum, NonlocalSum)
