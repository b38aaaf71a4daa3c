"""The benchmark of the operators on a few nodes: every kind is there, and converges."""

from pipeline.benches import operators as bench_operators


def test_every_kind_is_measured():
    results = {r.quantity: r.value for r in bench_operators.operators(14, 2)}
    for name in bench_operators.KINDS:
        assert results[f"{name}: product"] > 0
        (iterations,) = (v for k, v in results.items() if k.startswith(f"{name}: iterations"))
        assert 3 <= iterations <= 20  # measured 5 to 18
    assert results["odd weights: sum over that of even ones"] > 0
    assert results["convolution: product over the convolution's"] == 1.0
