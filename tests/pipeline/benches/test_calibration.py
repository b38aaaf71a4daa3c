"""The benchmark of calibration, its small version."""

import pytest

from pipeline.benches.registry import run_benchmark


@pytest.mark.slow
def test_small_calibration():
    results = run_benchmark("calibration", small=True)["results"]
    value = {row["quantity"]: row["value"] for row in results}
    assert value["starts that end at the one optimum"] == 50
    assert value["effective samples"] >= 100
    assert 0 < value["one V_L curve with derivatives, processor time"] < 1000
