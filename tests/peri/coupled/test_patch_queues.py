"""What a current takes from the nodes behind it, against plain loops."""

import numpy as np
import pytest
from scipy import sparse

from peri.coupled.patch_queues import drain, spill


def queues(seed, patches=7, nodes=40):
    """Contents, some of them zero, and shares: each node behind one patch at most."""
    rng = np.random.default_rng(seed)
    content = rng.uniform(0.0, 2.0, nodes) * (rng.uniform(size=nodes) > 0.2)
    owner = rng.integers(0, patches + 2, nodes)  # some nodes behind none
    shares = rng.uniform(0.1, 1.0, nodes)
    dense = np.where(owner[None, :] == np.arange(patches)[:, None], shares[None, :], 0.0)
    dense /= np.maximum(dense.sum(axis=1, keepdims=True), 1e-300)
    return content, sparse.csr_matrix(dense), rng.uniform(0.0, 4.0, patches)


def plain_drain(content, drawn, demand):
    """One patch after the other, from one empty node to the next."""
    left, unmet = content.copy(), demand.copy()
    for patch, row in enumerate(drawn.toarray()):
        while unmet[patch] > 0:
            there = np.flatnonzero((row > 0) & (left > 0))
            if not there.size:
                break
            share = row[there] / row[there].sum()
            first = np.argmin(left[there] / share)
            take = min(unmet[patch], left[there][first] / share[first])
            empty = take == left[there][first] / share[first]
            left[there] = np.maximum(left[there] - take * share, 0.0)
            left[there[first]] = 0.0 if empty else left[there[first]]
            unmet[patch] -= take
    return left, unmet


@pytest.mark.parametrize("seed", range(5))
def test_drain_is_the_plain_loop_and_conserves(seed):
    content, drawn, demand = queues(seed)
    left, unmet = drain(content, drawn, demand)
    expected, missing = plain_drain(content, drawn, demand)
    np.testing.assert_allclose(left, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(unmet, missing, rtol=0, atol=1e-14)
    assert (left >= 0).all() and ((left == 0) > (content == 0)).any()
    # round-off
    assert content.sum() - left.sum() == pytest.approx((demand - unmet).sum(), rel=1e-14)


def test_drain_does_not_depend_on_the_parts_of_a_demand():
    content, drawn, demand = queues(11)
    at_once, _ = drain(content, drawn, demand)
    by_parts = content
    for share in (0.25, 0.5, 0.25):
        by_parts, _ = drain(by_parts, drawn, share * demand)
    np.testing.assert_allclose(by_parts, at_once, rtol=0, atol=1e-13)


def test_spill_takes_from_the_nearest_and_says_what_is_missing():
    content = np.array([0.0, 1.0, 1.0, 1.0])
    place = np.arange(4.0)[:, None]
    unmet = spill(content, place, place[:1], np.array([1.5]), np.arange(4))
    np.testing.assert_array_equal(content, [0.0, 0.0, 0.5, 1.0])
    assert unmet.tolist() == [0.0]
    unmet = spill(content, place, place[:1], np.array([5.0]), np.arange(4))
    assert not content.any() and unmet.tolist() == [3.5]
