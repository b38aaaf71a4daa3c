"""A child process that is kept: it does one request after another, each a line of JSON.

What takes seconds to import and load is so imported and loaded once.  The child ends with the
thread that started it, or when nobody has asked it for a while.
"""

import json
import os
import select
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress

from pipeline.record.children import end_with_parent, how_it_ended

IDLE_SECONDS = 120.0
"""After so long without a request a child ends; whoever wants one then starts another."""

_NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)
"""For requests to a child that is gone: SIGPIPE would end a process in which PETSc is loaded."""


class WorkerEndedError(RuntimeError):
    """The child ended before it answered; the message says how, with the last line it wrote."""


class Worker:
    """A child that runs `python -m MODULE`, whose main calls `serve`.

    To be used in the thread that makes it, and closed.  start: as subprocess.Popen.
    """

    def __init__(
        self,
        module: str,
        environment: Mapping[str, str],
        start: Callable[..., subprocess.Popen] = subprocess.Popen,
    ):
        self._said = tempfile.TemporaryFile()
        self._requests, requests = socket.socketpair()
        self.process = start(
            [sys.executable, "-m", module, str(os.getpid())],
            stdin=requests,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=environment,
            text=True,
        )
        requests.close()

    def alive(self) -> bool:
        """Whether the child can be asked."""
        return self.process.poll() is None

    def ask(self, request: object) -> object:
        """The child's answer to a request, both as JSON has them; WorkerEndedError without one."""
        self.begin(request)
        return self.answer()

    def begin(self, request: object) -> None:
        """Hand the child a request without waiting for the answer."""
        self._said.seek(0)
        self._said.truncate()
        with suppress(ConnectionError):  # a child that has ended: `answer` says so
            self._requests.sendall(f"{json.dumps(request)}\n".encode(), _NO_SIGNAL)

    def answered(self) -> bool:
        """Whether `answer` need not wait: the child has answered or ended."""
        return bool(select.select([self.process.stdout], [], [], 0.0)[0])

    def answer(self) -> object:
        """Wait for what the child answers to `begin`; WorkerEndedError where it ends instead."""
        answer = self.process.stdout.readline()
        if answer.endswith("\n"):
            return json.loads(answer)
        code = self.process.wait()
        lines = self.said().strip().splitlines() or ["no message"]
        raise WorkerEndedError(f"{how_it_ended(code)}: {lines[-1].strip()}")

    def said(self) -> str:
        """What the child has printed since the last request."""
        self._said.seek(0)
        return self._said.read().decode(errors="replace")

    def kill(self) -> None:
        """End the child whatever it does; from any thread."""
        self.process.kill()

    def close(self) -> None:
        """End the child and free what this process has of it."""
        self.process.kill()
        self._requests.close()
        self.process.stdout.close()
        self.process.wait()
        self._said.close()


def serve(do: Callable[[object], object]) -> int:
    """Answer requests with do(request) until there are no more; the exit code of the child.

    An exception of `do` ends the child.  What anything prints goes to standard error.
    """
    end_with_parent(parent=int(sys.argv[1]))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    while select.select([sys.stdin], [], [], IDLE_SECONDS)[0]:
        line = sys.stdin.readline()  # one at a time: the next request waits for the answer
        if not line:
            break
        print(json.dumps(do(json.loads(line))), file=answers, flush=True)
    return 0
