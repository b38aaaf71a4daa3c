"""Laws of the rate by name: what the alloy gives, and what is refused."""

import pytest

from pipeline.run import scene_of
from pipeline.scene.resolve import rate_law
from tests.pipeline.scene.command.test_scene_file import asked


def of_law(law):
    return scene_of(
        asked("--alloy", "Mg-5Gd", "--immersion", "1d", "--out", "x", "--kinetics", law)
    )


@pytest.mark.parametrize("given", ["", ",saturation_concentration=0.6608"])
def test_saturation_is_the_alloys(given):
    scene = of_law("repassivation:critical_concentration=0.3" + given)
    law = rate_law(scene, "Mg-5Gd")
    held = scene.alloy("Mg-5Gd").corrosion.saturation_concentration
    assert law.saturation_concentration == pytest.approx(held, rel=1e-12)
    assert law.width == pytest.approx(0.02 * held)


@pytest.mark.parametrize(
    "law",
    [
        "acidity:",
        "repassivation:critical_concentration=0.3,",
        "rupture:critical_concentration=0.3,",
    ],
)
def test_another_saturation_is_refused(law):
    with pytest.raises(ValueError, match="must be left out or be that of Mg-5Gd, 0.6608 mol/m"):
        of_law(law + "saturation_concentration=0.5")
