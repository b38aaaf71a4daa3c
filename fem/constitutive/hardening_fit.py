"""Hardening laws fitted to a measured stress-strain curve."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from fem.constitutive.hardening import (
    Hardening,
    SwiftHardening,
    TabulatedHardening,
    VoceHardening,
    flow_stress,
)

PROOF_STRAIN = 0.002  # plastic strain from which on a point counts: the 0.2 % proof stress
LAWS = ("voce", "swift", "table")
_STRAIN_UNITS = {"1": 1.0, "%": 0.01}
_STRESS_UNITS = {"Pa": 1.0, "MPa": 1e6, "GPa": 1e9}
_TABLE_POINTS = 60
_FEWEST_POINTS = 5


@dataclass(frozen=True)
class HardeningFit:
    """A fitted law and how well it meets the points it was fitted to."""

    law: Hardening
    error: float  # root mean square of the difference in true stress [Pa]
    points: int  # used: plastic, and before the neck
    largest_strain: float  # plastic strain of the last of them; beyond it the law extrapolates


def fit_from_csv(
    path: str | Path,
    young: float,
    measure: str = "engineering",
    law: str = "voce",
    strain_unit: str = "1",
    stress_unit: str = "MPa",
) -> HardeningFit:
    """Fit a hardening law to a tensile test in a CSV file.

    The first two columns are strain (total, not plastic) and stress; a first line without numbers
    is a header, lines that start with # are skipped. strain_unit: "1" or "%"; stress_unit: "Pa",
    "MPa" or "GPa". The rest as in `fit_from_curve`. Raises FileNotFoundError, or ValueError with
    the line that is not two numbers.
    """
    for name, value, units in (
        ("strain_unit", strain_unit, _STRAIN_UNITS),
        ("stress_unit", stress_unit, _STRESS_UNITS),
    ):
        if value not in units:
            raise ValueError(f"{name} is {value!r}; allowed are {', '.join(units)}")
    rows: list[tuple[float, float]] = []
    started = False
    with open(path, newline="", encoding="utf-8-sig") as file:
        for row in csv.reader(file):
            if not any(cell.strip() for cell in row) or row[0].lstrip().startswith("#"):
                continue
            try:
                rows.append((float(row[0]), float(row[1])))
            except (ValueError, IndexError):
                if started:
                    raise ValueError(
                        f"{path}: a line reads {','.join(row)!r}; strain and stress as two numbers "
                        "separated by a comma are needed"
                    ) from None
            started = True
    data = np.array(rows, float).reshape(-1, 2)
    return fit_from_curve(
        data[:, 0] * _STRAIN_UNITS[strain_unit],
        data[:, 1] * _STRESS_UNITS[stress_unit],
        young,
        measure,
        law,
    )


def fit_from_curve(
    strain: np.ndarray,
    stress: np.ndarray,
    young: float,
    measure: str = "engineering",
    law: str = "voce",
) -> HardeningFit:
    """Fit a hardening law to total strain (n,) and stress (n,) [Pa] of a tensile test.

    measure: "engineering" (converted by ln(1 + e) and s (1 + e), volume constant; points beyond the
    largest stress, where the bar necks, are left out) or "true". young [Pa] gives the elastic part
    of the strain. Points from 0.2 % plastic strain on count, so that the rounding at yield and a
    machine's slack do not; the law continues them to zero. law: "voce" and "swift" by least squares
    in true stress, "table" piecewise linear through the points, smoothed to not fall.

    Raises ValueError, with the field and what is allowed, for a curve from which no law follows.
    """
    if law not in LAWS:
        raise ValueError(f"hardening law is {law!r}; allowed are {', '.join(LAWS)}")
    if not (np.isfinite(young) and young > 0):
        raise ValueError(f"young is {young}; it must be a positive modulus in Pa")
    true_strain, true_stress = _true_curve(np.asarray(strain), np.asarray(stress), measure)
    plastic = true_strain - true_stress / young
    used = plastic >= PROOF_STRAIN
    if used.sum() < _FEWEST_POINTS:
        raise ValueError(
            f"the stress-strain curve has {int(used.sum())} points beyond {PROOF_STRAIN:.1%} "
            f"plastic strain with young = {young:.4g} Pa; at least {_FEWEST_POINTS} are needed "
            "(check the units of strain and stress)"
        )
    e, s = plastic[used], true_stress[used]
    if np.any(np.diff(e) <= 0):
        order = np.argsort(e, kind="stable")
        e, s = e[order], s[order]
    fitted = {"voce": _voce, "swift": _swift, "table": _table}[law](e, s)
    model = np.array([flow_stress(fitted.kind, fitted.parameters(), value)[0] for value in e])
    return HardeningFit(fitted, float(np.sqrt(np.mean((model - s) ** 2))), len(e), float(e[-1]))


def _true_curve(strain, stress, measure) -> tuple[np.ndarray, np.ndarray]:
    """Checked true strain and true stress, up to the neck for an engineering curve."""
    if measure not in ("engineering", "true"):
        raise ValueError(f"stress-strain measure is {measure!r}; allowed are engineering, true")
    if strain.shape != stress.shape or strain.ndim != 1 or len(strain) < _FEWEST_POINTS:
        raise ValueError(
            f"the stress-strain curve has {strain.size} strains and {stress.size} stresses; "
            f"at least {_FEWEST_POINTS} pairs are needed"
        )
    if not (np.isfinite(strain).all() and np.isfinite(stress).all()):
        raise ValueError("the stress-strain curve has values that are no numbers")
    if strain.max() > 2.0:
        raise ValueError(
            f"the largest strain is {strain.max():.4g}; it must be at most 2 (is it in per cent?)"
        )
    if strain.min() <= -0.5 or stress.max() <= 0:
        raise ValueError(
            f"strain starts at {strain.min():.4g} and the largest stress is {stress.max():.4g} Pa; "
            "a test in tension has positive ones"
        )
    if not 1e4 < stress.max() < 1e11:
        raise ValueError(
            f"the largest stress is {stress.max():.4g} Pa; 1e4 to 1e11 Pa is possible "
            "(check its unit)"
        )
    if measure == "true":
        return strain, stress
    last = int(np.argmax(stress)) + 1
    return np.log1p(strain[:last]), stress[:last] * (1.0 + strain[:last])


def _best(objective: Callable[[float], float], low: float, high: float) -> float:
    """Argument of the least value between two positive bounds, searched on a logarithmic scale."""
    grid = np.linspace(np.log(low), np.log(high), 200)
    values = [objective(np.exp(x)) for x in grid]
    k = int(np.argmin(values))
    bounds = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    found = minimize_scalar(
        lambda x: objective(np.exp(x)), bounds=bounds, method="bounded", options={"xatol": 1e-12}
    )
    return float(np.exp(found.x if found.fun <= values[k] else grid[k]))


def _voce(e: np.ndarray, s: np.ndarray) -> VoceHardening:
    """Least squares: linear in s0 and Q at a given b, so only b is searched."""

    def solve(b: float) -> tuple[np.ndarray, float]:
        return nnls(np.c_[np.ones_like(e), -np.expm1(-b * e)], s)

    b = _best(lambda b: solve(b)[1], 0.01 / e[-1], 1e4)
    (s0, saturation), _ = solve(b)
    if not s0 > 0:
        raise ValueError(
            "the stress-strain curve leads to a Voce law without initial yield stress; use the law "
            "'swift' or 'table', or check young and the units"
        )
    return VoceHardening(float(s0), float(saturation), b)


def _swift(e: np.ndarray, s: np.ndarray) -> SwiftHardening:
    """Least squares in s: e0 is searched, n searched within, s0 linear."""

    def scale(e0: float, n: float) -> tuple[float, float]:
        shape = (1.0 + e / e0) ** n
        s0 = float(shape @ s / (shape @ shape))
        return s0, float(np.linalg.norm(s0 * shape - s))

    def exponent(e0: float) -> float:
        found = minimize_scalar(
            lambda n: scale(e0, n)[1], bounds=(0.0, 0.999), method="bounded",
            options={"xatol": 1e-10},
        )  # fmt: skip
        return float(found.x)

    e0 = _best(lambda e0: scale(e0, exponent(e0))[1], 1e-5, 10.0)
    n = exponent(e0)
    return SwiftHardening(scale(e0, n)[0], e0, n)


def _table(e: np.ndarray, s: np.ndarray) -> TabulatedHardening:
    """Means of at most 60 groups of points, made not to fall; constant below the first one."""
    groups = np.array_split(np.arange(len(e)), min(_TABLE_POINTS, len(e)))
    strains = np.array([e[group].mean() for group in groups])
    stresses = np.maximum.accumulate([s[group].mean() for group in groups])
    keep = np.concatenate([[True], np.diff(strains) > 0])
    strains, stresses = strains[keep], stresses[keep]
    return TabulatedHardening(
        (0.0, *map(float, strains)), (float(stresses[0]), *map(float, stresses))
    )
