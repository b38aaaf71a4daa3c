"""The benchmark of pits runs small, and says what it is held to."""

import pytest

from pipeline.benches.localised import pitting


@pytest.mark.slow
def test_pitting_compares_rates_and_marches_a_lacy_cover():
    results = {r.quantity: r for r in pitting((24, 24, 20), 2.0)}
    for scheme in ("explicit", "implicit"):
        ratio = results[f"{scheme} step, local rates over one rate"]
        assert ratio.value > 0.3 and ratio.target == "<= 1.3"
    assert results["lacy cover: balance error"].value < 1e-12
    assert results["lacy cover: width of the pit"].value > 10.0
