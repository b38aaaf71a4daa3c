"""Corrosion in clean liquid as one table and one quadrature, with exact derivatives.

Where the liquid stays far below C_sat and C_solid, a metal node obeys C' = -D g(V_L) mu C, with mu
its interface bond sum and D g the interface diffusivity.  In terms of the exposure
z = int D g dt (m^2) every node is known, C = C_solid exp(-mu z), and so is the volume loss

    V(z) = C_solid / (C_solid - C_sat) sum_k w_k (1 - exp(-mu_k z)),     sum_k w_k <= 1,

with w_k the share of the metal's volume whose bond sum is mu_k.  The kinetics only says when:

    T(z) = int_0^z dz' / g(V(z')) = D t.

The table of V belongs to the scene and is made once; a new rate costs one quadrature.  With
T(z; p) = D t held, a parameter p of the kinetics moves the exposure by dz/dp = -g dT/dp, and the
volume loss by V'(z) dz/dp: exact, no differences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from peri.corrosion.classes.volumes import class_bond_sums
from peri.corrosion.kinetics import Exposed, Kinetics
from peri.corrosion.nodes.bimaterial import BiMaterial
from peri.corrosion.scene import CorrosionScene

Array = NDArray[np.float64]

_POINTS = 8
"""Gauss points of a cell.  With them and the cells below V is exact to 1e-13."""

_CELLS_PER_UNIT = 8
"""Cells per unit of u = asinh(mu_max z / _FIRST): twice as many change V by less than 1e-13."""

_FIRST = 1e-8
"""mu_max z below which cells are even in z: volume losses from 1e-9 on have cells of their own."""

_LARGEST_CHANGE = 0.7
"""Of ln g within a cell, else the cells are halved; at 0.7 a quadrature errs by 1e-10."""

_HALVINGS = 12
"""How often cells are halved at most; kinetics that jump would ask for ever more."""

_SERIES = 1e-8
"""mu z below which e^(-mu z) is 1 - mu z + (mu z)^2 / 2 to round-off."""

_SPENT = 40.0
"""mu z above which nothing is left, to round-off."""

_NODES, _WEIGHTS = legendre.leggauss(_POINTS)
_TO_COEFFICIENTS = np.linalg.inv(legendre.legvander(_NODES, _POINTS - 1))
_INTEGRAL = np.stack(
    [legendre.legint(row, lbnd=-1) for row in np.eye(_POINTS)]
)  # (degree, degree + 1): antiderivatives that vanish at the cell's left end


@dataclass(frozen=True)
class RateFactor:
    """What the kinetics says at given volume losses.

    value : g >= 0, of the shape of the volume losses.  slopes : dg/dp by the name of the
    parameter p, each of that shape.
    """

    value: Array
    slopes: Mapping[str, Array]


def factor_of(kinetics: Kinetics) -> Callable[[Array], RateFactor]:
    """A law of `peri.corrosion.kinetics` as `ReducedCorrosion.volume_loss` takes it.

    A law without `derivatives` has no slopes.
    """
    derivatives = getattr(kinetics, "derivatives", lambda at: {})

    def factor(volume_loss: Array) -> RateFactor:
        slopes = derivatives(Exposed(volume_loss))
        return RateFactor(
            np.broadcast_to(kinetics.rate(Exposed(volume_loss)), np.shape(volume_loss)),
            {name: slope for name, slope in slopes.items() if name != "volume_loss"},
        )

    return factor


@dataclass(frozen=True)
class VolumeLoss:
    """Volume losses at the times asked for, and how they change.

    value : V_L (nt,).  slopes : dV_L/dp (nt,) by parameter.  exposure : z (nt,), m^2.
    """

    value: Array
    slopes: dict[str, Array]
    exposure: Array


@dataclass(frozen=True)
class _Table:
    """V and V' at the Gauss points of all cells (nc, np), and dz/dx there (x in [-1, 1])."""

    edges: Array  # of the cells in u
    stretch: Array
    loss: Array
    slope: Array


class ReducedCorrosion:
    """Volume loss in clean liquid of one piece of metal on one lattice, whatever its rate.

    Parameters
    ----------
    bond_sums : array (n,)
        mu of each part of the metal, 1/m^2, >= 0.
    volumes : array (n,)
        Volume of each part, in any one unit, >= 0.
    loss_per_dissolved : float
        C_solid / (C_solid - C_sat), >= 1.

    Raises
    ------
    ValueError
        For arrays of different lengths or negative entries.
    """

    @classmethod
    def of(cls, scene: CorrosionScene, problem: BiMaterial | None = None) -> ReducedCorrosion:
        """That of a scene; `problem`: the scene's, as before any step, where the caller has it.

        Raises ValueError for a law of the bond other than the proportional one.
        """
        refuse_other_laws(scene)
        solid, saturated = scene.solid_concentration, scene.saturation_concentration
        if scene.exposure is not None:
            metal = scene.exposure.metal
            return cls(class_bond_sums(scene), metal.volume, solid / (solid - saturated))
        sums = (problem or BiMaterial(scene)).metal_bond_sums()[scene.metal]
        return cls(sums, scene.capacity()[scene.metal], solid / (solid - saturated))

    def __init__(self, bond_sums: ArrayLike, volumes: ArrayLike, loss_per_dissolved: float = 1.0):
        sums, parts = np.asarray(bond_sums, float), np.asarray(volumes, float)
        if sums.shape != parts.shape or sums.ndim != 1:
            raise ValueError(f"volumes: {parts.shape}; it must be one per bond sum, {sums.shape}")
        for name, values in (("bond_sums", sums), ("volumes", parts)):
            if not (np.isfinite(values).all() and (values >= 0).all()):
                raise ValueError(f"{name}: it must be finite and not negative")
        total = parts.sum()
        exposed = sums > 0
        self.bond_sums, member = np.unique(sums[exposed], return_inverse=True)
        shares = np.bincount(member, parts[exposed], self.bond_sums.size)
        self.shares = shares / total if total > 0 else np.zeros_like(shares)
        self.loss_per_dissolved = float(loss_per_dissolved)
        self._tables = [_make_table(self.bond_sums, self.shares, self.loss_per_dissolved)]

    def loss_at(self, exposure: ArrayLike) -> Array:
        """V_L at exposures z (m^2), summed over all parts: slow, for checks and oracles."""
        return np.minimum(1.0, self.loss_per_dissolved * self.dissolved_at(exposure))

    def dissolved_at(self, exposure: ArrayLike) -> Array:
        """Share of the metal's amount that is dissolved at exposures z (m^2)."""
        z = np.asarray(exposure, float)
        out = [float(self.shares @ -np.expm1(-self.bond_sums * value)) for value in z.ravel()]
        return np.array(out).reshape(z.shape)

    def largest_loss(self) -> float:
        """V_L after endless time: what no liquid sees stays."""
        return min(1.0, self.loss_per_dissolved * float(self.shares.sum()))

    def volume_loss(
        self,
        times: ArrayLike,
        diffusivity: float,
        factor: Callable[[Array], RateFactor],
    ) -> VolumeLoss:
        """V_L at times, with its derivatives.

        Parameters
        ----------
        times : array (nt,)
            s, >= 0, in any order.  Where the rate changes with time itself, the time that a
            constant one would need.
        diffusivity : float
            D_int at zero volume loss, m^2/s, >= 0.
        factor : callable
            Kinetics: volume losses (any shape) to `RateFactor`.

        Returns
        -------
        VolumeLoss
            Its slopes hold "diffusivity" and the parameters that `factor` names.

        Raises
        ------
        ValueError
            For negative times or diffusivity.
        """
        times = np.asarray(times, float)
        if times.size and not (np.isfinite(times).all() and times.min() >= 0):
            raise ValueError("times: they must be finite and not negative")
        if not (np.isfinite(diffusivity) and diffusivity >= 0):
            raise ValueError(f"diffusivity: {diffusivity}; it must be finite and not negative")
        if not self.bond_sums.size or not self.shares.any():
            still = np.zeros_like(times)
            return VolumeLoss(still, {"diffusivity": still.copy()}, still.copy())
        wanted = diffusivity * times
        for level in range(_HALVINGS + 1):
            table = self._table(level)
            kinetics = factor(table.loss)
            value = np.broadcast_to(kinetics.value, table.loss.shape)
            # A rate of zero is never left behind: 1/g is capped, not infinite.
            needed = table.stretch / np.maximum(value, 1e-280)
            passed = np.concatenate([[0.0], np.cumsum(needed @ _WEIGHTS)])
            change = np.abs(np.diff(np.log(np.maximum(value[:, [0, -1]], 1e-280)), axis=1))[:, 0]
            reached = passed[:-1] <= wanted.max(initial=0.0)
            if not (change[reached] > _LARGEST_CHANGE).any():
                break
        return self._at(wanted, times, table, kinetics, value, needed, passed, factor)

    def _at(
        self,
        wanted: Array,
        times: Array,
        table: _Table,
        kinetics: RateFactor,
        value: Array,
        needed: Array,
        passed: Array,
        factor: Callable[[Array], RateFactor],
    ) -> VolumeLoss:
        """Invert T(z) = D t in the cells where it lies, and differentiate there."""
        count = len(needed)
        beyond = wanted >= passed[-1]
        cell = np.clip(np.searchsorted(passed, wanted, side="right") - 1, 0, count - 1)
        here = needed[cell] @ _TO_COEFFICIENTS.T
        x = _invert(here @ _INTEGRAL, here, wanted - passed[cell])
        x = np.where(beyond, 1.0, x)
        basis = legendre.legvander(x, _POINTS)
        in_cell = basis[:, :_POINTS]

        def interpolated(values: Array) -> Array:
            return np.sum((values[cell] @ _TO_COEFFICIENTS.T) * in_cell, axis=1)

        low, high = table.edges[cell], table.edges[cell + 1]
        exposure = _FIRST / self.bond_sums[-1] * np.sinh(low + 0.5 * (x + 1.0) * (high - low))
        loss = np.clip(interpolated(table.loss), 0.0, 1.0)
        # All that can be lost is lost there, and time no longer matters.
        slope = np.where(beyond | (loss >= 1.0), 0.0, interpolated(table.slope))
        rate = np.broadcast_to(factor(loss).value, loss.shape)
        exposure = exposure + np.where(beyond, (wanted - passed[-1]) * rate, 0.0)
        slopes = {"diffusivity": slope * rate * times}
        for name, of_name in kinetics.slopes.items():
            relative = np.divide(
                np.broadcast_to(of_name, value.shape), value, where=value > 0,
                out=np.zeros(value.shape),
            )  # fmt: skip
            later = -needed * relative
            before = np.concatenate([[0.0], np.cumsum(later @ _WEIGHTS)])
            part = np.sum((later[cell] @ _TO_COEFFICIENTS.T @ _INTEGRAL) * basis, axis=1)
            slopes[name] = -slope * rate * (before[cell] + part)
        return VolumeLoss(loss, slopes, exposure)

    def _table(self, level: int) -> _Table:
        while len(self._tables) <= level:
            self._tables.append(_halved(self._tables[-1]))
        return self._tables[level]


def refuse_other_laws(scene: CorrosionScene) -> None:
    """Refuse a scene whose bonds do not carry D_int g(V_L) w (C_i - C_j)."""
    if not scene.one_rate:
        needs = ", ".join(sorted(scene.needs))
        raise ValueError(
            f"kinetics: {len(scene.solids)} solids, {type(scene.kinetics).__name__} needs {needs}; "
            "clean liquid reduces to one equation for one solid and laws of the volume loss alone"
        )
    if not scene.dissolution.reduces:
        raise ValueError(
            f"dissolution: {scene.dissolution.name!r}; clean liquid reduces to one equation for "
            "'proportional' only"
        )


def _make_table(sums: Array, shares: Array, scale: float) -> _Table:
    """V and V' in cells even in asinh(mu_max z / _FIRST), to where nothing more is lost."""
    if not sums.size:
        nothing = np.zeros((1, _POINTS))
        return _Table(np.array([0.0, 1.0]), nothing, nothing, nothing)
    fastest = sums[-1]
    end = np.arcsinh(40.0 * fastest / sums[0] / _FIRST)
    edges = np.linspace(0.0, end, int(np.ceil(end * _CELLS_PER_UNIT)) + 1)
    half = 0.5 * np.diff(edges)[:, None]
    u = edges[:-1, None] + half * (1.0 + _NODES)
    z = _FIRST / fastest * np.sinh(u)
    stretch = _FIRST / fastest * np.cosh(u) * half
    loss, slope = np.empty_like(z), np.empty_like(z)
    # The sums ascend: only those between no loss to speak of and all lost take an exponential.
    flux = shares * sums
    spent, first, second = (
        np.concatenate([[0.0], np.cumsum(part)]) for part in (shares, flux, 0.5 * flux * sums)
    )
    for n, exposures in enumerate(z):
        low = int(np.searchsorted(sums, _SERIES / exposures[-1]))
        high = int(np.searchsorted(sums, _SPENT / exposures[0]))
        lost = -np.expm1(-np.multiply.outer(exposures, sums[low:high]))
        few = exposures * (first[low] - exposures * second[low])
        loss[n] = lost @ shares[low:high] + few + (spent[-1] - spent[high])
        slope[n] = (1.0 - lost) @ flux[low:high] + first[low] - 2.0 * exposures * second[low]
    loss, slope = scale * loss, scale * slope
    return _Table(edges, stretch, np.minimum(loss, 1.0), slope)


def _halved(table: _Table) -> _Table:
    """The same in cells of half the width, by interpolation within the cells."""
    edges = np.sort(np.concatenate([table.edges, 0.5 * (table.edges[1:] + table.edges[:-1])]))
    halves = np.stack([0.5 * (_NODES - 1.0), 0.5 * (_NODES + 1.0)])
    matrix = legendre.legvander(halves, _POINTS - 1) @ _TO_COEFFICIENTS

    def split(values: Array) -> Array:
        return np.einsum("hqp,cp->chq", matrix, values).reshape(-1, _POINTS)

    return _Table(
        edges, 0.5 * split(table.stretch), np.clip(split(table.loss), 0.0, 1.0), split(table.slope)
    )


def _invert(integral: Array, slope: Array, wanted: Array) -> Array:
    """x in [-1, 1] where each rising polynomial (Legendre coefficients per row) has its value."""
    low, high = -np.ones(wanted.shape), np.ones(wanted.shape)
    whole = integral.sum(axis=1)  # every Legendre polynomial is 1 at the right end
    x = np.clip(
        2.0 * np.divide(wanted, whole, where=whole > 0, out=np.zeros_like(whole)) - 1, -1, 1
    )
    for _ in range(60):
        basis = legendre.legvander(x, _POINTS)
        excess = np.sum(integral * basis, axis=1) - wanted
        low, high = np.where(excess < 0, x, low), np.where(excess > 0, x, high)
        steepness = np.sum(slope * basis[:, :_POINTS], axis=1)
        step = np.divide(excess, steepness, where=steepness > 0, out=np.full_like(x, 4.0))
        tried = x - step
        done = np.abs(step) <= 1e-13
        within = (tried > low) & (tried < high)
        x = np.where(done, x, np.where(within, tried, 0.5 * (low + high)))
        if done.all():
            break
    return x
