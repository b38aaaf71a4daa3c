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

RATE_CHANGE = 0.1
"""Largest control target of the steps that `auto` takes: with 0.2 and 0.4 a step of weeks empties
skin classes, is taken at first order and errs by 1.2 % of V_L after 8 weeks, with 0.1 by 0.2 %
(Mg-5Gd, reference screw at half a horizon; each march takes 2 to 4 s)."""


def read_classes(text: str) -> int | str:
    """`auto` or a number, as typed."""
    if text == AUTO or text.isdecimal():
        return text if text == AUTO else int(text)
    raise SceneError(f"rate classes is '{text}'; it must be auto or 0 (none) to 8")


def one_rate_because(scene: Scene) -> str:
    """Why the nodes of a scene have one rate each; "" for a scene with rate classes."""
    if scene.corrosion.classes:
        return ""
    return _obstacle(scene) or "as asked for: --classes auto takes rate classes"


def with_classes(scene: Scene, keep_steps: bool = False) -> Scene:
    """The scene with rate classes, where it allows them, and steps short enough for them.

    keep_steps: leave the control target of the steps as it is.
    """
    if _obstacle(scene):
        return scene
    change = scene.corrosion.rate_change
    change = change if keep_steps else min(change, RATE_CHANGE)
    settings = dataclasses.replace(scene.corrosion, classes=WANTED, rate_change=change)
    return dataclasses.replace(scene, corrosion=settings)


def _obstacle(scene: Scene) -> str:
    if isinstance(scene.geometry, ImageFile):
        return "the metal is known by its voxels, not by a surface"
    try:
        dataclasses.replace(scene, corrosion=dataclasses.replace(scene.corrosion, classes=WANTED))
    except SceneError as error:
        return str(error)
    return ""
