"""Engines that cannot serve are refused in a sentence; a stand-in for Dask answers for it."""

import sys
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from pipeline.campaigns.engines import dask, local, mpi
from pipeline.record.machine import processor_cores


class Client:
    """As distributed.Client, for workers of 4e9 bytes and two threads; one does not see files."""

    blind = False
    silent = False

    def __init__(self, address, timeout):
        if self.silent:
            raise TimeoutError
        self.address = address

    def wait_for_workers(self, count, timeout):
        pass

    def scheduler_info(self, workers):
        return {"workers": {"a": {"memory_limit": 4e9, "nthreads": 2}}}

    def get_executor(self):
        return ThreadPoolExecutor(1)

    def run(self, ask, path):
        return {"a": ask(path) and not self.blind}

    def close(self):
        pass


@pytest.fixture
def stand_in(monkeypatch):
    """`distributed` with this client."""
    client = type("Client", (Client,), {})
    monkeypatch.setitem(
        sys.modules, "distributed", SimpleNamespace(Client=client, LocalCluster=None)
    )
    return client


def test_dask_says_what_a_task_may_take(stand_in, tmp_path):
    with dask(None, "tcp://host:8786") as crew:
        assert crew.memory == 2e9 and crew.threads == 1
        crew.check_store(tmp_path)
        with pytest.raises(ValueError, match="3.0 GB of memory and a worker has 2.0 GB"):
            crew.check_memory(3e9, "a task")
    assert list(tmp_path.iterdir()) == []


def test_a_store_that_workers_do_not_see_is_refused(stand_in, tmp_path):
    stand_in.blind = True
    with (
        dask(None, "tcp://host:8786") as crew,
        pytest.raises(ValueError, match="is not seen by worker a"),
    ):
        crew.check_store(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_that_does_not_answer_is_refused(stand_in):
    stand_in.silent = True
    with (
        pytest.raises(ValueError, match="tcp://host:8786'; it does not answer within 10 s"),
        dask(None, "tcp://host:8786"),
    ):
        pass


def test_dask_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ValueError, match=r"which is not installed; install perilife\[cluster\]"),
        dask(None, None),
    ):
        pass


@pytest.mark.parametrize("engine", [local, mpi])
def test_an_address_is_for_dask(engine):
    with pytest.raises(ValueError, match="--scheduler goes with --engine dask"), engine(1, "a:1"):
        pass


def test_workers_of_this_machine_share_its_cores():
    with local(1, None) as crew:
        assert crew.threads == processor_cores()
    with local(1000, None) as crew:
        assert crew.threads == 1
