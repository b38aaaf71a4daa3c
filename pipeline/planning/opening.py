"""Opening a run folder: everything that can be refused is refused before anything is written."""

import math
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.record.run_folder import SCENE_FILE, RunFolder, RunFolderError, write_json
from pipeline.record.stage_hashes import geometry_hash, pull_hash
from pipeline.scene.command.scene_file import read_stored
from pipeline.scene.scene import Scene


@contextmanager
def open_run(
    scene: Scene,
    out: str | Path,
    resume: bool,
    *,
    solid: object = None,
    stages: Iterable[str] = ("geometry", "corrode", "map"),
    ranks: int = 1,
    workers: int | None = None,
    march_ranks: int = 1,
) -> Iterator[tuple[RunFolder, object]]:
    """Check scene, machine and folder, then create or reopen the folder and hold its lock.

    solid: of the scene, where it has been built already; stages, ranks, workers, march_ranks: what
    is to be done, for which the machine is checked (readiness.check_machine) unless it all is done.
    Yields the folder and the solid (None where the geometry is complete already).  A folder that
    this call created is removed again when nothing in it was completed because of a refusal.

    Raises ValueError, OSError or MemoryError with one sentence.
    """
    from pipeline.planning.readiness import check_machine
    from pipeline.planning.sizes import check_screw
    from pipeline.stages.geometry import build_solid, read_surface

    check_screw(scene)
    folder = RunFolder(out)
    check_folder(folder, scene, resume)
    if not folder.complete(folder.geometry, "geometry", geometry_hash(scene)):
        solid = solid or build_solid(scene)
        check_machine(scene, solid, folder.path, ranks, workers, stages, march_ranks)
    else:
        solid = None
        if not all_pulled(folder, scene):
            there = read_surface(folder.geometry)
            check_machine(scene, there, folder.path, ranks, workers, stages, march_ranks)
    absent = [p for p in (folder.path, *folder.path.absolute().parents) if not p.exists()]
    with folder.lock():
        created = not folder.scene_file.exists()
        try:
            if created:
                write_json(folder.scene_file, scene.to_json())
            yield folder, solid
        except (ValueError, OSError, MemoryError):
            if created and not any(folder.path.rglob("*.stage.json")):
                _remove(folder.path, absent)
            raise


def check_stage(
    folder: RunFolder, scene: Scene, stage: str, ranks: int = 1, workers: int | None = None
) -> None:
    """Refuse a stage of an open run folder that this machine cannot do (readiness.check_machine).

    Nothing is looked at where the geometry is not complete, without which the stage is refused.
    """
    from pipeline.planning.readiness import check_machine
    from pipeline.stages.geometry import read_surface

    ready = folder.complete(folder.geometry, "geometry", geometry_hash(scene))
    if ready and not all_pulled(folder, scene):
        solid = read_surface(folder.geometry)
        check_machine(scene, solid, folder.path, ranks, workers, [stage])


def all_pulled(folder: RunFolder, scene: Scene) -> bool:
    """Whether no tensile test is left to do."""
    return all(
        folder.complete(
            folder.test(alloy.name, moment.label, hold.name),
            "pull",
            pull_hash(scene, alloy.name, moment, hold),
        )
        for hold in scene.holds
        for alloy in scene.alloys
        for moment in scene.with_intact()
    )


def read_run(out: str | Path) -> tuple[RunFolder, Scene]:
    """The run folder at `out` and its scene; refuses what is not a run folder."""
    folder = RunFolder(out)
    return folder, read_scene(folder)


def read_scene(folder: RunFolder) -> Scene:
    """The scene stored in a run folder."""
    if not folder.path.is_dir():
        raise FileNotFoundError(f"run folder '{folder.path}' does not exist")
    if not folder.scene_file.is_file():
        raise RunFolderError(f"'{folder.path}' holds no {SCENE_FILE}, so it is no run folder")
    return read_stored(folder.scene_file)


def check_folder(folder: RunFolder, scene: Scene, resume: bool) -> None:
    """Refuse a folder that is in use by another scene, not empty, or cannot be written."""
    path = folder.path
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"run folder '{path}' is a file; it must be a folder or new")
    if not folder.is_empty():
        if not folder.scene_file.is_file():
            raise RunFolderError(
                f"folder '{path}' is not empty and holds no {SCENE_FILE}, so it is no run folder; "
                "choose another --out"
            )
        if not resume:
            raise RunFolderError(
                f"run folder '{path}' is not empty; add --resume to go on with the same scene, "
                "or choose another --out"
            )
        stored = read_scene(folder)
        if stored.hash() != scene.hash():
            raise RunFolderError(
                f"run folder '{path}' belongs to another scene ({difference(stored, scene)}); "
                "--resume needs the same one"
            )
    parent = path.absolute()
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise NotADirectoryError(f"run folder '{path}' cannot be made, '{parent}' is a file")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise PermissionError(f"there is no right to write in '{parent}', which --out needs")


def difference(stored: Scene, asked: Scene) -> str:
    """A field in which two scenes differ, with both values, and how many do.

    What was typed goes before the constants of the alloys that follow from it, round-off last.
    """
    found = sorted(
        _differences(stored.to_json(), asked.to_json(), ""),
        key=lambda entry: (_round_off(*entry[1:]), entry[0].startswith("alloys[")),
    )
    if not found:
        return "no field differs"
    name, there, here = found[0]
    more = f"; {len(found)} fields differ" if len(found) > 1 else ""
    return f"{name} is {_brief(there)} there and {_brief(here)} here{more}"


def _differences(a: object, b: object, name: str) -> Iterator[tuple[str, object, object]]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted({*a, *b}):
            yield from _differences(a.get(key), b.get(key), f"{name}.{key}" if name else key)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for number, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _differences(x, y, f"{name}[{number}]")
    elif a != b:
        yield name, a, b


def _round_off(a: object, b: object) -> bool:
    return isinstance(a, float) and isinstance(b, float) and math.isclose(a, b, rel_tol=1e-12)


def _brief(value: object) -> str:
    if not isinstance(value, list | dict):
        return repr(value)
    if isinstance(value, list) and value and all("label" in entry for entry in value):
        return " ".join(str(entry["label"]) for entry in value)
    return f"{len(value)} entries"


def _remove(path: Path, created: list[Path]) -> None:
    """Take away what this run wrote: the folder's content, and the folders it created."""
    for entry in path.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)
    for folder in created:
        try:
            folder.rmdir()
        except OSError:
            return
