"""Lattices, node sets, families of a horizon."""

import numpy as np
import pytest

from peri.engine.lattice import Lattice, ball, box_lattice, cylinder, family


def test_nodes_lie_where_the_lattice_says():
    lattice = Lattice((1.0, -2.0), (0.5, 0.25), (3, 4))
    x, y = np.broadcast_arrays(*lattice.coordinates())
    assert x.shape == (3, 4) and lattice.dimension == 2
    # halves and quarters are exact in binary
    assert lattice.cell_volume == 0.125
    assert x[2, 0] == 2.0 and y[0, 3] == -1.25
    np.testing.assert_array_equal(lattice.axis(1), [-2.0, -1.75, -1.5, -1.25])


def test_box_of_whole_cells_is_covered_exactly_and_symmetrically():
    lattice = box_lattice((-1.0, 0.0, 2.0), (1.0, 0.3, 3.0), (0.1, 0.1, 0.25))
    assert lattice.shape == (20, 3, 4)
    for a, (low, high) in enumerate([(-1.0, 1.0), (0.0, 0.3), (2.0, 3.0)]):
        half = 0.5 * lattice.spacing[a]
        # round-off of coordinates of order one: measured 2e-16
        assert lattice.axis(a)[0] - half == pytest.approx(low, abs=1e-14)
        assert lattice.axis(a)[-1] + half == pytest.approx(high, abs=1e-14)


def test_box_of_broken_cells_is_larger_and_keeps_its_middle():
    lattice = box_lattice((0.0,), (1.0,), 0.3)
    assert lattice.shape == (4,)
    assert lattice.axis(0).mean() == pytest.approx(0.5, abs=1e-15)  # round-off


def test_volume_of_ball_and_cylinder_converges():
    """Nodes times cell volume against 4/3 pi r^3 and pi r^2 h."""
    errors = []
    for cells in (10, 40):
        lattice = box_lattice((-1.0,) * 3, (1.0,) * 3, 2.0 / cells)
        balls = ball(lattice, (0.0,) * 3, 0.8).sum() * lattice.cell_volume
        rods = cylinder(lattice, (0.0,) * 3, 0.7, 1.2).sum() * lattice.cell_volume
        errors.append((balls / (4 / 3 * np.pi * 0.8**3) - 1, rods / (np.pi * 0.49 * 1.2) - 1))
    coarse, fine = np.abs(errors)
    # lattice points in a body: measured 0.044 and 0.168 at 10 cells, 0.0058 and 0.0004 at 40
    assert np.all(fine < 0.01) and np.all(coarse > 4 * fine)


def test_cylinder_axis_can_be_chosen():
    lattice = box_lattice((-1.0,) * 3, (1.0,) * 3, 0.25)
    along_z = cylinder(lattice, (0.0,) * 3, 0.6, 1.5, axis=2)
    along_x = cylinder(lattice, (0.0,) * 3, 0.6, 1.5, axis=0)
    assert along_z.any() and not np.array_equal(along_z, along_x)
    np.testing.assert_array_equal(along_x, np.transpose(along_z, (2, 1, 0)))


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("ratio", [1.0, 2.0, 3.0, 3.3, 8.0])
def test_volume_correction_is_equation_3_2(dimension, ratio):
    """beta = 1 inside delta - dx/2, falls linearly to 0 at delta + dx/2."""
    spacing, horizon = 0.1, 0.1 * ratio
    bonds = family(Lattice((0.0,) * dimension, (spacing,) * dimension, (1,) * dimension), horizon)
    expected = np.ones(len(bonds.bond_length))
    rim = bonds.bond_length > horizon - spacing / 2
    expected[rim] = (horizon + spacing / 2 - bonds.bond_length[rim]) / spacing
    assert rim.any()
    # round-off of lengths of order one over a cell of a tenth: measured 4e-15
    np.testing.assert_allclose(bonds.volume_correction, expected, atol=1e-13)
    # no bond left out: every lattice offset shorter than delta + dx/2 is there
    reach = int(ratio) + 2
    grids = np.meshgrid(*[np.arange(-reach, reach + 1)] * dimension, indexing="ij")
    length = np.sqrt(sum(g.ravel() ** 2.0 for g in grids))
    whole = ((length > 0) & (length < ratio + 0.5 - 1e-9)).sum()
    assert bonds.multiplicity.sum() == whole


def test_family_of_an_ellipsoid_follows_its_direction():
    lattice = Lattice((0.0,) * 3, (0.1, 0.1, 0.1), (1, 1, 1))
    bonds = family(lattice, (0.6, 0.3, 0.2))
    along_x = np.all(bonds.offsets[:, 1:] == 0, axis=1)
    along_z = np.all(bonds.offsets[:, :2] == 0, axis=1)
    # 6 and 2 spacings on the axes; at the horizon itself beta is 1/2 (Eq. 3.2), to round-off
    assert bonds.offsets[along_x].max() == 6 and bonds.offsets[along_z].max() == 2
    assert bonds.volume_correction[along_x][-1] == pytest.approx(0.5, abs=1e-12)
    # Jafarzadeh et al. 2022, Eq. 15: 1/delta^2 = sum n_a^2 / delta_a^2
    direction = bonds.bond / bonds.bond_length[:, None]
    expected = (direction**2 / np.array([0.6, 0.3, 0.2]) ** 2).sum(axis=1) ** -0.5
    np.testing.assert_allclose(bonds.direction_horizon, expected, rtol=1e-14)  # round-off


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lattice((0.0,), (1.0, 1.0), (3, 3)), "lattice"),
        (lambda: Lattice((), (), ()), "1 to 3 axes"),
        (lambda: Lattice((0.0,) * 4, (1.0,) * 4, (2,) * 4), "1 to 3 axes"),
        (lambda: Lattice((0.0,), (0.0,), (3,)), "spacing"),
        (lambda: Lattice((0.0,), (-1.0,), (3,)), "spacing"),
        (lambda: Lattice((0.0,), (float("nan"),), (3,)), "spacing"),
        (lambda: Lattice((0.0,), (float("inf"),), (3,)), "spacing"),
        (lambda: Lattice((0.0,), (1.0,), (0,)), "shape"),
        (lambda: Lattice((float("inf"),), (1.0,), (3,)), "origin"),
        (lambda: box_lattice((0.0,), (1.0,), 0.0), "spacing"),
        (lambda: box_lattice((0.0,), (1.0,), float("nan")), "spacing"),
        (lambda: box_lattice((1.0,), (1.0,), 0.1), "upper"),
        (lambda: family(Lattice((0.0,), (1.0,), (3,)), 0.9), "horizon"),
        (lambda: family(Lattice((0.0,) * 2, (1.0, 2.0), (3, 3)), 1.9), "horizon"),
        (lambda: family(Lattice((0.0,), (1.0,), (3,)), float("nan")), "horizon"),
        (lambda: family(Lattice((0.0,), (1.0,), (3,)), float("inf")), "horizon"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message):
        make()
