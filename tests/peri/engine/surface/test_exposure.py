"""The surface integral of the exposure against integrals over the liquid's volume."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from peri.engine.surface.exposure import exposure
from peri.engine.surface.triangles import Surface, signed_distance
from tests.peri.bodies import ball, ball_exposure, box, turned

RNG = np.random.default_rng(5)
KERNELS = {
    # q, influence
    "published": (0.0, "constant"),
    "linear": (0.0, "linear"),
    "weak": (-0.5, "constant"),
    "weak, linear": (-1.0, "linear"),
    "strong": (0.4, "constant"),
    "strong, linear": (0.5, "linear"),
    "singular": (0.9, "constant"),
}
DEPTHS = np.array([0.95, 0.7, 0.3, 0.05, 1e-3, 1e-6])


def kernel(r: float, q: float, influence: str) -> float:
    """omega / r^(1+2q): the kernel times the surface of a sphere's share of its radius."""
    return (1.0 - r if influence == "linear" else 1.0) * r ** (-1.0 - 2.0 * q)


def flat_front(z: float, q: float, influence: str, dimension: int) -> float:
    """Lambda at depth z (horizons) below a plane, by the share of each sphere beyond it."""
    share = {
        1: lambda r: 1.0,
        2: lambda r: 2 * math.acos(min(1.0, z / r)),
        3: lambda r: 2 * math.pi * (1 - z / r),
    }[dimension]
    # In ln r, so that the singular end is resolved.
    value, _ = quad(
        lambda s: share(math.exp(s)) * kernel(math.exp(s), q, influence) * math.exp(s),
        math.log(z), 0.0, epsabs=0.0, epsrel=1e-11, limit=400,
    )  # fmt: skip
    return value


def by_rays(point, q, influence, count=400_000):
    """Lambda at a point of the quadrant x, y, z > 0 of metal, by evenly spread rays."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    turn = np.pi * (1 + 5**0.5) * k
    u = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    with np.errstate(divide="ignore"):
        way = np.where(u < 0, -np.asarray(point) / u, np.inf).min(axis=1)
    radius = np.exp(np.linspace(math.log(1e-4), 0, 4001))
    values = [kernel(r, q, influence) * r for r in radius]
    steps = 0.5 * np.diff(np.log(radius)) * (np.array(values)[1:] + np.array(values)[:-1])
    tail = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    inside = way < 1
    return 4 * np.pi * np.interp(way[inside], radius, tail).sum() / count


@pytest.mark.parametrize("name", KERNELS)
def test_flat_front(name):
    q, influence = KERNELS[name]
    horizon = 0.2
    points = np.stack([np.full(6, 0.61), np.full(6, 0.59), horizon * DEPTHS], axis=1)
    found = exposure(points, box([0, 0, 0], [1.2] * 3), horizon, q, influence)
    expected = [flat_front(z, q, influence, 3) for z in DEPTHS]
    unit = horizon ** (-2 * q)
    # Measured: 3e-14 of the linear kernels near the rim (they cancel there), else 1e-15.
    np.testing.assert_allclose(found, unit * np.array(expected), rtol=1e-11)


def test_flat_front_closed_form():
    points = np.stack([np.full(6, 3.1), np.full(6, 2.9), DEPTHS], axis=1)
    found = exposure(points, box([0, 0, 0], [6] * 3), 1.0)
    np.testing.assert_allclose(found, 2 * np.pi * (-np.log(DEPTHS) - 1 + DEPTHS), rtol=1e-12)


@pytest.mark.parametrize("name", KERNELS)
def test_cube_edge_and_corner_against_rays(name):
    q, influence = KERNELS[name]
    points = np.array([[0.2, 3.0, 0.1], [0.2, 0.15, 0.1], [0.02, 0.3, 0.4], [0.05, 0.05, 0.05]])
    found = exposure(points, box([0, 0, 0], [6] * 3), 1.0, q, influence)
    expected = [by_rays(p, q, influence) for p in points]
    # Measured: 1e-3 at worst (q = 0.9), which is the rays' own error.
    np.testing.assert_allclose(found, expected, rtol=3e-3)


def test_ball_second_order_in_the_triangles():
    depth = np.array([0.02, 0.1, 0.4, 0.7])
    way = RNG.normal(size=(40, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    points = ((3.0 - depth)[:, None, None] * way).reshape(-1, 3)
    exact = ball_exposure(depth, 3.0, 1.0)
    errors = []
    for refinements in (3, 4, 5):
        found = exposure(points, ball(3.0, refinements), 1.0).reshape(4, -1)
        errors.append(np.abs(found / exact[:, None] - 1).mean(axis=1))
    assert min(errors[-1]) > 1e-4  # not trivially exact
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(order[-1] > 1.8) and np.all(order[-1] < 2.3)
    assert max(errors[-1]) < 0.03  # at a depth of a sixth of a triangle's edge


def test_zero_outside_reach_and_opposite_in_the_liquid():
    surface = box([0, 0, 0], [6] * 3)
    deep = np.array([[3.0, 3, 3], [3, 3, 1.0], [2, 2.5, 1.01], [3, 3, -1.2], [50, 50, 50]])
    assert np.all(exposure(deep, surface, 1.0) == 0)
    metal = np.stack([np.full(6, 3.1), np.full(6, 2.9), DEPTHS], axis=1)
    liquid = metal * [1, 1, -1]
    np.testing.assert_allclose(
        exposure(liquid, surface, 1.0), -exposure(metal, surface, 1.0), rtol=1e-12
    )


def test_cavity_counts_as_liquid():
    outer, inner = box([0, 0, 0], [6] * 3), box([2, 1.5, 1.5], [4, 4.5, 4.5])
    both = Surface(
        np.vstack([outer.vertices, inner.vertices]),
        np.vstack([outer.facets, 8 + inner.facets[:, ::-1]]),
    )
    assert both.volume == pytest.approx(6**3 - 2 * 3 * 3)
    points = np.array([[1.6, 3, 3.1], [1.2, 3.2, 3]])
    expected = 2 * np.pi * (-np.log([0.4, 0.8]) - 1 + np.array([0.4, 0.8]))
    np.testing.assert_allclose(exposure(points, both, 1.0), expected, rtol=1e-12)


def test_rotation_changes_nothing():
    surface = box([0, 0, 0], [3, 2, 2.5])
    points = np.array([[0.1, 0.2, 0.3], [2.9, 1.1, 1.2], [1.5, 0.01, 2.4]])
    round_, rotation = turned(surface, 2)
    np.testing.assert_allclose(
        exposure(points @ rotation.T, round_, 1.0), exposure(points, surface, 1.0), rtol=1e-10
    )


def test_far_triangles_by_three_points():
    surface = ball(3.0, 5)
    way = RNG.normal(size=(30, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    points = (3 - np.linspace(0.05, 0.9, 30))[:, None] * way
    exact = exposure(points, surface, 1.0, far=math.inf)
    error = np.abs(exposure(points, surface, 1.0) - exact).max() / exact.mean()
    assert 0 < error < 2e-4  # measured 8e-5


def test_two_dimensions():
    square = np.array([[0, 0], [6, 0], [6, 6], [0, 6.0]])
    surface = Surface(square, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    assert surface.volume == pytest.approx(36)
    points = np.stack([np.full(6, 3.1), DEPTHS], axis=1)
    for q, influence in KERNELS.values():
        expected = [flat_front(z, q, influence, 2) for z in DEPTHS]
        np.testing.assert_allclose(
            exposure(points, surface, 1.0, q, influence), expected, rtol=1e-8
        )
    # A disc by the share of each circle outside, s > R - a.
    n, radius, a = 2000, 3.0, 2.6
    angle = 2 * np.pi * np.arange(n) / n
    disc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    round_ = Surface(disc, np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1))
    expected, _ = quad(
        lambda s: 2 / s * math.acos(
            min(1.0, (radius**2 - a * a - s * s) / (2 * a * s))
        ), radius - a, 1.0, epsrel=1e-10,
    )  # fmt: skip
    found = exposure(np.array([[a, 0.0], [0.0, -a]]), round_, 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)  # measured 2e-6, the polygon's


def test_one_dimension():
    surface = Surface(np.array([[0.0], [2.0], [2.5], [4.0]]), np.arange(4)[:, None])
    assert surface.volume == pytest.approx(3.5)
    found = exposure(np.array([[0.3], [1.0], [1.8], [2.2]]), surface, 1.0)
    gap = math.log(0.7 / 0.2)  # metal again beyond 0.5 of liquid
    metal = -(math.log(1 / 0.2) + math.log(1 / 0.3))
    np.testing.assert_allclose(found, [math.log(1 / 0.3), 0.0, gap, metal], atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: Surface(s.vertices, s.facets[:-1]), "open"),
        (lambda s: Surface(s.vertices, s.facets[:, ::-1]), "outward"),
        (lambda s: Surface(s.vertices, np.vstack([s.facets[:1, ::-1], s.facets[1:]])), "orient"),
        (lambda s: Surface(s.vertices * np.nan, s.facets), "finite"),
        (lambda s: Surface(s.vertices, s.facets + 8), "vertex numbers"),
        (lambda s: Surface(s.vertices[:, :2], s.facets), "facets: shape"),
        (lambda s: exposure(np.zeros((1, 2)), s, 1.0), "points"),
        (lambda s: exposure(np.zeros((1, 3)), s, (1.0, 1.0, 2.0)), "horizon"),
        (lambda s: exposure(np.zeros((1, 3)), s, 1.0, 1.0), "kernel_exponent"),
        (lambda s: exposure(np.zeros((1, 3)), s, 1.0, 0.0, "cubic"), "influence"),
    ],
)
def test_refusals(change, message):
    with pytest.raises(ValueError, match=message):
        change(box([0, 0, 0], [1] * 3))


def test_signed_distance():
    surface, rotation = turned(box([0, 0, 0], [2] * 3), 4)
    points = RNG.uniform(-0.9, 2.9, size=(3000, 3))
    outside = np.linalg.norm(np.maximum(np.maximum(-points, points - 2), 0), axis=1)
    inside = np.minimum(points, 2 - points).min(axis=1)
    expected = np.where(inside > 0, inside, -outside)
    depth, inward = signed_distance(points @ rotation.T, surface, 1.0)
    near = np.abs(expected) < 1.0
    assert near.sum() > 1000 and np.isnan(depth[~near]).all()
    np.testing.assert_allclose(depth[near], expected[near], atol=1e-12)
    step = 1e-6
    deeper, _ = signed_distance((points @ rotation.T + step * inward)[near], surface, 1.0)
    assert np.nanmedian(np.abs(deeper - depth[near] - step)) < 1e-12
