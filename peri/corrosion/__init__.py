"""Corrosion models on the nonlocal engine.

The names below load what they need on first use, so that laws and choices
(corrosion.kinetics, corrosion.laws) can be read without the compiled solvers.
"""

from __future__ import annotations

import importlib

_HOMES = {
    "CorrosionResult": "peri.corrosion.run",
    "CorrosionScene": "peri.corrosion.scene",
    "corrode": "peri.corrosion.run",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
