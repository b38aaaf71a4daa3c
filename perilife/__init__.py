"""What is installed under the name perilife: command, `LifeCycle`, `Results`, way to the packages.

`peri`, `fem` and `pipeline` are good names in a checkout and bad ones in site-packages, where other
distributions have a `pipeline` or `fem` of their own and pip would write one over the other.
Installed, they therefore lie in `perilife/packages`, file by file as they are in the checkout, and
this file makes them importable, for this process and for those that it starts, as soon as it is
imported itself; `setup.py` lays them there. In a checkout it does nothing of the kind.
"""

import os
import sys
from pathlib import Path

_PACKAGES = Path(__file__).parent / "packages"

if _PACKAGES.is_dir() and str(_PACKAGES) not in sys.path:
    sys.path.insert(0, str(_PACKAGES))
    _given = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = f"{_PACKAGES}{os.pathsep}{_given}" if _given else str(_PACKAGES)

__all__ = ["LifeCycle", "Results", "main"]


def main() -> int:
    """The command `perilife`; returns its exit code."""
    from pipeline.cli import main as command

    return command()


def __getattr__(name: str) -> object:
    """`LifeCycle` and `Results`, imported when they are asked for."""
    if name not in ("LifeCycle", "Results"):
        raise AttributeError(f"module 'perilife' has no attribute {name!r}")
    import pipeline

    return getattr(pipeline, name)
