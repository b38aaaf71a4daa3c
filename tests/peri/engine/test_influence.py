"""Calibrated constants and stencils against formulas, moments and a bond-by-bond sum."""

import numpy as np
import pytest

from peri.engine.choices import INFLUENCES
from peri.engine.influence import (
    INFLUENCE_FUNCTIONS,
    closed_constant,
    diffusion_stencil,
    front_stencil,
)
from peri.engine.lattice import Lattice
from tests.peri.dense import plain_moment, plain_weight


def test_every_influence_function_is_a_choice():
    assert tuple(INFLUENCE_FUNCTIONS) == INFLUENCES


def lattice_of(*spacing):
    return Lattice((0.0,) * len(spacing), spacing, (1,) * len(spacing))


@pytest.mark.parametrize(
    ("dimension", "exponent", "influence", "expected"),
    [
        # micro-diffusivities D K of Jafarzadeh et al. 2022 (corrected) and the dissertation, D = 1
        (3, -0.5, "constant", lambda d: 9 / (2 * np.pi * d**3)),  # kernel 1/xi^2, Table 4.1
        (3, 0.0, "constant", lambda d: 3 / (np.pi * d**2)),  # Eq. 2.72
        (3, 0.25, "constant", lambda d: 3 * 0.75 / (np.pi * d**1.5)),
        (2, 0.0, "constant", lambda d: 4 / (np.pi * d**2)),  # kernel 1/xi^2
        (1, 0.5, "constant", lambda d: 1 / d),  # kernel 1/xi^2
        (1, 0.0, "constant", lambda d: 2 / d**2),
        # linear influence: int (1 - r) r dr = 1/6 instead of 1/2
        (3, 0.0, "linear", lambda d: 9 / (np.pi * d**2)),
        (1, 0.0, "linear", lambda d: 6 / d**2),
    ],
)
def test_closed_constants(dimension, exponent, influence, expected):
    for horizon in (0.3, 2.0, 1e-4):
        value = closed_constant(dimension, horizon, exponent, influence)
        assert value == pytest.approx(expected(horizon), rel=1e-14)  # round-off


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("influence", ["constant", "linear"])
@pytest.mark.parametrize("exponent", [-0.5, 0.0, 0.4])
def test_weights_bond_by_bond(dimension, influence, exponent):
    """Every weight of both calibrations against the formula written out for one bond."""
    spacing, horizon = 0.2, 0.6
    options = {"kernel_exponent": exponent, "influence": influence}
    closed = closed_constant(dimension, horizon, exponent, influence)
    discrete = 2.0 / plain_moment(dimension, spacing, horizon, **options)
    for calibration, constant in (("closed", closed), ("discrete", discrete)):
        stencil = diffusion_stencil(
            lattice_of(*[spacing] * dimension), horizon, calibration=calibration, **options
        )
        assert stencil.octant.max() > 0
        for offset in np.ndindex(stencil.octant.shape):
            bond = np.multiply(offset, spacing)
            expected = (
                plain_weight(bond, spacing, horizon, constant=constant, **options)
                if any(offset)
                else 0.0
            )
            # round-off; 1e-12 of the largest where the volume correction itself is round-off
            assert stencil.octant[offset] == pytest.approx(
                expected, rel=1e-12, abs=1e-12 * stencil.octant.max()
            )


FAMILIES = {
    "line": ((0.1,), 0.3),
    "square": ((0.1, 0.1), 0.2),
    "cube": ((0.1, 0.1, 0.1), 0.2),
    "cube, one spacing": ((0.1, 0.1, 0.1), 0.1),
    "cube, eight spacings": ((0.1, 0.1, 0.1), 0.8),
    "cube, broken ratio": ((0.1, 0.1, 0.1), 0.337),
    "stretched 2:1": ((0.1, 0.2, 0.1), 0.4),
    "stretched 25:1": ((0.04, 1.0), 2.0),
    "stretched 25:1 in 3D": ((0.1, 0.1, 2.5), (0.3, 0.3, 7.5)),
    "ellipsoid": ((0.1, 0.1, 0.1), (0.6, 0.3, 0.2)),
    "ellipsoid on a stretched lattice": ((0.1, 0.05, 0.2), (0.3, 0.3, 0.6)),
}


@pytest.mark.parametrize("name", FAMILIES)
def test_discrete_second_moment_is_two(name):
    spacing, horizon = FAMILIES[name]
    stencil = diffusion_stencil(lattice_of(*spacing), horizon)
    # round-off of sums of up to 2552 bonds: measured at most 7e-16 relative
    np.testing.assert_allclose(stencil.second_moment(), 2.0, rtol=1e-13)
    assert stencil.octant.min() >= 0 and stencil.octant.flat[0] == 0
    # the full stencil says the same as its octant
    full = stencil.dense()
    assert full.sum() == pytest.approx(stencil.total, rel=1e-13)  # another order of summation
    assert (full > 0).sum() == stencil.bonds
    for a, h in enumerate(spacing):
        position = h * np.arange(-stencil.reach[a], stencil.reach[a] + 1)
        plane = full.sum(axis=tuple(b for b in range(len(spacing)) if b != a))
        assert plane @ position**2 == pytest.approx(2.0, rel=1e-13)  # as above
        assert abs(plane @ position) < 1e-13 * stencil.total * horizon_of(horizon)  # odd: none


def horizon_of(horizon):
    return max(np.atleast_1d(horizon))


def test_closed_second_moment_approaches_two():
    """The closed constant misses the lattice's moment by O(1/m): the defect that stays when
    delta -> 0 at fixed m (dissertation 3.2.5)."""
    errors = []
    for m in (2, 4, 8):
        stencil = diffusion_stencil(lattice_of(1.0, 1.0, 1.0), m, calibration="closed")
        errors.append(2.0 - stencil.second_moment()[0])
    # measured 0.181, 0.0515, 0.0116
    assert 0.17 < errors[0] < 0.19 and 0.010 < errors[2] < 0.013
    assert 1.5 < np.log2(errors[1] / errors[2]) < 2.5  # measured 2.14


@pytest.mark.parametrize(("dimension", "limit"), [(1, 2.0), (2, 8 / np.pi), (3, 3.0)])
def test_front_strength_under_refinement(dimension, limit):
    """S delta -> 2, 8/pi, 3 in 1D, 2D, 3D for q = 0, with first order in 1/m.

    The lattice has no bond of length zero, which the integral over x (1 - x/delta) counts: the
    leading error is 1/m of the limit.
    """
    ratios = [2, 4, 8, 16]
    errors = []
    for m in ratios:
        stencil = diffusion_stencil(lattice_of(*[1.0 / m] * dimension), 1.0)
        values = [stencil.front_strength(a) for a in range(dimension)]
        assert np.ptp(values) < 1e-13 * values[0]  # cubic symmetry, round-off
        errors.append(1.0 - values[0] / limit)
    orders = -np.diff(np.log2(errors))
    # measured 1.00 in 1D; 0.91, 0.95, 0.95 in 2D and 0.86, 0.91, 0.96 in 3D
    assert np.all((orders > 0.8) & (orders < 1.1))
    # measured 0.0313, 0.0474, 0.0594
    assert 0.03 < errors[-1] < 0.07


def test_front_strength_is_the_sum_over_pairs_across_a_plane():
    """Flux through a flat front counted pair by pair on a lattice of two half-spaces."""
    stencil = diffusion_stencil(lattice_of(0.1, 0.1), 0.3)
    full, h = stencil.dense(), 0.1
    flux = 0.0
    for depth in range(stencil.reach[0]):  # node `depth` spacings behind the front
        for ahead in range(stencil.reach[0] - depth):
            flux += full[stencil.reach[0] + depth + ahead + 1].sum() * h
    assert flux == pytest.approx(stencil.front_strength(0), rel=1e-13)  # round-off


RATIOS = (1.0, 2.0, 5.0, 10.0, 25.0, 100.0)


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("m", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("long", [0, 1, 2])
def test_stretched_lattices_are_calibrated_exactly(ratio, m, long):
    """1:1 to 100:1, in 1D to 3D: second moments, and the strengths of an interface's bonds."""
    for dimension in range(long + 1, 4):
        spacing = [1e-6] * dimension
        spacing[long] *= ratio
        lattice, horizon = lattice_of(*spacing), tuple(m * h for h in spacing)
        stencil = diffusion_stencil(lattice, horizon)
        # round-off
        np.testing.assert_allclose(stencil.diffusivities, 1.0, rtol=1e-13)
        front = front_stencil(lattice, horizon)
        strengths = [front.front_strength(a) for a in range(dimension)]
        np.testing.assert_allclose(strengths, 1.0, rtol=1e-13)
        for positive in (stencil, front):
            assert positive.octant.min() >= 0 and (positive.octant > 0).sum() > 0


def test_a_front_along_every_axis_has_the_flux_that_it_says():
    """Flux through the plane between two half-spaces at 25:1, added up pair by pair."""
    spacing, m = (25e-6, 1e-6), 4
    full = front_stencil(lattice_of(*spacing), tuple(m * h for h in spacing)).dense()
    for a, h in enumerate(spacing):
        plane = full.sum(axis=1 - a)  # weights by offset along a
        flux = sum(
            plane[m + depth + ahead + 1] * h for depth in range(m) for ahead in range(m - depth)
        )
        assert flux == pytest.approx(1.0, rel=1e-13)  # round-off
    # the weights of diffusion: S_x 3.22e4, S_y 5.57e5 1/m
    diffusion = diffusion_stencil(lattice_of(*spacing), tuple(m * h for h in spacing))
    strengths = [diffusion.front_strength(a) for a in (0, 1)]
    np.testing.assert_allclose(strengths, [3.220e4, 5.569e5], rtol=2e-4)


def test_a_plane_and_a_rotated_wave_decay_alike():
    """Symbols of long waves over 64 directions at 25:1: |k|^2 up to the fourth order."""
    spacing, m = (25e-6, 1e-6), 4
    stencil = diffusion_stencil(lattice_of(*spacing), tuple(m * h for h in spacing))
    x, y = (h * np.arange(-r, r + 1) for h, r in zip(spacing, stencil.reach, strict=True))
    wave = 2 * np.pi / (200 * m * max(spacing))
    for angle in np.linspace(0.0, 2 * np.pi, 64):
        phase = wave * (np.cos(angle) * x[:, None] + np.sin(angle) * y[None, :])
        symbol = (stencil.dense() * 2.0 * np.sin(0.5 * phase) ** 2).sum()
        # measured 1.4e-5, along the long spacing
        assert symbol / wave**2 == pytest.approx(1.0, rel=5e-5)


def test_the_published_calibration_says_what_it_amounts_to(caplog):
    """Jafarzadeh et al. 2022 at 25:1, delta = 4 dx: 0.21761 D along, 6.96532 D across."""
    lattice, horizon = lattice_of(25e-6, 1e-6), (100e-6, 4e-6)
    with caplog.at_level("INFO", "peri.engine.influence"):
        stencil = diffusion_stencil(lattice, horizon, calibration="as_published")
    np.testing.assert_allclose(stencil.diffusivities, [0.21761, 6.96532], rtol=2e-5)
    assert "diffusivities 0.218 D, 6.97 D along the axes" in caplog.text
    with pytest.raises(ValueError, match="'closed' on a stretched lattice .* 0.218 D, 6.97 D"):
        diffusion_stencil(lattice, horizon, calibration="closed")
    # many spacings: the integral's isotropy returns (0.63 and 2.0 at 16)
    many = diffusion_stencil(lattice, (16 * 25e-6, 16e-6), calibration="as_published")
    np.testing.assert_allclose(many.diffusivities, [0.63, 2.0], rtol=0.02)
    # on equal spacings nothing is new
    one, other = (
        diffusion_stencil(lattice_of(1.0, 1.0), 3.0, calibration=name).octant
        for name in ("closed", "as_published")
    )
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"influence": "cubic"}, "influence: 'cubic'; allowed: constant, linear"),
        ({"calibration": "none"}, "calibration: 'none'; allowed: discrete, closed, as_pub"),
        ({"kernel_exponent": 1.0}, "kernel_exponent"),
        ({"kernel_exponent": float("nan")}, "kernel_exponent"),
        ({"horizon": 0.5}, "horizon"),
        ({"influence": "linear"}, "leaves no bond"),
        ({"influence": "linear", "calibration": "closed"}, "leaves no bond"),
    ],
)
def test_refusals(options, message):
    arguments = {"horizon": 1.0, **options}
    with pytest.raises(ValueError, match=message):
        diffusion_stencil(lattice_of(1.0, 1.0), **arguments)
