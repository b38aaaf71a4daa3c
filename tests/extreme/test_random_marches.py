"""Some of the random marches of tests.extreme.random_marches."""

import numpy as np
import pytest

from peri.corrosion.run import corrode
from tests.extreme.random_marches import check, faults, main, random_march

HARD = {
    88: "closed liquid whose level the rounding of a long step hides",
    148: "the same with Faraday's law",
    632: "a step that releases nearly all of the liquid",
    634: "emptied metal and clean liquid beside it",
    673: "all liquid held at C_sat, nothing dissolves",
    912: "full liquid whose rate its concentration sets",
    1535: "a step of 1e13 s",
}


@pytest.mark.parametrize("seed", HARD)
def test_hard_ones(seed):
    assert check(seed)[0] == "ended"


def test_some_of_the_others(capsys):
    assert main(["25"]) == 0, capsys.readouterr().out


def test_what_a_march_breaks_is_found():
    march = random_march(41)
    result = corrode(march.scene, [march.end], march.stepping)
    assert faults(march.scene, result) == []
    result.concentration[0][march.scene.domain] *= 1 + 1e-8
    assert any(fault.startswith("balance") for fault in faults(march.scene, result))
    result.concentration[0].flat[0] = -1e-6
    result.history["volume_loss"] = np.array([0.5, 0.4])
    found = " ".join(faults(march.scene, result))
    assert "lowest C" in found and "V_L falls" in found


@pytest.mark.slow
def test_a_thousand():
    assert main(["1000"]) == 0
