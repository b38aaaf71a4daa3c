"""Spectral decomposition, the shear factor of the logarithmic strain, the inverse."""

import numpy as np
import pytest

from fem.constitutive.hencky import _decompose_by_rotations, decompose, invert, shear_factor

RNG = np.random.default_rng(3)


def _rotation():
    q, r = np.linalg.qr(RNG.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


@pytest.mark.parametrize("method", [decompose, _decompose_by_rotations])
@pytest.mark.parametrize(
    "stretches",
    [
        (1.0, 1.0, 1.0),
        (2.0, 1.0, 1.0),
        (2.0, 2.0, 1.0),
        (1.0, 1.0 + 1e-9, 1.0 - 1e-12),
        (1.0, 1.0 + 1e-3, 1.0 + 1e-5),
        (1e-6, 1.0, 1e6),
        (3.0, 2.0, 0.5),
    ],
)
def test_decomposition_reproduces_the_matrix(stretches, method):
    for rotation in [np.eye(3)[:, [2, 0, 1]], *(_rotation() for _ in range(20))]:
        matrix = rotation @ np.diag(stretches) @ rotation.T
        matrix = 0.5 * (matrix + matrix.T)
        values, *vectors = method(tuple(matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]))
        vectors = np.array(vectors).T
        # measured 1e-15 of the largest eigenvalue, and 9e-16 for orthonormality
        assert abs(vectors @ np.diag(values) @ vectors.T - matrix).max() < 1e-14 * max(stretches)
        assert abs(vectors.T @ vectors - np.eye(3)).max() < 1e-14


def test_methods_of_decomposition_agree_where_one_takes_over_from_the_other():
    """Small eigenvalues around a tenth of the mean: closed form above, rotations below."""
    for smallest in (0.05, 0.09, 0.11, 0.2):
        rotation = _rotation()
        matrix = rotation @ np.diag([smallest, 1.0, 2.0]) @ rotation.T
        symmetric = tuple(matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        for method in (decompose, _decompose_by_rotations):
            # measured 9e-16
            assert sorted(method(symmetric)[0]) == pytest.approx([smallest, 1.0, 2.0], rel=1e-14)


def test_shear_factor_is_smooth_through_equal_strains():
    assert shear_factor(0.0) == 1.0
    for difference in (1e-12, 1e-8, 1e-4, 0.0999, 0.1001, -0.0999, -0.1001, 0.5, -3.0):
        # x coth x by squared stretches: (ln a - ln b) / 2 (a + b) / (a - b), without cancellation
        exact = difference * (1.0 + 2.0 / np.expm1(2.0 * difference))
        # series truncated at the tenth power below 0.1: measured 3e-16
        assert shear_factor(difference) == pytest.approx(exact, rel=1e-14)


def test_inverse_and_determinant():
    matrix = RNG.normal(size=(3, 3)) + 2 * np.eye(3)
    determinant, inverse = invert(tuple(matrix.ravel()))
    assert determinant == pytest.approx(np.linalg.det(matrix), rel=1e-13)
    assert abs(np.reshape(inverse, (3, 3)) @ matrix - np.eye(3)).max() < 1e-13  # measured 4e-16
    assert invert((0.0,) * 9)[0] == 0.0
