"""Couples on 1, 2 and 4 MPI ranks beside the same in one process."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from peri.coupled.galvanic import corrode
from tests.peri.coupled import galvanic_rank_cases as cases

ROOT = Path(__file__).resolve().parents[3]
RANKS = (1, 2, 4)
OPEN = ("faraday_error", "imbalance", "balance_error")

pytest.importorskip("petsc4py")
pytestmark = pytest.mark.skipif(shutil.which("mpirun") is None, reason="mpirun is not installed")


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory):
    """Results of galvanic_rank_cases and its checkpoint by number of ranks, each run once."""
    found = {}

    def results(ranks):
        if ranks not in found:
            path = tmp_path_factory.mktemp("couples") / f"{ranks}.npz"
            environment = os.environ | {
                "NUMBA_NUM_THREADS": "1",
                "PYTHONPATH": str(ROOT),
                "OMPI_MCA_mpi_yield_when_idle": "1",
            }
            script = ROOT / "tests" / "peri" / "coupled" / "galvanic_rank_cases.py"
            done = subprocess.run(
                ["mpirun", "--oversubscribe", "-n", str(ranks), sys.executable, script, path],
                env=environment, capture_output=True, text=True, timeout=300,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr[-3000:]
            found[ranks] = dict(np.load(path)), Path(f"{path}.h5")
        return found[ranks]

    return results


@pytest.fixture(scope="module")
def embedded():
    """The same marches in this process, fields and history by name."""
    found = {}
    for name, (make, times, renewal) in cases.MARCHES.items():
        result = corrode(make(), times, renewal, solver_tolerance=cases.TOLERANCE)
        found[name] = {**result.fields, **result.history}
    return found


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("name", cases.MARCHES)
def test_a_couple_on_ranks_is_that_of_one_process(name, ranks, on_ranks, embedded):
    arrays, expected = on_ranks(ranks)[0], embedded[name]
    amount = expected["metal_amount"]
    assert amount[-1] < 0.95 * amount[0]  # metal is lost
    if name == cases.STOPPED:
        assert expected["salt_amount"][-1] > 0
    for key, values in expected.items():
        got = arrays[f"{name}/{key}"]
        if key in OPEN:
            assert np.abs(got).max() < 1e-12, key
        elif values.dtype == bool or key in ("dissolved_nodes", "time"):
            np.testing.assert_array_equal(got, values, err_msg=key)
        elif key not in ("newton", "iterations"):
            # measured at most 7e-13 of the largest
            scale = np.nanmax(np.abs(values))
            np.testing.assert_allclose(got, values, rtol=0, atol=1e-10 * scale, err_msg=key)
    iterations = arrays[f"{name}/iterations"].sum()
    assert 0 < iterations <= 1.3 * expected["iterations"].sum()


def test_a_march_on_ranks_goes_on_there_and_in_one_process(on_ranks, embedded):
    make, times, renewal = cases.MARCHES[cases.STOPPED]
    for ranks in RANKS:
        arrays, _ = on_ranks(ranks)
        # what the root raised in a report has ended the others, which report nothing
        assert list(arrays["stopped"][1:]) == [0] * (ranks - 1) and arrays["stopped"][0] > 2
        for key in embedded[cases.STOPPED]:
            np.testing.assert_array_equal(
                arrays[f"resumed/{key}"], arrays[f"{cases.STOPPED}/{key}"], err_msg=key
            )
    file = on_ranks(2)[1]
    resumed = corrode(
        make(), times, renewal, checkpoint=file, resume=True, solver_tolerance=cases.TOLERANCE
    )
    expected = embedded[cases.STOPPED]
    np.testing.assert_allclose(
        resumed.history["metal_amount"], expected["metal_amount"], rtol=1e-10
    )


@pytest.mark.parametrize("ranks", RANKS)
def test_refusals_reach_every_rank(ranks, on_ranks):
    arrays, _ = on_ranks(ranks)
    for name, words in (("mirrors", "robin: 'as_published'"), ("no sink", "needs a sink")):
        assert len(arrays[name]) == ranks and all(words in said for said in arrays[name])
