"""Files that appear under their names only when they are whole."""

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to, with the same ending: renamed to `path` at the end.

    Where the writing fails it is removed and an OSError names `path`; what a killed process left
    is removed when its run folder is locked again.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is not None:
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_arrays(path: Path, arrays: Mapping[str, ArrayLike], compressed: bool = False) -> None:
    """Write arrays by name as .npz.

    It is put together in memory: on a full disk numpy's archive would be closed a second time when
    it is collected, and Python print a traceback of that.
    """
    content = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(content, **arrays)
    with whole_file(path) as temporary:
        temporary.write_bytes(content.getbuffer())
