"""Galvanic corrosion: the potential of a couple, and the march of what its currents dissolve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from peri.coupled.galvanic_march import GalvanicProblem
from peri.coupled.galvanic_renewal import Renewal
from peri.coupled.galvanic_scene import ROBIN, GalvanicScene, Metal
from peri.engine.march.marching import march
from peri.transport.potential.electrostatics import PotentialField, PotentialProblem

__all__ = ["ROBIN", "GalvanicResult", "GalvanicScene", "Metal", "Renewal", "corrode", "potential"]


@dataclass(frozen=True)
class GalvanicResult:
    """Output of `corrode`.

    times : (nt,), s.  fields : by name, (nt, *lattice.shape): concentration (of the metals that
    dissolve, mol/m^3), metal (bool), potential (of the liquid, V), current_density (A/m^2) and
    electrode_potential (V) of the metal nodes at the surface; NaN where there is nothing to say.
    history : per step, arrays named as GalvanicProblem.columns says.  wall_time : s.
    """

    scene: GalvanicScene
    times: np.ndarray
    fields: dict[str, np.ndarray]
    history: dict[str, np.ndarray]
    columns: dict[str, str]
    wall_time: float

    def depths(self, axis: int = -1) -> np.ndarray:
        """Lost metal of every column along an axis over the column's section, m, (nt, ...)."""
        scene, a = self.scene, axis % self.scene.lattice.dimension
        solid = scene.solid_concentrations()
        lost = np.where(solid > 0, solid - self.fields["concentration"], 0.0)
        share = lost / np.where(solid > 0, solid, 1.0)
        return share.sum(axis=a + 1) * scene.lattice.spacing[a]


def potential(scene: GalvanicScene) -> PotentialField:
    """Potential and currents of the couple as it is, before anything has dissolved."""
    problem = GalvanicProblem(scene)
    return problem.solve(problem.untouched(), None)


def corrode(
    scene: GalvanicScene,
    times: Sequence[float],
    renewal: Renewal | None = None,
    *,
    progress: Callable[[float, str], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    one_level: bool = False,
    solver_tolerance: float = 1e-9,
    between: Callable[..., PotentialProblem] = PotentialProblem,
) -> GalvanicResult:
    """March a couple to the times asked for (engine.march.marching.march).

    Conserved: what the currents of the dissolving metals carry is what these lose, z F mole by
    mole (history["faraday_error"], round-off; tests/peri/coupled/test_galvanic.py).

    solver_tolerance : residual of the nodes' charge balances relative to the patches' currents.
    between : what solves for the potential between the metals (galvanic_ranks has another).
    one_level : take one potential in each pool of liquid and compute no field (coupled.wagner says
    what that changes).

    Raises
    ------
    ValueError
        For bad times; as PotentialProblem does (no sink for a current, a law that falls).
    """
    problem = GalvanicProblem(scene, solver_tolerance, one_level, between)
    done = march(
        problem,
        times,
        renewal or Renewal(),
        checkpoint=checkpoint,
        resume=resume,
        checkpoint_every=checkpoint_every,
        progress=progress,
    )
    fields = {name: np.array([out[name] for out in done.outputs]) for name in done.outputs[0]}
    columns = {"time": "s", "step": "s", **problem.columns, "iterations": "1"}
    return GalvanicResult(scene, done.times, fields, done.history, columns, done.wall_time)
