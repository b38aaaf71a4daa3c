"""What liquid that saturates for a while holds back of the loss: a bound without a march.

The inflow S_j of a liquid cell never rises, and falls by at most the share r dt in a time dt (r: of
the fastest class and the kinetics together).  Hence the liquid is at each time below the steady one
Q of that inflow, with r c C_sat for what it still stores (c the cells' shares of liquid, L what
flows off),

    L Q = S + r c C_sat - W,    0 <= C_sat - Q  perpendicular to  W >= 0,

for c Q' + L Q >= S where no cell is held, and what a cell at C_sat holds back in truth is at most
W_j: both by comparison, as L is an M-matrix.  S takes the classes from above: they decay by the
bonds that W leaves on, with the exposure z of clean liquid, which the true one exceeds; and the
kinetics is that of the loss so far, from below.  What has been held back by a time is missing in
the metal's loss at equal z, and no more than that at equal times: the kinetics only slows, and
the loss is concave in z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from peri.corrosion.classes.cells import Cells
from peri.corrosion.kinetics import Exposed, Kinetics
from peri.engine.solvers import ConvergenceError, DiffusionSystem
from peri.omissions.bounds import left_after
from peri.omissions.reduced import ReducedCorrosion, factor_of

Array = NDArray[np.float64]

_FIRST = 0.05
"""First step of time, over the time in which the inflow may fall to 1/e."""
_GROWTH = 1.4
"""Of the steps of time; W counts as at a step's start.  With half of both the bound of Mg-5Gd's
fastest samples is a tenth lower, and takes twice as long."""
_ROUNDS = 30
"""Of the saturated cells, by which they have settled (measured: 6)."""
_TOLERANCE = 1e-7
"""Residual of a solution, relative to the inflow."""
_LOSSES = 1000
"""Volume losses at which the kinetics is looked at for how fast it falls."""


@dataclass(frozen=True)
class HeldBack:
    """What saturation may change.

    cells : saturated at once at most.  until : s of bare metal after which none is.  share : bound
    of what is held back, relative to V_L, the largest at the times asked for.
    """

    cells: int
    until: float
    share: float


def held_back(
    problem: Cells, reduced: ReducedCorrosion, times: Array, enough: float = math.inf
) -> HeldBack:
    """Bound of what saturated liquid holds back by times; the surface must not move until then.

    Parameters
    ----------
    problem : Cells
        As before any step, with held liquid; one kinetics, that never speeds up.
    reduced : ReducedCorrosion
        The same scene in clean liquid.
    times : array (nt,)
        s, > 0.
    enough : float
        A share beyond which the bound need not be known (infinite then).
    """
    scene = problem.scene
    asked = np.sort(scene.bare_time(times))
    law, diffusivity = factor_of(scene.kinetics), scene.base_interface_diffusivity()
    losses = reduced.volume_loss(asked, diffusivity, law).value
    inflow, seen = _Inflow(problem), np.zeros(problem.cell.size)
    shift = inflow.decline * scene.saturation_concentration * problem.free_share
    state = _Steady(problem)
    time, held, step, most = 0.0, 0.0, _FIRST / inflow.decline, 0
    clean, fastest = 0.0, 0.0  # exposures z, m^2: of clean liquid, and one that is too high
    moments, shares = [0.0], [0.0]
    while time < asked[-1]:
        rate, source = inflow.at(seen)
        if not state.settle(source + shift):
            return HeldBack(most, time, math.inf)
        if not state.active.any():
            break
        most = max(most, int(state.active.sum()))
        later = min(time + step, float(asked[-1]))
        held += float(state.held.sum()) / inflow.whole * (later - time)
        if held * reduced.loss_per_dissolved > enough * losses[-1]:
            return HeldBack(most, later, math.inf)
        exposure = float(reduced.volume_loss([later], diffusivity, law).exposure[0])
        on = 1.0 - np.divide(state.held, source, out=np.zeros_like(source), where=source > 0)
        seen += inflow.bond_sum(np.clip(on, 0.0, 1.0)) * (exposure - clean)
        fastest += rate * (later - time)
        clean, time, step = exposure, later, step * _GROWTH
        moments.append(time)
        shares.append(held)
    if (left_after(problem, problem.bond_sum * fastest) < problem.volume).any():
        return HeldBack(most, time, math.inf)
    by_then = np.interp(asked, moments, shares) * reduced.loss_per_dissolved
    return HeldBack(most, time, float((by_then / losses).max()))


class _Inflow:
    """What the classes give to the liquid, from above, by what they have seen.

    decline : largest share of it that is lost in a time, 1/s.  whole : the metal's amount over the
    volume of a cell, mol/m^3.
    """

    def __init__(self, problem: Cells) -> None:
        self.problem = problem
        scene, volume, sums = problem.scene, problem.volume, problem.bond_sum
        self.solid, self.saturated = scene.solid_concentration, scene.saturation_concentration
        first = problem.interface_rate(0.0)[0]
        mean = float(volume @ sums) / float(volume.sum())
        self.decline = first * (float(sums.max()) + mean * _steepest(scene.kinetics))
        self.whole = self.solid * float(volume.sum())

    def at(self, seen: Array) -> tuple[float, Array]:
        """D_int g, m^2/s, and the inflow (padded) when each class (n,) has seen G z at least."""
        problem = self.problem
        gone = float(problem.volume @ -np.expm1(-seen)) / float(problem.volume.sum())
        loss = max(0.0, gone - self.saturated / self.solid)
        rate = problem.base_diffusivity * float(problem.scene.kinetics.rate(Exposed(loss)))
        classes = self.saturated + (self.solid - self.saturated) * np.exp(-seen)
        arriving = problem.near(problem.scatter(problem.volume * problem.mu * classes))
        return rate, rate * problem.free_share * problem.nu * arriving

    def bond_sum(self, on: Array) -> Array:
        """G (n,) of the classes where only the share `on` (padded) of each free cell's bonds is."""
        problem = self.problem
        share = problem.free_share * on + problem.held_share
        return problem.mu * problem.gather(problem.near(share * problem.nu))


class _Steady:
    """The steady liquid below C_sat under an inflow; the last one is where the next begins.

    active : cells at C_sat.  held : W, what they hold back (padded, mol/m^3/s of relative volume).
    """

    def __init__(self, problem: Cells) -> None:
        self.problem = problem
        self.liquid = np.zeros(problem.sum.padded_shape)
        self.held = np.zeros(problem.sum.padded_shape)
        self.active = np.zeros(problem.sum.padded_shape, bool)

    def settle(self, source: Array) -> bool:
        """Solve for a source (padded); False where the cells at C_sat do not settle."""
        problem, most = self.problem, self.problem.scene.saturation_concentration
        wanted = _TOLERANCE * float(np.linalg.norm(source))
        for _ in range(_ROUNDS):
            self.liquid[self.active] = most
            weight = np.where(self.active, 0.0, problem.free_share)
            d = problem.scene.liquid_diffusivity
            around = d * problem.neighbour_share
            sink = weight * (around - d * problem.sum(weight))
            system = DiffusionSystem(problem.sum, weight, around, d, sink)
            try:
                rest = np.where(weight > 0, source - self._flows_off(), 0.0)
                system.solve(self.liquid, rest, wanted)
            except ConvergenceError:
                return False
            left = source - self._flows_off()
            over = (self.liquid > most * (1.0 + 1e-9)) & problem.free
            active = np.where(self.active, left > 0, over)
            if np.array_equal(active, self.active):
                self.held = np.where(active, left, 0.0)
                return True
            self.active = active
        return False

    def _flows_off(self) -> Array:
        problem = self.problem
        flow = problem.neighbour_share * self.liquid
        flow -= problem.sum(problem.free_share * self.liquid)
        return problem.free_share * problem.scene.liquid_diffusivity * flow


def _steepest(kinetics: Kinetics) -> float:
    """How fast a rate falls with the volume loss: the largest -d ln g / d V."""
    rates = factor_of(kinetics)(np.linspace(0.0, 1.0, _LOSSES + 1)).value
    falls = -np.diff(np.log(np.maximum(rates, 1e-280)))
    return max(0.0, float(falls.max())) * _LOSSES
