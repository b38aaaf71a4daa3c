"""From a solid to its residual strength: three lines of Python, or the command `perilife`.

>>> from pipeline import LifeCycle
>>> result = LifeCycle("Mg-5Gd", "8w").run()
>>> result.strength_left

The names below load what they need on first use, so that `import pipeline` takes no time.
"""

from __future__ import annotations

import importlib

__all__ = ["LifeCycle", "Results"]

_HOMES = {"LifeCycle": "pipeline.api.life_cycle", "Results": "pipeline.api.results"}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
