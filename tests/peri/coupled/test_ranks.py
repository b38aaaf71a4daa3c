"""Metal and ions on 1, 2 and 4 MPI ranks against one process."""

import numpy as np
import pytest

from peri.engine.march.marching import March
from peri.engine.processes import ONE_PROCESS
from tests.peri.coupled import rank_cases
from tests.peri.coupled.rank_cases import CASES, STOPPED, marched, problem_of
from tests.ranks import OnRanks, needs_mpirun

FAST = ("goes",)
"""Run on two ranks by default; with `slow` every case on 1, 2 and 4."""

RESTS = {"volume_loss": 1e-14, "psi": 1e-14, "potential": 1e-15, "largest_potential": 1e-15}
"""What is a rest of 1 or of RT/F (27 mV), to that much: measured 1e-16, 5e-16, 2e-17."""
OF_THE_METAL = ("liquid_amount", "released_amount", "hydrogen_amount")
"""Differences of the metal's amount, known to 1e-12 of that: measured 3e-13."""
FREE = ("mixed/history/applied_charge", "dilute/history/applied_charge")
ROUND_OFF = ("iterations", "balance", "balance_error", "element_error", "net_charge")
"""What is not compared number by number; a free potential lets no charge through, either."""

pytest.importorskip("petsc4py")
pytestmark = needs_mpirun

slow = pytest.mark.slow
RUNS = [
    *(pytest.param(name, 2, FAST, id=f"{name}-2") for name in FAST),
    *(
        pytest.param(name, ranks, tuple(CASES), id=f"{name}-{ranks}-all", marks=slow)
        for ranks in (1, 2, 4)
        for name in CASES
    ),
]
STOPS = [run for run in RUNS if run.values[0] in STOPPED]


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory):
    """Results of rank_cases by number of ranks and cases, each run once."""
    return OnRanks(rank_cases.__name__, tmp_path_factory.mktemp("ranks"), timeout=1500.0)


@pytest.fixture(scope="module")
def alone():
    """Results of a case in this process, each run once."""
    found = {}

    def results(name):
        if name not in found:
            problem = problem_of(name)
            found[name] = rank_cases.results(name, problem, marched(name, problem))
        return found[name]

    return results


@pytest.mark.parametrize(("name", "ranks", "names"), RUNS)
def test_ranks_find_what_one_process_does(name, ranks, names, on_ranks, alone):
    arrays, expected = on_ranks(ranks, names), alone(name)
    assert arrays["ranks"] == ranks
    # The state is not trivial: metal is lost, and what the case is for comes to pass.
    assert expected[f"{name}/history/volume_loss"][-1] > 1e-7
    if name in ("brucite", "calcite", "closed"):
        assert expected[f"{name}/history/{name.replace('closed', 'brucite')}_amount"][-1] > 0
    if name.endswith("goes"):
        assert expected[f"{name}/history/dissolved_nodes"].sum() > 5
    for field in ("time", "step", "dissolved_nodes", "saturated_nodes"):
        key = f"{name}/history/{field}"
        np.testing.assert_array_equal(arrays[key], expected[key])
    np.testing.assert_array_equal(arrays[f"{name}/metal"], expected[f"{name}/metal"])
    compared, metal = 0, expected[f"{name}/history/metal_amount"][0]
    for key, values in expected.items():
        if key.rpartition("/")[2] in ROUND_OFF or key.endswith(FREE):
            continue
        assert arrays[key].shape == values.shape, key
        np.testing.assert_array_equal(np.isnan(arrays[key]), np.isnan(values), err_msg=key)
        finite = np.isfinite(values)
        scale = np.abs(values[finite]).max(initial=1e-300)
        off = np.abs(arrays[key][finite].astype(float) - values[finite]).max(initial=0.0)
        # Measured up to 1e-11 of the whole field.
        share, last = 2e-7 if values.dtype == np.float32 else 1e-10, key.rpartition("/")[2]
        rest = RESTS.get(last, 1e-12 * metal if last in OF_THE_METAL else 0.0)
        assert off <= share * scale + rest, key
        compared += 1
    assert compared > 15


@pytest.mark.parametrize(
    ("ranks", "names"),
    [(2, FAST), *(pytest.param(n, tuple(CASES), marks=slow) for n in (1, 2, 4))],
)
def test_sums_and_errors_are_those_of_all_ranks(ranks, names, on_ranks):
    arrays = on_ranks(ranks, names)
    whole = rank_cases.reductions(ONE_PROCESS, slice(0, None))
    assert arrays["reductions/said"].tolist() == [whole["said"]] * ranks
    assert arrays["reductions/first"].tolist() == [False] * (ranks - 1) + [True]
    for name in ("added", "largest", "norm", "row_norms", "least_squares"):
        for found in arrays[f"reductions/{name}"]:
            np.testing.assert_allclose(found, whole[name], rtol=1e-13, err_msg=name)


@pytest.mark.parametrize(("name", "ranks", "names"), RUNS)
def test_balances_hold_on_ranks(name, ranks, names, on_ranks, alone):
    arrays = on_ranks(ranks, names)
    assert arrays[f"{name}/balance"].max() < 1e-10
    assert arrays[f"{name}/net_charge"].max() < 1e-12
    assert arrays[f"{name}/lowest"].min() > 0
    errors = arrays.get(f"{name}/history/element_error", np.zeros(1))
    assert errors.max() < 1e-10
    iterations = arrays[f"{name}/history/iterations"].sum()
    assert 0 < iterations <= 1.15 * alone(name)[f"{name}/history/iterations"].sum()


@pytest.mark.parametrize(("name", "ranks", "names"), STOPS)
def test_a_checkpoint_of_ranks_is_resumed_there_and_in_one_process(
    name, ranks, names, on_ranks, alone
):
    arrays = on_ranks(ranks, names)
    reports = np.array([STOPPED[name]] + [0] * (ranks - 1))
    np.testing.assert_array_equal(arrays[f"stopped/{name}"], reports)
    for key in alone(name):
        np.testing.assert_array_equal(arrays[f"resumed/{key}"], arrays[key], err_msg=key)
    problem = problem_of(name)
    done: March = marched(
        name, problem, resume=True, checkpoint_every=1e9,
        checkpoint=on_ranks.file(ranks, names, f".{name}"),
    )  # fmt: skip
    expected = alone(name)[f"{name}/history/volume_loss"]
    assert len(done.history["time"]) == len(expected)
    np.testing.assert_allclose(done.history["volume_loss"], expected, rtol=0, atol=1e-11)
    ph = alone(name)[f"{name}/ph"]
    found = np.array([output["ph"] for output in done.outputs])
    np.testing.assert_allclose(found, ph, rtol=0, atol=1e-6)  # single precision
