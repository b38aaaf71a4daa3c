"""Influence functions, kernel exponents and the constants calibrated for them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from peri.engine.choices import CALIBRATIONS
from peri.engine.lattice import Family, Lattice, family

INFLUENCE_FUNCTIONS = {
    "constant": lambda ratio: np.ones_like(ratio),
    "linear": lambda ratio: np.clip(1.0 - ratio, 0.0, None),
}
"""omega(|xi|/delta): Eqs 2.12 and 2.13 of the dissertation."""

log = logging.getLogger(__name__)


def closed_constant(
    dimension: int,
    horizon: float | np.ndarray,
    kernel_exponent: float,
    influence: str,
) -> float | np.ndarray:
    """The constant K that matches the second moment of the continuous kernel.

    K = 2 / int omega xi_x^2 / |xi|^(d + 2q) dV over the ball of radius `horizon` (m): in 3D with
    omega = 1 it is 3(1-q) / (pi delta^(2-2q)), dissertation Eq. 2.72 (Eq. 2.58 as printed is six
    times too small).  `kernel_exponent` is q < 1.  Returns K in m^(2q-2), shaped like `horizon`.
    """
    q = kernel_exponent
    surface_per_axis = {1: 2.0, 2: np.pi, 3: 4.0 * np.pi / 3.0}[dimension]
    radial = 1.0 / (2.0 - 2.0 * q)
    if influence == "linear":
        radial -= 1.0 / (3.0 - 2.0 * q)
    return 2.0 / (surface_per_axis * radial * np.asarray(horizon, float) ** (2.0 - 2.0 * q))


def closed_strength(horizon: float, kernel_exponent: float, influence: str) -> float:
    """Front strength of the continuous kernel in 3D, 1/m: 3/delta for q = 0, omega = 1.

    The flux through a flat front for unit diffusivity and unit difference, pi K int_0^delta omega
    r^(-2q) dr, finite for q < 1/2 (ValueError beyond).
    """
    q = kernel_exponent
    if not q < 0.5:
        raise ValueError(f"kernel_exponent: {q}; a front's strength is finite below 1/2 only")
    radial = 1.0 / (1.0 - 2.0 * q)
    if influence == "linear":
        radial -= 1.0 / (2.0 - 2.0 * q)
    constant = float(closed_constant(3, horizon, q, influence))
    return float(np.pi * constant * radial * horizon ** (1.0 - 2.0 * q))


@dataclass(frozen=True)
class Stencil:
    """Bond weights of the nonlocal diffusion operator of unit diffusivity.

    dC_i/dt = D sum_j w(xi_ij) (C_j - C_i) with w = K omega beta dV / |xi|^(d+2q), 1/m^2.

    octant : (reach_x+1, ..., ) weights of the non-negative offsets; zero at the origin.
    spacing : node distance per axis, m.
    parity : per axis, 1 where a weight keeps its value and -1 where it changes its sign when the
        offset is reflected; by default even in every axis, as all weights of diffusion are.
    """

    octant: np.ndarray
    spacing: tuple[float, ...]
    parity: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parity", tuple(self.parity) or (1,) * self.octant.ndim)
        for a, sign in enumerate(self.parity):
            if sign < 0 and np.take(self.octant, 0, axis=a).any():
                raise ValueError(
                    f"octant: weights odd along axis {a} must vanish at offset 0 of it"
                )

    @property
    def dimension(self) -> int:
        return self.octant.ndim

    @property
    def reach(self) -> tuple[int, ...]:
        """Largest offset along each axis."""
        return tuple(n - 1 for n in self.octant.shape)

    @property
    def multiplicity(self) -> np.ndarray:
        """How often each octant entry occurs in the full stencil."""
        grids = np.meshgrid(*[np.arange(n) for n in self.octant.shape], indexing="ij", sparse=True)
        out = np.ones(self.octant.shape, int)
        for g in grids:
            out = out * np.where(g > 0, 2, 1)
        return out

    @property
    def bonds(self) -> int:
        """Number of bonds of a node with a full neighbourhood."""
        return int(self.multiplicity[self.octant != 0].sum())

    @property
    def total(self) -> float:
        """sum_j w_ij of a full neighbourhood, 1/m^2; 0 for odd weights."""
        return float((self.multiplicity * self.octant).sum()) if min(self.parity) > 0 else 0.0

    def second_moment(self) -> np.ndarray:
        """sum_j w_ij xi_a^2 per axis, (d,); 2 where the lattice sum is exact for quadratics."""
        return self._moment(2)

    @property
    def diffusivities(self) -> np.ndarray:
        """What a unit diffusivity amounts to along each axis for long waves, (d,)."""
        return 0.5 * self.second_moment()

    def front_strength(self, axis: int = 0) -> float:
        """S = sum_{xi_a > 0} w xi_a, 1/m: flux D S (C_1 - C_2) through a flat front at C_1 | C_2.

        A front normal to a lattice axis between two half-spaces of uniform concentration; the
        continuous value for q = 0, omega = 1 is 3 / delta in 3D.
        """
        return float(0.5 * self._moment(1)[axis])

    def mean_strength(self) -> float:
        """Front strength averaged over all orientations of the front, 1/m.

        The mean of max(xi . n, 0) over directions n is |xi| / 2, / pi, / 4 in 1D, 2D, 3D.  The
        lattice counts an axis-parallel front low (15 % at delta = 2 dx in 3D, 3 % at 8 dx), so a
        body with faces in all directions is better served by this than by `front_strength`.
        """
        grids = np.meshgrid(
            *[h * np.arange(n) for h, n in zip(self.spacing, self.octant.shape, strict=True)],
            indexing="ij",
            sparse=True,
        )
        length = np.sqrt(sum(g**2 for g in grids))
        share = {1: 0.5, 2: 1.0 / np.pi, 3: 0.25}[self.dimension]
        return float(share * (self.multiplicity * self.octant * length).sum())

    def _moment(self, power: int) -> np.ndarray:
        weighted = self.multiplicity * self.octant
        out = np.empty(self.dimension)
        for a, h in enumerate(self.spacing):
            position = (h * np.arange(self.octant.shape[a])) ** power
            shape = [1] * self.dimension
            shape[a] = -1
            out[a] = (weighted * position.reshape(shape)).sum()
        return out

    def dense(self) -> np.ndarray:
        """The full stencil, (2 reach + 1 per axis)."""
        out = self.octant
        for a in range(self.dimension):
            mirrored = np.flip(np.take(out, range(1, out.shape[a]), axis=a), axis=a)
            mirrored = self.parity[a] * mirrored
            out = np.concatenate([mirrored, out], axis=a)
        return out


def diffusion_stencil(
    lattice: Lattice,
    horizon: float | Sequence[float],
    kernel_exponent: float = 0.0,
    influence: str = "constant",
    calibration: str = "discrete",
) -> Stencil:
    """The stencil of unit-diffusivity nonlocal diffusion on a lattice.

    Parameters
    ----------
    horizon : float or sequence
        Radius of the neighbourhood, or its semi-axes, m.
    kernel_exponent : float
        q of the kernel 1/|xi|^(d+2q), q < 1 (dissertation Eq. 2.49).
    influence : {"constant", "linear"}
    calibration : {"discrete", "closed", "as_published"}
        "closed" takes K of the continuous integral; "discrete" scales it so that the lattice sum
        has second moment 2 along every axis, K = 2 / sum_j w_j xi_a^2: the standard scheme then
        converges as delta -> 0 at fixed delta/dx; the closed one does not (dissertation 3.2.5).
        "as_published" is "closed", on stretched lattices, too, with the horizon of each bond's
        direction (Jafarzadeh et al. 2022 Eqs 15-16, isotropic in the integral only): at 25:1 and
        delta = 4 dx the diffusivity is 0.218 D along the long spacing and 6.97 D across
        (`Stencil.diffusivities`, which is also logged).

    Raises
    ------
    ValueError
        For an unknown influence function or calibration, q >= 1, "closed" on a stretched lattice,
        a linear influence function on a lattice where it leaves no bond along an axis, or a
        neighbourhood so elongated that a positive discrete calibration does not exist.
    """
    if calibration not in CALIBRATIONS:
        raise ValueError(f"calibration: {calibration!r}; allowed: {', '.join(CALIBRATIONS)}")
    bonds, weight = _closed_weights(lattice, horizon, kernel_exponent, influence)
    if calibration == "discrete":
        return _stencil(lattice, bonds, weight * _moment_correction(bonds, weight, 2))
    stencil = _stencil(lattice, bonds, weight)
    semi_axes = np.broadcast_to(np.asarray(horizon, float), (lattice.dimension,))
    if np.ptp(semi_axes) > 1e-9 * semi_axes.max() or np.ptp(lattice.spacing) > 1e-9 * max(
        lattice.spacing
    ):
        amounts = ", ".join(f"{value:.3g} D" for value in stencil.diffusivities)
        if calibration == "closed":
            raise ValueError(
                f"calibration: 'closed' on a stretched lattice or horizon amounts to diffusivities "
                f"{amounts} along the axes; use 'discrete' (exact), or 'as_published' to have that"
            )
        log.info("calibration as_published: diffusivities %s along the axes", amounts)
    return stencil


def front_stencil(
    lattice: Lattice,
    horizon: float | Sequence[float],
    kernel_exponent: float = 0.0,
    influence: str = "constant",
) -> Stencil:
    """Bond weights of an interface, of the same strength across every axis, 1/m.

    sum_{xi_a > 0} w xi_a = 1 for each axis a: the flux through a flat front normal to an axis is
    k (C_1 - C_2) for bonds k w (C_1 - C_2), k in m/s.  The weights of diffusion do not have this
    on a stretched lattice: at 25:1 and delta = 4 dx their strength is 17 times larger across the
    short spacing than along the long one.

    Parameters and errors: as for `diffusion_stencil`.
    """
    bonds, weight = _closed_weights(lattice, horizon, kernel_exponent, influence)
    return _stencil(lattice, bonds, weight * _moment_correction(bonds, weight, 1))


def _stencil(lattice: Lattice, bonds: Family, weight: np.ndarray) -> Stencil:
    octant = np.zeros(tuple(bonds.offsets.max(axis=0) + 1))
    octant[tuple(bonds.offsets.T)] = weight
    return Stencil(octant, lattice.spacing)


def _closed_weights(
    lattice: Lattice, horizon: float | Sequence[float], kernel_exponent: float, influence: str
) -> tuple[Family, np.ndarray]:
    """The bonds of a node and their weights with the constant of the continuous integral."""
    if influence not in INFLUENCE_FUNCTIONS:
        raise ValueError(f"influence: {influence!r}; allowed: {', '.join(INFLUENCE_FUNCTIONS)}")
    if not np.isfinite(kernel_exponent) or kernel_exponent >= 1.0:
        raise ValueError(f"kernel_exponent: {kernel_exponent}; allowed: finite and below 1")
    d = lattice.dimension
    bonds = family(lattice, horizon)
    constant = closed_constant(d, bonds.direction_horizon, kernel_exponent, influence)
    omega = INFLUENCE_FUNCTIONS[influence](bonds.bond_length / bonds.direction_horizon)
    weight = (
        constant
        * omega
        * bonds.volume_correction
        * lattice.cell_volume
        / bonds.bond_length ** (d + 2.0 * kernel_exponent)
    )
    if np.any((bonds.multiplicity * weight) @ bonds.bond**2 <= 0):
        raise ValueError(
            f"influence: {influence!r} leaves no bond along an axis of this lattice; "
            "use 'constant' or a longer horizon"
        )
    return bonds, weight


def _moment_correction(bonds: Family, weight: np.ndarray, power: int) -> np.ndarray:
    """Factors sum_a s_a n_a^2 (n: bond direction) that make sum_j w_j |xi_a|^power = 2."""
    direction_squared = bonds.bond**2 / bonds.bond_length[:, None] ** 2
    moments = (bonds.multiplicity * weight)[:, None] * bonds.bond**power
    matrix = moments.T @ direction_squared
    scale = np.linalg.solve(matrix, np.full(matrix.shape[0], 2.0))
    factor = direction_squared @ scale
    if np.any(factor <= 0):
        raise ValueError(
            "horizon: no positive discrete calibration exists for this neighbourhood; "
            "use calibration 'as_published' or a horizon of at least two spacings along every axis"
        )
    return factor
