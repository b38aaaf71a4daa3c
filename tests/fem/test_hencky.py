"""Spectral decomposition and the divided difference of the logarithm."""

import numpy as np
import pytest

from fem.constitutive.hencky import eigen_symmetric, invert, log_divided_difference

RNG = np.random.default_rng(3)


def _rotation():
    q, r = np.linalg.qr(RNG.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


@pytest.mark.parametrize(
    "stretches",
    [
        (1.0, 1.0, 1.0),
        (2.0, 1.0, 1.0),
        (1.0, 1.0 + 1e-9, 1.0 - 1e-12),
        (1e-6, 1.0, 1e6),
        (3.0, 2.0, 0.5),
    ],
)
def test_decomposition_reproduces_the_matrix(stretches):
    for _ in range(20):
        rotation = _rotation()
        matrix = rotation @ np.diag(stretches) @ rotation.T
        matrix = 0.5 * (matrix + matrix.T)
        values, vectors = np.empty(3), np.empty((3, 3))
        eigen_symmetric(matrix.copy(), values, vectors)
        # measured 9e-16 of the largest eigenvalue, and 9e-16 for orthonormality
        assert abs(vectors @ np.diag(values) @ vectors.T - matrix).max() < 1e-14 * max(stretches)
        assert abs(vectors.T @ vectors - np.eye(3)).max() < 1e-14


def test_divided_difference_is_smooth_through_equal_arguments():
    for second in (0.3, 1.0, 7.0):
        assert log_divided_difference(second, second) == pytest.approx(1 / second, rel=1e-15)
        for relative in (1e-12, 1e-8, 1e-5, 0.999e-3, 1.001e-3, 0.1, -0.5, 30.0):
            first = second * (1 + relative)
            exact = np.log1p((first - second) / second) / (first - second)
            # series truncated at the seventh power below 1e-3: measured 3e-16
            assert log_divided_difference(first, second) == pytest.approx(exact, rel=1e-14)


def test_inverse_and_determinant():
    matrix = RNG.normal(size=(3, 3)) + 2 * np.eye(3)
    inverse = np.empty((3, 3))
    assert invert(matrix, inverse) == pytest.approx(np.linalg.det(matrix), rel=1e-13)
    assert abs(inverse @ matrix - np.eye(3)).max() < 1e-13  # measured 4e-16, condition 16
    assert invert(np.zeros((3, 3)), inverse) == 0.0
