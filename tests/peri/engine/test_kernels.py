"""The serial and the threaded version of a compiled loop: same sums, each with its own cache."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from peri.engine import compiled, kernels

ROOT = Path(__file__).parents[3]


def test_both_versions_add_the_same():
    random = np.random.default_rng(1)
    small, large = (random.random((n,) * 3) for n in (8, 60))
    assert small.size < compiled._THREADED_FROM < large.size
    for values in (small, large):
        found = kernels.inner_product(values, values).sum()
        # The threads' parts are added in another order: measured 0
        np.testing.assert_allclose(found, (values**2).sum(), rtol=1e-13)


def test_the_cache_keeps_both_versions_apart(tmp_path):
    """One file for both would serve whichever was compiled first, whatever the size."""
    code = (
        "import numpy as np; from peri.engine import multigrid_kernels\n"
        "for n in (8, 60):\n"
        "    multigrid_kernels.add_to(np.zeros((n,) * 3), np.ones((n,) * 3))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=tmp_path)
    assert len(list(tmp_path.rglob("multigrid_kernels.add_to*.nbi"))) == 2


def test_the_residual_of_a_stage_is_that_of_its_formula():
    random = np.random.default_rng(2)
    shape, reach = (9, 8, 12), (2, 1, 2)
    y, old, gain, weight, diagonal = random.random((5, *shape))
    low = random.integers(0, 4, (5, 6))
    high = low + random.integers(0, 4, (5, 6))
    rows = np.zeros(shape, bool)
    for i, j in np.ndindex(*low.shape):
        rows[i + 2, j + 1, low[i, j] + 2 : high[i, j] + 2] = True
    assert 0 < rows.sum() < 5 * 6 * 8
    expected = np.where(rows, weight * (old / 0.3 - diagonal * y + 7.0 * gain), gain)
    squares = kernels.stage_residual(y, old, gain, weight, diagonal, 7.0, 0.3, low, high, reach)
    # measured 4e-16 and 1e-16: another order of additions
    np.testing.assert_allclose(gain, expected, rtol=0, atol=1e-14)
    assert abs(squares.sum() / ((weight * old)[rows] ** 2).sum() - 1) < 1e-14
