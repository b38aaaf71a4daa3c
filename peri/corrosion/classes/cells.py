"""Cells with rate classes, discretised, and how they are stepped (volumes.py has the form)."""

from __future__ import annotations

from peri.corrosion.classes.stage import Array, CellStage, StageSolver
from peri.corrosion.classes.volumes import Volumes
from peri.corrosion.scene import CorrosionScene
from peri.engine.processes import ONE_PROCESS, OneProcess


class Cells(Volumes):
    """Volumes with the implicit stage that moves them on; parameters as there."""

    def __init__(
        self,
        scene: CorrosionScene | None,
        tolerance: float = 1e-9,
        processes: OneProcess = ONE_PROCESS,
    ) -> None:
        self._solver = StageSolver(self)
        super().__init__(scene, tolerance, processes)

    def set_volumes(self, volume: Array, ahead: Array | None = None) -> None:
        """See Volumes.set_volumes."""
        super().set_volumes(volume, ahead)
        self.forget()

    def forget(self) -> None:
        """Drop the preconditioner of earlier stages."""
        self._solver.forget()

    def stage(
        self, old: Array, old_classes: Array, tau: float, guess: Array, theta: Array | None,
        volume_loss: float, owed: Array | None = None,
    ) -> CellStage:  # fmt: skip
        """Solve Y = old + tau F(Y), kinetics and saturation included; see StageSolver.solve."""
        return self._solver.solve(old, old_classes, tau, guess, theta, volume_loss, owed)
