"""A file has its name when it is whole; what cannot be written leaves nothing but a sentence."""

import errno
import subprocess
import sys

import numpy as np
import pytest

from pipeline.record.whole_file import whole_file, write_arrays

ROOM = 50_000  # bytes that a file may have

FULL = """
import resource, sys
from pathlib import Path
import numpy as np
from pipeline.cli import sentence
from pipeline.record.whole_file import write_arrays
resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))
try:
    write_arrays(Path(sys.argv[1]), {{"a": np.random.default_rng(1).random(20_000)}}, {compressed})
except OSError as error:
    print(sentence(error), error.errno)
"""


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_beyond_the_room_end_with_the_sentence_and_leave_nothing(tmp_path, compressed):
    path = tmp_path / "arrays.npz"
    done = subprocess.run(
        [sys.executable, "-c", FULL.format(room=ROOM, compressed=compressed), str(path)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""  # a zip archive that fails prints a traceback when it is collected
    assert done.stdout == f"'{path}' cannot be used: File too large. {errno.EFBIG}\n"
    assert not list(tmp_path.iterdir())


def test_arrays_come_back_to_the_bit(tmp_path):
    values = np.random.default_rng(2).random((3, 50))
    for compressed in (False, True):
        write_arrays(tmp_path / "new" / "a.npz", {"a": values, "b": [1, 2]}, compressed)
        with np.load(tmp_path / "new" / "a.npz") as stored:
            assert np.array_equal(stored["a"], values) and list(stored["b"]) == [1, 2]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.npz"]


def test_what_fails_leaves_the_older_file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError), whole_file(path) as temporary:
        assert temporary.suffix == path.suffix and temporary.parent == tmp_path
        temporary.write_text("half")
        raise RuntimeError("on the way")
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
