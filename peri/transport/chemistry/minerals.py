"""Minerals in a moving liquid: amount >= 0 against the saturation index, in one system with flux.

A mineral is one scalar field, the extent G with A G = c r: what its growth r (mol/m3/s) takes out
of the liquid changes Pi_e by -nu_e G everywhere.

equilibrium : r + M/tau >= 0 and ln(Omega) <= 0, one of them zero at every node.  The G at which a
    node is exactly saturated, all else given, is a local convex problem (speciation.saturate); with
    it the condition is an obstacle problem G >= psi for A, whose matrix has the sign pattern of an
    M-matrix: the primal-dual active set finds its solution monotonically, without damping.
kinetic : r = k S ln(Omega) where the mineral is there or ln(Omega) exceeds its nucleation value,
    not below -M/tau (no more dissolves than is there).  Newton's method with A + k S H, H the
    derivative -d ln(Omega)/dG = nu^T (nu^T D C nu)^-1 nu > 0, halved while the residual grows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from peri.engine.solvers import ConvergenceError, DiffusionSystem
from peri.transport.chemistry.composition import Composer
from peri.transport.chemistry.speciation import saturate
from peri.transport.liquid import LiquidSpace, LiquidState

_MAXIMUM_SWEEPS = 60
_MAXIMUM_ROUNDS = 100
_ROUND_OFF = 10.0
"""Where Newton's steps stop to help, a residual of this many times the tolerance will do."""
_SAME_SINK = 1e-3
"""Of a sink: a change below it keeps the system of the last Newton step."""
_SATURATED = 1e-9
"""ln(Omega) at which a node counts as saturated."""


@dataclass(frozen=True)
class MineralField:
    """A mineral on the nodes of a liquid.

    nu : (E,) components set free per mole;  constant : c of ln(Omega) = nu . m + c
    region : (n,) bool, where it may form
    rate : k S, mol/m3/s per unit of ln(Omega); infinite in equilibrium
    ln_nucleation : ln(Omega) to be passed where there is none
    """

    name: str
    nu: np.ndarray
    constant: float
    region: np.ndarray
    rate: float
    ln_nucleation: float

    @property
    def in_equilibrium(self) -> bool:
        """Whether the mineral follows the saturation index at once."""
        return not np.isfinite(self.rate)

    def ln_omega(self, m: np.ndarray) -> np.ndarray:
        """ln(Omega), (n,), from the free components (E, n)."""
        return self.nu @ m + self.constant


SunkSystem = tuple[np.ndarray, DiffusionSystem]
"""A sink (n,), 1/m2, and the system with it."""


class ReactingLiquid(Protocol):
    """What a mineral sees of the liquid that it forms in.

    sunk : by the number of a kinetic mineral, the system of its last Newton step in this solution
    """

    space: LiquidSpace
    composer: Composer
    b: np.ndarray
    minerals: Sequence[MineralField]
    plain: DiffusionSystem
    relative: float
    sunk: dict[int, SunkSystem]

    def target(self, state: LiquidState, nodes: np.ndarray | None = None) -> np.ndarray: ...

    def compose(self, state: LiquidState, nodes: np.ndarray | None = None) -> None: ...


def settle(
    liquid: ReactingLiquid,
    state: LiquidState,
    there: np.ndarray | None,
    step: float,
    absolute: float,
) -> None:
    """Compose a liquid with its minerals in balance: one after the other until none changes.

    Until then only the composition where those may form that take part is followed; those that
    take no part are looked at when it is known everywhere.

    there : (M, n) minerals that there are, mol/m3; None: none may form
    step : s, over which no more than they can dissolve
    absolute : residual norm of each

    Raises ConvergenceError, CompositionError.
    """
    taking = _taking(liquid, state, there)
    for i in set(range(len(liquid.minerals))) - set(taking):
        state.extents[i] = 0.0  # what an earlier, looser balance left of one that is gone
    while True:
        if taking and there is not None:
            nodes = np.flatnonzero(np.any([liquid.minerals[i].region for i in taking], axis=0))
            liquid.compose(state, nodes)
            _balance(liquid, state, taking, there, step, absolute, nodes)
        liquid.compose(state)
        more = sorted({*taking, *_taking(liquid, state, there)})
        if more == taking:
            return
        taking = more


def _taking(liquid: ReactingLiquid, state: LiquidState, there: np.ndarray | None) -> list[int]:
    """Numbers of the minerals that are there, change, or pass their nucleation index."""
    if there is None:
        return []
    some = liquid.space.any
    return [
        i
        for i, mineral in enumerate(liquid.minerals)
        if some(there[i])
        or some(state.rates[i])
        or some(mineral.region & (mineral.ln_omega(state.ln_component) > mineral.ln_nucleation))
    ]


def _balance(
    liquid: ReactingLiquid,
    state: LiquidState,
    taking: Sequence[int],
    there: np.ndarray,
    step: float,
    absolute: float,
    nodes: np.ndarray,
) -> None:
    volume, norm = liquid.space.volume, liquid.space.norm
    for _ in range(_MAXIMUM_SWEEPS):
        change = 0.0
        for i in taking:
            before = state.rates[i].copy()
            state.iterations += _solve_mineral(
                liquid, state, i, there[i] / step, there[i], 0.1 * absolute, nodes
            )
            change = max(change, norm(volume * (state.rates[i] - before)))
            absolute = max(absolute, liquid.relative * norm(volume * state.rates[i]))
        if change <= absolute:
            return
    raise ConvergenceError(
        f"minerals: their rates still change by {change:.2g} after {_MAXIMUM_SWEEPS} rounds, "
        f"{absolute:.2g} wanted; a shorter step or a smaller release will do"
    )


def _solve_mineral(
    liquid: ReactingLiquid,
    state: LiquidState,
    number: int,
    lowest: np.ndarray,
    there: np.ndarray,
    absolute: float,
    nodes: np.ndarray,
) -> int:
    """Bring one mineral in balance with the liquid, everything else given; in place.


    lowest : (n,) M/tau, the fastest that it can dissolve, mol/m3/s
    there : (n,) M, mol/m3
    nodes : where composition is read and kept up: the mineral's region at least

    Returns the iterations of the linear solver.  Raises ConvergenceError.
    """
    if liquid.minerals[number].in_equilibrium:
        return _equilibrium(liquid, state, number, lowest, absolute, nodes)
    return _kinetic(liquid, state, number, lowest, there, absolute, nodes)


def _equilibrium(
    liquid: ReactingLiquid,
    state: LiquidState,
    number: int,
    lowest: np.ndarray,
    absolute: float,
    nodes: np.ndarray,
) -> int:
    space, mineral = liquid.space, liquid.minerals[number]
    absolute = max(absolute, 0.1 * liquid.relative * space.norm(space.volume * lowest))
    active = state.active[number]
    may = mineral.region | active
    at, place = np.flatnonzero(may), np.cumsum(may) - 1
    base = liquid.target(state, at) + mineral.nu[:, None] * state.extents[number, at]
    obstacle = np.full(space.n, np.nan)
    iterations = 0
    for _ in range(_MAXIMUM_ROUNDS):
        new = active & np.isnan(obstacle)
        if space.any(new):
            m = state.ln_component[:, new].copy()
            constant = np.full((1, int(new.sum())), mineral.constant)
            obstacle[new] = space.processes.together(
                lambda m=m, constant=constant, new=new: saturate(
                    liquid.composer, base[:, place[new]], liquid.b, m, mineral.nu[None, :], constant
                )
            )[0]
        extent = np.where(active, obstacle, state.extents[number])
        forms = space.any(active)
        if forms or space.any(lowest) or space.any(state.extents[number]):
            system = space.system(active) if forms else liquid.plain
            extent, used = space.solve(system, -space.volume * lowest, extent, 0.1 * absolute)
            iterations += used
        state.extents[number] = extent
        liquid.compose(state, nodes)
        growth = space.outflow(extent) / space.volume
        ln_omega = mineral.ln_omega(state.ln_component)
        stays = active & (growth + lowest >= 0)
        joins = ~active & mineral.region & (ln_omega > _SATURATED)
        updated = stays | joins
        settled = not space.any(updated != active)
        active = updated
        if settled:
            state.active[number] = active
            # Off the active set the growth is what the linear solver was given.
            state.rates[number] = np.where(active, growth, -lowest)
            return iterations
    raise ConvergenceError(
        f"{mineral.name}: the nodes where it forms still change after {_MAXIMUM_ROUNDS} rounds"
    )


def _kinetic(
    liquid: ReactingLiquid,
    state: LiquidState,
    number: int,
    lowest: np.ndarray,
    there: np.ndarray,
    absolute: float,
    nodes: np.ndarray,
) -> int:
    space, mineral = liquid.space, liquid.minerals[number]
    start = mineral.ln_omega(state.ln_component)
    # Open where the threshold is passed, and as long as the mineral is there.
    state.active[number] |= mineral.region & (start > mineral.ln_nucleation)
    is_open = mineral.region & (state.active[number] | (there > 0))
    iterations = 0

    def rate(ln_omega: np.ndarray) -> np.ndarray:
        return np.where(is_open, np.maximum(mineral.rate * ln_omega, -lowest), 0.0)

    growth = rate(start)
    residual = space.volume * growth - space.outflow(state.extents[number])
    norm = space.norm(residual)
    for _ in range(_MAXIMUM_ROUNDS):
        moved = space.norm(space.volume * growth)
        absolute = max(absolute, 0.1 * liquid.relative * moved)
        if norm <= absolute:
            state.rates[number] = growth
            return iterations
        ln_omega = mineral.ln_omega(state.ln_component)
        moving = is_open & (mineral.rate * ln_omega > -lowest)
        sink = np.zeros(space.n)
        sink[moving] = mineral.rate * liquid.composer.sensitivity(
            state.concentration[:, moving], mineral.nu
        )
        step, used = space.solve(
            _sunk(liquid, number, sink), residual, np.zeros(space.n),
            max(1e-3 * norm, 0.1 * absolute),
        )  # fmt: skip
        iterations += used
        before = state.extents[number].copy()
        old_m = state.ln_component[:, nodes]
        share = 1.0
        while True:
            state.extents[number] = before + share * step
            state.ln_component[:, nodes] = old_m
            try:
                liquid.compose(state, nodes)
                growth = rate(mineral.ln_omega(state.ln_component))
                residual = space.volume * growth - space.outflow(state.extents[number])
                new_norm = space.norm(residual)
            except ArithmeticError:
                new_norm = np.inf
            if new_norm < (1 - 1e-4 * share) * norm or new_norm <= absolute:
                break
            share *= 0.5
            if share < 1e-6 and norm <= _ROUND_OFF * absolute:
                # Nothing but round-off is left.
                state.extents[number] = before
                state.ln_component[:, nodes] = old_m
                liquid.compose(state, nodes)
                state.rates[number] = rate(mineral.ln_omega(state.ln_component))
                return iterations
            if share < 1e-6:
                raise ConvergenceError(
                    f"{mineral.name}: no step along Newton's direction lowers the residual "
                    f"{norm:.2g}, {absolute:.2g} wanted"
                )
        norm = new_norm
    raise ConvergenceError(
        f"{mineral.name}: residual {norm:.2g} after {_MAXIMUM_ROUNDS} Newton steps, "
        f"{absolute:.2g} wanted"
    )


def _sunk(liquid: ReactingLiquid, number: int, sink: np.ndarray) -> DiffusionSystem:
    """The system of Newton's step: the last one as long as its sink is nearly this one.

    What is off only slows Newton's method down, by as much; a new one costs several iterations.
    """
    if number in liquid.sunk:
        before, system = liquid.sunk[number]
        norm = liquid.space.norm
        if norm(sink - before) <= _SAME_SINK * norm(sink):
            return system
    system = liquid.space.system(sink=sink)
    liquid.sunk[number] = sink, system
    return system
