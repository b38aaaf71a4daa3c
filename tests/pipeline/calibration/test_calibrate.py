"""`perilife calibrate`, from a file to a parameter set that a run takes as it is."""

import json
from pathlib import Path

import numpy as np
import pytest

import perilife_data
from pipeline.calibration.calibrate import calibrate, free_and_held, measurements_of
from pipeline.calibration.fit import CalibrationError, Measurements
from pipeline.calibration.models import Implant, ReducedModel, constants, march, with_constants
from pipeline.cli import main
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import DomainSettings, ScrewGeometry
from pipeline.scene.screw import ScrewParameters

DATA = Path(__file__).with_name("mg-5gd-synthetic.csv")
WEEK = 7 * 86400.0
WEEKS = np.array([1, 2, 3, 4, 8]) * WEEK
PIN = ["--thread", "none", "--spacing", "250um", "--horizon", "250um"]
PIN += ["--radial-margin", "0.5mm", "--axial-margin", "0.5mm"]
ACTING = ("interface_diffusivity", "volume_loss_scale")
COARSE = dict(
    geometry=ScrewGeometry(ScrewParameters(thread="none")),
    spacing=250e-6,
    horizon=250e-6,
    domain=DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
)


@pytest.fixture(scope="module")
def pin():
    """A coarse pin of Mg-5Gd: scene and implant."""
    scene = resolve_scene(["Mg-5Gd"], ["8w"], **COARSE)
    return scene, Implant(scene)


@pytest.fixture(scope="module")
def noiseless(pin):
    model = ReducedModel(pin[0], "Mg-5Gd", pin[1], ACTING)
    values = [constants(pin[0], "Mg-5Gd")[name] for name in ACTING]
    return Measurements(WEEKS, model(WEEKS, np.log(values))[0], np.full(5, 0.01)), values


@pytest.mark.slow
def test_noiseless_data_give_the_published_constants_back(pin, noiseless):
    scene, implant = pin
    data, values = noiseless
    found = calibrate(scene, "Mg-5Gd", data, implant=implant)
    assert [found.result.values[name] for name in ACTING] == pytest.approx(values, rel=1e-6)
    assert found.clean < 1e-4 and found.result.reached == found.result.starts
    assert found.without_effect == ("liquid_diffusivity", "saturation_concentration")
    assert "D_liq and C_sat have no effect in clean liquid" in found.sentences()[0]


def test_what_has_no_effect_stays_as_given(pin, noiseless):
    """Here a C_sat of less than the search's range."""
    scene = with_constants(pin[0], "Mg-5Gd", {"saturation_concentration": 0.5})
    free = ["volume_loss_scale", "saturation_concentration"]
    found = calibrate(scene, "Mg-5Gd", noiseless[0], free=free, implant=pin[1], starts=1)
    assert found.without_effect == ("saturation_concentration",)
    assert found.held["saturation_concentration"] == 0.5


def test_the_reduced_model_is_the_march_of_clean_liquid(pin, noiseless):
    scene, _ = pin
    assert march(scene.to_json(), "Mg-5Gd", [0.0, *WEEKS]) == pytest.approx(
        [0.0, *noiseless[0].values], abs=1e-12
    )


@pytest.mark.slow
def test_rate_classes_are_those_of_the_march():
    scene = resolve_scene(["Mg-5Gd"], ["8w"], corrosion={"classes": 2}, **COARSE)
    plain = resolve_scene(["Mg-5Gd"], ["8w"], corrosion={"classes": 0}, **COARSE)
    implant = Implant(scene)
    logs = np.log([constants(scene, "Mg-5Gd")[name] for name in ACTING])
    values = ReducedModel(scene, "Mg-5Gd", implant, ACTING)(WEEKS, logs)[0]
    assert march(scene.to_json(), "Mg-5Gd", list(WEEKS)) == pytest.approx(values, abs=1e-12)
    without = march(plain.to_json(), "Mg-5Gd", list(WEEKS))
    assert np.abs(values / without - 1).max() > 0.02  # classes are not one rate per node


def test_a_held_constant_stays_and_the_other_follows(pin, noiseless):
    scene, implant = pin
    data, _ = noiseless
    fix = {"volume_loss_scale": 0.3}
    found = calibrate(scene, "Mg-5Gd", data, fix=fix, implant=implant)
    assert found.result.names == ("interface_diffusivity",)
    assert found.scene.alloy("Mg-5Gd").corrosion.volume_loss_scale == 0.3
    assert 1e-8 < found.result.loss < 1  # a little worse than the free fit


def test_what_cannot_be_searched_is_refused(pin, noiseless):
    scene, implant = pin
    data, _ = noiseless
    with pytest.raises(CalibrationError, match="does not act on the volume loss"):
        calibrate(scene, "Mg-5Gd", data, free=["saturation_concentration"], implant=implant)
    with pytest.raises(CalibrationError, match="'speed' is not known"):
        free_and_held(scene, "Mg-5Gd", ["speed"], {})
    with pytest.raises(CalibrationError, match="both free and fixed"):
        free_and_held(scene, "Mg-5Gd", ["volume_loss_scale"], {"volume_loss_scale": 0.2})
    with pytest.raises(CalibrationError, match="no parameter is free"):
        calibrate(scene, "Mg-5Gd", data, fix=constants(scene, "Mg-5Gd"), implant=implant)


def test_measurements_at_time_zero_do_not_count(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("immersion time [w], volume loss [%]\n0, 0\n1, 3\n")
    found, digest = measurements_of(path)
    assert found.times.tolist() == [WEEK] and len(digest) == 64
    path.write_text("immersion time [w], volume loss [%]\n0, 0\n")
    with pytest.raises(CalibrationError, match="every measurement is at time 0"):
        measurements_of(path)
    path.write_text("immersion time [w], volume loss [%], standard deviation [%]\n1, 3, 0\n")
    with pytest.raises(CalibrationError, match=r"data.csv: standard deviation of measurement 1"):
        measurements_of(path)


def test_the_command_writes_a_set_that_a_run_takes(tmp_path, capsys):
    out = tmp_path / "fit"
    arguments = ["calibrate", "--alloy", "Mg-5Gd", "--volume-loss", f"Mg-5Gd={DATA}", *PIN]
    assert main([*arguments, "--profile", "volume_loss_scale", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "not identified, fixed at 0.6608 mol/m^3" in said
    assert "after   24 weeks" in said and "profile of l" in said
    assert f"--parameters {out / 'parameters.toml'}" in said.splitlines()[-1]
    found = perilife_data.load_parameter_set(out / "parameters.toml")
    fitted = found.for_alloy("Mg-5Gd")
    assert fitted.interface_diffusivity.kind == "fitted"
    assert fitted.saturation_concentration.kind == "not_identified"
    calibration = found.calibrations["Mg-5Gd"]
    assert calibration.parameters == ACTING and len(calibration.samples) == 400
    logs = np.log(calibration.samples)
    best = np.log([fitted.interface_diffusivity.si, fitted.volume_loss_scale.si])
    assert np.all(np.abs(logs.mean(axis=0) - best) < logs.std(axis=0))
    scene = resolve_scene(["Mg-5Gd"], ["8w"], parameter_set=str(out / "parameters.toml"), **COARSE)
    content = json.loads((out / "calibration.json").read_text())
    assert content["constants"]["saturation_concentration"] == "not identified"
    corrosion = scene.alloy("Mg-5Gd").corrosion
    assert corrosion.interface_diffusivity == pytest.approx(
        content["constants"]["interface_diffusivity"]["value"]
    )
    # the set's own run is the fit: residuals as stated
    losses = march(scene.to_json(), "Mg-5Gd", WEEKS.tolist())
    assert np.array(content["measured"]) - losses == pytest.approx(content["residuals"], abs=1e-8)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--fix", "volume_loss_scale"], "NAME=VALUE"),
        (["--free", "speed"], "'speed' is not known"),
        (["--wanted", "soon"], "wanted time"),
        (["--profile", "speed"], "--profile is speed"),
        (["--model", "nnpp"], "--model is 'nnpp'; it must be bi-material in a fit"),
        (["--volume-loss", f"Mg-10Gd={DATA}"], "it must be of Mg-5Gd"),
    ],
)
def test_the_command_refuses_in_one_sentence(more, words, tmp_path, capsys):
    out = tmp_path / "fit"
    arguments = ["calibrate", "--alloy", "Mg-5Gd", "--volume-loss", f"Mg-5Gd={DATA}", *PIN]
    assert main([*arguments, *more, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1 and not out.exists()


def test_no_measurements_and_a_full_folder_are_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    data = ["--volume-loss", f"Mg-5Gd={DATA}"]
    for more, words in (([], "no measurements were given"), (data, "is not empty")):
        assert main(["calibrate", "--alloy", "Mg-5Gd", *more, "--out", str(tmp_path)]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_where_the_liquid_counts_only_combinations_are_determined():
    """Mg-10Gd of Table 5.1 in its own scene: marches, two of four constants determined."""
    scene = resolve_scene(["Mg-10Gd"], ["8w"], spacing=100e-6, corrosion={"classes": 0})
    losses = np.array(march(scene.to_json(), "Mg-10Gd", WEEKS.tolist()))
    found = calibrate(scene, "Mg-10Gd", Measurements(WEEKS, losses, np.full(5, 0.01)))
    assert found.clean is None and found.result.names == ("liquid_diffusivity", "volume_loss_scale")
    product = found.unseen["saturation_concentration"]
    np.testing.assert_allclose(
        np.abs(product.components), np.array([0, 1, 1, 0]) / np.sqrt(2), atol=0.02
    )
    assert found.unseen["interface_diffusivity"].deviation > 1
    assert found.sentences()[0] == "only D_liq C_sat is determined, not D_liq and C_sat"
    assert found.result.values == pytest.approx(
        {name: constants(scene, "Mg-10Gd")[name] for name in found.result.names}, rel=1e-3
    )
