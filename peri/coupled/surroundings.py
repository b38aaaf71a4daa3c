"""The liquid around the metal of a corrosion scene, and what the metal releases into it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene
from peri.transport.chemistry.composition import Composer
from peri.transport.chemistry.speciation import Solution
from peri.transport.liquid import LiquidSpace, LiquidState
from peri.transport.nernst_planck import QuasiSteadyLiquid, TransportOptions
from peri.transport.stored import StoredLiquid

MAGNESIUM = {"Mg": 1.0, "OH": 2.0}
"""Mg + 2 H2O -> Mg2+ + 2 OH- + H2: what anode and cathode at one place set free per mole."""

HYDROGEN_PER_METAL = 1.0
"""Moles of H2 per mole of magnesium."""


def relaxation_time(scene: CorrosionScene, medium: Solution) -> float:
    """L^2 / (2 D), s: L the largest distance from the metal, D the smallest diffusivity."""
    away = distance_transform_edt(~scene.metal, sampling=scene.lattice.spacing)
    width = float(away[scene.domain].max())
    return width**2 / (2 * float(medium.chemistry.diffusivity.min()))


def outside_of(scene: CorrosionScene) -> tuple[float, float]:
    """How many of the metal's nodes lie at its surface, and how many there are (at least 1)."""
    metal = scene.metal & ~binary_erosion(scene.metal)
    return float(metal.sum()), max(float(scene.metal.sum()), 1.0)


class Surroundings:
    """Liquid nodes, chemistry and release for the present phases of a bi-material problem.

    Parameters
    ----------
    discrete : BiMaterial; its processes share out the liquid, too
    medium : Solution of one node, what refreshed nodes hold
    options : TransportOptions
    stores : whether the liquid has a content (StoredLiquid) or is at rest (QuasiSteadyLiquid)

    switch : padded box array, which metal nodes exchange with the liquid (1, or 0 for those that
        would take solute back); 1 for all.
    pockets : number of liquid nodes that no bonds join to the refreshed layer; they have no steady
        state and take no part at rest (their release is `pocket_share` of the whole).

    Raises
    ------
    ValueError
        At rest without a refreshed layer.
    """

    def __init__(
        self,
        discrete: BiMaterial,
        medium: Solution,
        options: TransportOptions | None = None,
        stores: bool = False,
    ) -> None:
        scene = discrete.scene
        if not scene.dissolution.reduces:
            raise ValueError(
                f"dissolution: '{scene.dissolution.name}' with the ions of the liquid; allowed: "
                "proportional"
            )
        fixed = discrete.sum.crop(discrete.fixed.astype(float)) > 0
        if not (discrete.is_open or stores):
            raise ValueError(
                f"boundary: '{scene.boundary}' leaves no refreshed liquid, so the liquid must store"
            )
        metal = discrete.sum.crop(discrete.metal.astype(float)) > 0
        liquid = scene.domain & ~metal
        capacity = scene.capacity()
        given, processes = (fixed, capacity), discrete.processes
        space = LiquidSpace(scene.stencil, liquid, *given, processes)
        lost = np.zeros(space.n, bool) if stores else space.cut_off()
        self.pockets = space.count(lost)
        if self.pockets:
            gone = space.crop(lost.astype(float), elsewhere=0.0) > 0
            space = LiquidSpace(scene.stencil, liquid & ~gone, *given, processes)
        self.space, self.discrete = space, discrete
        near = np.zeros(space.n, bool)
        if discrete.box is not None:
            seen = discrete.put(discrete.box(discrete.box_metal_volume))
            near = space.gather(seen) > 0
        self.near = near
        self.liquid: QuasiSteadyLiquid | StoredLiquid
        if stores:
            self.liquid = StoredLiquid(space, medium, MAGNESIUM, near, options)
        else:
            self.liquid = QuasiSteadyLiquid(space, medium, MAGNESIUM, near, options)
        self.pocket_share = 0.0
        self.switch: np.ndarray | float = 1.0

    def source(
        self, concentration: np.ndarray, theta: np.ndarray | None, volume_loss: float
    ) -> np.ndarray:
        """Metal released into each node, mol/m3/s, (n,): the interface bonds of the bi-material.

        D_int g(V_L) theta_j sum_{metal i} c_i w_ij (C_i - C_j); concentration : padded field,
        theta : padded field of the box or None (all 1).
        """
        discrete = self.discrete
        if discrete.box is None:
            return np.zeros(self.space.n)
        liquid = np.where(discrete.box_metal, 0.0, discrete.take(concentration))
        rate, local = discrete.interface_rate(volume_loss, discrete.seen_liquid(liquid))
        inflow = self._brought(concentration, theta, rate, local)
        source = self.space.gather(discrete.put(inflow))
        total = discrete.processes.total
        whole = total(float((inflow * discrete.box_free_volume).sum()))
        there = total(float(self.space.volume @ source))
        self.pocket_share = 1.0 - there / whole if whole > 0 else 0.0
        return source

    def inflow(
        self,
        concentration: np.ndarray,
        theta: np.ndarray | None,
        rate: float,
        local: np.ndarray | float,
    ) -> np.ndarray:
        """What the interface brings at a rate (m^2/s) and shares of the metal's nodes, (n,)."""
        brought = self._brought(concentration, theta, rate, local)
        return self.space.gather(self.discrete.put(brought))

    def _brought(
        self,
        concentration: np.ndarray,
        theta: np.ndarray | None,
        rate: float,
        local: np.ndarray | float,
    ) -> np.ndarray:
        discrete = self.discrete
        values = discrete.take(concentration)
        volume = discrete.box_metal_volume * self.switch * local
        inflow = rate * (discrete.box(volume * values) - values * discrete.box(volume))
        if theta is not None:
            inflow = inflow * theta
        free = discrete.box_free_volume > 0
        return np.where(free & ~discrete.box_metal, inflow, 0.0)

    def moved(self, values: np.ndarray, older: Surroundings) -> np.ndarray:
        """Rows (k, n) on this space from those on an older one.

        New nodes get the mean of the nodes around them, weighted as the bonds are.
        """
        known = np.isin(self.space.index, older.space.index)
        place = np.searchsorted(older.space.index, self.space.index[known])
        new = np.zeros((len(values), self.space.n))
        new[:, known] = values[:, place]
        if self.space.any(~known):
            degree = np.maximum(self.space.neighbours(known.astype(float)), 1e-300)
            for row in new:
                row[~known] = (self.space.neighbours(row) / degree)[~known]
        return new

    def carried_over(self, state: LiquidState, older: Surroundings) -> LiquidState:
        """A state on this space from one on an older one; new nodes get their neighbours' mean.

        The mean of what they hold, in equilibrium: means of its logarithms would not be neutral.
        Raises CompositionError.
        """

        def rows(values: np.ndarray) -> np.ndarray:
            return self.moved(values, older)

        def moved(values: np.ndarray) -> np.ndarray:
            return rows(values[None])[0]

        carried = LiquidState(
            rows(state.ln_component),
            rows(state.concentration),
            moved(state.release),
            rows(state.extents),
            rows(state.migrated),
            rows(state.rates),
            moved(state.psi),
            moved(state.net_charge),
            active=[moved(a.astype(float)) >= 1.0 for a in state.active],
        )
        self.space.processes.together(lambda: self._fill_pores(carried, older))
        return carried

    def _fill_pores(self, state: LiquidState, older: Surroundings) -> None:
        """Compose what new nodes hold, in place."""
        liquid = self.liquid
        pores = ~np.isin(self.space.index, older.space.index)
        pores &= (state.concentration > 0).any(axis=0)
        if not pores.any():
            return
        stoichiometry = liquid.chemistry.stoichiometry
        b = liquid.b if liquid.b.shape[1] == 1 else liquid.b[:, pores]
        ln_component = state.ln_component[:, pores]
        composer = Composer(stoichiometry, np.ones(len(stoichiometry)))
        totals = stoichiometry.T @ state.concentration[:, pores]
        state.concentration[:, pores] = composer.solve(totals, b, ln_component)
        state.ln_component[:, pores] = ln_component
        state.net_charge[pores] = liquid.chemistry.charge @ state.concentration[:, pores]
