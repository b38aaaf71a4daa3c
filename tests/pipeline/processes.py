"""Which processes of a test are still there."""

from pathlib import Path


def survivors(mark: str) -> list[int]:
    """Ids of the processes, zombies apart, in whose environment `mark` stands (Linux)."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found
