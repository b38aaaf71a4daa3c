"""A crevice as a film: one equation along a gap that is thin beside its length.

With the concentration even across the gap h(x, t), one wall that dissolves and a plane of symmetry
(or a wall that does not) opposite,

    d(h C)/dt = d/dx (h D dC/dx) + C_solid dh/dt,   dh/dt = theta i(C) / (z F C_solid),

C <= C_sat, 0 <= theta <= 1, one of them equal; C = 0 at the mouth x = 0 and no flux at the closed
end.  The concentration is even across the gap but for max(h^2/(D t), i h/(z F D C_sat)), relative
(`bound`), t the time within which it changes: 0.87 s over t and 8e-5 for the crevice of Jafarzadeh
et al. 2022.

Finite volumes along the gap, gap of a face the mean of its nodes'; a stage solves for C by Newton's
method on a tridiagonal matrix, with the saturated nodes as an active set.  i rises with C, so a
long implicit step may have several solutions: a stage with tau (C_solid - C) d(i/zFC_solid)/dC > h
anywhere is refused, and the march shortens the step.  What is lost equals what is dissolved in the
gap and what left by the mouth (`balance_error`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import solve_banded

from peri.engine.constants import FARADAY
from peri.engine.march.checkpoints import fingerprint
from peri.engine.march.problem import Attempt, Fields, FirstOrder, Stage, State, moment
from peri.engine.solvers import ConvergenceError

_ITERATIONS = 60
_TOLERANCE = 1e-10
"""Of the concentration, over C_sat."""
_LARGEST_MOVE = 0.2
"""Of the concentration in one iteration, over C_sat."""

COLUMNS = {
    "lost": "m^2",
    "released": "mol/m",
    "balance_error": "1",
    "deepest": "m",
    "deepest_at": "m",
    "active_site": "m",
    "saturated_share": "1",
}
"""History: area of metal lost, amount that left (per metre of width), its balance, the greatest
depth and where it is, where the wall moves fastest, and the share of nodes held at C_sat."""


class CurrentByConcentration(Protocol):
    """A law like corrosion.acidity.AcidityLaw."""

    def current(self, concentration: np.ndarray) -> np.ndarray:
        """A/m^2."""

    def slope(self, concentration: np.ndarray) -> np.ndarray:
        """A m/mol."""


@dataclass(frozen=True)
class ThinGap:
    """A crevice that one equation describes.

    Parameters
    ----------
    length : float
        From mouth to closed end, m.
    gap : array (n,)
        At the start, at the middles of n equal cells from the mouth on, m.
    concentration : array (n,)
        At the start, mol/m^3, from 0 to C_sat.
    law : CurrentByConcentration
    charge_number : float
        z of the dissolving metal, > 0; there is no default, because the rate is i/(z F).
    diffusivity : float
        m^2/s.
    solid_concentration, saturation_concentration : float
        mol/m^3, 0 < C_sat < C_solid.

    Raises
    ------
    ValueError
        For values out of range; it names the value and what is allowed.
    """

    length: float
    gap: np.ndarray
    concentration: np.ndarray
    law: CurrentByConcentration
    charge_number: float
    diffusivity: float
    solid_concentration: float
    saturation_concentration: float

    def __post_init__(self) -> None:
        for name in ("length", "charge_number", "diffusivity", "saturation_concentration"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value}; it must be finite and positive")
        low, high = self.saturation_concentration, self.solid_concentration
        if not (np.isfinite(high) and high > low):
            raise ValueError(
                f"solid_concentration: {high} mol/m^3; it must be above the "
                f"saturation_concentration of {low} mol/m^3"
            )
        gap, start = self.gap, self.concentration
        if gap.ndim != 1 or gap.size < 2 or gap.shape != start.shape:
            raise ValueError(
                f"gap: shape {gap.shape}, concentration {start.shape}; both must be of one axis "
                "and of equal length, two at least"
            )
        if not (np.isfinite(gap).all() and gap.min() > 0):
            raise ValueError(f"gap: {gap.min()} m; every entry must be finite and positive")
        if not (start.min() >= 0 and start.max() <= low):
            raise ValueError(
                f"concentration: {start.min()} to {start.max()} mol/m^3; it must be from 0 to the "
                f"saturation_concentration of {low} mol/m^3"
            )

    @property
    def places(self) -> np.ndarray:
        """Distance of each node from the mouth, m."""
        return (np.arange(self.gap.size) + 0.5) * self.length / self.gap.size

    def bound(self, time: float) -> float:
        """Relative unevenness across the gap, for concentrations that change within `time` (s)."""
        widest = float(self.gap.max())
        most = np.array([self.saturation_concentration])
        carried = self.charge_number * FARADAY * self.diffusivity * self.saturation_concentration
        across = float(self.law.current(most)[0]) * widest / carried
        return max(widest**2 / (self.diffusivity * time), across)


def potential_along(scene: ThinGap, fields: Fields, conductivity: np.ndarray) -> np.ndarray:
    """The liquid's potential along the gap above that at the mouth, V.

    What a wall's current carries into the gap leaves by the mouth, so that the current of a section
    is that of all wall behind it: kappa h dphi/dx = int_x^L i dx'.

    Parameters
    ----------
    fields : of a state of ThinGapProblem (`gap` and `speed` are used).
    conductivity : array (n,)
        kappa, S/m, > 0, such as transport.potential.conductivity gives for the concentrations.

    Raises
    ------
    ValueError
        For conductivities that are not positive.
    """
    kappa = np.asarray(conductivity, float)
    if not (np.isfinite(kappa).all() and kappa.min() > 0):
        raise ValueError(f"conductivity: {kappa.min()} S/m; it must be finite and positive")
    cell = scene.length / scene.gap.size
    current = scene.charge_number * FARADAY * scene.solid_concentration * fields["speed"] * cell
    behind = np.cumsum(current[::-1])[::-1]  # through the face on the mouth's side of a node
    half = 0.5 * cell / (kappa * fields["gap"])
    # From face to face each half of a cell with its own section; half of a node's own current
    # enters behind its middle.
    to_middle = half * (behind - 0.25 * current)
    whole = half * (2.0 * behind - current)
    return np.cumsum(whole) - whole + to_middle


class ThinGapProblem(FirstOrder):
    """The film equation of a ThinGap, to be marched.

    Fields: `amount` (h C, mol/m^2), `gap` (m), `concentration` (mol/m^3), `speed` (of the wall,
    m/s).  Numbers: `released` (mol per metre of width).
    """

    columns = COLUMNS
    evolved = ("amount", "gap")

    def __init__(self, scene: ThinGap) -> None:
        self.scene = scene
        self.cell = scene.length / scene.gap.size
        self._per_current = 1.0 / (scene.charge_number * FARADAY * scene.solid_concentration)

    def key(self) -> str:
        """Hash of the scene."""
        return fingerprint(self.scene)

    def initial(self) -> State:
        """The seed in the gap."""
        scene = self.scene
        speed = self._per_current * scene.law.current(scene.concentration)
        fields = {
            "amount": scene.gap * scene.concentration,
            "gap": scene.gap.copy(),
            "concentration": scene.concentration.copy(),
            "speed": speed,
        }
        return State(0.0, fields, {"released": 0.0})

    # --- the equation ---------------------------------------------------------------------

    def _conductances(self, gap: np.ndarray) -> np.ndarray:
        """D h / dx^2 of each face, from the mouth (half a cell away) to the closed end; m/s."""
        face = np.zeros(gap.size + 1)
        face[0] = 2.0 * gap[0]
        face[1:-1] = 0.5 * (gap[1:] + gap[:-1])
        return self.scene.diffusivity * face / self.cell**2

    @staticmethod
    def _inflow(conductance: np.ndarray, concentration: np.ndarray) -> np.ndarray:
        """d/dx (h D dC/dx) of each node, mol/(m^2 s)."""
        around = np.concatenate([[0.0], concentration, [0.0]])
        return np.diff(conductance * np.diff(around))

    def stage(self, old: Fields, tau: float, guess: State) -> Stage:
        """Solve for the concentration, the wall's speed where C < C_sat follows from it."""
        scene, most = self.scene, self.scene.saturation_concentration
        solid = scene.solid_concentration
        amount, gap = old["amount"], old["gap"]
        if gap.min() <= 0:
            raise ConvergenceError("the right side has no gap")
        c = np.clip(guess.fields["concentration"], 0.0, most)
        held = guess.fields["concentration"] >= most * (1 - 1e-12)
        speed = np.where(held, guess.fields["speed"], self._per_current * scene.law.current(c))
        rounds = 0
        for _ in range(_ITERATIONS):
            rounds += 1
            rate = self._per_current * scene.law.current(c)
            slope = self._per_current * scene.law.slope(c)
            speed = np.where(held, speed, rate)
            width = gap + tau * speed
            g = self._conductances(width)
            source = amount + solid * tau * speed
            residual = width * c - source - tau * self._inflow(g, c)
            multiplication = np.where(held, 0.0, tau * (solid - c) * slope)
            band = np.zeros((3, c.size))
            band[0, 1:] = np.where(held[:-1], 0.0, -tau * g[1:-1])
            band[1] = np.where(held, 1.0, width + tau * (g[:-1] + g[1:]) - multiplication)
            band[2, :-1] = np.where(held[1:], 0.0, -tau * g[1:-1])
            change = solve_banded((1, 1), band, -np.where(held, c - most, residual))
            largest = float(np.abs(change).max())
            if not np.isfinite(largest):
                raise ConvergenceError("the film equation has no finite solution")
            c = np.maximum(c + min(1.0, _LARGEST_MOVE * most / max(largest, 1e-300)) * change, 0.0)
            needed = (gap * most - amount - tau * self._inflow(g, np.minimum(c, most))) / (
                tau * (solid - most)
            )
            offered = self._per_current * scene.law.current(np.full_like(c, most))
            now = np.where(held, needed <= offered * (1 + 1e-12), c > most)
            speed = np.where(now & held, np.clip(needed, 0.0, offered), speed)
            speed = np.where(now & ~held, offered, speed)
            same = bool((now == held).all())
            held = now
            if same and largest <= _TOLERANCE * most:
                break
        else:
            raise ConvergenceError(f"the film equation did not converge in {_ITERATIONS} rounds")
        if np.any(multiplication > width):
            raise ConvergenceError("the film equation may have several solutions for this step")
        c = np.minimum(c, most)
        speed = np.where(held, speed, self._per_current * scene.law.current(c))
        width = gap + tau * speed
        g = self._conductances(width)
        # The amount by the balance, so that nothing is lost whatever the tolerance.
        new = amount + tau * (self._inflow(g, c) + solid * speed)
        rates = {"released": float(g[0] * c[0] * self.cell)}
        c = np.where(held, most, np.clip(new / width, 0.0, most))
        fields = {"amount": new, "gap": width, "concentration": c, "speed": speed}
        return Stage(fields, rates=rates, iterations=rounds)

    # --- its control ----------------------------------------------------------------------

    def bounded(self, fields: Fields) -> Fields:
        """Amounts of 0 at least and a gap that never closes."""
        return {
            "amount": np.maximum(fields["amount"], 0.0),
            "gap": np.maximum(fields["gap"], self.scene.gap),
        }

    def admissible(self, old: State, stages: Sequence[Stage]) -> bool:
        """Whether no amount is negative and no wall grew."""
        new = stages[-1].fields
        rounding = 1e-12 * self.scene.saturation_concentration * self.scene.gap.max()
        grown = new["gap"] < old.fields["gap"] * (1 - 1e-12)
        return bool(new["amount"].min() >= -rounding and not grown.any())

    def pace(self, state: State) -> float:
        """Change of the amounts by transport over the amounts, 1/s."""
        fields = state.fields
        flow = self._inflow(self._conductances(fields["gap"]), fields["concentration"])
        return float(np.abs(flow).sum() / max(fields["amount"].sum(), 1e-300))

    def change(self, attempt: Attempt) -> float:
        """Difference from a constant rate, of the liquid and of the metal lost, over the change."""
        off = moved = 0.0
        for name, weight in (("amount", 1.0), ("gap", self.scene.solid_concentration)):
            change = attempt.stages[-1].fields[name] - attempt.old.fields[name]
            off += weight * float(np.abs(change - attempt.expected[name]).sum())
            moved += weight * float(np.abs(change).sum())
        return attempt.share * off / moved if moved > 0 else 0.0

    def describe(self, state: State) -> str:
        """Time and depth."""
        deepest = 1e6 * float((state.fields["gap"] - self.scene.gap).max())
        return f"{moment(state.time)}, {deepest:.3g} um deep"

    def row(self, state: State) -> tuple[float, ...]:
        """See COLUMNS."""
        scene, fields = self.scene, state.fields
        depth = fields["gap"] - scene.gap
        lost = float(depth.sum()) * self.cell
        inside = float((fields["amount"] - scene.gap * scene.concentration).sum()) * self.cell
        released, dissolved = state.numbers["released"], scene.solid_concentration * lost
        scale = dissolved + float((scene.gap * scene.concentration).sum()) * self.cell
        error = (dissolved - inside - released) / scale if scale > 0 else 0.0
        deepest, fastest = int(depth.argmax()), int(fields["speed"].argmax())
        share = float((fields["concentration"] >= scene.saturation_concentration).mean())
        places = scene.places
        return (
            lost, released, error, float(depth[deepest]), float(places[deepest]),
            float(places[fastest]), share,
        )  # fmt: skip
