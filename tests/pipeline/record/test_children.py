"""Children end with a parent that is killed, ranks too, and hold its lock until then."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from pipeline.record import children, interruption
from pipeline.record.machine import child_environment
from pipeline.record.run_folder import RunFolder, RunFolderError
from tests.pipeline.processes import survivors

PARENT = """
import sys, time
from pipeline.record import children, interruption
from pipeline.record.machine import child_environment, mpirun
from pipeline.record.run_folder import RunFolder

ranks, note = int(sys.argv[1]), sys.argv[2]
code = (
    "import os, sys, time\\n"
    "from pipeline.record.children import end_with_parent\\n"
    "end_with_parent()\\n"
    "open(sys.argv[1] + '.' + os.environ.get('OMPI_COMM_WORLD_RANK', '0'), 'w').write('up')\\n"
    "import threading, signal\\n"
    "signal.signal(signal.SIGTERM, signal.SIG_IGN)\\n"  # the worst of ranks
    "sum(iter(lambda: 1, 0))\\n"  # holds the interpreter as a solver does
)
command = [sys.executable, "-c", code, note]
command = command if ranks == 1 else [*mpirun(ranks, "a test"), *command]
folder = RunFolder(note + "-run")
with folder.lock():
    child = children.start(
        command, launcher=ranks > 1, keep=folder.descriptors, env=child_environment(ranks, 1)
    )
    print(child.pid, flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("and_launcher", [False, True])
def test_nothing_survives_a_killed_parent_and_the_lock_is_held_until_then(
    tmp_path, ranks, and_launcher
):
    if ranks > 1 and shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
    mark = f"perilife-test-{os.getpid()}-{ranks}-{and_launcher}"
    environment = {**child_environment(0, None), "PERILIFE_TEST_MARK": mark}
    note = tmp_path / "note"
    command = [sys.executable, "-c", PARENT, str(ranks), str(note)]
    parent = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    first = int(parent.stdout.readline())
    _wait(lambda: len(list(tmp_path.glob("note.*"))) == ranks)
    assert len(survivors(mark)) >= 1 + ranks
    parent.kill()
    parent.wait()
    if and_launcher and survivors(mark):
        os.kill(first, signal.SIGKILL)
    folder, refused = RunFolder(f"{note}-run"), []
    end = time.monotonic() + 20
    while time.monotonic() < end:
        try:
            alive = survivors(mark)
            with folder.lock():
                break
        except RunFolderError as error:
            refused.append((alive, str(error)))
    else:
        pytest.fail(f"the lock is still held: {refused[-1]}")
    assert all(f"process {parent.pid}" in text for _, text in refused)
    _wait(lambda: not survivors(mark))


def test_the_lock_is_held_by_what_inherits_it_and_by_nothing_else(tmp_path):
    folder = RunFolder(tmp_path / "run")
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    with folder.lock():
        heir = children.start(sleep, keep=folder.descriptors)
        other = children.start(sleep)
        os.close(folder._lock)  # as when the process ends
        folder._lock = os.open(os.devnull, os.O_RDONLY)
        try:
            with pytest.raises(RunFolderError, match="is in use by process"):
                RunFolder(folder.path)._acquire()
            children.end(heir)
            again = RunFolder(folder.path)._acquire()
            os.close(again)
        finally:
            children.end(heir)
            children.end(other)


def test_an_interruption_during_the_start_is_raised_after_it_and_ends_the_child(monkeypatch):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    made = []

    class Interrupted(subprocess.Popen):
        def __init__(self, *arguments, **options):
            os.kill(os.getpid(), signal.SIGINT)
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    try:
        interruption.listen()
        with pytest.raises(KeyboardInterrupt):
            children.start([sys.executable, "-c", "import time; time.sleep(60)"])
        assert made[0].poll() == -signal.SIGTERM
    finally:
        interruption.listen()  # forgets the request
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])


def test_the_way_in_which_a_child_ended_is_put_in_words():
    assert children.how_it_ended(3) == "exit status 3"
    assert "no memory" in children.how_it_ended(-9)
    assert children.how_it_ended(-11) == "signal SIGSEGV"


def test_a_child_of_a_rank_is_no_rank():
    """Open MPI: a child that inherits who its parent is ends in MPI_Init."""
    pytest.importorskip("mpi4py")
    if shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
    child = "from mpi4py import MPI; print(f'child {MPI.COMM_WORLD.size}')"
    code = (
        "import subprocess, sys; from mpi4py import MPI\n"
        "from pipeline.record.machine import child_environment, mpirun\n"
        f"command = [sys.executable, '-c', {child!r}]\n"
        "for ranks, start in ((1, []), (2, mpirun(2, 'a test'))):\n"
        "    environment = child_environment(ranks, 1)\n"
        "    subprocess.run([*start, *command], env=environment, check=True)\n"
    )
    command = ["mpirun", "-n", "1", sys.executable, "-c", code]
    done = subprocess.run(
        command, env=child_environment(1, 1), capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    # ranks may write into each other's lines
    assert (done.stdout.count("child 1"), done.stdout.count("child 2")) == (1, 2)


def _wait(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)
