"""One task of a campaign: one stage of one scene, in a process of its own.

`do_task` starts `python -m pipeline.campaigns.task`, so that a crash or the memory of one task
never touches the others, whichever engine calls it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

from pipeline.campaigns.store import StoreFolder
from pipeline.life_cycle import LifeCycle
from pipeline.record.machine import child_environment
from pipeline.scene.scene import Scene, scene_from_json

ATTEMPTS = 3
"""How often a task whose process dies is begun; one that refuses is begun once."""

_REFUSED = 2


@dataclass(frozen=True)
class Task:
    """A stage ("geometry", "corrode" or "test") of a scene in a store.

    key: the folder of the stage in the store, so that equal stages are one task.
    """

    stage: str
    key: str
    store: str
    scene: Scene
    alloy: str = ""
    label: str = ""
    hold: str = ""

    def to_json(self) -> dict[str, object]:
        """What `do_task` takes, on this machine or another."""
        return {
            "stage": self.stage, "store": self.store, "alloy": self.alloy, "label": self.label,
            "hold": self.hold, "scene": self.scene.to_json(),
        }  # fmt: skip


def do_task(content: dict) -> str:
    """Do a task in a child process; returns an empty text, or one sentence on why it failed."""
    said = ""
    for _ in range(ATTEMPTS):
        done = subprocess.run(
            [sys.executable, "-m", "pipeline.campaigns.task"],
            input=json.dumps(content),
            env=child_environment(0, None),
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == 0:
            return ""
        lines = done.stderr.strip().splitlines() or ["no message"]
        said = f"{content['stage']} ended with exit status {done.returncode}: {lines[-1].strip()}"
        if done.returncode == _REFUSED:
            break
    return said


def perform(content: dict) -> None:
    """Do a task in this process; a stage that the store has is left as it is."""
    scene = scene_from_json(content["scene"])
    cycle = LifeCycle(scene, StoreFolder(content["store"], scene), workers=1)
    if content["stage"] == "geometry":
        cycle.geometry()
    elif content["stage"] == "corrode":
        cycle.corrode(content["alloy"])
    else:
        moment = next(m for m in scene.with_intact() if m.label == content["label"])
        hold = next(h for h in scene.holds if h.name == content["hold"])
        test = (content["alloy"], moment, hold)
        cycle.map(*test)
        cycle.pull([test])


def main() -> int:
    """Do the task that standard input describes."""
    try:
        perform(json.loads(sys.stdin.read()))
    except (ValueError, OSError, MemoryError) as error:
        print(" ".join(str(error).split()) or type(error).__name__, file=sys.stderr)
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
