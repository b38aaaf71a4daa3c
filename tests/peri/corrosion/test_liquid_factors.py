"""Laws that read the liquid: the factors, and anode and cathode at one place."""

import math

import numpy as np
import pytest

from peri.corrosion.acidity import AcidityLaw
from peri.corrosion.electrode_kinetics import ElectrodeKinetics
from peri.corrosion.inhibition import Inhibited
from peri.corrosion.kinetics import ConstantRate, Exposed, VolumeLossLaw
from peri.corrosion.liquid_factors import LiquidFactors
from peri.engine.constants import FARADAY, GAS_CONSTANT

FREE = {"anodic": 1e-3, "cathodic": 1e-2, "potential": -2.0, "hydrogen_potential": -0.9}


def test_factors_multiply_and_are_one_where_left_out() -> None:
    law = LiquidFactors(
        VolumeLossLaw(0.2), 0.5, 7.5, chloride_order=0.3, chloride_reference=100.0,
        layer_thickness=1e-5, layer_twice=True,
    )  # fmt: skip
    assert law.needs == {"volume_loss", "ph", "chloride", "layer"}
    at = Exposed(0.1, ph=np.array([7.5, 8.5]), chloride=100.0, layer=np.array([0.0, 1e-5]))
    half, tenth = 10**-0.5, 10**-0.5
    assert law.rate(at) == pytest.approx([half, half * tenth * 0.5], rel=1e-14)
    assert law.rate(Exposed(0.0, ph=7.5, chloride=200.0, layer=0.0)) == pytest.approx(2**0.3)
    plain = LiquidFactors(ConstantRate())
    assert plain.needs == frozenset() and plain.rate(Exposed(0.3)) == 1.0


@pytest.mark.parametrize("ph_order", [0.0, 0.1])
def test_free_corrosion_is_where_the_currents_are_equal(ph_order: float) -> None:
    law = ElectrodeKinetics(**FREE, ph_order=ph_order)
    f = FARADAY / (GAS_CONSTANT * law.temperature)
    ph = np.array([7.0, 9.0, 11.0])
    found = law.corrosion_potential(ph, 0.0)
    # Two exponentials: the potential in closed form.
    ratio = np.log(1e-2 / 1e-3) - ph_order * (ph - 7.0) * math.log(10.0)
    exact = (ratio / f + 1.0 * -2.0 + 0.5 * -0.9) / 1.5
    assert found == pytest.approx(exact, abs=1e-13)
    anodic, cathodic = law.currents(found, ph, 0.0)
    assert anodic == pytest.approx(cathodic, rel=1e-10)
    rate = law.rate(Exposed(ph=ph, magnesium=np.zeros(3)))
    assert rate[0] == pytest.approx(1.0, rel=1e-12)
    assert rate[1:] == pytest.approx(10.0 ** (-ph_order * (ph[1:] - 7.0) * 2 / 3), rel=1e-9)


def test_its_own_ions_hold_the_anode_back_as_nernst_says() -> None:
    law = ElectrodeKinetics(**FREE)
    nernst = law.potential + GAS_CONSTANT * law.temperature / (2 * FARADAY) * math.log(1e-3)
    anodic, _ = law.currents(np.array([nernst]), 7.0, 1.0)
    forward, _ = law.currents(np.array([nernst]), 7.0, 0.0)
    assert abs(anodic[0]) < 1e-12 * forward[0]
    # Near equilibrium the ions matter, far from it they do not.
    slow = ElectrodeKinetics(**{**FREE, "cathodic": 1e-12})
    far, near = (
        law_.rate(Exposed(ph=7.0, magnesium=np.array([0.0, 1000.0]))) for law_ in (law, slow)
    )
    assert far[1] == pytest.approx(far[0], rel=1e-3) and near[1] < 0.9 * near[0]
    assert np.isfinite(law.rate(Exposed(ph=7.0, magnesium=np.array([0.0]))))


def test_an_inhibitor_covers_the_metal_by_langmuirs_isotherm() -> None:
    law = Inhibited(LiquidFactors(VolumeLossLaw(0.2), 0.5, 7.5), "Cl", 0.01, 0.8)
    assert law.needs == {"volume_loss", "ph", "inhibitor"}
    at = Exposed(0.0, ph=7.5, inhibitor=np.array([0.0, 100.0, 1e9]))
    assert law.rate(at) == pytest.approx([1.0, 1.0 - 0.8 * 0.5, 0.2], rel=1e-6)
    half = law.rate(Exposed(0.2 * math.log10(2.0), ph=7.5, inhibitor=100.0))
    assert half == pytest.approx(0.5 * 0.6)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: LiquidFactors(VolumeLossLaw(0.2), layer_thickness=1e-5), "already contains the"),
        (lambda: LiquidFactors(ConstantRate(), ph_order=-1.0), "ph_order: -1.0; it must be finite"),
        (lambda: LiquidFactors(ConstantRate(), layer_thickness=0.0), "layer_thickness: 0.0 m"),
        (lambda: LiquidFactors(ConstantRate(), chloride_reference=0.0), "chloride_reference: 0.0"),
        (lambda: LiquidFactors(AcidityLaw(10.0)), "looks at more than the volume loss"),
        (lambda: ElectrodeKinetics(**FREE, balance="shared"), "balance: 'shared'; it must be one"),
        (lambda: ElectrodeKinetics(**FREE, balance="applied"), "balance: 'applied' with 0 of app"),
        (lambda: Inhibited(ConstantRate(), "Cl", 0.0), "constant: 0.0 m.3/mol; it must be"),
        (lambda: Inhibited(ConstantRate(), "Cl", 1.0, 1.1), "efficiency: 1.1; it must be above 0"),
        (
            lambda: Inhibited(ElectrodeKinetics(**FREE, balance="mixed"), "Cl", 1.0),
            "anodes and cathodes lie apart",
        ),
        (lambda: ElectrodeKinetics(**{**FREE, "anodic": 0.0}), "anodic: 0.0; it must be finite"),
        (lambda: ElectrodeKinetics(**FREE, anodic_transfer=1.5), "anodic_transfer: 1.5"),
    ],
)
def test_laws_are_checked(build, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        build()
