"""What child processes are told of threads and ranks."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pipeline.record.machine import child_environment, find_place_for_compiled_code
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
    monkeypatch.setattr(study_pulls.Workshop, "mesh", lambda self, *sizes: None)
    pull = study_pulls.Pull("", "", "Mg-5Gd", "0w", "P1", 0.3e-3, 0.2e-3, 0.01)
    before = dict(os.environ)
    with pytest.raises(KeyboardInterrupt):
        study_pulls.Workshop(tmp_path).pull([pull], 1, print)
    assert seen == [("1", "1", "none")]
    assert dict(os.environ) == before


MODULE = """
import numba
@numba.njit(cache=True)
def double(x):
    return 2 * x
"""


@pytest.mark.parametrize("told", [False, True])
def test_a_missing_home_folder_does_not_stop_the_compiler(tmp_path, told):
    """Without a place that can be written Numba refuses; with the one that is found it compiles."""
    (tmp_path / "kernels.py").write_text(MODULE)
    (tmp_path / "__pycache__").write_text("no folder, not even for root")
    environment = child_environment(0, 1) | {"HOME": "/proc/none", "TMPDIR": str(tmp_path)}
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        environment.pop(name, None)
    begin = "from pathlib import Path; from pipeline.record import machine; "
    begin += f"machine.find_place_for_compiled_code(Path({str(tmp_path)!r})); " if told else ""
    code = f"{begin}import sys; sys.path.insert(0, {str(tmp_path)!r}); import kernels; "
    code += "print(kernels.double(21))"
    command = [sys.executable, "-B", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if not told:
        assert done.returncode == 1 and "no locator available" in done.stderr
        return
    assert done.stdout == "42\n", done.stderr
    place = tmp_path / f"perilife-{os.getuid()}"
    assert place.stat().st_mode & 0o777 == 0o700
    assert list(place.rglob("*.nbi"))


def test_a_folder_of_somebody_else_is_no_place_for_compiled_code(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    theirs = tmp_path / f"perilife-{os.getuid()}"
    theirs.mkdir()
    theirs.chmod(0o777)
    find_place_for_compiled_code(Path("/proc"))
    chosen = Path(os.environ["NUMBA_CACHE_DIR"])
    assert chosen != theirs and chosen.parent == tmp_path and chosen.stat().st_mode & 0o777 == 0o700
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    find_place_for_compiled_code(tmp_path)  # there is a place, so that Numba is left alone
    assert "NUMBA_CACHE_DIR" not in os.environ
