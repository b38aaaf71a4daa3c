"""Linear systems of all kinds of operators: against dense solutions, and bounded iterations."""

import numpy as np
import pytest

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import ball, box_lattice
from peri.engine.operators import NonlocalSum, Operator
from peri.engine.solvers import ConvergenceError, LinearSystem
from peri.schemes.bonds import (
    Exponential,
    Harmonic,
    geometric_conductances,
    mean_conductances,
    square_root_fluxes,
)
from peri.schemes.stored import StoredBonds


class Box:
    """A box of one edge with a ball cut out of it and held values outside of another."""

    def __init__(self, dimension, cells, ratio):
        self.lattice = box_lattice((-0.5,) * dimension, (0.5,) * dimension, 1.0 / cells)
        stencil = diffusion_stencil(self.lattice, ratio / cells)
        self.sum = NonlocalSum(stencil, self.lattice.shape)
        centre = (0.0,) * dimension
        there = ~ball(self.lattice, centre, 0.2)
        self.there = self.sum.pad(there)
        self.unknown = self.sum.pad(there & ball(self.lattice, centre, 0.5 - ratio / cells))

    def field(self, function):
        values = np.broadcast_to(function(*self.lattice.coordinates()), self.lattice.shape)
        return self.sum.pad(values) * self.there


def wavy(x, y, *_):
    return np.exp(3 * np.sin(6 * x) * np.cos(5 * y))  # contrast 400


def jump(x, y, *_):
    return np.where(x + 0 * y > 0.1, 1.0, 1e-3)


def slope(span):
    return lambda x, y, *_: span * (np.sin(4 * x) + 0.5 * y)


def iterations_of(operator, **options):
    """Iterations to 1e-8 for a rough right side; the true residual is checked."""
    rng = np.random.default_rng(5)
    b = operator.sum.pad(rng.normal(size=operator.sum.lattice_shape)) * operator.unknown
    system = LinearSystem(operator, **options)
    x, norm = np.zeros_like(b), float(np.linalg.norm(b))
    count = system.solve(x, b.copy(), 1e-8 * norm)
    assert np.linalg.norm(system.residual(x, b)) <= 3e-8 * norm
    return count


KINDS = {
    "mean": lambda b: mean_conductances(b.sum, b.field(wavy), b.unknown),
    "geometric": lambda b: geometric_conductances(b.sum, b.field(wavy), b.unknown),
    "harmonic": lambda b: Harmonic(b.sum, b.field(wavy), b.unknown),
    "square root": lambda b: square_root_fluxes(b.sum, b.field(slope(5)), b.there, b.unknown),
    "exponential": lambda b: Exponential(b.sum, b.field(slope(5)), b.there, b.unknown),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("size", [(2, 14, 2), (3, 9, 1)])
def test_solution_against_a_dense_solver(name, size):
    """Held values outside, storage, and a rank-one term as `extra`."""
    box = Box(*size)
    operator = KINDS[name](box)
    nodes = np.flatnonzero(operator.unknown)
    columns = []
    for node in nodes:
        unit, out = (np.zeros(box.sum.padded_shape) for _ in range(2))
        unit.ravel()[node] = 1.0
        operator.apply(unit, out)
        columns.append(out.ravel()[nodes])
    row = np.where(np.arange(nodes.size) < 5, 1.0, 0.0)
    matrix = np.array(columns).T + np.diag(np.full(nodes.size, 3.0)) + np.outer(row, row)

    def extra(u, y):
        along = row @ u.ravel()[nodes]
        y.ravel()[nodes] += row * along
        return along**2

    extra_diagonal = np.zeros(box.sum.padded_shape)
    extra_diagonal.ravel()[nodes] = row
    system = LinearSystem(
        operator, shift=3.0 * operator.unknown, extra=extra, extra_diagonal=extra_diagonal
    )
    held = box.field(lambda x, *_: 1.0 + x) * (1 - box.unknown)
    b = operator.gain(held, np.zeros(box.sum.padded_shape))
    x = np.zeros_like(b)
    system.solve(x, b.copy(), 1e-12 * float(np.linalg.norm(b)))
    expected = np.linalg.solve(matrix, b.ravel()[nodes])
    assert nodes.size > 50 and expected.max() > 0.01
    # a residual of 1e-12: measured 5e-12
    np.testing.assert_allclose(x.ravel()[nodes], expected, rtol=0, atol=1e-10 * expected.max())
    assert np.count_nonzero(x * (operator.unknown == 0)) == 0


@pytest.mark.parametrize("name", KINDS)
def test_iterations_do_not_depend_on_size_or_storage(name):
    counts = []
    for size in ((2, 32, 3), (2, 64, 3), (3, 20, 2), (3, 32, 2)):
        box = Box(*size)
        operator = KINDS[name](box)
        for stiffness in (1.0, 1e3, np.inf):
            shift = operator.unknown / (stiffness * box.sum.spacing[2] ** 2)
            counts.append(iterations_of(operator, shift=shift))
    # measured 4 to 7 (BiCGSTAB, two products each) and 10 to 11 (conjugate gradients)
    assert min(counts) >= 3 and max(counts) <= (8 if name in ("square root", "exponential") else 13)


def test_a_jump_of_conductivity():
    """1 : 1000 across a plane: the harmonic mean does not notice, the mean is the hardest."""
    box = Box(2, 64, 3)
    kappa = box.field(jump)
    assert 8 <= iterations_of(Harmonic(box.sum, kappa, box.unknown)) <= 12  # measured 10
    assert iterations_of(geometric_conductances(box.sum, kappa, box.unknown)) <= 21  # 18
    assert iterations_of(mean_conductances(box.sum, kappa, box.unknown)) <= 52  # 47


@pytest.mark.parametrize("make", [square_root_fluxes, Exponential])
def test_the_scale_pays_for_drift(make):
    """s spans 6 times 10 and 50: with the scale 8 and 21 iterations, without 22 and 83."""
    box = Box(2, 64, 3)
    for span, most in ((10, 10), (50, 25)):
        operator = make(box.sum, box.field(slope(span)), box.there, box.unknown)
        scaled = iterations_of(operator)
        plain = Operator.local(operator)
        operator.local = lambda plain=plain: plain
        assert 5 <= scaled <= most
        assert iterations_of(operator) > 2 * scaled


def test_strong_drift_is_solved_without_the_scale():
    """s spans 490, 38 over a bond: exp(s/2) spans 1e106 and does not scale."""
    box = Box(2, 64, 3)
    operator = Exponential(box.sum, box.field(slope(200)), box.there, box.unknown)
    assert operator.local().scale is None
    assert 20 <= iterations_of(operator) <= 160  # measured 125


def test_bicgstab_takes_symmetric_systems_too():
    box = Box(2, 32, 3)
    operator = KINDS["mean"](box)
    assert iterations_of(operator, symmetric=False) <= 8  # measured 6


def test_a_breakdown_is_reported():
    """A rotation by 90 degrees: r . A r = 0, and BiCGSTAB has no direction to go."""
    bond_sum = NonlocalSum(diffusion_stencil(box_lattice((0.0,), (2.0,), 1.0), 1.0), (2,))
    on = bond_sum.pad(np.ones(2))
    # two nodes: bond back (to the left), bond ahead
    turn = StoredBonds(bond_sum, on, [[0.0, 1.0], [-1.0, 0.0]], np.zeros(bond_sum.padded_shape))
    system = LinearSystem(turn, sink=on)
    system.precondition = lambda r, z: np.copyto(z, r)
    with pytest.raises(ConvergenceError, match="linear solver"):
        system.solve(np.zeros_like(on), on.copy(), 1e-10)
