"""A child for the tests of workers: says its number, dies by a signal or by an exception."""

import os
import signal
import sys
import time

from pipeline.record import worker


def answer(request: dict) -> dict:
    """Print something, then do as asked."""
    print("on standard output")
    print("last words", file=sys.stderr, flush=True)
    if request["do"] == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if request["do"] == "raise":
        raise RuntimeError("no such thing")
    if request["do"] == "sleep":
        time.sleep(60)
    if request["do"] == "hurry":
        worker.IDLE_SECONDS = 0.0
    return {"process": os.getpid(), **request}


if __name__ == "__main__":
    sys.exit(worker.serve(answer))
