"""The benchmark of galvanic corrosion runs small, and says what it is held to."""

from pipeline.benches.galvanic import galvanic


def test_it_counts_newton_steps_and_balances():
    results = {r.quantity: r for r in galvanic((12,), 1e-3)}
    assert 0 < results["potential, 1728 nodes: Newton steps"].value <= 8
    assert 0 < results["potential, 1728 nodes: CG iterations of a Newton step"].value <= 20
    open_ended = [r for name, r in results.items() if "left open" in name]
    assert len(open_ended) == 3 and all(r.value < 1e-12 for r in open_ended)
    assert results["potential, 1728 nodes, from scratch"].target == "<= 12 (2e6 nodes)"
