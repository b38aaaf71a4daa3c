"""What each stage of a run depends on: a stage is repeated only when its hash changes.

A hash covers the numbers of the scene that the stage reads, the stages before it, and the revision
of its code.
"""

import dataclasses

from pipeline.record.machine import version
from pipeline.scene.scene import HoldScene, Scene, content_hash
from pipeline.scene.units import ImmersionTime

STAGE_REVISION = {"geometry": 4, "corrode": 9, "map": 8, "pull": 9, "report": 7}
"""Raise a stage's number with every change of code (peri and fem included) or of a default outside
the scene that changes what the stage writes: otherwise a run folder that is gone on with keeps what
the older code wrote there.  Stages that build on it follow by themselves."""


def stage_hash(stage: str, *parts: object) -> str:
    """Hash of a stage's inputs, of the revision of its code and of the version of perilife."""
    return content_hash(version(), stage, STAGE_REVISION[stage], *parts)


def geometry_hash(scene: Scene) -> str:
    """What the solid and its meshes depend on; a solid file counts by its content."""
    meshes = {folder: dataclasses.asdict(mesh) for folder, mesh in scene.meshes().items()}
    return stage_hash("geometry", _geometry(scene), meshes)


def corrosion_hash(scene: Scene, alloy: str) -> str:
    """What the corrosion march of one alloy depends on; the mesh is not part of it."""
    return stage_hash(
        "corrode",
        _geometry(scene),
        dataclasses.asdict(scene.lattice),
        dataclasses.asdict(scene.domain),
        dataclasses.asdict(scene.corrosion),
        dataclasses.asdict(scene.alloy(alloy).corrosion),
        [time.seconds for time in scene.with_intact()],
        *([] if scene.ions is None else [dataclasses.asdict(scene.ions)]),
    )


def map_hash(scene: Scene, alloy: str, time: ImmersionTime, hold: HoldScene) -> str:
    """What the damage map of one alloy and time for one way of holding depends on."""
    return stage_hash(
        "map",
        stage_hash("geometry", _geometry(scene), dataclasses.asdict(hold.mesh)),
        corrosion_hash(scene, alloy),
        time.seconds,
        hold.tensile.element,
        hold.tensile.damage == "cell",
        hold.tensile.mapping,
        [hold.tensile.bottom_grip, hold.tensile.top_grip],
        scene.alloy(alloy).material.q1,
    )


def pull_hash(scene: Scene, alloy: str, time: ImmersionTime, hold: HoldScene) -> str:
    """What the tensile test of one alloy and time in one way of holding depends on."""
    return stage_hash(
        "pull",
        map_hash(scene, alloy, time, hold),
        dataclasses.asdict(scene.alloy(alloy).material),
        dataclasses.asdict(hold.tensile),
    )


def report_hash(scene: Scene, records: list[str]) -> str:
    """What the report depends on; records: those of the stages that it shows, as text."""
    return stage_hash("report", scene.to_json(), records)


def _geometry(scene: Scene) -> dict:
    geometry = dataclasses.asdict(scene.geometry)
    geometry.pop("path", None)
    return geometry
