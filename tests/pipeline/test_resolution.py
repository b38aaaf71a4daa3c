"""The presets come from the table of the study, and a report quotes their errors."""

from types import SimpleNamespace

import pytest

from pipeline import doubts
from pipeline.resolution import PRESETS_FILE, RESOLUTIONS, read_presets, resolution
from pipeline.resolve import resolve_scene
from pipeline.scene import ScrewGeometry
from pipeline.screw import ScrewParameters


def run_of(**changes):
    """As much of a run as the doubts about its discretisation look at."""
    scene = resolve_scene(["Mg-5Gd", "Mg-10Gd"], ["0w", "8w"], **changes)
    return SimpleNamespace(scene=scene, scene_extras={}, records=(), alloys=scene.alloys)


def test_each_preset_is_surer_than_the_one_before_it():
    errors = [RESOLUTIONS[name].corrosion_error.error for name in ("quick", "standard", "fine")]
    assert errors == sorted(errors, reverse=True)
    # What the presets were chosen for; fine takes the best that was measured.
    assert errors[0] <= 0.10 and errors[1] <= 0.03
    spacings = [RESOLUTIONS[name].spacing for name in ("quick", "standard", "fine")]
    assert spacings == sorted(spacings, reverse=True)
    assert {r.horizon for r in RESOLUTIONS.values()} == {200e-6}


def test_the_error_of_a_preset_is_the_larger_one_of_its_alloys():
    for preset in RESOLUTIONS.values():
        known = preset.corrosion_error
        # The file holds two digits of each number: 5 % of rounding.
        assert max(map(known.of, known.time)) == pytest.approx(known.error, rel=0.05)
        assert known.of("an alloy of one's own") == known.error
        assert known.half_error_cost > 1


def test_a_file_that_is_no_table_of_presets_is_refused(tmp_path):
    path = tmp_path / "presets.toml"
    path.write_text(PRESETS_FILE.read_text().replace("[fine]", "[coarse]", 1))
    with pytest.raises(ValueError, match="presets.toml"):
        read_presets(path)
    path.write_text("quick = [")
    with pytest.raises(ValueError, match="presets.toml"):
        read_presets(path)
    with pytest.raises(ValueError, match="quick, standard, fine"):
        resolution("medium")


@pytest.mark.parametrize("name", RESOLUTIONS)
def test_the_report_quotes_the_error_of_the_preset_used(name):
    text = doubts.error_estimate(run_of(resolution_name=name))
    known = RESOLUTIONS[name].corrosion_error
    assert f"{100 * known.of('Mg-10Gd'):.1f} % for Mg-10Gd" in text
    assert "in this very scene" in text
    assert f"{100 * known.error:.1f} %" in doubts.in_short(run_of(resolution_name=name), 3)


def test_other_settings_do_not_borrow_the_error_of_a_preset():
    for changes in ({"spacing": 80e-6}, {"corrosion": {"step": 3600.0}}):
        text = doubts.error_estimate(run_of(**changes))
        assert "has not been measured for these lattice and time settings" in text
        assert "%" not in text


def test_another_solid_is_told_where_the_error_was_measured():
    other = ScrewGeometry(ScrewParameters(thread="none"))
    text = doubts.error_estimate(run_of(geometry=other))
    assert "on the reference screw with Table 5.1, not here" in text
