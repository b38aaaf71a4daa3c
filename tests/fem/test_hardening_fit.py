"""Hardening laws recovered from synthetic stress-strain curves."""

import numpy as np
import pytest

from fem.constitutive import fit_from_csv
from fem.constitutive.hardening import SwiftHardening, VoceHardening, flow_stress
from fem.constitutive.hardening_fit import fit_from_curve

YOUNG = 43e9
VOCE = VoceHardening(130e6, 156e6, 10.6)
SWIFT = SwiftHardening(120e6, 0.01, 0.22)


def curve(law, last=0.19, points=300):
    """Total true strain and true stress [Pa], elastic part included."""
    plastic = np.r_[0.0, np.geomspace(1e-5, last, points)]
    stress = np.array([flow_stress(law.kind, law.parameters(), e)[0] for e in plastic])
    return np.r_[0.0, plastic + stress / YOUNG], np.r_[0.0, stress]


def engineering(strain, stress):
    return np.expm1(strain), stress * np.exp(-strain)


@pytest.mark.parametrize(("law", "name"), [(VOCE, "voce"), (SWIFT, "swift")])
@pytest.mark.parametrize("measure", ["engineering", "true"])
def test_recovers_the_law(law, name, measure):
    strain, stress = curve(law)
    if measure == "engineering":
        strain, stress = engineering(strain, stress)
    fit = fit_from_curve(strain, stress, YOUNG, measure, name)
    # exact data: measured 1.4e-8 (Voce), 5e-8 (Swift)
    np.testing.assert_allclose(fit.law.parameters()[:3], law.parameters()[:3], rtol=1e-6)
    assert fit.error < 10  # Pa, measured 0.25
    assert fit.points > 50 and 0.15 < fit.largest_strain <= 0.19


def test_points_after_the_neck_do_not_count():
    strain, stress = engineering(*curve(VOCE, last=0.5))
    top = np.argmax(stress)
    assert 100 < top < len(stress) - 5
    fallen = np.where(np.arange(len(stress)) > top, 0.5 * stress, stress)
    fit = fit_from_curve(strain, fallen, YOUNG)
    np.testing.assert_allclose(fit.law.parameters()[:3], VOCE.parameters()[:3], rtol=1e-6)


def test_noise_and_slack_of_the_machine():
    """1 MPa of noise and an elastic slope a fifth too low leave the curve within 2 %."""
    strain, stress = engineering(*curve(VOCE))
    noisy = stress + np.random.default_rng(2).normal(0, 1e6, len(stress))
    fit = fit_from_curve(strain + 0.2 * stress / YOUNG, noisy, YOUNG)
    assert 0.5e6 < fit.error < 2e6
    for e in (0.01, 0.05, 0.15):
        expected, _ = flow_stress(VOCE.kind, VOCE.parameters(), e)
        assert flow_stress(fit.law.kind, fit.law.parameters(), e)[0] == pytest.approx(
            expected, rel=0.02
        )


def test_table_follows_any_curve():
    strain, stress = curve(SWIFT)
    fit = fit_from_curve(strain, stress, YOUNG, "true", "table")
    assert fit.law.strains[0] == 0.0 and len(fit.law.strains) <= 61
    for e in (0.004, 0.02, 0.1, 0.18):
        expected, _ = flow_stress(SWIFT.kind, SWIFT.parameters(), e)
        assert flow_stress(fit.law.kind, fit.law.parameters(), e)[0] == pytest.approx(
            expected, rel=3e-3
        )


def test_perfect_plasticity_has_no_hardening():
    strain = np.r_[np.linspace(0, 100e6 / YOUNG, 5), np.linspace(0.004, 0.1, 30)]
    stress = np.minimum(YOUNG * strain, 100e6)
    fit = fit_from_curve(strain, stress, YOUNG, "true")
    # measured 2e-16; 6e-6 at strain 0 with SciPy 1.15, whose least squares are less exact
    assert flow_stress(0, fit.law.parameters(), 0.0)[0] == pytest.approx(100e6, rel=2e-5)
    assert flow_stress(0, fit.law.parameters(), 0.1)[0] == pytest.approx(100e6, rel=2e-5)


def test_csv_with_units_header_and_comments(tmp_path):
    strain, stress = engineering(*curve(VOCE))
    rows = "\n".join(
        f"{100 * e:.9g},{1e-6 * s:.9g}, note" for e, s in zip(strain, stress, strict=True)
    )
    path = tmp_path / "test.csv"
    path.write_text(f"# extruded bar\nstrain_percent,stress_MPa,remark\n\n{rows}\n")
    fit = fit_from_csv(path, YOUNG, strain_unit="%")
    np.testing.assert_allclose(fit.law.parameters()[:3], VOCE.parameters()[:3], rtol=1e-5)


GOOD = curve(VOCE)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fit_from_curve(*GOOD, YOUNG, "nominal"), "engineering, true"),
        (lambda: fit_from_curve(*GOOD, YOUNG, law="spline"), "voce, swift, table"),
        (lambda: fit_from_curve(*GOOD, -1.0), "young"),
        (lambda: fit_from_curve(GOOD[0], 1e-6 * GOOD[1], YOUNG), "check its unit"),
        (lambda: fit_from_curve(100 * GOOD[0], GOOD[1], YOUNG), "per cent"),
        (lambda: fit_from_curve(0.01 * GOOD[0], GOOD[1], YOUNG), "points beyond"),
        (lambda: fit_from_curve(GOOD[0][:3], GOOD[1][:3], YOUNG), "pairs are needed"),
        (lambda: fit_from_curve(GOOD[0], -GOOD[1], YOUNG), "in tension"),
        (lambda: fit_from_curve(GOOD[0], np.nan * GOOD[1], YOUNG), "no numbers"),
    ],
)
def test_refuses(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("strain,stress\n0.1,abc\n", {}, "0.1,abc"),
        ("strain\n0.1\n", {}, "two numbers"),
        ("", {}, "pairs are needed"),
        ("0,0\n", {"strain_unit": "mm"}, "strain_unit"),
        ("0,0\n", {"stress_unit": "ksi"}, "stress_unit"),
    ],
)
def test_refuses_files(tmp_path, text, options, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        fit_from_csv(path, YOUNG, **options)
    with pytest.raises(FileNotFoundError):
        fit_from_csv(tmp_path / "absent.csv", YOUNG)
