"""The material: parameters for the reader, and its update at one quadrature point.

Multiplicative split F = Fe Fp, Hencky's law tau = K tr(eps) 1 + 2 G dev(eps) in the elastic
logarithmic strain, porous plasticity by `gurson.return_map` in principal axes. The internal
variable of the flow is Cp^-1 (six numbers), so that no earlier F is needed:  b_trial = F Cp^-1 F^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem.constitutive.compiled import kernel
from fem.constitutive.gurson import (
    ACCELERATION,
    BULK,
    COALESCENCE,
    LIMIT,
    NUCLEATED,
    NUCLEATION_DEVIATION,
    NUCLEATION_MEAN,
    PARAMETERS,
    Q1,
    Q2,
    Q3,
    RESIDUAL_STRENGTH,
    SHEAR,
    STIFFENING,
    STIFFNESS_LOSS,
    effective_damage,
    grown,
    return_map,
)
from fem.constitutive.hardening import Hardening, VoceHardening, flow_stress
from fem.constitutive.hencky import (
    decompose,
    from_principal,
    invert,
    push_forward,
    shear_factor,
    spatial_tangent,
)

# Points at f_max carry nothing; this share of the moduli keeps a cell's other points held together.
VOID_STIFFNESS = 1e-4


def _require(condition: bool, field: str, value: object, allowed: str) -> None:
    if not condition:
        raise ValueError(f"material {field} is {value}; it must be {allowed}")


@dataclass(frozen=True)
class Material:
    """Elastic constants, hardening and porous yield function (5.40).

    young [Pa], poisson in (-1, 0.5), hardening (see `hardening`), q1 > 0 (published 1.5), q2.
    Options beyond the source, off by default: nucleation of f by plastic strain (Chu and Needleman;
    volume fraction, mean and standard deviation of the strain) and coalescence (Tvergaard and
    Needleman: from f = `coalescence` on, f grows in the yield function such that the metal fails at
    f = `failure`).
    stiffness_loss: the moduli fall with f as the strength does, by 1 - q1 f. Departure from the
    source, which keeps them: metal that yields at a hundredth of the stress would yield at a
    hundredth of the strain too, and no Newton iteration gets through. What it does to the peak
    force is in tests/fem/test_strength.py.
    """

    young: float
    poisson: float
    hardening: Hardening
    q1: float = 1.5
    q2: float = 1.0
    nucleated_fraction: float = 0.0
    nucleation_strain: float = 0.3
    nucleation_deviation: float = 0.1
    coalescence: float | None = None
    failure: float | None = None
    stiffness_loss: bool = True

    def __post_init__(self) -> None:
        _require(
            np.isfinite(self.young) and self.young > 0,
            "young",
            self.young,
            "a positive modulus in Pa",
        )
        _require(-1 < self.poisson < 0.5, "poisson", self.poisson, "above -1 and below 0.5")
        _require(1 < self.q1 < 10, "q1", self.q1, "above 1 and below 10")
        _require(0 < self.q2 <= 2, "q2", self.q2, "above 0 and at most 2")
        _require(
            0 <= self.nucleated_fraction < 1 / self.q1,
            "nucleated_fraction",
            self.nucleated_fraction,
            "at least 0 and below 1/q1",
        )
        _require(
            self.nucleation_deviation > 0,
            "nucleation_deviation",
            self.nucleation_deviation,
            "positive",
        )
        _require(
            (self.coalescence is None) == (self.failure is None),
            "coalescence and failure",
            (self.coalescence, self.failure),
            "given together or not at all",
        )
        if self.coalescence is not None and self.failure is not None:
            _require(
                0 < self.coalescence < min(self.failure, 1 / self.q1) and self.failure < 1,
                "coalescence and failure",
                (self.coalescence, self.failure),
                "0 < coalescence < failure < 1, coalescence below 1/q1",
            )

    @property
    def maximum_damage(self) -> float:
        """f_max = 1/q1, where the yield surface shrinks to a point."""
        return 1.0 / self.q1

    def parameters(self) -> np.ndarray:
        """The vector that the kernels read (indices in `gurson`)."""
        vector = np.zeros(PARAMETERS)
        vector[BULK] = self.young / (3.0 * (1.0 - 2.0 * self.poisson))
        vector[SHEAR] = self.young / (2.0 * (1.0 + self.poisson))
        vector[Q1], vector[Q2], vector[Q3] = self.q1, self.q2, self.q1**2
        vector[NUCLEATED] = self.nucleated_fraction
        vector[NUCLEATION_MEAN] = self.nucleation_strain
        vector[NUCLEATION_DEVIATION] = self.nucleation_deviation
        vector[STIFFNESS_LOSS] = float(self.stiffness_loss)
        effective_limit = (1.0 - RESIDUAL_STRENGTH) / self.q1
        vector[COALESCENCE], vector[ACCELERATION] = 1.0, 1.0
        vector[LIMIT] = effective_limit
        if self.coalescence is not None and self.failure is not None:
            vector[COALESCENCE] = self.coalescence
            vector[ACCELERATION] = (1.0 / self.q1 - self.coalescence) / (
                self.failure - self.coalescence
            )
            vector[LIMIT] = (
                self.coalescence + (effective_limit - self.coalescence) / vector[ACCELERATION]
            )
        return vector


@kernel
def _strength_left(damage: float, material: np.ndarray) -> float:
    """Share 1 - q1 f* of the strength."""
    effective, _ = effective_damage(damage, material)
    return 1.0 - material[Q1] * effective


@kernel
def strength_left(damage: np.ndarray, parameters: np.ndarray, of_cell: np.ndarray) -> np.ndarray:
    """`_strength_left` for an array of f (nc, nq); parameters, of_cell: see `laws.Laws`."""
    left = np.empty_like(damage)
    for c in range(damage.shape[0]):
        for q in range(damage.shape[1]):
            left[c, q] = _strength_left(damage[c, q], parameters[of_cell[c]])
    return left


@kernel
def _stiffness_left(damage: float, material: np.ndarray) -> float:
    """Moduli over those of the intact metal: as the strength falls; a void's beyond f_max."""
    if damage >= material[LIMIT]:
        return VOID_STIFFNESS
    return _strength_left(damage, material) if material[STIFFNESS_LOSS] > 0.0 else 1.0


@kernel
def stiffness_left(damage: np.ndarray, parameters: np.ndarray, of_cell: np.ndarray) -> np.ndarray:
    """`_stiffness_left` for an array of f (nc, nq); parameters, of_cell: see `laws.Laws`."""
    left = np.empty_like(damage)
    for c in range(damage.shape[0]):
        material = parameters[of_cell[c]]
        for q in range(damage.shape[1]):
            left[c, q] = _stiffness_left(damage[c, q], material)
    return left


@kernel
def update_point(
    gradient, plastic_old, strain, damage, acting, material, kind, hardening, need_tangent, tangent,
    scratch,
):  # fmt: skip
    """Update one quadrature point.

    gradient: F, nine numbers; plastic_old: Cp^-1, six, at the start of the step; strain, damage:
    plastic strain and f there; acting: f that strength and moduli have during the step. When asked,
    fills `tangent` (6, 6): that of the corotational rate, see `hencky.spatial_tangent`.
    `scratch` is (13, 6).

    Returns (ok, stress, Cp^-1, plastic strain, f, stored energy, dissipated energy, mises, mean
    stress) with Kirchhoff stresses, six numbers for tensors, and energies per reference volume; ok
    is False for det F <= 0 or no number.
    """
    jacobian, inverse = invert(gradient)
    stretches, first, second, third = decompose(push_forward(gradient, plastic_old))
    if not (jacobian > 0.0 and min(stretches[0], min(stretches[1], stretches[2])) > 0.0):
        nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return False, nothing, plastic_old, strain, damage, 0.0, 0.0, 0.0, 0.0
    bulk, shear = material[BULK], material[SHEAR]
    e0, e1, e2 = (
        0.5 * np.log(stretches[0]),
        0.5 * np.log(stretches[1]),
        0.5 * np.log(stretches[2]),
    )
    volume = e0 + e1 + e2
    e0, e1, e2 = e0 - volume / 3.0, e1 - volume / 3.0, e2 - volume / 3.0  # deviator from here on
    mises = shear * np.sqrt(6.0 * (e0 * e0 + e1 * e1 + e2 * e2))
    keep = _stiffness_left(acting, material)
    if acting >= material[LIMIT]:
        a_pl, beta, new_strain, new_damage, flow = 0.0, 1.0, strain, damage, 1.0
        a_v = b_v = a_q = b_q = 0.0
    else:  # the return depends on the ratio of flow stress and moduli only
        a_pl, beta, new_strain, new_damage, flow, a_v, b_v, a_q, b_q = return_map(
            volume, mises, jacobian / keep, strain, acting, material, kind, hardening
        )
        if acting != damage:
            new_damage = grown(damage, a_pl, strain, new_strain, material)
            new_damage = min(max(new_damage, 0.0), material[LIMIT])
    pressure = bulk * (volume - a_pl)
    mean, scale = keep * pressure, 2.0 * keep * shear * beta
    principal_stress = (mean + scale * e0, mean + scale * e1, mean + scale * e2)
    stress = from_principal(principal_stress, first, second, third)
    plastic_new = plastic_old
    if new_strain != strain or a_pl != 0.0:
        volumetric = 2.0 / 3.0 * (volume - a_pl)
        elastic = (
            np.exp(volumetric + 2.0 * beta * e0),
            np.exp(volumetric + 2.0 * beta * e1),
            np.exp(volumetric + 2.0 * beta * e2),
        )
        # Cp^-1 = F^-1 b_e F^-T
        plastic_new = push_forward(inverse, from_principal(elastic, first, second, third))
    final = beta * mises
    stored = 0.5 * bulk * (volume - a_pl) ** 2 + final * final / (6.0 * shear)
    dissipated = 0.0
    if new_strain > strain:
        old_flow, _ = flow_stress(kind, hardening, strain)
        average = 0.5 * (1.0 + old_flow * jacobian / (keep * flow))
        dissipated = average * (pressure * a_pl + final * (mises - final) / (3.0 * shear))
    if need_tangent:
        # share of the elastic tangent, which Newton asks for where its steps go astray
        share = material[STIFFENING]
        elastic_share, plastic_share = share * keep, (1.0 - share) * keep
        diagonal = 2.0 * shear * (plastic_share * beta + elastic_share)
        rest = (plastic_share + elastic_share) * bulk - diagonal / 3.0
        direction = 6.0 * shear * shear / mises if mises > 0.0 else 0.0
        deviator, principal = scratch[9], scratch[10:13]
        deviator[0], deviator[1], deviator[2] = e0, e1, e2
        for b in range(3):
            d_a = bulk * (a_v + a_q * direction * deviator[b])
            d_beta = 2.0 * shear * (b_v + b_q * direction * deviator[b])
            for a in range(3):
                principal[a, b] = rest + plastic_share * (deviator[a] * d_beta - d_a)
            principal[b, b] += diagonal
        moduli = (
            diagonal * shear_factor(e0 - e1),
            diagonal * shear_factor(e0 - e2),
            diagonal * shear_factor(e1 - e2),
        )
        spatial_tangent(principal, moduli, first, second, third, scratch, tangent)
    finite = np.isfinite(pressure) and np.isfinite(final) and np.isfinite(new_strain)
    return (
        finite, stress, plastic_new, new_strain, new_damage, keep * stored, keep * dissipated,
        keep * final, mean,
    )  # fmt: skip


@kernel
def update_points(
    gradients, plastic_old, strains, damages, material, kind, hardening, stresses, tangents,
    plastic_new, new_strains, new_damages,
):  # fmt: skip
    """Update n points: F (n,9), Cp^-1 (n,6), strain (n,), f (n,); returns the number that failed.

    Fills Kirchhoff stress (n,6) and the tangent (n,6,6) of its corotational rate.
    For tests and benchmarks; the assembly calls `update_point` within its loop over cells.
    """
    scratch = np.empty((13, 6))
    failed = 0
    for i in range(gradients.shape[0]):
        f, p = gradients[i], plastic_old[i]
        ok, stress, plastic, new_strains[i], new_damages[i], _, _, _, _ = update_point(
            (f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8]),
            (p[0], p[1], p[2], p[3], p[4], p[5]),
            strains[i], damages[i], damages[i], material, kind, hardening, True, tangents[i],
            scratch,
        )  # fmt: skip
        for k in range(6):
            stresses[i, k], plastic_new[i, k] = stress[k], plastic[k]
        if not ok:
            failed += 1
    return failed


def identity_plastic(shape: tuple[int, ...]) -> np.ndarray:
    """Cp^-1 of virgin material, (*shape, 6)."""
    plastic = np.zeros((*shape, 6))
    plastic[..., :3] = 1.0
    return plastic


def uniaxial_yield(material: Material, damage: float) -> float:
    """Uniaxial stress over yield stress at f, by bisection of (5.40)."""
    from fem.constitutive.gurson import yield_function

    parameters = material.parameters()
    low, high = 0.0, 1.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if yield_function(middle, middle / 3.0, 1.0, damage, parameters) > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


__all__ = ["Material", "VoceHardening", "identity_plastic", "uniaxial_yield", "update_points"]
