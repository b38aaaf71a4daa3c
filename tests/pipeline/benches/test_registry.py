"""A case of a benchmark runs in a process of its own; one that fails says why."""

import pytest

from pipeline.benches import corrosion as bench_corrosion
from pipeline.benches.case import in_own_process, peak_memory, published_screw


@pytest.mark.slow
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


@pytest.mark.parametrize("m", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_the_published_screw_can_be_made_coarse(m):
    scene = published_screw("Mg-5Gd", m, 2e-4)
    assert scene.horizon == pytest.approx(m * 2e-4)
    assert 30_000 < scene.domain.sum() < 36_000  # 4/3 pi 20^3 = 33,510
    assert scene.metal.sum() > 500


def test_the_screw_reports_times_and_splits_the_difference_of_both_marches(monkeypatch):
    def march(case, *, lean=False, steps=None, rate_change=0.05, **choices):
        loss = 0.1 if lean else 0.1004 if rate_change == 0.05 else 0.1001
        found = {
            "volume_loss": loss, "steps": 9, "nodes": 100, "bonds": 32, "peak_bytes": 1e8,
            "seconds": 4.0 if lean else 40.0, "processor_seconds": 5.0 if lean else 50.0,
        }  # fmt: skip
        if lean:
            assert steps == [1.0, 2.0]  # those of the default march
            return {
                **found, "left_out": ["liquid"], "clean_liquid": True, "bound": 1e-6,
                "clean_losses": [0.05, 0.1004 * (1 + 1e-7)],
            }  # fmt: skip
        return {
            **found, "iterations": 90, "balance_error": 1e-12, "step_lengths": [1.0, 2.0],
            "losses": [0.05 * (1 + 4e-7), 0.1004],
        }  # fmt: skip

    monkeypatch.setattr(bench_corrosion, "in_own_process", march)
    results = bench_corrosion.screw(2e-4, (2,))
    values = {r.quantity: r.value for r in results}
    targets = {r.quantity: r.target for r in results}
    assert values["Mg-5Gd, m = 2: liquid everywhere"] == 40.0
    assert values["Mg-5Gd, m = 2: liquid everywhere, processor time"] == 50.0
    assert values["Mg-5Gd, m = 2: without liquid"] == 4.0
    assert values["Mg-5Gd, m = 2: its processor time"] == 5.0
    name = "Mg-5Gd, m = 2"
    for quantity, value, target in (
        (f"{name}: change of the volume loss by halving it, relative", 3e-3, "<= 1e-3"),
        (f"{name}: full against lean, relative", 4e-3, None),
        (f"{name}: with half the control target: full against lean", 1e-3, None),
        (f"{name}: of it the time-integration error (same steps, liquid left out)", 4e-3,
         "<= 1e-3"),
        (f"{name}: of it the liquid (same steps)", 1e-7, "<= 1e-06"),
        (f"{name}: the same, largest over all steps", 4e-7, "<= 1e-06"),
    ):  # fmt: skip
        assert values[quantity] == pytest.approx(value, rel=5e-3), quantity
        assert targets[quantity] == target, quantity
