"""Laws of the dissolution rate."""

import math

import pytest

from peri.corrosion.kinetics import ButlerVolmer, ConstantRate, Exposed, Tafel, VolumeLossLaw
from peri.corrosion.rate_laws import KINETICS
from peri.engine.constants import FARADAY, GAS_CONSTANT


def test_values():
    assert ConstantRate().rate(Exposed(0.7)) == 1.0
    # Eq. 5.13: a factor ten per l
    assert VolumeLossLaw(0.2).rate(Exposed(0.0)) == 1.0
    assert VolumeLossLaw(0.2).rate(Exposed(0.2)) == pytest.approx(0.1, rel=1e-15)
    assert VolumeLossLaw(0.2).rate(Exposed(0.5)) == pytest.approx(10**-2.5, rel=1e-15)
    # Eq. 2.47: a factor ten per slope
    assert Tafel(0.12, 0.06).rate(Exposed(0.3)) == pytest.approx(100.0, rel=1e-14)
    assert Tafel(-0.06, 0.06).rate(Exposed(0.3)) == pytest.approx(0.1, rel=1e-14)
    # Eq. 3.92 at 25 C: z F eta / RT = 2 * 0.1 / 0.025693 for 0.1 V
    thermal = GAS_CONSTANT * 298.15 / FARADAY
    assert thermal == pytest.approx(25.693e-3, rel=2e-5)  # RT/F at 25 C, five digits
    law = ButlerVolmer(0.1, 2.0, 0.3, 0.6, 298.15)
    expected = math.exp(0.06 / thermal) - math.exp(-0.12 / thermal)
    assert law.rate(Exposed(0.0)) == pytest.approx(expected, rel=1e-14)  # round-off
    assert ButlerVolmer(0.0).rate(Exposed(0.0)) == 0.0


def test_butler_volmer_becomes_tafel_at_high_overpotential():
    law = ButlerVolmer(0.3, 2.0, 0.5, 0.5, 298.15)
    slope = GAS_CONSTANT * 298.15 * math.log(10) / (0.5 * 2 * FARADAY)
    # the cathodic share is exp(-2 * 11.7)
    assert law.rate(Exposed(0.0)) == pytest.approx(Tafel(0.3, slope).rate(Exposed(0.0)), rel=1e-9)


GLOBAL = [name for name, law in KINETICS.items() if law.needs <= {"volume_loss"}]


@pytest.mark.parametrize("name", GLOBAL)
def test_every_law_falls_or_stays_with_the_volume_lost(name):
    arguments = {
        "constant": {},
        "volume_loss": {"length": 0.05},
        "tafel": {"overpotential": 0.1, "slope": 0.05},
        "butler_volmer": {"overpotential": 0.1},
    }[name]
    factors = [KINETICS[name](**arguments).rate(Exposed(v)) for v in (0.0, 0.1, 0.5, 1.0)]
    assert factors[0] > 0 and min(factors) >= 0
    assert all(after <= before for before, after in zip(factors, factors[1:], strict=False))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: VolumeLossLaw(0.0), "length"),
        (lambda: VolumeLossLaw(-1.0), "length"),
        (lambda: VolumeLossLaw(float("nan")), "length"),
        (lambda: VolumeLossLaw(float("inf")), "length"),
        (lambda: Tafel(0.1, 0.0), "slope"),
        (lambda: Tafel(100.0, 0.05), "overpotential.*decades"),
        (lambda: Tafel(float("nan"), 0.05), "overpotential"),
        (lambda: ButlerVolmer(-0.1), "overpotential"),
        (lambda: ButlerVolmer(float("nan")), "overpotential"),
        (lambda: ButlerVolmer(100.0), "overpotential.*decades"),
        (lambda: ButlerVolmer(0.1, charge_number=0.0), "charge_number"),
        (lambda: ButlerVolmer(0.1, anodic_transfer=0.0), "anodic_transfer"),
        (lambda: ButlerVolmer(0.1, cathodic_transfer=-1.0), "cathodic_transfer"),
        (lambda: ButlerVolmer(0.1, temperature=0.0), "temperature"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message):
        make()
