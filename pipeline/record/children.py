"""Child processes that end when their parent ends, however it ends (SIGKILL, out of memory).

The kernel sends the child a signal at its parent's death (Linux, prctl PR_SET_PDEATHSIG), whatever
the child computes.  `start` asks for that before the child's program begins; a rank of MPI, whose
parent is the launcher, asks for it itself with `end_with_parent`.
"""

import ctypes
import os
import signal
import subprocess
from collections.abc import Iterable, Sequence

from pipeline.record import interruption

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None, use_errno=True)


def end_with_parent(number: int = signal.SIGKILL, parent: int | None = None) -> None:
    """Let this process get the signal `number` when the thread that started it ends.

    parent: its process id where known; if it is gone already, this process ends at once.
    Where the system is not Linux nothing happens.
    """
    if not hasattr(_libc, "prctl"):
        return
    _libc.prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(number), 0, 0, 0)
    if parent is not None and os.getppid() != parent:
        os._exit(1)


def start(
    command: Sequence[str],
    *,
    launcher: bool = False,
    keep: Iterable[int] = (),
    **options: object,
) -> subprocess.Popen:
    """Start a program, in a session of its own, that ends with this process.

    launcher: the program is one that starts ranks (mpirun); it gets SIGTERM instead of SIGKILL,
    upon which it ends its ranks first.  keep: descriptors that the program inherits; a lock of
    `flock` on one of them is held until both processes have ended.  options: of subprocess.Popen.
    To be called in a thread that lives as long as the program.
    """
    parent, number = os.getpid(), signal.SIGTERM if launcher else signal.SIGKILL
    child = None
    try:
        with interruption.held():
            child = subprocess.Popen(
                command,
                pass_fds=tuple(keep),
                start_new_session=True,
                preexec_fn=lambda: end_with_parent(number, parent),
                **options,
            )
    except KeyboardInterrupt:
        if child is not None:
            end(child)
        raise
    return child


def end(process: subprocess.Popen, patience: float = 5.0) -> None:
    """End a child that `start` made and whatever it started: first asked, then told."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        try:
            os.killpg(process.pid, number)
            process.wait(patience)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def how_it_ended(code: int) -> str:
    """An exit status as subprocess gives it, in words for the person."""
    if code >= 0:
        return f"exit status {code}"
    if code == -signal.SIGKILL:
        return "signal SIGKILL, as a machine sends that has no memory left"
    return f"signal {signal.Signals(-code).name}"
