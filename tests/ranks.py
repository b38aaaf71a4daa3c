"""The one start of MPI ranks in the tests, and the results that files of tests take from it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
needs_mpirun = pytest.mark.skipif(shutil.which("mpirun") is None, reason="mpirun is not installed")


def run_on_ranks(ranks: int, module: str, *arguments: object, timeout: float = 300.0) -> None:
    """`python -m MODULE ARGUMENTS` on so many ranks of one thread each; it must end well.

    The ranks share one core, another one for each process of tests.  Their marches are small, and
    a rank that waits gives way to the one that it waits for; on cores of their own that are busy
    with other tests, the wait for a turn would be many times the work.
    """
    environment = os.environ | {
        "OMP_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT),
        "OMPI_MCA_mpi_yield_when_idle": "1",
        "OMPI_MCA_hwloc_base_binding_policy": "none",
    }
    cores = sorted(os.sched_getaffinity(0))
    core = cores[int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % len(cores)]
    command = ["mpirun", "--oversubscribe", "-n", str(ranks), sys.executable, "-m", module]
    done = subprocess.run(
        [*command, *map(str, arguments)], cwd=ROOT, env=environment, capture_output=True,
        text=True, timeout=timeout, preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]


class OnRanks:
    """What a module's cases give on ranks, each choice of them computed once.

    module : run as `python -m MODULE FILE.npz NAME...`, it computes the cases of these names (all
    without one) and writes the arrays; files that it writes beside begin with FILE.npz.
    """

    def __init__(self, module: str, folder: Path, timeout: float = 300.0) -> None:
        self.module, self.folder, self.timeout = module, folder, timeout
        self._found: dict[tuple, tuple[dict[str, np.ndarray], Path]] = {}

    def __call__(self, ranks: int, names: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
        """The arrays by name."""
        return self._of(ranks, names)[0]

    def file(self, ranks: int, names: tuple[str, ...] = (), ending: str = "") -> Path:
        """A file that was written beside the arrays."""
        return Path(f"{self._of(ranks, names)[1]}{ending}")

    def _of(self, ranks: int, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], Path]:
        if (ranks, names) not in self._found:
            path = self.folder / f"{ranks}-{len(self._found)}.npz"
            run_on_ranks(ranks, self.module, path, *names, timeout=self.timeout)
            self._found[ranks, names] = dict(np.load(path)), path
        return self._found[ranks, names]
