"""Hardening laws: slopes, Considere's condition of the fit, refusals."""

import numpy as np
import pytest

from fem.constitutive.hardening import (
    SwiftHardening,
    TabulatedHardening,
    VoceHardening,
    fit_voce,
    flow_stress,
)

CATALOGUE = [
    VoceHardening(100e6, 150e6, 10.0),
    VoceHardening(450e6, 265e6, 16.93, linear=129.24e6),
    VoceHardening(200e6),
    SwiftHardening(150e6, 0.01, 0.2),
    TabulatedHardening((0.0, 0.05, 0.2), (100e6, 160e6, 220e6)),
]


@pytest.mark.parametrize("law", CATALOGUE, ids=lambda law: type(law).__name__)
def test_slope_is_the_derivative(law):
    parameters = law.parameters()
    for strain in (0.01, 0.03, 0.11, 0.19, 0.4):
        step = 1e-6
        up, _ = flow_stress(law.kind, parameters, strain + step)
        down, _ = flow_stress(law.kind, parameters, strain - step)
        stress, slope = flow_stress(law.kind, parameters, strain)
        assert stress > 0
        # central difference over 2e-6: measured 6e-10
        assert abs((up - down) / (2 * step) - slope) < 1e-8 * max(slope, parameters.max())


def test_compiled_equals_plain_python():
    for law in CATALOGUE:
        for strain in np.linspace(0, 0.3, 7):
            parameters = law.parameters()
            # the same operations in the same order: equal to round-off (measured 0)
            np.testing.assert_allclose(
                flow_stress(law.kind, parameters, strain),
                flow_stress.py_func(law.kind, parameters, strain),
                rtol=1e-14,
            )


@pytest.mark.parametrize("data", [(130e6, 220e6, 0.19), (180e6, 270e6, 0.20), (91e6, 240e6, 0.12)])
def test_fit_passes_through_yield_strength_and_considere(data):
    yield_stress, ultimate, uniform = data
    law = fit_voce(*data)
    start, _ = flow_stress(law.kind, law.parameters(), 0.0)
    stress, slope = flow_stress(law.kind, law.parameters(), np.log1p(uniform))
    assert start == pytest.approx(yield_stress, rel=1e-14)
    # bisection to the last bit: measured 2e-16
    assert stress == pytest.approx(ultimate * (1 + uniform), rel=1e-12)
    assert slope == pytest.approx(stress, rel=1e-10)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: VoceHardening(-1.0), "s0"),
        (lambda: VoceHardening(1e6, -1.0), "Q"),
        (lambda: VoceHardening(1e6, 1e6, 0.0), "b"),
        (lambda: SwiftHardening(1e6, 0.0, 0.1), "e0"),
        (lambda: TabulatedHardening((0.0, 0.1), (2e6, 1e6)), "stresses"),
        (lambda: fit_voce(200e6, 150e6, 0.1), "ultimate"),
        (lambda: fit_voce(130e6, 220e6, 19.0), "uniform strain"),
        (lambda: fit_voce(215e6, 220e6, 0.3), "Voce curve exists only"),
    ],
)
def test_refuses(call, words):
    with pytest.raises(ValueError, match=words):
        call()
