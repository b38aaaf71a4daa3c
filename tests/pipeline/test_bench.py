"""A case of a benchmark runs in a process of its own; one that fails says why."""

import pytest

from pipeline import bench_corrosion
from pipeline.bench_case import in_own_process, peak_memory, published_screw


def test_a_case_in_its_own_process_has_its_own_peak_memory():
    ballast = bytearray(600_000_000)
    ballast[::4096] = b"x" * len(ballast[::4096])
    assert peak_memory() > 600e6
    found = in_own_process("solve", spacing=400e-6, m=2, ratio=100.0, threads=1)
    assert found["nodes"] > 3000 and 0 < found["unknowns"] < found["nodes"]
    assert found["iterations"] <= 20
    # 172 MB with all libraries loaded; the parent's 600 MB do not count.
    assert 20e6 < found["peak_bytes"] < 500e6


def test_a_case_that_fails_says_why():
    with pytest.raises(RuntimeError, match="solve.*spacing"):
        in_own_process("solve", spacing=-1.0, m=2, ratio=100.0)


@pytest.mark.parametrize("m", [2, 4])
def test_the_published_screw_can_be_made_coarse(m):
    scene = published_screw("Mg-5Gd", m, 2e-4)
    assert scene.horizon == pytest.approx(m * 2e-4)
    assert 30_000 < scene.domain.sum() < 36_000  # 4/3 pi 20^3 = 33,510
    assert scene.metal.sum() > 500


def test_the_screw_reports_wall_and_processor_time_of_both_marches(monkeypatch):
    def march(case, *, lean=False, **choices):
        found = {
            "volume_loss": 0.1, "steps": 9, "nodes": 100, "bonds": 32, "peak_bytes": 1e8,
            "seconds": 4.0 if lean else 40.0, "processor_seconds": 5.0 if lean else 50.0,
        }  # fmt: skip
        if lean:
            return {**found, "left_out": ["liquid"], "clean_liquid": True, "bound": 1e-6}
        return {**found, "iterations": 90, "balance_error": 1e-12}

    monkeypatch.setattr(bench_corrosion, "in_own_process", march)
    values = {r.quantity: r.value for r in bench_corrosion.screw(2e-4, (2,))}
    assert values["Mg-5Gd, m = 2: liquid everywhere"] == 40.0
    assert values["Mg-5Gd, m = 2: liquid everywhere, processor time"] == 50.0
    assert values["Mg-5Gd, m = 2: without liquid"] == 4.0
    assert values["Mg-5Gd, m = 2: its processor time"] == 5.0
