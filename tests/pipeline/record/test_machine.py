"""What child processes are told of threads and ranks."""

import os

import pytest

from pipeline.record.machine import child_environment
from pipeline.studies import workshop as study_pulls

VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OMPI_MCA_hwloc_base_binding_policy")


@pytest.fixture(autouse=True)
def threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "6")
    monkeypatch.delenv("OMPI_MCA_hwloc_base_binding_policy", raising=False)


@pytest.mark.parametrize(
    ("ranks", "given", "expected"),
    [
        (0, None, ("7", "6", None)),
        (0, 2, ("7", "2", None)),
        (1, None, ("1", "6", "none")),
        (1, 2, ("1", "2", "none")),
        (4, 1, ("1", "1", "none")),
    ],
)
def test_ranks_and_threads_of_a_child(ranks, given, expected):
    environment = child_environment(ranks, given)
    assert tuple(environment.get(name) for name in VARIABLES) == expected
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_the_pulls_of_a_study_have_one_thread_each_and_the_caller_keeps_its_own(
    monkeypatch, tmp_path
):
    seen = []

    class Pool:
        """Stands for the pool of processes, which inherit the environment at this moment."""

        def __init__(self, *arguments):
            seen.append(tuple(os.environ.get(name) for name in VARIABLES))

        def __enter__(self):
            raise KeyboardInterrupt

        def __exit__(self, *raised):
            return False

    monkeypatch.setattr(study_pulls, "ProcessPoolExecutor", Pool)
    before = dict(os.environ)
    with pytest.raises(KeyboardInterrupt):
        study_pulls.Workshop(tmp_path).pull([], 1, print)
    assert seen == [("1", "1", "none")]
    assert dict(os.environ) == before
