"""Shares of the doubt, and what one more measurement leaves, on sums that are known."""

import numpy as np
import pytest

from pipeline.campaigns.doubts import after_one_more, half_range, shares_of_constants
from pipeline.record.doubts import HoldDoubts, Next, Source, read_doubts, write_doubts

RANDOM = np.random.default_rng(0)
LOGS = RANDOM.standard_normal((4000, 2))


def test_independent_constants_share_the_variance_as_their_squares():
    found = shares_of_constants(LOGS, 3.0 * LOGS[:, 0] + LOGS[:, 1])
    assert found == pytest.approx([0.9, 0.1], abs=0.03)  # chance correlation of 4000
    # a curve through one constant is that constant's alone
    assert shares_of_constants(LOGS, LOGS[:, 0] ** 3) == pytest.approx([1.0, 0.0], abs=0.01)


def test_correlated_constants_overlap():
    logs = np.stack([LOGS[:, 0], -0.94 * LOGS[:, 0] + np.sqrt(1 - 0.94**2) * LOGS[:, 1]], axis=1)
    found = shares_of_constants(logs, logs[:, 0])
    assert found == pytest.approx([1.0, 0.94**2], abs=0.01)


def test_what_does_not_vary_carries_nothing():
    assert not shares_of_constants(LOGS, np.ones(len(LOGS))).any()
    assert shares_of_constants(np.ones((9, 1)), np.arange(9.0)) == pytest.approx([0.0])


def test_one_more_measurement_leaves_what_bayes_says():
    """W = 2 M + noise: var(W | y) = 4 s^2 v/(v + s^2) + noise, v the variance of M."""
    measured = LOGS[:, :1]
    wanted = 2.0 * measured[:, 0] + 0.5 * LOGS[:, 1]
    for scatter in (0.1, 1.0, 10.0):
        exact = 4.0 * scatter**2 / (1.0 + scatter**2) + 0.25
        assert after_one_more(measured, wanted, scatter)[0] ** 2 == pytest.approx(exact, rel=0.05)
    assert after_one_more(measured, wanted, 1e9)[0] == pytest.approx(wanted.std())


def test_a_range_is_even_between_its_ends():
    assert half_range([0.0, 0.3, 1.0]) == pytest.approx(np.linspace(0, 1, 100001).std(), rel=1e-4)


def test_doubts_come_back_from_their_file(tmp_path):
    row = Next(7.0, 0.01, 0.02)
    source = Source("horizon", None, None, None, "why")
    found = [
        HoldDoubts("A", "slot", 84.0, 0.1, 0.8, -1.0, (source,), {"l": 0.5}, row, (row,), 0.01)
    ]
    write_doubts(tmp_path / "doubts.json", found)
    assert read_doubts(tmp_path / "doubts.json") == found
    assert read_doubts(tmp_path / "none.json") == []
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(ValueError, match="cannot be read"):
        read_doubts(tmp_path / "other.json")
