"""Where the tasks of a campaign run: anything that is a `concurrent.futures.Executor`.

local: as many child processes as asked for.  dask: a scheduler of Dask distributed, on one machine,
over ssh or under a batch system, behind one address.  mpi: the ranks of an mpirun, by
`mpirun -n N python -m mpi4py.futures -m pipeline.cli campaign ...`.
"""

from __future__ import annotations

import math
import os
import platform
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pipeline.campaigns.task import workers_of
from pipeline.record.machine import available_memory, processor_cores
from pipeline.scene.units import format_bytes

PATIENCE = 10.0
"""Seconds that a scheduler has to answer."""

_PROBES = 8
"""Tasks per MPI rank by which the hosts of the ranks are found."""

_PAUSE = 0.02  # s, of each of them


@dataclass(frozen=True)
class Crew:
    """Who does the tasks.

    executor: takes them; memory: bytes that a task may take beside the others of its host, at the
    worker that has least; threads: of the compiled kernels of a task; check_store: refuses workers
    that do not see a store.
    """

    executor: Executor
    memory: float
    threads: int = 1
    check_store: Callable[[Path], None] = lambda store: None

    def check_memory(self, needed: float, what: str) -> None:
        """Refuse a task that needs more bytes than a worker has; what: the task in words."""
        if needed > self.memory:
            raise ValueError(
                f"{what} needs about {format_bytes(needed)} of memory and a worker has "
                f"{format_bytes(self.memory)}; fewer --workers, or workers with more, must do it"
            )


@contextmanager
def local(workers: int | None, address: str | None) -> Iterator[Crew]:
    """Child processes of this one, each kept by the thread that waits for it."""
    if address is not None:
        raise ValueError("--scheduler goes with --engine dask, which must be given too")
    cores = processor_cores()
    count = workers or cores
    executor = ThreadPoolExecutor(count)
    with workers_of(executor):
        yield Crew(executor, available_memory() / count, max(1, cores // count))


@contextmanager
def dask(workers: int | None, address: str | None) -> Iterator[Crew]:
    """Workers of Dask; without an address, `workers` of this machine's own, one thread each."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(
            "--engine dask needs distributed, which is not installed; install perilife[cluster]"
        ) from None
    cluster, threads = None, 1
    if address is None:
        count = workers or processor_cores()
        threads = max(1, processor_cores() // count)
        cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
    try:
        client = Client(cluster or address, timeout=PATIENCE)
    except (OSError, TimeoutError):
        raise ValueError(
            f"--scheduler is '{address}'; it does not answer within {PATIENCE:g} s"
        ) from None
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
        found = client.scheduler_info(-1)["workers"].values()
        limits = [w["memory_limit"] / w["nthreads"] for w in found if w["memory_limit"]]
        yield Crew(
            client.get_executor(),
            min(limits, default=math.inf),
            threads,
            lambda store: _check_store(client, store),
        )
    except TimeoutError:
        raise ValueError("the scheduler has no workers; start some first") from None
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
    if blind:
        raise ValueError(
            f"store '{store}' is not seen by worker {blind[0]}; it must be on a file system that "
            "all workers share"
        )


def _exists(path: str) -> bool:
    return Path(path).exists()


@contextmanager
def mpi(workers: int | None, address: str | None) -> Iterator[Crew]:
    """Ranks of an mpirun, one task each at a time."""
    from mpi4py import MPI
    from mpi4py.futures import MPIPoolExecutor

    if address is not None:
        raise ValueError("--scheduler goes with --engine dask, which must be given too")
    with MPIPoolExecutor(workers) as executor:
        count = _PROBES * (workers or MPI.COMM_WORLD.size)
        found = set(executor.map(_host, range(count)))
        ranks = Counter(node for node, _ in {(node, rank) for node, rank, *_ in found})
        memory = min(available / ranks[node] for node, _, available, _ in found)
        threads = min(max(1, cores // ranks[node]) for node, _, _, cores in found)
        yield Crew(executor, memory, threads)


def _host(number: int) -> tuple[str, int, float, int]:
    """Host of a rank, its process, the host's available memory (bytes) and the rank's cores."""
    time.sleep(_PAUSE)  # so that no rank takes the probes of the others
    return platform.node(), os.getpid(), float(available_memory()), processor_cores()


ENGINES = {"local": local, "dask": dask, "mpi": mpi}
