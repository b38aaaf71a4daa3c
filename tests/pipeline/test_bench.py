"""A case of a benchmark runs in a process of its own; one that fails says why."""

import pytest

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
