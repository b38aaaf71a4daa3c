"""The material: parameters for the reader, and its update at one quadrature point.

Multiplicative split F = Fe Fp, Hencky's law tau = K tr(eps) 1 + 2 G dev(eps) in the elastic
logarithmic strain, porous plasticity by `gurson.return_map` in principal axes. The internal
variable of the flow is Cp^-1 (six numbers), so that no earlier F is needed:  b_trial = F Cp^-1 F^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

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
    return_map,
)
from fem.constitutive.hardening import Hardening, VoceHardening, flow_stress
from fem.constitutive.hencky import (
    eigen_symmetric,
    from_principal,
    invert,
    push_forward,
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
    force is in tests/fem/test_tensile_test.py.
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


@njit(cache=True, nogil=True)
def _stiffness_left(damage: float, material: np.ndarray) -> float:
    """Moduli over those of the intact metal: 1 - q1 f*, as the strength; a void's beyond f_max."""
    if damage >= material[LIMIT]:
        return VOID_STIFFNESS
    if material[STIFFNESS_LOSS] > 0.0:
        effective, _ = effective_damage(damage, material)
        return 1.0 - material[Q1] * effective
    return 1.0


@njit(cache=True, nogil=True)
def stiffness_left(damage: np.ndarray, material: np.ndarray) -> np.ndarray:
    """`_stiffness_left` for an array of f (nc, nq); material: the parameter vector."""
    left = np.empty_like(damage)
    for c in range(damage.shape[0]):
        for q in range(damage.shape[1]):
            left[c, q] = _stiffness_left(damage[c, q], material)
    return left


@njit(cache=True, nogil=True)
def update_point(
    gradient, plastic_old, strain, damage, material, kind, hardening, need_tangent, stress,
    tangent, plastic_new, small, dyad,
):  # fmt: skip
    """Update one quadrature point.

    gradient: F (3,3); plastic_old: Cp^-1 (6,) at the start of the step; strain, damage: plastic
    strain and f there. Fills `stress` (Kirchhoff, 3x3), `tangent` (9x9: d tau = tangent : dF F^-1)
    when asked, and `plastic_new` (6,). `small` (5,3,3) and `dyad` (9,9) are scratch.

    Returns (ok, plastic strain, f, stored energy, dissipated energy, mises, mean stress) with
    energies per reference volume and Kirchhoff stresses; ok is False for det F <= 0 or no number.
    """
    trial, vectors, principal, inverse, log_strain = (
        small[0], small[1], small[2], small[3], small[4],
    )  # fmt: skip
    jacobian = invert(gradient, inverse)
    if not jacobian > 0.0:
        return False, strain, damage, 0.0, 0.0, 0.0, 0.0
    plastic = (
        plastic_old[0], plastic_old[1], plastic_old[2],
        plastic_old[3], plastic_old[4], plastic_old[5],
    )  # fmt: skip
    push_forward(gradient, plastic, trial)
    stretches = log_strain[2]
    eigen_symmetric(trial, stretches, vectors)
    if not (stretches[0] > 0.0 and stretches[1] > 0.0 and stretches[2] > 0.0):
        return False, strain, damage, 0.0, 0.0, 0.0, 0.0
    bulk, shear = material[BULK], material[SHEAR]
    deviator, normal = log_strain[0], log_strain[1]
    for a in range(3):
        deviator[a] = 0.5 * np.log(stretches[a])
    volume = deviator[0] + deviator[1] + deviator[2]
    for a in range(3):
        deviator[a] -= volume / 3.0
    squared = deviator[0] ** 2 + deviator[1] ** 2 + deviator[2] ** 2
    mises = shear * np.sqrt(6.0 * squared)
    keep = _stiffness_left(damage, material)
    if damage >= material[LIMIT]:
        a_pl, beta, new_strain, new_damage, flow = 0.0, 1.0, strain, damage, 1.0
        a_v = b_v = a_q = b_q = 0.0
    else:  # the return depends on the ratio of flow stress and moduli only
        a_pl, beta, new_strain, new_damage, flow, a_v, b_v, a_q, b_q = return_map(
            volume, mises, jacobian / keep, strain, damage, material, kind, hardening
        )
    pressure = bulk * (volume - a_pl)
    scale = 2.0 * shear * beta
    tau = from_principal(
        vectors,
        keep * (pressure + scale * deviator[0]),
        keep * (pressure + scale * deviator[1]),
        keep * (pressure + scale * deviator[2]),
    )
    stress[0, 0], stress[1, 1], stress[2, 2] = tau[0], tau[1], tau[2]
    stress[0, 1] = stress[1, 0] = tau[3]
    stress[0, 2] = stress[2, 0] = tau[4]
    stress[1, 2] = stress[2, 1] = tau[5]
    if new_strain == strain and a_pl == 0.0:
        for k in range(6):
            plastic_new[k] = plastic_old[k]
    else:
        third = (volume - a_pl) / 3.0
        elastic = from_principal(
            vectors,
            np.exp(2.0 * (third + beta * deviator[0])),
            np.exp(2.0 * (third + beta * deviator[1])),
            np.exp(2.0 * (third + beta * deviator[2])),
        )
        push_forward(inverse, elastic, trial)  # Cp^-1 = F^-1 b_e F^-T
        plastic_new[0], plastic_new[1], plastic_new[2] = trial[0, 0], trial[1, 1], trial[2, 2]
        plastic_new[3], plastic_new[4], plastic_new[5] = trial[0, 1], trial[0, 2], trial[1, 2]
    final = beta * mises
    stored = 0.5 * bulk * (volume - a_pl) ** 2 + final * final / (6.0 * shear)
    dissipated = 0.0
    if new_strain > strain:
        old_flow, _ = flow_stress(kind, hardening, strain)
        mean = 0.5 * (1.0 + old_flow * jacobian / (keep * flow))
        dissipated = mean * (pressure * a_pl + final * (mises - final) / (3.0 * shear))
    if need_tangent:
        for b in range(3):
            normal[b] = 6.0 * shear * shear * deviator[b] / mises if mises > 0.0 else 0.0
        for a in range(3):
            for b in range(3):
                d_a = a_v + a_q * normal[b]
                d_beta = b_v + b_q * normal[b]
                principal[a, b] = bulk * (1.0 - d_a) - 2.0 / 3.0 * shear * beta
                principal[a, b] += 2.0 * shear * deviator[a] * d_beta
            principal[a, a] += 2.0 * shear * beta
        # share of the elastic tangent, which Newton asks for where its steps go astray
        share = material[STIFFENING]
        for a in range(3):
            for b in range(3):
                elastic_part = bulk + (4.0 if a == b else -2.0) / 3.0 * shear
                principal[a, b] += share * (elastic_part - principal[a, b])
                principal[a, b] *= keep
        ratio = 2.0 * shear * keep * (beta + share * (1.0 - beta))
        spatial_tangent(principal, stretches, vectors, ratio, tangent, dyad[0], dyad[1])
    finite = np.isfinite(pressure) and np.isfinite(final) and np.isfinite(new_strain)
    return (
        finite, new_strain, new_damage, keep * stored, keep * dissipated, keep * final,
        keep * pressure,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def update_points(
    gradients, plastic_old, strains, damages, material, kind, hardening, stresses, tangents,
    plastic_new, new_strains, new_damages,
):  # fmt: skip
    """Update n points: F (n,3,3), Cp^-1 (n,6), strain (n,), f (n,); returns the number that failed.

    For tests and benchmarks; the assembly calls `update_point` within its loop over cells.
    """
    small, dyad = np.empty((5, 3, 3)), np.empty((2, 9, 9))
    failed = 0
    for i in range(gradients.shape[0]):
        ok, strain, damage, _, _, _, _ = update_point(
            gradients[i], plastic_old[i], strains[i], damages[i], material, kind, hardening, True,
            stresses[i], tangents[i], plastic_new[i], small, dyad,
        )  # fmt: skip
        new_strains[i], new_damages[i] = strain, damage
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
