"""Equilibrium composition of a closed vessel, or of one open to a gas, with or without minerals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from peri.transport.chemistry.activity import (
    ACTIVITIES,
    conditional_constants,
    davies,
    debye_hueckel,
    ionic_strength,
    ln_water_activity,
    mineral_constants,
    wateq,
)
from peri.transport.chemistry.composition import ABSENT, Composer, CompositionError
from peri.transport.chemistry.species import LN10, MOLAR, Chemistry

_MAXIMUM_ROUNDS = 200
_STRENGTH_TOLERANCE = 1e-13
_LONGEST_STEP = 2.0
_START = -16.0
_ROUND_OFF_STEP = 1e-8
"""A step below this that does not shrink any more is round-off."""


@dataclass(frozen=True)
class Solution:
    """A liquid in equilibrium at n nodes.

    chemistry : Chemistry
    ln_component : (E, n) ln of the free components, mol/m3
    concentration : (K, n) mol/m3
    ln_gamma : (K, n);  ln_water : (n,)
    mineral : (M, n) amounts formed from the totals, mol/m3 of liquid
    """

    chemistry: Chemistry
    ln_component: np.ndarray
    concentration: np.ndarray
    ln_gamma: np.ndarray
    ln_water: np.ndarray
    mineral: np.ndarray

    @property
    def ph(self) -> np.ndarray:
        """-log10 of the activity of H, (n,)."""
        h = self.chemistry.components.index("H")
        return -(self.ln_component[h] - math.log(MOLAR) + self.ln_gamma[h]) / LN10

    @property
    def strength(self) -> np.ndarray:
        """Ionic strength, mol/L, (n,)."""
        return ionic_strength(self.chemistry.charge, self.concentration)

    @property
    def totals(self) -> np.ndarray:
        """Totals of the components in the liquid, mol/m3, (E, n)."""
        return self.chemistry.stoichiometry.T @ self.concentration

    @property
    def net_charge(self) -> np.ndarray:
        """sum_k z_k C_k, mol/m3, (n,)."""
        return self.chemistry.charge @ self.concentration

    @property
    def saturation_index(self) -> np.ndarray:
        """log10(Omega) of every mineral, (M, n); minus infinity without one of its components."""
        constants = mineral_constants(self.chemistry, self.ln_gamma, self.ln_water)
        nu = np.array([m.stoichiometry for m in self.chemistry.minerals])
        nu = nu.reshape(len(self.chemistry.minerals), len(self.chemistry.components))
        index = (nu @ self.ln_component + constants) / LN10
        return np.where((nu > 0) @ (self.ln_component <= ABSENT), -np.inf, index)

    def inert_ion(self) -> int:
        """The most abundant ion (of the first node) that takes part in no reaction; -1: none."""
        nu, z = self.chemistry.stoichiometry, self.chemistry.charge
        alone = (nu != 0).sum(axis=0) == 1
        content = self.concentration[: alone.size, 0] * alone * (z[: alone.size] != 0)
        return int(np.argmax(content)) if content.max() > 0 else -1

    def amount(self, species: str) -> np.ndarray:
        """Concentration of one species, mol/m3, (n,)."""
        return self.concentration[self.chemistry.index(species)]


def speciate(
    chemistry: Chemistry,
    totals: np.ndarray,
    activity: str = "davies",
    *,
    strength: float | np.ndarray | None = None,
    minerals: tuple[str, ...] = (),
    gas: Mapping[str, float] | None = None,
    constant: tuple[float, float] | None = None,
    start: np.ndarray | None = None,
    held: tuple[np.ndarray, np.ndarray] | None = None,
) -> Solution:
    """Return the equilibrium composition for totals of the components.

    Parameters
    ----------
    chemistry : Chemistry
    totals : (E,) or (E, n) mol/m3 (chemistry.totals makes neutral ones)
    activity : "davies" or "wateq" (at each node's own ionic strength), "fixed" (Davies at
        `strength`) or "ideal"
    strength : ionic strength for "fixed", mol/L, a number or (n,)
    minerals : names of the minerals that form wherever the liquid would be supersaturated in them
    gas : activity, mol/L, of each dissolved gas that the vessel is open to (as much of it enters or
        leaves as keeps this activity; the totals of its components follow)
    constant : A and B of the Debye-Hueckel law (default: those of the temperature)
    start : (E, n) ln of the free components to start from
    held : ln gamma (K, 1) and ln of the water's activity (1,) to use in the place of those of
        `activity`

    Raises
    ------
    ValueError
        For an unknown activity or mineral, or "fixed" without a strength.
    CompositionError
        For totals that no composition has.
    """
    if activity not in ACTIVITIES:
        raise ValueError(f"activity: '{activity}'; allowed are {', '.join(ACTIVITIES)}")
    if activity == "fixed" and strength is None:
        raise ValueError("activity: 'fixed' needs the ionic strength of the medium")
    known = [m.name for m in chemistry.minerals]
    for name in minerals:
        if name not in known:
            raise ValueError(f"mineral '{name}' is unknown; known are {', '.join(known) or 'none'}")
    target = np.array(totals, float).reshape(len(chemistry.components), -1)
    n = target.shape[1]
    a = b0 = 0.0
    if activity != "ideal":
        a, b0 = constant or debye_hueckel(chemistry.temperature)
    composer = Composer(chemistry.stoichiometry, np.ones(len(chemistry.names)))
    m = np.full(target.shape, _START) if start is None else np.array(start, float)
    ions = 0.5 * np.abs(target).sum(axis=0) / MOLAR
    strength_now = np.broadcast_to(
        np.zeros(n) if activity == "ideal" else ions if strength is None else strength, (n,)
    )
    ln_water = np.zeros(n)
    amounts = np.zeros((len(known), n))
    for _ in range(_MAXIMUM_ROUNDS):
        if held is not None:
            ln_gamma = np.broadcast_to(held[0], (len(chemistry.names), n))
            ln_water = np.broadcast_to(held[1], (n,))
        elif activity == "ideal":
            ln_gamma = np.zeros((len(chemistry.names), n))
        elif activity == "wateq":
            ln_gamma = wateq(chemistry, strength_now, a, b0)
        else:
            ln_gamma = davies(chemistry.charge, strength_now, a)
        b = conditional_constants(chemistry, ln_gamma, ln_water)
        phases = _phases(chemistry, ln_gamma, ln_water, minerals, gas or {})
        if phases.nu.shape[0]:
            _solve_with_phases(composer, target, b, m, phases, amounts)
        else:
            composer.solve(target, b, m)
        concentration = composer.concentrations(m, b)
        if activity == "ideal" or held is not None:
            break
        new_water = ln_water_activity(concentration)
        new_strength = ionic_strength(chemistry.charge, concentration)
        change = np.abs(new_water - ln_water).max(initial=0.0)
        ln_water = new_water
        if activity != "fixed":
            change = max(change, np.abs(new_strength - strength_now).max(initial=0.0))
            strength_now = new_strength
        if change <= _STRENGTH_TOLERANCE:
            break
    else:
        raise CompositionError(
            f"activity: the ionic strength still changes by {change:.2g} mol/L after "
            f"{_MAXIMUM_ROUNDS} rounds; '{activity}' does not hold for this liquid"
        )
    return Solution(chemistry, m, concentration, ln_gamma, ln_water, amounts)


@dataclass(frozen=True)
class _Phases:
    """Constraints nu . m + c <= 0 (minerals, amounts >= 0) or = 0 (gases)."""

    nu: np.ndarray  # (P, E)
    c: np.ndarray  # (P, n)
    mineral: tuple[int, ...]  # number of the mineral, -1 for a gas


def _phases(
    chemistry: Chemistry,
    ln_gamma: np.ndarray,
    ln_water: np.ndarray,
    minerals: tuple[str, ...],
    gas: Mapping[str, float],
) -> _Phases:
    constants = mineral_constants(chemistry, ln_gamma, ln_water)
    nu, c, number = [], [], []
    for name, activity in gas.items():
        k = chemistry.index(name)
        e = len(chemistry.components)
        row = chemistry.stoichiometry[k]
        nu.append(row)
        c.append(
            row @ ln_gamma[:e]
            - row.sum() * math.log(MOLAR)
            + chemistry.ln_k[k]
            + chemistry.water[k] * ln_water
            - math.log(activity)
        )
        number.append(-1)
    for i, mineral in enumerate(chemistry.minerals):
        if mineral.name in minerals:
            nu.append(mineral.stoichiometry)
            c.append(constants[i])
            number.append(i)
    e, n = len(chemistry.components), ln_gamma.shape[1]
    return _Phases(np.array(nu).reshape(-1, e), np.array(c).reshape(-1, n), tuple(number))


def _solve_with_phases(
    composer: Composer,
    target: np.ndarray,
    b: np.ndarray,
    m: np.ndarray,
    phases: _Phases,
    amounts: np.ndarray,
) -> None:
    """Per node: the most supersaturated mineral joins the active set, a negative one leaves."""
    amounts[:] = 0.0
    gases = [p for p, i in enumerate(phases.mineral) if i < 0]
    for i in range(m.shape[1]):
        active = list(gases)
        for _ in range(50 + 10 * len(phases.mineral)):
            column = slice(i, i + 1)
            amount = saturate(
                composer, target[:, column], b[:, column], m[:, column],
                phases.nu[active], phases.c[active, column],
            )[:, 0]  # fmt: skip
            lowest = min(
                ((amount[q], p) for q, p in enumerate(active) if phases.mineral[p] >= 0),
                default=(0.0, -1),
            )
            if lowest[0] < 0.0:
                active.remove(lowest[1])
                continue
            ln_omega = phases.nu @ m[:, i] + phases.c[:, i]
            ln_omega[active] = -np.inf
            worst = int(np.argmax(ln_omega))
            if ln_omega[worst] <= 1e-12:
                break
            active.append(worst)
        else:
            raise CompositionError("minerals: no set of minerals is in equilibrium with the liquid")
        for q, p in enumerate(active):
            if phases.mineral[p] >= 0:
                amounts[phases.mineral[p], i] = amount[q]


def saturate(
    composer: Composer,
    target: np.ndarray,
    b: np.ndarray,
    m: np.ndarray,
    nu: np.ndarray,
    c: np.ndarray,
    tolerance: float = 1e-12,
) -> np.ndarray:
    """Solve for m and the amounts G that leave the liquid exactly saturated.

    sum_k nu_ke w_k C_k + sum_p nu_pe G_p = target_e  and  nu_p . m + c_p = 0: the minimum of the
    convex F of composition.py on the planes of saturation, G their multipliers (of either sign).

    Parameters
    ----------
    target : (E, n);  b : (K, n) or (K, 1);  m : (E, n), improved in place
    nu : (P, E);  c : (P, n)

    Returns G, (P, n).  Raises CompositionError where Newton's method does not converge.
    """
    phases, n = nu.shape[0], m.shape[1]
    amount = np.zeros((phases, n))
    if not phases:
        composer.solve(target, b, m)
        return amount
    present = ~((target <= 0) & composer.only_positive[:, None])
    m[:] = np.where(present | (np.abs(nu).sum(axis=0) > 0)[:, None], np.maximum(m, -600.0), ABSENT)
    # A component that comes in newly starts from its total, not from next to nothing.
    new = composer.only_positive[:, None] & (target > 0) & (m <= -600.0)
    weight = composer.weight[: target.shape[0], None]
    m[new] = np.log(np.where(new, target, 1.0) / weight)[new]
    before = np.full(n, np.inf)
    for _ in range(_MAXIMUM_ROUNDS):
        concentration = composer.concentrations(m, b)
        weighted = composer.weight[:, None] * concentration
        residual = target - composer.stoichiometry.T @ weighted
        off = m <= ABSENT
        residual[off] = 0.0
        inverse_r, inverse_nu = _solve_spd(
            composer.hessian(concentration), residual.T, nu
        )  # (n, E), (n, E, P)
        schur = np.einsum("pe,neq->npq", nu, inverse_nu)
        gap = -(nu @ m + c)
        new = np.linalg.solve(schur, (np.einsum("pe,ne->np", nu, inverse_r) - gap.T)[..., None])[
            ..., 0
        ]
        step = (inverse_r - np.einsum("nep,np->ne", inverse_nu, new)).T
        step[off] = 0.0
        longest = np.abs(step).max(axis=0)
        if not np.all(np.isfinite(longest)):
            break
        m += step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-300))
        amount = new.T
        # Done, or as near as round-off lets the last quadratic steps come.
        stuck = (longest < _ROUND_OFF_STEP) & (longest > 0.5 * before)
        if ((longest < tolerance) | stuck).all():
            return amount
        before = longest
    raise CompositionError("minerals: the composition at saturation did not converge")


def _solve_spd(
    matrix: np.ndarray, vector: np.ndarray, nu: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """matrix^-1 vector and matrix^-1 nu^T per node, scaled to a unit diagonal first."""
    scale = 1.0 / np.sqrt(np.einsum("nee->ne", matrix))
    scaled = matrix * scale[:, :, None] * scale[:, None, :]
    columns = np.concatenate(
        [vector[:, :, None], np.broadcast_to(nu.T, (len(matrix), *nu.T.shape))], axis=2
    )
    solved = np.linalg.solve(scaled, columns * scale[:, :, None]) * scale[:, :, None]
    return solved[:, :, 0], solved[:, :, 1:]
