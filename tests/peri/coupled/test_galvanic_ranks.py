"""Couples on 1, 2 and 4 MPI ranks beside the same in one process."""

import numpy as np
import pytest

from peri.coupled.galvanic import corrode
from tests.peri.coupled import galvanic_rank_cases as cases
from tests.ranks import OnRanks, needs_mpirun

FAST = (cases.STOPPED, "ball")
"""Run on two ranks by default; with `slow` every case on 1, 2 and 4."""
OPEN = ("faraday_error", "imbalance", "balance_error")
RUNS = ((2, FAST), *(pytest.param(n, (), marks=pytest.mark.slow) for n in (1, 2, 4)))

pytest.importorskip("petsc4py")
pytestmark = needs_mpirun


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory):
    """Results of galvanic_rank_cases by number of ranks, each run once."""
    return OnRanks(cases.__name__, tmp_path_factory.mktemp("couples"))


@pytest.fixture(scope="module")
def embedded():
    """The same marches in this process, fields and history by name, each run once."""
    found = {}

    def results(name):
        if name not in found:
            make, times, renewal = cases.MARCHES[name]
            result = corrode(make(), times, renewal, solver_tolerance=cases.TOLERANCE)
            found[name] = {**result.fields, **result.history}
        return found[name]

    return results


@pytest.mark.parametrize(("ranks", "names"), RUNS)
def test_a_couple_on_ranks_is_that_of_one_process(ranks, names, on_ranks, embedded):
    arrays = on_ranks(ranks, names)
    for name in names or cases.MARCHES:
        expected = embedded(name)
        amount = expected["metal_amount"]
        assert amount[-1] < 0.95 * amount[0]  # metal is lost
        if name == cases.STOPPED:
            assert expected["salt_amount"][-1] > 0
        for key, values in expected.items():
            got, what = arrays[f"{name}/{key}"], f"{name}/{key}"
            if key in OPEN:
                assert np.abs(got).max() < 1e-12, what
            elif values.dtype == bool or key in ("dissolved_nodes", "time"):
                np.testing.assert_array_equal(got, values, err_msg=what)
            elif key not in ("newton", "iterations"):
                # measured at most 7e-13 of the largest
                scale = np.nanmax(np.abs(values))
                np.testing.assert_allclose(got, values, rtol=0, atol=1e-10 * scale, err_msg=what)
        iterations = arrays[f"{name}/iterations"].sum()
        assert 0 < iterations <= 1.3 * expected["iterations"].sum()


@pytest.mark.parametrize(("ranks", "names"), RUNS)
def test_a_march_on_ranks_goes_on_there_and_in_one_process(ranks, names, on_ranks, embedded):
    make, times, renewal = cases.MARCHES[cases.STOPPED]
    arrays, expected = on_ranks(ranks, names), embedded(cases.STOPPED)
    # what the root raised in a report has ended the others, which report nothing
    assert list(arrays["stopped"][1:]) == [0] * (ranks - 1) and arrays["stopped"][0] > 2
    for key in expected:
        np.testing.assert_array_equal(
            arrays[f"resumed/{key}"], arrays[f"{cases.STOPPED}/{key}"], err_msg=key
        )
    resumed = corrode(
        make(), times, renewal, resume=True, solver_tolerance=cases.TOLERANCE,
        checkpoint=on_ranks.file(ranks, names, ".h5"),
    )  # fmt: skip
    np.testing.assert_allclose(
        resumed.history["metal_amount"], expected["metal_amount"], rtol=1e-10
    )


@pytest.mark.parametrize(("ranks", "names"), RUNS)
def test_refusals_reach_every_rank(ranks, names, on_ranks):
    arrays = on_ranks(ranks, names)
    for name, words in (("mirrors", "robin: 'as_published'"), ("no sink", "needs a sink")):
        assert len(arrays[name]) == ranks and all(words in said for said in arrays[name])
