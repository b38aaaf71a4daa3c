"""The rate of a front: orientation, sphere, Zhao et al.'s profile, travelling front."""

import math

import numpy as np
import pytest

from peri.engine.influence import diffusion_stencil
from peri.engine.lattice import Lattice
from peri.reference import fronts


def unit_stencil(dimension, ratio):
    lattice = Lattice((0.0,) * dimension, (1.0,) * dimension, (1,) * dimension)
    return diffusion_stencil(lattice, float(ratio))


def test_profile_of_a_flat_front_has_the_published_quadrature_errors():
    """Table 2 of Zhao et al. (2021): 7.15e-2, 2.18e-2, 6.4e-3, 1.8e-3 for m = 2, 4, 8, 16."""
    for ratio, published in ((2, 7.15e-2), (4, 2.18e-2), (8, 6.4e-3), (16, 1.8e-3)):
        # Half a unit of the last digit of the finest entries.
        digits = 0.5e-4
        assert -fronts.flat_front_quadrature_error(ratio) == pytest.approx(published, abs=digits)


def test_profile_of_a_flat_front_integrates_to_the_flux():
    edges = np.linspace(0.0, 1.0, 200_001)
    middle = 0.5 * (edges[1:] + edges[:-1])
    # Midpoint rule at 2e5 points; measured 7e-9.
    assert fronts.flat_front_profile(middle, 1.0).mean() == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
def test_strength_depends_less_on_direction_the_finer_the_lattice(dimension):
    def spread(ratio):
        stencil = unit_stencil(dimension, ratio)
        axis = stencil.front_strength()
        angles = [np.radians(a) for a in (30, 45)]
        normals = [[math.cos(a), math.sin(a), 0.0][:dimension] for a in angles]
        return [fronts.directional_strength(stencil, n) / axis - 1 for n in normals]

    errors = {m: spread(m) for m in (2, 4, 8)}
    # 30 and 45 degrees: 11.5 and 8.1 % (2D), 15.3 and 12.2 % (3D) at m = 2, falling like 1/m.
    expected = {2: (0.11504, 0.08055), 3: (0.15289, 0.12190)}[dimension]
    assert errors[2] == pytest.approx(expected, abs=2e-5)
    for coarse, fine in ((2, 4), (4, 8)):
        for a, b in zip(errors[coarse], errors[fine], strict=True):
            assert 0.8 < math.log2(a / b) < 1.4  # measured 1.03 to 1.27


def test_axis_direction_is_the_front_strength():
    stencil = unit_stencil(3, 3)
    assert fronts.directional_strength(stencil, (0, 0, 2.0)) == pytest.approx(
        stencil.front_strength(2), rel=1e-14
    )


def test_mean_strength_is_the_mean_over_directions():
    stencil = unit_stencil(3, 2)
    points = np.random.default_rng(7).normal(size=(4000, 3))
    mean = np.mean([fronts.directional_strength(stencil, n) for n in points])
    # 4000 random directions; the spread over directions is 4 %, its mean error 0.06 %.
    assert stencil.mean_strength() == pytest.approx(mean, rel=2.5e-3)


@pytest.mark.parametrize("ratio", [2, 4])
def test_sphere_receives_the_mean_strength(ratio):
    stencil = unit_stencil(3, ratio)
    radius = 6.0 * ratio
    measured = fronts.sphere_strength(stencil, radius, 1.0)
    expected = stencil.mean_strength() * fronts.sphere_curvature_factor(ratio, radius)
    # What is left is where the staircase falls; measured 0.3 % (m = 2) and 0.1 % (m = 4).
    assert measured == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("concentration_ratio", [1e5, 28.0])
def test_travelling_front_is_slower_than_faraday_by_the_logarithm(dimension, concentration_ratio):
    """Proportional dissolution: speed C_solid / flux = 1 / ln(C_solid / C_sat) on any lattice."""
    for ratio in (2, 4, 8):
        speed = fronts.front_speed_ratio(unit_stencil(dimension, ratio), concentration_ratio)
        # The march is exact between events; the transient has decayed to 1e-6.
        assert speed * math.log(concentration_ratio) == pytest.approx(1.0, rel=1e-4)
