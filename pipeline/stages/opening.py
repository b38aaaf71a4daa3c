"""Opening a run folder: everything that can be refused is refused before anything is written."""

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
    from pipeline.stages.geometry import build_solid, read_surface
    from pipeline.stages.readiness import check_machine
    from pipeline.stages.sizes import check_screw

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
    from pipeline.stages.geometry import read_surface
    from pipeline.stages.readiness import check_machine

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
    """The first field in which two scenes differ, with both values."""
    found = _first_difference(stored.to_json(), asked.to_json(), "")
    if found is None:
        return "no field differs"
    name, there, here = found
    return f"{name} is {there} there and {here} here"


def _first_difference(a: object, b: object, name: str) -> tuple[str, object, object] | None:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted({*a, *b}):
            inner = f"{name}.{key}" if name else key
            found = _first_difference(a.get(key), b.get(key), inner)
            if found is not None:
                return found
        return None
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for number, (x, y) in enumerate(zip(a, b, strict=True)):
            found = _first_difference(x, y, f"{name}[{number}]")
            if found is not None:
                return found
        return None
    if a == b:
        return None
    brief = [f"{len(v)} entries" if isinstance(v, list | dict) else repr(v) for v in (a, b)]
    return (name, *brief)


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
