"""Electrodes of the data files as laws of the engine."""

from pathlib import Path

import numpy as np
import pytest

import perilife_data
from peri.corrosion.polarization import POLARIZATION
from pipeline.scene.laws.polarization import polarization_law

NUMBERS = {
    "exchange_current_density": (0.3, "A/m^2"),
    "equilibrium_potential": (-400, "mV"),
    "charge_number": (2, "1"),
    "anodic_transfer": (0.3, "1"),
    "cathodic_transfer": (0.6, "1"),
}


def file(folder: Path, law: str, rest: str) -> Path:
    path = folder / "own.toml"
    stamp = 'source = "zhao2021"\nwhere = "here"\nkind = "measured"\n'
    text = (
        f'name = "own"\ntitle = "Own"\nreference_electrode = "SHE"\nmedium = "brine"\n'
        f'law = "{law}"\n[temperature]\nvalue = 298.15\nunit = "K"\n{stamp}{rest}'
    )
    path.write_text(text.replace("STAMP", stamp), encoding="utf-8")
    return path


def test_tafel_pieces_as_used_and_as_printed():
    alloy = perilife_data.load_electrode("AE44")
    used, printed = polarization_law(alloy), polarization_law(alloy, as_published=True)
    below = -1.48 - 1e-12
    assert used.current(below) == pytest.approx(21.145, rel=1e-9)
    assert printed.current(below) == pytest.approx(30.162, abs=5e-4)
    assert used.current(-1.3) == printed.current(-1.3)
    steel = polarization_law(perilife_data.load_electrode("mild-steel"))
    assert isinstance(steel, POLARIZATION["tafel"]) and steel.current(-0.58) == -0.00125
    second = polarization_law(perilife_data.load_electrode("AA6063"))
    # The couple's joint is near -1.468 V, where the cathode carries -4.45 A/m^2.
    assert second.current(-1.468) == pytest.approx(-0.142 * 10 ** (0.105 / 0.0701), rel=1e-12)


def test_points_and_butler_volmer(tmp_path):
    rest = (
        '[curve]\npotential = [-0.5, 0.0, 0.2]\npotential_unit = "V"\n'
        'current_density = [-1.0, 0.0, 7.0]\ncurrent_density_unit = "A/m^2"\nSTAMP'
    )
    law = polarization_law(perilife_data.load_electrode(file(tmp_path, "tabulated", rest)))
    np.testing.assert_allclose(law.current(np.array([-0.5, 0.2])), [-1.0, 7.0], rtol=1e-14)
    rest = "".join(
        f'[butler_volmer.{name}]\nvalue = {value}\nunit = "{unit}"\nSTAMP'
        for name, (value, unit) in NUMBERS.items()
    )
    law = polarization_law(perilife_data.load_electrode(file(tmp_path, "butler_volmer", rest)))
    assert law.current(-0.4) == pytest.approx(0.0, abs=1e-15)
    scaled = 2 * 96485.33212 / (8.314462618 * 298.15)
    expected = 0.3 * (np.exp(0.03 * scaled) - np.exp(-0.06 * scaled))
    assert law.current(-0.3) == pytest.approx(expected, rel=1e-12)
