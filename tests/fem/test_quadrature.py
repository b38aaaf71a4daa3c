"""Points and weights of the elements and of the sampling of a cell."""

import numpy as np
import pytest

from fem.quadrature import quadrature_points, sampling_points

POINTS = np.array([(0.1, 0.0, 0.2), (1.3, 0.1, 0.0), (0.2, 0.9, 0.1), (0.3, 0.4, 1.7)])
CELL = np.array([(0, 1, 2, 3)])


@pytest.mark.parametrize("halvings", [0, 1, 2])
def test_sampling_of_a_cell_integrates_quadratics(halvings):
    """Every child has the four-point rule, so the sum is that of the whole cell, to round-off."""

    def quadratic(x):
        return 1.0 + x[..., 0] ** 2 - 2.0 * x[..., 1] * x[..., 2]

    at, volumes = sampling_points(POINTS, CELL, halvings)
    assert at.shape == (1, 4 * 8**halvings, 3)
    whole, weights = quadrature_points(POINTS, CELL, "P2")
    expected = (quadratic(whole) * weights).sum()
    assert volumes.sum() == pytest.approx(weights.sum(), rel=1e-13)
    assert (quadratic(at) * volumes).sum() == pytest.approx(expected, rel=1e-13)


def test_sampling_sees_a_layer_that_four_points_miss():
    """Share of a cell within a layer 0.15 thick below one face: 1 - 0.85^3 of its height."""
    corners = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    errors = []
    for halvings in (0, 2, 3):
        at, volumes = sampling_points(corners, CELL, halvings)
        share = volumes[at[..., 2] < 0.15].sum() / volumes.sum()
        errors.append(abs(share / (1 - 0.85**3) - 1))
    # measured 0.94, 0.02, 0.04
    assert errors[0] > 0.5 and max(errors[1:]) < 0.06
