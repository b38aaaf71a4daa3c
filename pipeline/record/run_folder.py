"""The run folder: where each stage writes, which stages are complete, who works in it.

A stage is complete when its record (`<stage>.stage.json`, written last) carries the hash of
the inputs that the scene asks for and every output has the size and the hash that the record says.
Files appear under a temporary name and are renamed, so that none is ever half-written.
"""

import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from pipeline.record.whole_file import whole_file

SCENE_FILE = "scene.json"
SUMMARY_FILE = "summary.csv"
REPORT_FILE = "report.html"
LOCK_FILE = ".lock"


class RunFolderError(ValueError):
    """A run folder that may not be used; the message is one sentence for the person."""


@dataclass(frozen=True)
class StageRecord:
    """What is known about one finished stage.

    inputs: hash of everything the stage depends on; seconds: wall time it took; outputs: size and
    hash by path relative to the run folder (RunFolder.fingerprints); numbers: results worth
    keeping beside it.
    """

    stage: str
    inputs: str
    seconds: float
    finished: str = ""
    outputs: dict[str, dict[str, object]] = field(default_factory=dict)
    numbers: dict[str, object] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)


class RunFolder:
    """Paths of a run folder and the records of its stages."""

    def __init__(self, path: Path | str):
        self.path = Path(path)
        self._lock: int | None = None
        self._hashes: dict[tuple, str] = {}

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

    def test(self, alloy: str, label: str, hold: str) -> Path:
        """Damage map and tensile test of one alloy after one immersion time, held in one way."""
        return self.path / alloy / label / hold

    def is_empty(self) -> bool:
        """Whether nothing is in the folder but perhaps what an ended run left before its scene."""
        if not self.path.exists():
            return True
        left = f".{SCENE_FILE}."
        return all(e.name == LOCK_FILE or e.name.startswith(left) for e in self.path.iterdir())

    def write_record(self, folder: Path, record: StageRecord) -> None:
        """Store the record that makes a stage complete; call it after the outputs exist."""
        content = asdict(record)
        write_json(folder / f"{record.stage}.stage.json", {**content, "seal": _seal(content)})

    def read_record(self, folder: Path, stage: str) -> StageRecord | None:
        """Record of a stage, or None when there is none that can be read and is as written."""
        try:
            content = json.loads((folder / f"{stage}.stage.json").read_text(encoding="utf-8"))
            seal = content.pop("seal")
            return StageRecord(**content) if seal == _seal(content) else None
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return None

    def complete(self, folder: Path, stage: str, inputs: str) -> StageRecord | None:
        """Record of a stage whose inputs match and whose outputs are as written, else None."""
        record = self.read_record(folder, stage)
        if record is None or record.inputs != inputs or self._damaged_output(record):
            return None
        return record

    def damage(self, folder: Path, stage: str, inputs: str) -> str:
        """What happened to a stage that was complete with these inputs, naming the file, or ""."""
        path = folder / f"{stage}.stage.json"
        record = self.read_record(folder, stage)
        if record is None:
            there = path.exists()
            return f"'{path.relative_to(self.path)}' is not as it was written" if there else ""
        return self._damaged_output(record) if record.inputs == inputs else ""

    def fingerprints(self, paths: Iterable[Path]) -> dict[str, dict[str, object]]:
        """Size in bytes and SHA-256 of files, by path relative to the run folder."""
        return {
            str(path.relative_to(self.path)): {
                "bytes": path.stat().st_size,
                "sha256": self._sha256(path),
            }
            for path in paths
        }

    def _damaged_output(self, record: StageRecord) -> str:
        for name, written in record.outputs.items():
            path = self.path / name
            if not path.is_file():
                return f"'{name}' is missing"
            size = path.stat().st_size
            if size != written["bytes"]:
                return f"'{name}' has {size:,} bytes where {written['bytes']:,} were written"
            if self._sha256(path) != written["sha256"]:
                return f"'{name}' was changed after it was written"
        return ""

    def _sha256(self, path: Path) -> str:
        """Hash of a file, computed again only where the file is another or was touched."""
        status = path.stat()
        key = (str(path), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
        if key not in self._hashes:
            with open(path, "rb") as file:
                self._hashes[key] = hashlib.file_digest(file, "sha256").hexdigest()
        return self._hashes[key]

    def forget(self, folder: Path, stage: str) -> None:
        """Drop a stage's record before its outputs are written anew."""
        (folder / f"{stage}.stage.json").unlink(missing_ok=True)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder for this process and the children that inherit `descriptors`.

        Refused when another run holds the folder.  The operating system frees the lock when the
        last of these processes ends, however they end.  What a killed process left half-written
        is removed.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        self._lock = self._acquire()
        try:
            for path in self.path.rglob("*"):
                if not {".tmp", ".part"}.isdisjoint(path.suffixes) and path.is_file():
                    path.unlink(missing_ok=True)
            yield
        finally:
            (self.path / LOCK_FILE).unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = None

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Open files that a child must inherit to hold the folder's lock as this process does."""
        return () if self._lock is None else (self._lock,)

    def _acquire(self) -> int:
        path = self.path / LOCK_FILE
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _same_file(descriptor, path):
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
                    return descriptor
            except BlockingIOError:
                owner = os.pread(descriptor, 32, 0).decode(errors="replace").strip()
                os.close(descriptor)
                raise RunFolderError(self._in_use_by(owner)) from None
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)  # another run removed the file between opening and locking

    def _in_use_by(self, owner: str) -> str:
        way_out = "wait for it to end or choose another folder with --out"
        if owner.isdigit() and Path("/proc/self").exists() and not Path("/proc", owner).exists():
            return (
                f"run folder '{self.path}' is in use by a pull of process {owner}, which has "
                f"ended itself; {way_out}"
            )
        return f"run folder '{self.path}' is in use by process {owner or 'unknown'}; {way_out}"


def _seal(content: dict) -> str:
    """Hash of a record's content, by which it is known whether somebody changed it."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _same_file(descriptor: int, path: Path) -> bool:
    """Whether `path` still names the open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def write_text(path: Path, text: str) -> None:
    """Write `text` under a temporary name in the same folder and rename it to `path`."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: object) -> None:
    """Write `content` as indented JSON, in one step as `write_text` does."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def utc_now() -> str:
    """The present in UTC, ISO 8601 to the microsecond."""
    return datetime.now(UTC).isoformat(timespec="microseconds")
