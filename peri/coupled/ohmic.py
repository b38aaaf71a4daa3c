"""What other currents of a metal would make of the potential beside it, by Ohm's law alone.

The drop in a liquid that resists is many RT/F, by which currents fall e times each, so that rounds
of currents and potential find no end.  With K the liquid's conductance as its ions have it now, M
the mean over a metal node's bonds to liquid, U_i what the bonds of node i release at rate 1, n(v)
anode less cathode at its own potential v = E_m - phi and phi_0 the potential that the ions have for
the currents n_0, it is

    v = E_m - phi_0 - M x,   K x = M^T U (n(v) - n_0),   sum_i U_i n_i(v_i) = what is wanted

(electrons, RT/F and the like left out), the minimum of a convex function, since n rises with v.
Where the currents are those that phi_0 belongs to, x is zero: the answer of the rounds is that of
the ions, whatever K is; K only makes them few.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from peri.coupled.surroundings import Surroundings
from peri.engine.operators import Convolution
from peri.engine.solvers import LinearSystem
from peri.transport.liquid import LiquidState

_STEPS = 60
_ENOUGH = 1e-9
"""Of the currents: residual at which Newton's steps end."""
_INNER = 1e-3
"""Reduction of the residual within a step."""
_HELD = 1e-9
"""Of a node's bonds, what holds the level of a liquid that nothing refreshed holds."""
_FARTHEST = 1e4
"""Newton steps that the search along one looks at, at most."""

Net = Callable[[np.ndarray], np.ndarray]


class Ohmic:
    """The response of the liquid's potential beside the metal to other currents.

    Parameters
    ----------
    around : Surroundings
    state : LiquidState, of which the conductance is
    of : bool padded box array, the metal's nodes that give currents, (k,) of them
    strengths : (k,) charge that each gives at rate 1, mol/m3/s times relative volume
    """

    def __init__(
        self, around: Surroundings, state: LiquidState, of: np.ndarray, strengths: np.ndarray
    ) -> None:
        space, liquid, discrete = around.space, around.liquid, around.discrete
        self.around, self.of, self.strengths = around, of, strengths
        chemistry = liquid.chemistry
        mobile = chemistry.charge**2 * chemistry.diffusivity
        root = np.sqrt(mobile @ state.concentration), float(np.sqrt(mobile @ liquid.edge))
        right = space.all_volume * space.spread(*root)
        self.unknown = space.spread(np.ones(space.n))
        self.operator = Convolution(space.sum, self.unknown * right, right, symmetric=True)
        self._row_sums = np.maximum(self.operator.row_sums(), 0.0)
        self._bonds = discrete.box(discrete.take(space.all_volume))[of]
        self.thermal = liquid.thermal_voltage
        self.closed = not space.any(space.exit)
        self._total, self._norm = space.processes.total, space.processes.norm

    def seen(self, psi: np.ndarray) -> np.ndarray:
        """M: the mean of a padded field over the bonds of each node, (k,)."""
        discrete = self.around.discrete
        field = discrete.take(self.around.space.all_volume * psi)
        return discrete.box(field)[self.of] / self._bonds

    def given(self, values: np.ndarray) -> np.ndarray:
        """M^T: values (k,) of the nodes spread over the liquid, padded."""
        discrete = self.around.discrete
        box = np.zeros(self.of.shape)
        box[self.of] = values / self._bonds
        return self.unknown * self.around.space.all_volume * discrete.put(discrete.box(box))

    def _system(self, slope: np.ndarray) -> LinearSystem:
        """K + M^T slope M, its level held where nothing refreshed holds it."""
        across = self.given(slope)

        def through(u: np.ndarray, y: np.ndarray) -> float:
            seen = self.seen(u)
            y += self.given(slope * seen)
            return float((slope * seen**2).sum())

        held = _HELD * self.operator.diagonal()
        return LinearSystem(
            self.operator, shift=held, sink=self._row_sums + across + held,
            extra=through, extra_diagonal=across,
        )  # fmt: skip

    def _solve(self, system: LinearSystem, right: np.ndarray, reduction: float) -> np.ndarray:
        found = np.zeros_like(right)
        system.solve(found, right.copy(), reduction * self._norm(right))
        return found

    def answer(
        self,
        net: Net,
        read: np.ndarray,
        phi: np.ndarray,
        begin: Callable[[np.ndarray], float],
        wanted: float | None,
    ) -> tuple[float, np.ndarray]:
        """E_m (V) and the nodes' own potentials, (k,).

        net : anode less cathode of nodes at potentials (k,);  read : their potentials when the
        liquid had `phi` (k,), V;  begin : E_m that balances the currents for a phi;  wanted : of
        the sum of strengths times net, None where E_m is held (`begin` gives it)
        """
        strengths, thermal, total = self.strengths, self.thermal, self._total
        before = net(read)
        if wanted is not None:
            whole = total(float(strengths.sum()))
            before = before - (total(float(strengths @ before)) - wanted) / whole
        none = np.zeros(strengths.size)
        # From no current: where currents are too large, each step takes them down e times only.
        drop = self._solve(self._system(none), self.given(strengths * before), _ENOUGH)
        rest = phi - thermal * self.seen(drop)
        free = wanted is not None and not self.closed
        psi, metal = np.zeros_like(drop), begin(rest)
        row = np.zeros_like(psi)
        for _ in range(_STEPS):
            own = metal - rest - thermal * self.seen(psi)
            now = net(own)
            source = self.given(strengths * now)
            self.operator.apply(psi, row)
            residual = (source - row) * self.unknown
            left = wanted - total(float(strengths @ now)) if free else 0.0
            size = self._norm(self.given(strengths * np.abs(now)))
            if self._norm(residual) <= _ENOUGH * size:
                if not free or abs(left) <= _ENOUGH * total(float(strengths @ np.abs(now))):
                    break
            slope = strengths * _slope(net, own)
            system = self._system(thermal * slope)
            step, lift = self._solve(system, residual, _INNER), 0.0
            if free:
                other = self._solve(system, self.given(slope), _INNER)
                own_pull = total(float(slope.sum()))
                pull = own_pull - thermal * total(float(slope @ self.seen(other)))
                lift = (left + thermal * total(float(slope @ self.seen(step)))) / pull
                step += lift * other
            change = lift - thermal * self.seen(step)
            self.operator.apply(step, row)
            along = total(float((residual * step).sum())) + left * lift / thermal
            bend = total(float((row * step).sum()))
            share = self._search(net, own, change, along, bend)
            psi += share * step
            metal += share * lift
        if self.closed:
            level = self.around.space.mean(self.around.space.gather(psi - drop))
            metal -= thermal * level
        return metal, own

    def _search(
        self, net: Net, own: np.ndarray, change: np.ndarray, along: float, bend: float
    ) -> float:
        """The share of a step at which the convex function is least along it.

        along : what it falls by per share at first;  bend : the liquid's part of its second
        derivative
        """
        weight = self.strengths / self.thermal

        def of_nodes(share: float) -> float:
            return self._total(float(weight @ (net(own + share * change) * change)))

        first = of_nodes(0.0)

        def slope(share: float) -> float:
            return share * bend + of_nodes(share) - first - along

        if along <= 0.0 or abs(slope(1.0)) <= 0.1 * along:
            return 1.0
        high = 1.0
        while slope(high) < 0.0:
            high *= 2.0
            if high > _FARTHEST:
                return high
        return float(brentq(slope, 0.0, high, xtol=1e-12, rtol=1e-3))


def _slope(net: Net, own: np.ndarray, by: float = 1e-6) -> np.ndarray:
    return np.maximum((net(own + by) - net(own - by)) / (2.0 * by), 0.0)
