"""What a run goes by when it pulls beside other work: how long a test takes, how many fit."""

from pipeline.geometry.surface import Solid
from pipeline.planning.beside import room
from pipeline.planning.plan import make_plan, mesh_counts, seconds_of_test
from pipeline.scene.scene import HoldScene, Scene


def pull_seconds(scene: Scene, solid: Solid, hold: HoldScene) -> float:
    """How long one test in a way of holding is expected to take, s."""
    return seconds_of_test(hold, mesh_counts(scene, solid, hold)[1])


def room_beside_march(scene: Scene, solid: Solid, workers: int) -> int:
    """How many tests, of `workers` at a time, fit beside a march: into cores and memory."""
    return room(make_plan(scene, solid, workers).tasks, workers)
