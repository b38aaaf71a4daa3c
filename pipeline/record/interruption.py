"""Ctrl-C and SIGTERM end the work even where Python loses the exception.

A KeyboardInterrupt that is raised within a finaliser is printed and dropped, so the handler also
remembers that it was asked; long work looks with `check`.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_asked = threading.Event()
_held = threading.Event()


def listen() -> None:
    """Take SIGINT and SIGTERM from now on; to be called in the main thread."""
    _asked.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def check() -> None:
    """Raise KeyboardInterrupt if the process was asked to end."""
    if _asked.is_set():
        raise KeyboardInterrupt


@contextmanager
def held() -> Iterator[None]:
    """Within, a request to end is remembered only; it is raised at the end.

    For work that calls Python from C, such as a fork, where an exception would be printed and lost.
    Only the main thread gets such exceptions; in another one nothing is held.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        check()
        return
    _held.set()
    try:
        yield
    finally:
        _held.clear()
    check()


def _interrupt(number: int, frame: object) -> None:
    _asked.set()
    if not _held.is_set():
        raise KeyboardInterrupt
