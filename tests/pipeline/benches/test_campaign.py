"""The benchmark of campaigns gives its rows on two samples of a coarse pin."""

import pytest

from pipeline.benches.campaign import small_campaign


@pytest.mark.slow
def test_two_samples_share_the_geometry_and_the_intact_solid():
    rows = {row.quantity: row.value for row in small_campaign()}
    assert rows["geometries made"] == 1 and rows["scenes that failed"] == 0
    # two samples and the intact solid, whose set has constants of its own
    assert rows["marches"] == 3 and rows["mechanical tests"] == 3
    low, high = (rows[f"strength left, {e} of the samples"] for e in ("least", "largest"))
    assert 0.3 < low < high < 1
