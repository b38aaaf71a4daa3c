"""How the lattice's loss comes to a point of the mesh: the map of a scene, and why that one."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.scene.mechanics import EXPOSURES, NODES, TensileScene
from pipeline.scene.scene import Scene
from pipeline.scene.units import ImmersionTime


def mapping_of(scene: Scene, test: TensileScene) -> str:
    """`exposures` where the scene can have them and does not ask for another map, else `nodes`.

    Where metal that saw no liquid at first turns out to be lost, `auto` comes back to nodes
    (pipeline.stages.mapping).
    """
    return NODES if by_nodes_because(scene, test) else EXPOSURES


def by_nodes_because(scene: Scene, test: TensileScene) -> str:
    """Why the damage of a scene is interpolated between the nodes; "" where exposures give it."""
    if test.mapping == NODES:
        return "--mapping nodes"
    if not scene.corrosion.classes:
        return "each node has one rate"
    if scene.corrosion.dissolution != "proportional":
        return f"the law of a bond is {scene.corrosion.dissolution}"
    return ""


def fallen_back(
    scene: Scene, test: TensileScene, time: ImmersionTime, mapped: Mapping[str, object]
) -> str:
    """Why a test got nodes where its scene has exposures, from what its map stage found; "" else.

    mapped: the numbers of the stage's record.
    """
    if time.seconds == 0 or mapping_of(scene, test) == NODES:
        return ""
    return str(mapped.get("mapping_because", ""))
