"""Where the tasks of a campaign run: anything that is a `concurrent.futures.Executor`.

local: as many child processes as asked for.  dask: a scheduler of Dask distributed, on one machine,
over ssh or under a batch system, behind one address.  mpi: the ranks of an mpirun, by
`mpirun -n N python -m mpi4py.futures -m pipeline.cli campaign ...`.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from pipeline.record.machine import processor_cores

PATIENCE = 10.0
"""Seconds that a scheduler has to answer."""


@contextmanager
def local(workers: int | None, address: str | None, store: Path) -> Iterator[Executor]:
    """Child processes of this one; a thread waits for each."""
    if address is not None:
        raise ValueError("--scheduler goes with --engine dask, which must be given too")
    with ThreadPoolExecutor(workers or processor_cores()) as executor:
        yield executor


@contextmanager
def dask(workers: int | None, address: str | None, store: Path) -> Iterator[Executor]:
    """Workers of Dask; without an address, `workers` of this machine's own, one thread each."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(
            "--engine dask needs distributed, which is not installed; install perilife[cluster]"
        ) from None
    cluster = None
    if address is None:
        cluster = LocalCluster(
            n_workers=workers or processor_cores(), threads_per_worker=1, dashboard_address=None
        )
    try:
        client = Client(cluster or address, timeout=PATIENCE)
    except (OSError, TimeoutError):
        raise ValueError(
            f"--scheduler is '{address}'; it does not answer within {PATIENCE:g} s"
        ) from None
    try:
        _check_store(client, store)
        yield client.get_executor()
    finally:
        client.close()
        if cluster is not None:
            cluster.close()


def _check_store(client: object, store: Path) -> None:
    """Refuse workers that do not see the store."""
    token = store / f".seen-{uuid.uuid4().hex}"
    token.touch()
    try:
        seen = client.run(_exists, str(token))
    finally:
        token.unlink()
    blind = [worker for worker, there in seen.items() if not there]
    if not seen:
        raise ValueError("the scheduler has no workers; start some first")
    if blind:
        raise ValueError(
            f"store '{store}' is not seen by worker {blind[0]}; it must be on a file system that "
            "all workers share"
        )


def _exists(path: str) -> bool:
    return Path(path).exists()


@contextmanager
def mpi(workers: int | None, address: str | None, store: Path) -> Iterator[Executor]:
    """Ranks of an mpirun, one task each at a time."""
    from mpi4py.futures import MPIPoolExecutor

    if address is not None:
        raise ValueError("--scheduler goes with --engine dask, which must be given too")
    with MPIPoolExecutor(workers) as executor:
        yield executor


ENGINES = {"local": local, "dask": dask, "mpi": mpi}
