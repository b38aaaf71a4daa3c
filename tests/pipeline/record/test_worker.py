"""A child that is kept answers many requests, and says how it ended."""

import os
import signal
import subprocess
import sys
import time

import pytest

from pipeline.record.machine import child_environment
from pipeline.record.worker import Worker, WorkerEndedError
from tests.pipeline.processes import survivors

MODULE = "tests.pipeline.record.answering"


def test_one_child_answers_until_it_dies_and_says_how():
    worker = Worker(MODULE, child_environment(0, None))
    first, second = (worker.ask({"do": "nothing", "text": "ü\n"}) for _ in range(2))
    assert first == second == {"process": worker.process.pid, "do": "nothing", "text": "ü\n"}
    with pytest.raises(WorkerEndedError, match="signal SIGKILL.*: last words"):
        worker.ask({"do": "die"})
    assert not worker.alive()
    worker.close()
    worker = Worker(MODULE, child_environment(0, None))
    with pytest.raises(WorkerEndedError, match="exit status 1: RuntimeError: no such thing"):
        worker.ask({"do": "raise"})
    worker.close()


def test_a_child_that_nobody_asks_ends():
    worker = Worker(MODULE, child_environment(0, None))
    worker.ask({"do": "hurry"})
    assert worker.process.wait(20) == 0 and not worker.alive()
    told = []
    kept = signal.signal(signal.SIGPIPE, lambda *what: told.append(what))
    with pytest.raises(WorkerEndedError, match="exit status 0"):
        worker.ask({"do": "nothing"})
    signal.signal(signal.SIGPIPE, kept)
    assert not told  # PETSc ends a process that is told
    worker.close()


def test_a_child_ends_with_a_parent_that_is_killed():
    mark = f"perilife-worker-{os.getpid()}"
    code = (
        "import time\n"
        "from pipeline.record.machine import child_environment\n"
        "from pipeline.record.worker import Worker\n"
        f"worker = Worker('{MODULE}', child_environment(0, None))\n"
        "print(worker.ask({'do': 'nothing'})['process'], flush=True)\n"
        "time.sleep(60)\n"
    )
    environment = child_environment(0, None) | {"PERILIFE_TEST_MARK": mark}
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        assert child in survivors(mark)
        parent.kill()
        parent.wait()
        end = time.monotonic() + 20
        while survivors(mark) and time.monotonic() < end:
            time.sleep(0.05)
    assert not survivors(mark)
