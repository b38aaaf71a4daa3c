"""The run folder: where each stage writes, which stages are complete, who works in it.

A stage is complete when its record (`<stage>.stage.json`, written last) carries the hash of
the inputs that the scene asks for and every output that the record names is there.  Files
appear under a temporary name and are renamed, so that none is ever half-written.
"""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

SCENE_FILE = "scene.json"
SUMMARY_FILE = "summary.csv"
REPORT_FILE = "report.html"
LOCK_FILE = ".lock"


class RunFolderError(ValueError):
    """A run folder that may not be used; the message is one sentence for the person."""


@dataclass(frozen=True)
class StageRecord:
    """What is known about one finished stage.

    inputs: hash of everything the stage depends on; seconds: wall time it took;
    outputs: paths relative to the run folder; numbers: results worth keeping beside it.
    """

    stage: str
    inputs: str
    seconds: float
    finished: str = ""
    outputs: tuple[str, ...] = ()
    numbers: dict[str, object] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)


class RunFolder:
    """Paths of a run folder and the records of its stages."""

    def __init__(self, path: Path | str):
        self.path = Path(path)

    @property
    def scene_file(self) -> Path:
        """Resolved inputs of the run."""
        return self.path / SCENE_FILE

    @property
    def summary_file(self) -> Path:
        """Table with one row per alloy and immersion time."""
        return self.path / SUMMARY_FILE

    @property
    def report_file(self) -> Path:
        """The report, one file that stands alone."""
        return self.path / REPORT_FILE

    @property
    def geometry(self) -> Path:
        """Solid, tetrahedral mesh and their checks."""
        return self.path / "geometry"

    def corrosion(self, alloy: str) -> Path:
        """Concentration fields and history of one alloy."""
        return self.path / alloy / "corrosion"

    def immersion(self, alloy: str, label: str) -> Path:
        """Damage map and tensile test of one alloy after one immersion time."""
        return self.path / alloy / label

    def is_empty(self) -> bool:
        """Whether nothing is in the folder but perhaps the lock of this very run."""
        if not self.path.exists():
            return True
        return all(entry.name == LOCK_FILE for entry in self.path.iterdir())

    def write_record(self, folder: Path, record: StageRecord) -> None:
        """Store the record that makes a stage complete; call it after the outputs exist."""
        write_json(folder / f"{record.stage}.stage.json", asdict(record))

    def read_record(self, folder: Path, stage: str) -> StageRecord | None:
        """Record of a stage, or None when there is none that can be read."""
        try:
            content = json.loads((folder / f"{stage}.stage.json").read_text())
            return StageRecord(**{**content, "outputs": tuple(content["outputs"])})
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def complete(self, folder: Path, stage: str, inputs: str) -> StageRecord | None:
        """Record of a stage whose inputs match and whose outputs exist, else None."""
        record = self.read_record(folder, stage)
        if record is None or record.inputs != inputs:
            return None
        if not all((self.path / name).exists() for name in record.outputs):
            return None
        return record

    def forget(self, folder: Path, stage: str) -> None:
        """Drop a stage's record before its outputs are written anew."""
        (folder / f"{stage}.stage.json").unlink(missing_ok=True)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder for this process; refuse when another one holds it.

        The operating system frees the lock when the process ends, however it ends.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with open(self.path / LOCK_FILE, "a+") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                handle.seek(0)
                owner = handle.read().strip() or "unknown"
                raise RunFolderError(
                    f"run folder '{self.path}' is in use by process {owner}; wait for it to "
                    "end or choose another folder with --out"
                ) from None
            handle.seek(0)
            handle.truncate()
            handle.write(str(os.getpid()))
            handle.flush()
            try:
                yield
            finally:
                (self.path / LOCK_FILE).unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` under a temporary name in the same folder and rename it to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, content: object) -> None:
    """Write `content` as indented JSON, in one step as `write_text` does."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def utc_now() -> str:
    """The present in UTC, ISO 8601 to the microsecond."""
    return datetime.now(UTC).isoformat(timespec="microseconds")
