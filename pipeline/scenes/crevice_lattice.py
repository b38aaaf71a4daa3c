"""The crevice of alloy 625 on a lattice of 25:1, beside the film equation on the same steps.

One wall dissolves, the other is the edge of the lattice.  The taper is a staircase of the lattice's
rows; `film_of` gives the film equation the same staircase, so that what differs is the model alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.run import CorrosionResult, corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.constants import FARADAY
from peri.engine.lattice import Lattice
from peri.engine.march.marching import TimeStepping, march
from peri.omissions.thin_gap import ThinGap, ThinGapProblem
from pipeline.scenes.crevices import LENGTH, MOST

SOLID, DIFFUSIVITY, CHARGE = 1.4e5, 7.2e-10, 2.5
HOUR = 3600.0
STEPPING = TimeStepping("backward_euler", rate_change=0.1)


@dataclass(frozen=True)
class Compared:
    """Two models of one crevice at the same times.

    depth : (nt, nodes along the gap), m, of the lattice and of the film.  place : (nodes,), m from
    the mouth.  time : s of processor time, of each.
    """

    times: np.ndarray
    place: np.ndarray
    lattice: np.ndarray
    film: np.ndarray
    result: CorrosionResult

    def lost(self, depth: np.ndarray) -> np.ndarray:
        """Area of metal lost at each time, m^2."""
        return depth.sum(axis=1) * (self.place[1] - self.place[0])

    def site(self, depth: np.ndarray) -> float:
        """Where the wall moved fastest between the last two times, m from the mouth."""
        moved = depth[-1] - depth[-2]
        top = int(moved.argmax())
        low, high = max(top - 1, 0), min(top + 2, moved.size)
        a, b, c = moved[low], moved[top], moved[high - 1]
        # The vertex of the parabola through the fastest node and its neighbours.
        bend = a - 2 * b + c
        shift = 0.5 * (a - c) / bend if high - low == 3 and bend < 0 else 0.0
        return float(self.place[top] + shift * (self.place[1] - self.place[0]))


def crevice_on_lattice(
    seed: float,
    spacing: tuple[float, float] = (25e-6, 1e-6),
    ratio: int = 4,
    length: float = LENGTH,
    most: float = 8e-6,
    walls: bool = True,
    pores: bool = True,
) -> CorrosionScene:
    """The washer of alloy 625, x from the mouth and y across the gap.

    spacing : m.  ratio : horizon over spacing, along both.  length : of the crevice from its closed
    end, m; a shorter one leaves out the wide part at the mouth.  most : metal beyond what the
    widest place has of it, m.  walls, pores : see CorrosionScene.
    """
    along, across = spacing
    columns = round(length / along)
    place = (np.arange(columns) + 0.5) * along
    gap = np.rint((5e-6 + 20e-6 * (length - place) / LENGTH) / across).astype(int)
    shape = (columns + ratio, int(gap.max()) + max(ratio + 1, round(most / across)))
    lattice = Lattice(((0.5 - ratio) * along, 0.5 * across), spacing, shape)
    rows = np.arange(shape[1])
    inside = np.concatenate([np.full(ratio, gap[0]), gap])
    metal = rows[None, :] >= inside[:, None]
    mouth = np.zeros(shape, bool)
    mouth[:ratio] = True
    x = np.broadcast_to(lattice.axis(0)[:, None], shape)
    return CorrosionScene(
        lattice,
        tuple(ratio * h for h in spacing),
        metal & ~mouth,
        domain=~(metal & mouth),
        liquid=np.where(x > length - seed, 0.99 * MOST, 0.0),
        renewed=mouth & ~metal,
        walls=walls,
        pores=pores and walls,
        solid_concentration=SOLID,
        saturation_concentration=MOST,
        liquid_diffusivity=DIFFUSIVITY,
        dissolution_flux=1.0 / (CHARGE * FARADAY),
        flux_calibration="every_axis",
        dissolution="faradaic",
        kinetics=AcidityLaw(MOST),
    )


def film_of(scene: CorrosionScene) -> ThinGap:
    """The film equation on the columns of a crevice on a lattice, with its staircase."""
    inside = ~scene.renewed.any(axis=1)
    x = scene.lattice.axis(0)[inside]
    along, across = scene.lattice.spacing
    liquid = scene.domain & ~scene.metal
    assert scene.liquid is not None and isinstance(scene.kinetics, AcidityLaw)
    return ThinGap(
        float(x[-1] + 0.5 * along),
        gap=across * liquid[inside].sum(axis=1),
        concentration=scene.liquid[inside, 0].copy(),
        law=scene.kinetics,
        charge_number=CHARGE,
        diffusivity=scene.liquid_diffusivity,
        solid_concentration=scene.solid_concentration,
        saturation_concentration=scene.saturation_concentration,
    )


def depths_of(scene: CorrosionScene, concentration: np.ndarray, metal: np.ndarray) -> np.ndarray:
    """Lost metal of each column, m, (nt, columns inside)."""
    inside = ~scene.renewed.any(axis=1)
    left = np.where(metal, concentration, 0.0) / scene.solid_concentration
    lost = np.where(scene.metal, 1.0 - left, 0.0)
    return lost.sum(axis=2)[:, inside] * scene.lattice.spacing[1]


def compare(
    scene: CorrosionScene, times: list[float], stepping: TimeStepping = STEPPING
) -> Compared:
    """Both models to the same times (s), two at least."""
    result = corrode(scene, times, stepping)
    gap = film_of(scene)
    done = march(ThinGapProblem(gap), times, TimeStepping(rate_change=0.05))
    film = np.array([out["gap"] for out in done.outputs]) - gap.gap
    return Compared(
        result.times, gap.places, depths_of(scene, result.concentration, result.metal), film, result
    )
