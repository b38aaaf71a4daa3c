"""Another record of an alloy's hardening: what changes in the scene, and what is refused."""

import pytest

from pipeline.cli import build_parser
from pipeline.record.stage_hashes import corrosion_hash, map_hash, pull_hash
from pipeline.report.provenance import parameter_rows
from pipeline.scene.command.options import scene_from_options
from pipeline.scene.laws.hardening import with_hardening
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import SceneError, scene_from_json


def test_only_the_hardening_of_that_alloy_and_its_tests_change():
    plain = resolve_scene(["Mg-5Gd", "Mg-10Gd"], ["8w"])
    scene = with_hardening(plain, ["mg-5gd-crystal-plasticity"])
    before, after = plain.alloy("Mg-5Gd"), scene.alloy("Mg-5Gd")
    assert after.material.initial_yield_stress == pytest.approx(112.6e6)
    assert (after.corrosion, after.material.young_modulus) == (
        before.corrosion,
        before.material.young_modulus,
    )
    assert scene.alloy("Mg-10Gd") == plain.alloy("Mg-10Gd")
    assert scene_from_json(scene.to_json()) == scene
    moment, hold = scene.immersion[0], scene.holds[0]
    assert corrosion_hash(scene, "Mg-5Gd") == corrosion_hash(plain, "Mg-5Gd")
    test = ("Mg-5Gd", moment, hold)
    assert map_hash(scene, *test) == map_hash(plain, *test)
    assert pull_hash(scene, *test) != pull_hash(plain, *test)
    # the report names the record's source, and the hardening is still derived from three numbers
    rows = [r for r in parameter_rows(scene) if r.alloy == "Mg-5Gd" and r.section == "Mechanics"]
    kinds = {row.name: (row.kind, row.source) for row in rows}
    assert ("fitted", "guru2026") in kinds.values() and ("derived", "") in kinds.values()


def test_what_no_alloy_can_take_is_refused():
    scene = resolve_scene(["Mg-5Gd"], ["8w"])
    with pytest.raises(SceneError, match="is of Mg-10Gd; it must be of Mg-5Gd"):
        with_hardening(scene, ["mg-10gd-soft"])
    with pytest.raises(SceneError, match="must have one only"):
        with_hardening(scene, ["mg-5gd-soft", "mg-5gd-strong"])
    with pytest.raises(ValueError, match="hardening 'mg-5gd-weak' is unknown"):
        with_hardening(scene, ["mg-5gd-weak"])


def test_the_option_reaches_the_scene():
    arguments = ["plan", "--alloy", "Mg-5Gd", "--immersion", "8w", "--hardening", "mg-5gd-soft"]
    scene = scene_from_options(build_parser().parse_args(arguments))
    assert scene.alloys[0].hardening == "mg-5gd-soft"
    assert scene.alloys[0].material.initial_yield_stress == pytest.approx(91e6)
