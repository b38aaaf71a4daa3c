"""The presets come from the table of the study, and a report quotes their errors."""

import re
import tomllib
from types import SimpleNamespace

import pytest

from pipeline.report import doubts
from pipeline.scene.classes import WANTED
from pipeline.scene.errors import strength_error
from pipeline.scene.resolution import (
    PRESETS_FILE,
    RESOLUTIONS,
    TENSILE_FILE,
    read_presets,
    resolution,
)
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import ScrewGeometry
from pipeline.scene.screw import ScrewParameters


def run_of(**changes):
    """As much of a run as the doubts about its discretisation look at."""
    scene = resolve_scene(["Mg-5Gd", "Mg-10Gd"], ["0w", "8w"], **changes)
    alloys = [SimpleNamespace(name=alloy.name, corrosion_numbers={}) for alloy in scene.alloys]
    return SimpleNamespace(scene=scene, scene_extras={}, records=(), alloys=alloys, geometry={})


def test_each_preset_is_surer_than_the_one_before_it():
    errors = [RESOLUTIONS[name].corrosion_error.error for name in ("quick", "standard", "fine")]
    assert errors == sorted(errors, reverse=True)
    # What the presets were chosen for.
    assert errors[0] <= 0.01 and errors[1] <= 0.007 and errors[2] <= 0.0045
    # With one rate per node the same lattices err more, where that was measured.
    for preset in RESOLUTIONS.values():
        assert preset.node_error is None or preset.node_error.error > preset.corrosion_error.error
    assert RESOLUTIONS["quick"].node_error is not None
    assert {preset.classes for preset in RESOLUTIONS.values()} == {WANTED}
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
    path = tmp_path / "presets_tensile.toml"
    path.write_text(TENSILE_FILE.read_text().replace("element = ", "shape = ", 1))
    with pytest.raises(ValueError, match="presets_tensile.toml that `perilife study tensile`"):
        read_presets(tensile=path)
    with pytest.raises(ValueError, match="quick, standard, fine"):
        resolution("medium")


@pytest.mark.parametrize("name", RESOLUTIONS)
def test_the_report_quotes_the_error_of_the_preset_used(name):
    text = doubts.error_estimate(run_of(resolution_name=name))
    known = RESOLUTIONS[name].corrosion_error
    assert f"{100 * known.of('Mg-10Gd'):.1f} % for Mg-10Gd" in text
    assert "in this very scene" in text
    most = max(map(known.of, known.time))
    assert f"{100 * most:.1f} %" in doubts.in_short(run_of(resolution_name=name), 3)


def test_the_tensile_error_falls_with_the_preset():
    after = [RESOLUTIONS[n].tensile_error.error for n in ("quick", "standard", "fine")]
    assert after == sorted(after, reverse=True) and after[-1] > 0.001
    # Fourteen tests on two cores within an hour.
    assert 14 / 2 * RESOLUTIONS["standard"].tensile_error.processor_seconds <= 3600


def test_a_preset_that_keeps_neither_its_error_nor_its_time_says_so():
    table = tomllib.loads(TENSILE_FILE.read_text(encoding="utf-8"))
    assert table["quick"]["most_seconds"] == 30
    for name in RESOLUTIONS:
        preset = table[name]
        larger = max(preset["mesh_error"], preset["force_error"])
        kept = (
            larger + preset["increment_error"] <= preset["wanted_error"]
            and preset["processor_seconds"] <= preset["most_seconds"]
        )
        assert preset["reached"] == kept


@pytest.mark.parametrize("name", RESOLUTIONS)
def test_the_report_quotes_the_tensile_error_of_the_preset_used(name):
    error = f"{100 * RESOLUTIONS[name].tensile_error.of('Mg-5Gd'):.1f} %"
    run = run_of(resolution_name=name)
    text = doubts.error_estimate(run)
    known = RESOLUTIONS[name].tensile_error
    # that of all alloys has the larger part of each; the file holds two digits
    assert 0.9 * known.error < max(map(known.of, known.alloys)) < 1.02 * known.error
    assert f"the shank is off by about {error} for Mg-5Gd (" in text
    assert f"{100 * known.of('Mg-10Gd'):.1f} % for Mg-10Gd (" in text
    assert "measured after 24 weeks on the reference screw: `perilife study tensile" in text
    most = f"{100 * max(map(known.of, known.alloys)):.1f} %"
    assert f"strength left of the shank up to {most}" in doubts.in_short(run, 3)
    other = run_of(resolution_name=name, geometry=ScrewGeometry(ScrewParameters(thread="none")))
    # errors measured on the screw are quoted for the screw only
    assert "strength left held by shank has not been measured" in doubts.error_estimate(other)
    assert most not in doubts.in_short(other, 3)


def test_each_way_of_holding_has_the_error_that_was_measured_of_it():
    run = run_of(hold=["all"])
    text = doubts.error_estimate(run)
    assert "slotted section is off by about 2.3 % for Mg-5Gd (2.0 % by mesh, 0.3 % by incr" in text
    assert "1.3 % for Mg-10Gd" in text and "65.3 % for Mg-10Gd" in text
    assert (
        "`perilife run --alloy Mg-5Gd Mg-10Gd --immersion 24w --hold faces --mesh-size 0.2mm"
        in text
    )
    assert [strength_error(run.scene, hold) for hold in run.scene.holds] == pytest.approx(
        [RESOLUTIONS["quick"].tensile_error.of("Mg-10Gd"), 0.023, 0.783]
    )
    assert "slotted section up to 2.3 %, of the layer at the end f" in doubts.in_short(run, 3)
    finer = run_of(hold=["shank", "slot"], resolution_name="standard")
    text = doubts.error_estimate(finer)
    assert "held by slot has not been measured" in text and "the shank is off by" in text
    assert "of the slotted section not measured" in doubts.in_short(finer, 3)


@pytest.mark.parametrize(
    "changes",
    [
        {"mesh_size": 0.19e-3},
        {"tensile": {"damage": "cell"}},
        {"tensile": {"mapping": "nodes"}},
        {"tensile": {"increment": 0.03}},
        {"tensile": {"bottom_grip": 0.5e-3, "top_grip": 0.5e-3}},
    ],
)
def test_other_tensile_settings_do_not_borrow_the_error_of_a_preset(changes):
    run = run_of(**changes)
    text = doubts.error_estimate(run)
    assert "has not been measured for this solid, mesh, element, increment and map" in text
    assert "strength left of" not in text.replace("strength left held", "")
    assert "of the strength not measured" in doubts.in_short(run, 3)


def test_other_settings_do_not_borrow_the_error_of_a_preset():
    for changes in (
        {"spacing": 80e-6}, {"corrosion": {"step": 3600.0}}, {"corrosion": {"classes": 2}}
    ):  # fmt: skip
        text = doubts.error_estimate(run_of(**changes))
        assert "volume loss has not been measured for this solid, lattice and time settings" in text
        assert "volume loss is off by" not in text


def test_one_rate_per_node_has_an_error_of_its_own():
    quick = RESOLUTIONS["quick"]
    for classes, known in ((0, quick.node_error), (WANTED, quick.corrosion_error)):
        text = doubts.error_estimate(run_of(corrosion={"classes": classes}))
        assert f"at most {100 * known.of('Mg-5Gd'):.1f} % for Mg-5Gd" in text


@pytest.mark.parametrize(
    ("feature", "warned"), [(0.267e-3, False), (0.266e-3, True), (0.2e-3, True)]
)
def test_another_solid_has_no_error_and_a_warning_where_a_wall_is_thin(feature, warned):
    run = run_of(geometry=ScrewGeometry(ScrewParameters(thread="none")))
    run.geometry["smallest_feature"] = feature
    text = doubts.error_estimate(run)
    assert "volume loss has not been measured for this solid" in text
    assert not re.search(r"\d %", text)
    assert ("lattice spacings; below 4" in text) == warned


def test_a_run_with_rate_classes_says_what_it_found_of_its_error_itself():
    run = run_of(geometry=ScrewGeometry(ScrewParameters(thread="none")), corrosion={"classes": 3})
    for alloy, error, applied in zip(run.alloys, (0.0032, 0.0041), (True, False), strict=True):
        omission = {"name": "liquid", "applied": applied}
        alloy.corrosion_numbers = {"sampling_error": error, "omissions": [omission]}
    text = doubts.error_estimate(run)
    assert "off by about 0.32 % for Mg-5Gd, 0.41 % for Mg-10Gd" in text
    assert "time steps and the liquid of Mg-10Gd come on top" in text
    assert "has not been measured for this solid, lattice" not in text
    short = doubts.in_short(run, 3)
    assert "about 0.4 % by its own check, which does not look at the liquid" in short
