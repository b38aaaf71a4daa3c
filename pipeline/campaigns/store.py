"""A store of finished stages, each under the hash of its inputs: nothing is computed twice.

`STORE/STAGE/HASH/` holds what a stage writes and its record, which is written last; a stage that
was interrupted has no record and goes on in its folder.  The hashes are those of run folders.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.record.run_folder import RunFolder
from pipeline.record.stage_hashes import corrosion_hash, geometry_hash, pull_hash
from pipeline.scene.scene import Scene


class StoreFolder(RunFolder):
    """A run folder of one scene whose stages lie in a store that many scenes share."""

    def __init__(self, path: Path | str, scene: Scene):
        super().__init__(path)
        self.scene = scene

    @property
    def geometry(self) -> Path:
        """Solid and mesh, whichever scenes have them."""
        return self.path / "geometry" / geometry_hash(self.scene)

    def corrosion(self, alloy: str) -> Path:
        """Concentration fields of an alloy in this scene."""
        return self.path / "corrode" / corrosion_hash(self.scene, alloy)

    def test(self, alloy: str, label: str, hold: str) -> Path:
        """Damage map and mechanical test."""
        moment = next(m for m in self.scene.with_intact() if m.label == label)
        held = next(h for h in self.scene.holds if h.name == hold)
        return self.path / "test" / pull_hash(self.scene, alloy, moment, held)
