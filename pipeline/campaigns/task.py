"""One task of a campaign: one stage of one scene, in a child of whoever does it.

`do_task` hands it to `python -m pipeline.campaigns.task`, so that a crash of one task never touches
the others, whichever engine calls it.  Each thread of an engine keeps its child for the next task:
that a stage's libraries are imported and its kernels loaded for every task would cost as much as a
fifth of a mechanical test.
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass

from pipeline.campaigns.store import StoreFolder
from pipeline.life_cycle import StagedRun
from pipeline.record.machine import child_environment
from pipeline.record.worker import Worker, WorkerEndedError, serve
from pipeline.scene.scene import Scene, scene_from_json
from pipeline.stages.strength import CHECKPOINT_FILE

ATTEMPTS = 3
"""How often a task whose process dies is begun; one that refuses is begun once."""

_MODULE = "pipeline.campaigns.task"

_own = threading.local()
_workers: set[Worker] = set()
_ending = threading.Event()


@dataclass(frozen=True)
class Task:
    """A stage ("geometry", "corrode" or "test") of a scene in a store.

    key: the folder of the stage in the store, so that equal stages are one task.
    """

    stage: str
    key: str
    store: str
    scene: Scene
    alloy: str = ""
    label: str = ""
    hold: str = ""

    def to_json(self) -> dict[str, object]:
        """What `do_task` takes, on this machine or another."""
        return {
            "stage": self.stage, "store": self.store, "alloy": self.alloy, "label": self.label,
            "hold": self.hold, "scene": self.scene.to_json(),
        }  # fmt: skip


def do_task(content: dict, threads: int = 1) -> str:
    """Do a task in this thread's child; returns an empty text, or one sentence on why it failed.

    threads: of the child's compiled kernels.
    """
    said = "the campaign was stopped"
    for _ in range(ATTEMPTS):
        if _ending.is_set():
            break
        worker = _worker(threads)
        try:
            return str(worker.ask(content))
        except WorkerEndedError as error:
            said = f"{content['stage']} ended with {error}"
            _forget(worker)
    return said


def _worker(threads: int) -> Worker:
    """The child of this thread, started where there is none."""
    kept, with_threads = getattr(_own, "worker", (None, 0))
    if kept is not None and (with_threads != threads or not kept.alive()):
        _forget(kept)
        kept = None
    if kept is None:
        kept = Worker(_MODULE, child_environment(1, threads))
        _own.worker = (kept, threads)
        _workers.add(kept)
    return kept


def _forget(worker: Worker) -> None:
    _workers.discard(worker)
    worker.close()


@contextmanager
def workers_of(executor: Executor) -> Iterator[None]:
    """Within, threads of an executor of this process do tasks; their children end with the block.

    So do the tasks that still run then, where the block ends by an exception.
    """
    try:
        yield
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        _ending.set()
        for worker in list(_workers):
            worker.kill()
        executor.shutdown()
        for worker in list(_workers):
            _forget(worker)
        _ending.clear()


def perform(content: dict) -> None:
    """Do a task in this process; a stage that the store has is left as it is."""
    scene = scene_from_json(content["scene"])
    cycle = StagedRun(scene, StoreFolder(content["store"], scene), workers=1, pull_here=True)
    if content["stage"] == "geometry":
        cycle.geometry()
    elif content["stage"] == "corrode":
        cycle.corrode(content["alloy"])
    else:
        moment = next(m for m in scene.with_intact() if m.label == content["label"])
        hold = next(h for h in scene.holds if h.name == content["hold"])
        test = (content["alloy"], moment, hold)
        # a test that goes on from where it was killed differs in the last digits; rows must not
        place = cycle.folder.test(content["alloy"], moment.label, hold.name)
        (place / CHECKPOINT_FILE).unlink(missing_ok=True)
        cycle.map(*test)
        cycle.pull([test])


def answer(content: dict) -> str:
    """Do a task; an empty text, or one sentence on why it cannot be done."""
    try:
        perform(content)
    except (ValueError, OSError, MemoryError) as error:
        return " ".join(str(error).split()) or type(error).__name__
    return ""


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8.0f ms %(message)s")
    sys.exit(serve(answer))
