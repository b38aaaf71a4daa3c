"""The benchmark of the ions in its small version: what is conserved, and that minerals form."""

import pytest

from pipeline.benches.registry import BENCHMARKS


@pytest.mark.slow
def test_the_small_benchmark_meets_what_does_not_depend_on_the_machine() -> None:
    results = {r.quantity: r.value for r in BENCHMARKS["nnpp"].small()}
    assert results["lowest concentration"] >= 0
    assert results["net charge over ionic strength"] <= 1e-12
    assert results["balance of the worst component"] <= 1e-10
    assert results["180 um: V_L against steps of a quarter"] <= 1e-3
    assert results["180 um: pH against steps of a quarter"] <= 0.005
    assert results["calcite after eight weeks"] > 0
    assert results["hydroxyapatite after eight weeks"] > 0
    assert results["three minerals and potential: median step of 3 h"] > 0


@pytest.mark.slow
def test_the_small_published_lattice_is_neutral_and_conservative() -> None:
    results = {r.quantity: r.value for r in BENCHMARKS["nnpp-published"].small()}
    assert results["lowest concentration"] >= 0
    assert results["net charge over ionic strength"] <= 1e-12
    assert results["balance of the worst component"] <= 1e-10
    assert 0 < results["peak memory of the process"] < 8 and results["nodes"] > 1e4


@pytest.mark.slow
def test_the_small_saline_benchmark_is_neutral_and_conservative() -> None:
    results = {r.quantity: r.value for r in BENCHMARKS["nnpp-saline"].small()}
    assert results["lowest concentration"] >= 0
    assert results["net charge over ionic strength"] <= 1e-12
    assert results["balance of the worst component"] <= 1e-10
    assert 0 < results["volume loss"] < 0.1 and results["highest pH"] > 8
    assert results["26 days in such steps, from those measured"] > 0


@pytest.mark.slow
def test_the_steps_alone_can_be_had() -> None:
    results = {r.quantity: r.value for r in BENCHMARKS["nnpp-steps"].small()}
    steps = [value for name, value in results.items() if name.endswith("median step of 3 h")]
    assert len(steps) == 3 and 0 < sum(steps) < results["all of these steps"]
