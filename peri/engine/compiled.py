"""How loops over the lattice are compiled: serial and threaded, chosen by size."""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray
Triple = tuple[int, ...]

# Below this many elements the threads' start costs more than they save.
_THREADED_FROM = 150_000


def by_size(
    function: Callable | None = None,
    *,
    fastmath: bool | set[str] = False,
    error_model: str = "python",
) -> Callable:
    """Compile a loop twice, serial and threaded, and choose by the size of its first array.

    error_model "numpy": a division by zero gives infinity, and loops with divisions vectorise.
    """
    if function is None:
        return lambda f: by_size(f, fastmath=fastmath, error_model=error_model)
    options: dict[str, Any] = {"cache": True, "fastmath": fastmath, "error_model": error_model}
    serial = njit(**options)(_named(function, "serial"))
    threaded = njit(parallel=True, **options)(function)

    @functools.wraps(function)
    def choose(first: Array, *rest: Any) -> Any:
        return (threaded if first.size >= _THREADED_FROM else serial)(first, *rest)

    return choose


def _named(function: Callable, suffix: str) -> types.FunctionType:
    """A copy under a name of its own: Numba's cache tells functions apart by name and line only."""
    copy = types.FunctionType(function.__code__, function.__globals__, function.__name__)
    copy.__module__ = function.__module__
    copy.__qualname__ = f"{function.__qualname__}_{suffix}"
    return copy


# Contraction lets a*b+c become one fused operation; NaN and infinity keep their meaning.
CONTRACT = {"contract"}
