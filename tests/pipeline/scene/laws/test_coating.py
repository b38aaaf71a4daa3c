"""A coating from the command line to the march, the reduced model and the report."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.models import Implant, ReducedModel, constants, march
from pipeline.cli import build_parser, main
from pipeline.record.stage_hashes import corrosion_hash
from pipeline.report.provenance import parameter_rows, settings
from pipeline.scene.command.options import scene_from_options
from pipeline.scene.laws.coating import CoatingScene, read_coating
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import scene_from_json
from tests.pipeline.calibration.test_calibrate import ACTING, COARSE, WEEK, WEEKS

COATING = CoatingScene(0.1, 4 * WEEK)


def test_it_is_read_with_and_without_its_name():
    assert read_coating("factor=0.1,lifetime=28d") == COATING
    assert read_coating("coating:lifetime=4w, factor=0.1") == COATING


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("factor=0.1", "write factor=X,lifetime=T"),
        ("factor=0.1,lifetime=28d,factor=0.2", "write factor=X,lifetime=T"),
        ("factor=thin,lifetime=28d", "write factor=X,lifetime=T"),
        ("factor=1.1,lifetime=28d", "coating factor is 1.1; it must be from 0 to 1"),
        ("factor=0.1,lifetime=0d", "coating lifetime is 0.0"),
        ("factor=0.1,lifetime=28", "coating lifetime '28' is not understood"),
    ],
)
def test_another_form_is_refused_in_one_sentence(text, words, capsys):
    plan = ["plan", "--alloy", "Mg-5Gd", "--immersion", "8w", "--coating", text]
    assert main(plan) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1


def test_it_is_refused_with_ions(capsys):
    plan = ["plan", "--alloy", "Mg-5Gd", "--immersion", "8w", "--model", "nnpp"]
    assert main([*plan, "--coating", "factor=0.1,lifetime=28d"]) == 2
    assert "left out where --model is nnpp" in capsys.readouterr().err


def test_it_is_part_of_the_scene_and_assumed_in_the_report():
    arguments = ["plan", "--alloy", "Mg-5Gd", "--immersion", "8w"]
    arguments += ["--coating", "factor=0.1,lifetime=28d"]
    scene = scene_from_options(build_parser().parse_args(arguments))
    assert scene.corrosion.coating == COATING and scene_from_json(scene.to_json()) == scene
    bare = replace(scene, corrosion=replace(scene.corrosion, coating=None))
    assert corrosion_hash(scene, "Mg-5Gd") != corrosion_hash(bare, "Mg-5Gd")
    assert scene_from_json(bare.to_json()) == bare
    row = next(row for row in parameter_rows(scene) if row.name == "Coating")
    assert (row.kind, row.value) == ("assumed", "0.1 of the rate for 28 days")
    assert ("Coating", row.value) in settings(scene)["Corrosion solver"]
    assert not any(name == "Coating" for name, _ in settings(bare)["Corrosion solver"])


def test_the_reduced_model_is_the_march_under_it_too():
    scene = resolve_scene(["Mg-5Gd"], ["8w"], corrosion={"coating": COATING}, **COARSE)
    implant = Implant(scene)
    logs = np.log([constants(scene, "Mg-5Gd")[name] for name in ACTING])
    model = ReducedModel(scene, "Mg-5Gd", implant, ACTING)
    values, slopes = model(WEEKS, logs)
    assert values == pytest.approx(march(scene.to_json(), "Mg-5Gd", list(WEEKS)), abs=1e-12)
    bare = ReducedModel(resolve_scene(["Mg-5Gd"], ["8w"], **COARSE), "Mg-5Gd", implant, ACTING)
    # eight weeks, four of them at a tenth, are 4.4 weeks bare
    assert values[-1] == pytest.approx(bare(np.array([4.4 * WEEK]), logs)[0][0], rel=1e-12)
    for n in range(2):  # its derivatives by differences
        step = 1e-4 * np.eye(2)[n]
        difference = (model(WEEKS, logs + step)[0] - model(WEEKS, logs - step)[0]) / 2e-4
        assert slopes[:, n] == pytest.approx(difference, rel=1e-5)
