"""Rate classes of a scene: how many, or why each node has one rate instead."""

from __future__ import annotations

import dataclasses

from pipeline.scene.checks import SceneError
from pipeline.scene.image import ImageFile
from pipeline.scene.scene import Scene

AUTO = "auto"
"""Rate classes where the scene allows them, else one rate per node."""

WANTED = 3
"""Classes per cell that `auto` takes (peri.engine.surface.rate_classes.CLASSES)."""


def read_classes(text: str) -> int | str:
    """`auto` or a number, as typed."""
    if text == AUTO or text.isdecimal():
        return text if text == AUTO else int(text)
    raise SceneError(f"rate classes is '{text}'; it must be auto or 0 (none) to 8")


def one_rate_because(scene: Scene) -> str:
    """Why the nodes of a scene have one rate each; "" for a scene with rate classes."""
    if scene.corrosion.classes:
        return ""
    return _obstacle(scene) or "as --classes 0 asks"


def with_classes(scene: Scene) -> Scene:
    """The scene with rate classes, where it allows them."""
    if _obstacle(scene):
        return scene
    settings = dataclasses.replace(scene.corrosion, classes=WANTED)
    return dataclasses.replace(scene, corrosion=settings)


def _obstacle(scene: Scene) -> str:
    if all(time.seconds == 0 for time in scene.immersion):
        return "only time zero is asked for"
    if isinstance(scene.geometry, ImageFile):
        return "the metal is known by its voxels, not by a surface"
    try:
        dataclasses.replace(scene, corrosion=dataclasses.replace(scene.corrosion, classes=WANTED))
    except SceneError as error:
        return str(error)
    return ""
