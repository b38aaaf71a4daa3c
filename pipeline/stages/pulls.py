"""Pulls in child processes, several at a time, so that a crash of one never touches the others.

A `PullQueue` takes tests while others run, and this process may do something else meanwhile.

A child on one rank is kept for the next pull: importing and loading what a test needs costs as much
as a fifth of it.  Tests on several ranks have an mpirun each.  Both are
`python -m pipeline.stages.pulls`.
"""

import logging
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path

from pipeline.record import children, interruption
from pipeline.record.machine import child_environment, mpirun, processor_cores
from pipeline.record.worker import Worker, WorkerEndedError, serve
from pipeline.stages.strength import (
    LOG_FILE,
    PROGRESS_FILE,
    TensileJob,
    compile_for,
    forget_others,
    run_job,
    run_jobs_here,
)

logger = logging.getLogger(__name__)

POLL_SECONDS = 0.1

_MODULE = "pipeline.stages.pulls"


class TensileStageError(RuntimeError):
    """A tensile test that ended without a result; the message says where its log is."""


class Crew:
    """Children for tests on one rank that are kept from one call of `run_jobs` to the next.

    workers: tests at a time, which share the cores; keep: as in `run_jobs`.
    """

    def __init__(self, workers: int, keep: tuple[int, ...] = ()) -> None:
        self._environment = _environment(1, workers)
        self._start = partial(children.start, keep=keep)
        self.idle: list[Worker] = []
        self._preparing: Worker | None = None

    def prepare(self, elements: Iterable[str]) -> None:
        """Let a child load and compile what tests of these elements need, while others work.

        Compiling takes longer than a small test.  The child does tests afterwards.
        """
        self._preparing = self.worker()
        self._preparing.begin({"prepare": sorted(set(elements))})

    def ready(self) -> bool:
        """Whether no child compiles; a second one that began a test now would compile the same."""
        if self._preparing is None:
            return True
        if not self._preparing.answered():
            return False
        try:
            self._preparing.answer()
        except WorkerEndedError as error:  # where a test needs what failed, that test says so
            logger.info("nothing was compiled ahead: %s", error)
        self.idle.append(self._preparing)
        self._preparing = None
        return True

    def worker(self) -> Worker:
        """A child that waits, or a new one."""
        while self.idle:
            worker = self.idle.pop(0)
            if worker.alive():
                return worker
            worker.close()
        return Worker(_MODULE, self._environment, self._start)

    def members(self) -> list[Worker]:
        """The children that wait or compile."""
        return [*self.idle, *filter(None, [self._preparing])]

    def close(self, workers: Iterable[Worker]) -> None:
        """End children that wait."""
        for worker in workers:
            self.idle.remove(worker)
            worker.close()

    def __enter__(self) -> "Crew":
        return self

    def __exit__(self, *error: object) -> None:
        """End the children."""
        if self._preparing is not None:
            self.idle.append(self._preparing)
        while self.idle:
            self.idle.pop().close()


class _Alone:
    """A test in an mpirun of its own."""

    def __init__(self, key: str, job: TensileJob, process: subprocess.Popen) -> None:
        self.key, self.job, self.process = key, job, process
        self.started = time.monotonic()

    def poll(self) -> int | None:
        """The exit status; None while the test runs."""
        return self.process.poll()

    def end(self) -> None:
        children.end(self.process)


class _Kept:
    """A test in a child that can do others after it; worker: gives one."""

    def __init__(self, key: str, job: TensileJob, worker: Callable[[], Worker]) -> None:
        self.key, self.job, self._another = key, job, worker
        self.started = time.monotonic()
        self._ask()

    def _ask(self) -> None:
        self.worker = self._another()
        self.worker.begin(asdict(self.job))

    def poll(self) -> int | None:
        """0 when the test is done, the child's exit status when it died of it, else None."""
        if not self.worker.answered():
            return None
        try:
            self.worker.answer()
        except WorkerEndedError:
            code = self.worker.process.wait()
            if code != 0 or (Path(self.job.out) / LOG_FILE).exists():
                return code or 1  # without an answer nothing is done
            # nobody had asked it for long, and it was ending when it was: it has not begun
            self.worker.close()
            self._ask()
            return None
        return 0

    def end(self) -> None:
        children.end(self.worker.process)
        self.worker.close()


class PullQueue:
    """Tests that wait, those expected to take longest first, and those that run in children.

    ranks: of each test; workers: tests at a time; keep: descriptors that the processes inherit, the
    lock of the run folder (children.start); crew: the children for tests on one rank, where they
    are to be kept after the last one.  The callbacks are called with the key of a test, in the
    thread that does the tests.
    """

    def __init__(
        self,
        ranks: int = 1,
        workers: int = 1,
        started: Callable[[str], None] = lambda key: None,
        advanced: Callable[[str, float], None] = lambda key, fraction: None,
        finished: Callable[[str, float], None] = lambda key, seconds: None,
        keep: tuple[int, ...] = (),
        crew: Crew | None = None,
    ) -> None:
        self.workers, self.at_once = workers, workers
        self._started, self._advanced, self._finished = started, advanced, finished
        self._command, self._keep = _launcher(ranks), keep
        self._surroundings = _environment(ranks, workers)
        self._own = Crew(workers, keep)
        self._crew = crew or self._own
        self._waiting: list[tuple[float, str, TensileJob]] = []
        self._running: list[_Alone | _Kept] = []
        self._failures: list[str] = []
        self._change = threading.Lock()
        self._stop = threading.Event()

    def add(
        self, jobs: Mapping[str, TensileJob], seconds: Mapping[str, float] | None = None
    ) -> None:
        """Let tests wait; seconds: how long each is expected to take, in any unit."""
        expected = seconds or {}
        with self._change:
            self._waiting += [(-expected.get(key, 0.0), key, job) for key, job in jobs.items()]
            self._waiting.sort(key=lambda entry: entry[0])  # stable: else in their order

    def finish(self) -> None:
        """Do all tests that wait, in this thread.

        When one fails the others that run are allowed to end, then TensileStageError is raised;
        when this process is interrupted, all children are ended first, and when it is killed, they
        end with it.
        """
        try:
            while self._step():
                time.sleep(POLL_SECONDS)
        finally:
            self._end()
        self._raise_failures()

    @contextmanager
    def meanwhile(self) -> Iterator[None]:
        """Do tests beside the block, `at_once` at a time, and what is left after it, as `finish`.

        None at a time until the block sets `at_once`.  Where the block fails or is interrupted, the
        tests that run are ended.
        """
        self.at_once, last = 0, threading.Event()
        trouble: list[BaseException] = []

        def work() -> None:
            mine = self._crew.members()
            try:
                while self._step() or not last.is_set():
                    time.sleep(POLL_SECONDS)
            except BaseException as error:
                trouble.append(error)
            finally:
                self._end()
                # what this thread started would be killed at its end (children.start)
                self._crew.close([w for w in self._crew.idle if w not in mine])

        thread = threading.Thread(target=work, name="pulls")
        thread.start()
        try:
            yield
            self.at_once = self.workers
            last.set()
            while thread.is_alive():
                thread.join(POLL_SECONDS)
                interruption.check()
        finally:
            self._stop.set()
            last.set()
            thread.join()
        if trouble:
            raise trouble[0]
        self._raise_failures()

    def _step(self) -> bool:
        """Begin what can begin, look at what runs; whether there is anything left of either."""
        interruption.check()
        if self._stop.is_set():
            return False
        while len(self._running) < self.at_once and self._crew.ready():
            with self._change:
                if self._failures or not self._waiting:
                    break
                _, key, job = self._waiting.pop(0)
            self._running.append(self._begin(key, job))
            self._started(key)
        for item in list(self._running):
            code = item.poll()
            if code is None:
                self._advanced(item.key, _read_fraction(Path(item.job.out)))
                continue
            self._running.remove(item)
            # at once: a run that is killed later keeps this test and would keep the file
            (Path(item.job.out) / PROGRESS_FILE).unlink(missing_ok=True)
            if isinstance(item, _Kept):
                self._crew.idle.append(item.worker)
            if code == 0:
                self._finished(item.key, time.monotonic() - item.started)
            else:
                self._failures.append(_failure(item, code))
        return bool(self._running) or (bool(self._waiting) and not self._failures)

    def _begin(self, key: str, job: TensileJob) -> _Alone | _Kept:
        log = Path(job.out) / LOG_FILE
        log.unlink(missing_ok=True)
        if self._command is None:
            return _Kept(key, job, self._crew.worker)
        forget_others(job)
        with open(log, "wb") as said:
            return _Alone(
                key,
                job,
                children.start(
                    [*self._command, str(job.write())],
                    launcher=True,
                    keep=self._keep,
                    stdout=said,
                    stderr=subprocess.STDOUT,
                    stdin=subprocess.DEVNULL,
                    env=self._surroundings,
                ),
            )

    def _end(self) -> None:
        """End what runs, and the children that nobody keeps."""
        for item in self._running:
            item.end()
            (Path(item.job.out) / PROGRESS_FILE).unlink(missing_ok=True)
        self._running.clear()
        self._own.__exit__()

    def _raise_failures(self) -> None:
        if self._failures:
            raise TensileStageError("; ".join(self._failures))


def run_jobs(jobs: Mapping[str, TensileJob], **how: object) -> None:
    """Do tests in child processes; how: of PullQueue, whose `finish` says what is raised."""
    queue = PullQueue(**how)
    queue.add(jobs)
    queue.finish()


def _environment(ranks: int, workers: int) -> dict[str, str]:
    """One thread per rank for BLAS; Numba gets what is left of the cores."""
    return child_environment(ranks, max(1, processor_cores() // (ranks * workers)))


def _launcher(ranks: int) -> list[str] | None:
    """What starts one test on several ranks; None on one, where children are kept."""
    if ranks == 1:
        return None
    return [*mpirun(ranks, f"--np {ranks}"), sys.executable, "-m", _MODULE]


def _failure(item: _Alone | _Kept, code: int) -> str:
    log = Path(item.job.out) / LOG_FILE
    said = log.read_text(errors="replace") if log.exists() else item.worker.said()
    lines = [line for line in said.splitlines() if line.strip()]
    last = lines[-1].strip() if lines else "no message"
    return f"{item.key} ended with {children.how_it_ended(code)} ({last}; log: {log})"


def _read_fraction(folder: Path) -> float:
    try:
        return float((folder / PROGRESS_FILE).read_text())
    except (OSError, ValueError):
        return 0.0


def _answer(content: dict) -> str:
    """Do a job; what stops it stands in its log, too.  Or compile what jobs need."""
    if "prepare" in content:
        for element in content["prepare"]:
            compile_for(element)
        return ""
    job = TensileJob.from_json(content)
    try:
        run_jobs_here({job.out: job})
    except Exception:
        with open(Path(job.out) / LOG_FILE, "a", encoding="utf-8") as log:
            traceback.print_exc(file=log)
        raise
    return ""


def main(arguments: list[str]) -> int:
    """Entry point of a child: the job of a file on ranks, or one after another as asked."""
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8.0f ms %(message)s")
    if len(arguments) == 1 and arguments[0].isdigit():  # the parent's number
        return serve(_answer)
    if len(arguments) != 1:
        print(f"usage: python -m {_MODULE} JOB.json", file=sys.stderr)
        return 2
    children.end_with_parent()  # a rank's parent is mpirun
    run_job(TensileJob.read(Path(arguments[0])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
