"""The assembled force and stiffness of a mesh: rigid motions, tangent, thread count."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from fem.assembly import Assembler, multiply
from fem.constitutive import Material, VoceHardening
from fem.constitutive.laws import Laws
from fem.preparation import whole_mesh
from fem.quadrature_state import QuadratureState
from tests.fem.meshes import distorted_box

MAGNESIUM = Material(43e9, 0.3, VoceHardening(130e6, 156e6, 10.6))
ELEMENTS = ["P1", "P1-Fbar", "P2", "P2-Fbar"]


def assembler_of(element, damage, threads=1, shape=(2, 2, 3)):
    """Assembler and state of a distorted box with f = damage everywhere."""
    points, cells = distorted_box(shape)
    discretisation = whole_mesh(points, cells, element, threads)
    state = QuadratureState(np.full(discretisation.volumes.shape, damage))
    laws = Laws.of([MAGNESIUM], np.zeros(len(cells)))
    return Assembler(discretisation, laws, threads), state


def smooth_motion(coordinates, size):
    """A displacement field with gradients of order `size`, nowhere uniform."""
    x, y, z = coordinates.T / 1e-3
    return 1e-3 * size * np.c_[np.sin(y + 0.3 * z), 0.4 * x * z - 0.5 * y, z + 0.3 * z**2 + x * y]


@pytest.mark.parametrize("element", ELEMENTS)
def test_rigid_motion_gives_no_force(element):
    assembler, state = assembler_of(element, 0.1)
    x = assembler.discretisation.coordinates
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = x @ turn.T + [1e-3, -2e-3, 5e-4] - x
    assert abs(moved).max() > 1e-3
    result = assembler.assemble(moved, state)
    # of E times the section of a cell: measured 1e-15 to 3e-15
    assert result.failed == 0 and abs(result.force).max() < 1e-14 * 43e9 * (0.5e-3) ** 2
    assert result.stored < 1e-20 and result.dissipated == 0.0


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize(("size", "damage"), [(1e-4, 0.05), (0.03, 0.0), (0.03, 0.2)])
def test_taylor_slope_of_the_assembled_stiffness(element, size, damage):
    """|f(u + h v) - f(u) - h K v| falls as h^2: elastic, plastic, porous; F-bar terms included."""
    assembler, state = assembler_of(element, damage)
    d = assembler.discretisation
    u = smooth_motion(d.coordinates, size)
    v = size * 1e-3 * np.random.default_rng(3).normal(size=u.shape)
    start = assembler.assemble(u, state)
    assert start.failed == 0
    assert (state.new.strain.min() > 0.005) if size > 0.01 else (state.new.strain.max() == 0.0)
    force, product = start.force.copy(), np.empty_like(u)
    multiply(d.row_start, d.columns, start.values, v, product)
    steps = 1e-3 * 0.5 ** np.arange(3)
    remainder = np.array(
        [
            np.linalg.norm(assembler.assemble(u + h * v, state, False).force - force - h * product)
            for h in steps
        ]
    )
    slopes = np.log2(remainder[:-1] / remainder[1:])
    # measured 1.9954 to 2.0013
    assert slopes.min() > 1.985 and slopes.max() < 2.01
    # the absolute error, which a wrong but consistent slope could hide: measured 1.2e-7 to 1.5e-3
    assert remainder[-1] < 5e-3 * steps[-1] * np.linalg.norm(product)


@pytest.mark.parametrize("element", ["P1-Fbar", "P2"])
def test_threads_do_not_change_the_result(element):
    """Slabs of groups that share nodes are never assembled at the same time."""
    one, state = assembler_of(element, 0.1, shape=(3, 3, 20))
    two, other = assembler_of(element, 0.1, threads=2, shape=(3, 3, 20))
    assert len(two.discretisation.slabs) > 2
    u = smooth_motion(one.discretisation.coordinates, 0.02)
    first, second = one.assemble(u, state), two.assemble(u, other)
    # sums in another order only: measured 2e-16
    np.testing.assert_allclose(second.force, first.force, atol=1e-13 * abs(first.force).max())
    np.testing.assert_allclose(second.values, first.values, atol=1e-13 * abs(first.values).max())
