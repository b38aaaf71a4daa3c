"""Activity coefficients of dissolved species and the activity of water."""

from __future__ import annotations

import math

import numpy as np

from peri.transport.chemistry.species import LN10, MOLAR, Chemistry

ACTIVITIES = ("davies", "wateq", "fixed", "ideal")
"""davies, wateq: at the ionic strength of each node; fixed: at that of the medium (Davies);
ideal: all 1."""

WARNING_STRENGTH, HIGHEST_STRENGTH = 0.5, 1.0
"""mol/L: Davies' equation is doubtful from the first and refused above the second."""

_DEBYE_HUECKEL = ((298.15, 0.510025, 0.3284906e10), (310.15, 0.521144, 0.3304488e10))
"""K; A, (L/mol)^1/2; B, (L/mol)^1/2 / m."""


def debye_hueckel(temperature: float) -> tuple[float, float]:
    """Return A and B of the Debye-Hueckel law, (L/mol)^1/2 and (L/mol)^1/2 / m, at 25 to 37 degC.

    temperature : K.  The values are those of PHREEQC at 1 atm (Parkhurst and Appelo 2013); linear
    between.  Raises ValueError outside.
    """
    (low, *cold), (high, *warm) = _DEBYE_HUECKEL
    if not low - 1e-6 <= temperature <= high + 1e-6:
        raise ValueError(
            f"temperature: {temperature - 273.15:g} degC; activity coefficients are known from "
            "25 to 37 degC (use activity 'ideal' elsewhere)"
        )
    share = (temperature - low) / (high - low)
    a, b = (c + (w - c) * share for c, w in zip(cold, warm, strict=True))
    return a, b


def davies(charge: np.ndarray, strength: float | np.ndarray, a: float) -> np.ndarray:
    """Return ln(gamma), shape (K,) or (K, n), of species of the given charges.

    Davies: log10 gamma = -A z^2 (sqrt(I) / (1 + sqrt(I)) - 0.3 I); 0.1 I for neutral species.

    Parameters
    ----------
    charge : (K,) charge numbers
    strength : ionic strength I, mol/L, a number or (n,)
    a : A, (L/mol)^1/2
    """
    strength = np.asarray(strength, float)
    z = charge.reshape((-1,) + (1,) * strength.ndim)
    root = np.sqrt(strength)
    law = -a * z**2 * (root / (1.0 + root) - 0.3 * strength)
    return LN10 * np.where(z == 0, 0.1 * strength, law)


def wateq(chemistry: Chemistry, strength: float | np.ndarray, a: float, b: float) -> np.ndarray:
    """Return ln(gamma), shape (K,) or (K, n), by the Debye-Hueckel law of WATEQ.

    log10 gamma = -A z^2 sqrt(I) / (1 + B a0 sqrt(I)) + b0 I with a0 and b0 of each species
    (Truesdell and Jones 1974), Davies' equation for a species that declares none, as in PHREEQC.

    Parameters
    ----------
    chemistry : Chemistry; it must declare the size of one ion at least (ValueError)
    strength : ionic strength I, mol/L, a number or (n,)
    a, b : A and B of debye_hueckel
    """
    if np.isnan(chemistry.ion_size).all():
        raise ValueError(
            "activity: 'wateq' needs ion_size and strength_coefficient of the species, which this "
            "reaction set does not give; allowed: davies, fixed, ideal"
        )
    strength = np.asarray(strength, float)
    shape = (-1,) + (1,) * strength.ndim
    root, z = np.sqrt(strength), chemistry.charge.reshape(shape)
    size, slope = chemistry.ion_size.reshape(shape), chemistry.strength_coefficient.reshape(shape)
    law = LN10 * (-a * z**2 * root / (1.0 + b * size * root) + slope * strength)
    return np.where(np.isnan(law), davies(chemistry.charge, strength, a), law)


def ionic_strength(charge: np.ndarray, concentration: np.ndarray) -> np.ndarray:
    """Return I = 1/2 sum_k z_k^2 C_k in mol/L from concentrations (K, ...), mol/m3."""
    return 0.5 * np.tensordot(charge**2, concentration, 1) / MOLAR


def ln_water_activity(concentration: np.ndarray) -> np.ndarray:
    """Return ln(1 - 0.017 sum_k C_k), C in mol/L, from concentrations (K, ...), mol/m3."""
    return np.log1p(-0.017 * concentration.sum(axis=0) / MOLAR)


def check_strength(strength: float, activity: str) -> str:
    """Return a warning ("" for none) about the ionic strength (mol/L) of a medium.

    Raises ValueError where Davies' equation (or WATEQ's) does not hold at all, naming the way out.
    """
    if activity == "ideal" or strength <= WARNING_STRENGTH:
        return ""
    if strength > HIGHEST_STRENGTH or not math.isfinite(strength):
        raise ValueError(
            f"activity: '{activity}' at an ionic strength of {strength:.3g} mol/L; Davies' "
            f"equation holds up to {HIGHEST_STRENGTH:g} mol/L, use 'ideal'"
        )
    return (
        f"ionic strength {strength:.3g} mol/L is above {WARNING_STRENGTH:g} mol/L, where Davies' "
        "equation is doubtful"
    )


def conditional_constants(
    chemistry: Chemistry, ln_gamma: np.ndarray, ln_water: float | np.ndarray
) -> np.ndarray:
    """Return b, (K, ...), of C_k = exp(b_k + sum_e nu_ke m_e), m = ln of free components.

    Mass action C_k gamma_k = K_k prod_e (C_e gamma_e)^nu_ke a_w^n_k with constants in mol/L and
    concentrations in mol/m3: the unit is converted here and nowhere else.
    """
    shape = (-1,) + (1,) * (np.ndim(ln_gamma) - 1)
    nu, e = chemistry.stoichiometry, len(chemistry.components)
    return (
        chemistry.ln_k.reshape(shape)
        - ln_gamma
        + np.tensordot(nu, ln_gamma[:e], 1)
        + chemistry.water.reshape(shape) * ln_water
        + math.log(MOLAR) * (1.0 - nu.sum(axis=1)).reshape(shape)
    )


def mineral_constants(
    chemistry: Chemistry, ln_gamma: np.ndarray, ln_water: float | np.ndarray
) -> np.ndarray:
    """Return c, (M, ...), of ln(Omega_m) = sum_e nu_me m_e + c_m; m as above."""
    e = len(chemistry.components)
    rows = [
        np.tensordot(m.stoichiometry, ln_gamma[:e], 1)
        - m.stoichiometry.sum() * math.log(MOLAR)
        + m.water * np.asarray(ln_water)
        - m.ln_k
        for m in chemistry.minerals
    ]
    return np.array(rows).reshape((len(rows), *np.shape(ln_gamma)[1:]))
