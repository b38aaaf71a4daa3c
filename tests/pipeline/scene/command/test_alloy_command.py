"""An alloy's own file in a scene: constants of its own, none at all, and the file to fill in."""

import re
from dataclasses import asdict

import pytest

import perilife_data
from perilife_data.template import alloy_template
from pipeline.cli import main
from pipeline.life_cycle import StagedRun
from pipeline.planning.opening import open_run
from pipeline.report.provenance import parameter_rows
from pipeline.scene.resolve import NO_PARAMETERS, OWN_PARAMETERS, resolve_scene
from pipeline.scene.scene import (
    CorrosionParameters,
    DomainSettings,
    SceneError,
    ScrewGeometry,
    scene_from_json,
)
from pipeline.scene.screw import ScrewParameters
from tests.data.test_own_alloy import filled_in
from tests.pipeline.command_line import PIN, refused


@pytest.fixture()
def own(tmp_path):
    """The file of an alloy with constants of its own."""
    path = tmp_path / "zx10.toml"
    path.write_text(filled_in(alloy_template("ZX10"), corrosion=True))
    return str(path)


def test_constants_of_the_alloys_own_file_are_taken(own):
    scene = resolve_scene([own], ["8w"])
    (alloy,) = scene.alloys
    assert scene.parameter_set == OWN_PARAMETERS
    solid = perilife_data.load_alloy(own).solid_concentration.si
    found = asdict(alloy.corrosion)
    assert found.pop("calibration") == "closed"
    wanted = [solid, 0.7, 9e-9, 3e-15, 0.2, 1e-4, 2e-4]
    assert list(found.values()) == pytest.approx(wanted, rel=1e-12)
    assert scene_from_json(scene.to_json()) == scene
    rows = {row.name: row for row in parameter_rows(scene) if row.section == "Corrosion"}
    assert rows["Interface diffusivity"].source == "hermann2024"
    assert rows["Interface diffusivity"].where == "Table 5.1, D_int, of Mg-5Gd"
    both = resolve_scene([own, "Mg-5Gd"], ["8w"])
    assert both.parameter_set == "table-5.1"
    assert both.alloys[1].corrosion.interface_diffusivity == 2.8779e-15
    kinds = {row.alloy: row.where for row in parameter_rows(both) if row.symbol == "D_int"}
    assert kinds == {"ZX10": "Table 5.1, D_int, of Mg-5Gd", "Mg-5Gd": "Table 5.1, D_int"}


def test_a_set_that_is_named_goes_before_the_file(own):
    with pytest.raises(ValueError, match="set 'table-5.1' has no alloy 'ZX10'"):
        resolve_scene([own], ["8w"], parameter_set="table-5.1")


def test_fits_with_other_boundaries_are_not_mixed(own):
    text = open(own).read()
    closed = text.replace('boundary = "refreshed"', 'boundary = "no_flux"')
    open(own, "w").write(closed)
    assert resolve_scene([own], ["8w"]).domain.boundary == "no_flux"
    with pytest.raises(SceneError, match="boundary is no_flux and refreshed in the fits"):
        resolve_scene([own, "Mg-5Gd"], ["8w"])
    chosen = resolve_scene([own, "Mg-5Gd"], ["8w"], domain=DomainSettings())
    assert chosen.domain.boundary == "refreshed"


def test_without_constants_an_alloy_is_pulled_and_not_corroded(tmp_path):
    with pytest.raises(SceneError, match="alloy WE43 has no corrosion constants.*pulled.*8w"):
        resolve_scene(["Mg-5Gd", "WE43"], ["0w", "8w"])
    scene = resolve_scene(
        ["WE43"],
        ["0w"],
        geometry=ScrewGeometry(ScrewParameters(thread="none")),
        spacing=250e-6,
        horizon=250e-6,
        domain=DomainSettings(radial_margin=0.5e-3, axial_margin=0.5e-3),
        mesh_size=0.6e-3,
    )
    assert scene.parameter_set == NO_PARAMETERS and not scene.alloys[0].corrosion.known
    assert scene_from_json(scene.to_json()) == scene
    assert [row for row in parameter_rows(scene) if row.section == "Corrosion"] == []
    with open_run(scene, tmp_path / "run", False) as (folder, solid):
        cycle = StagedRun(scene, folder, solid=solid)
        cycle.geometry()
        corroded = cycle.corrode("WE43").numbers
        mapped = cycle.map("WE43", scene.immersion[0], scene.holds[0]).numbers
    assert corroded["volume_loss"] == [0.0] and "interface_diffusivity" not in corroded
    assert mapped["maximum_corrosion_damage"] == 0.0


def test_some_constants_are_no_constants():
    with pytest.raises(SceneError, match="liquid diffusivity is not given; it must be given, or"):
        CorrosionParameters(7e4, 0.7, None, 3e-15, 0.2)


def test_the_command_writes_a_file_to_fill_in(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["alloy", "new", "ZX00"]) == 0
    said = capsys.readouterr().out
    assert "zx00.toml" in said and "young_modulus" in said and "[corrosion]" in said
    run = ["run", *PIN, "--immersion", "0w", "--out", "run", "--alloy"]
    refused(capsys, [*run, "zx00.toml"], "mass_fractions.Zn", "FILL IN")
    refused(capsys, ["alloy", "new", "ZX00"], "zx00.toml", "there already")
    refused(capsys, ["alloy", "new", "WE43"], "shipped", "--like WE43")
    refused(capsys, ["alloy", "new", "x", "--out", "x.json"], "ends in .toml")
    refused(capsys, ["alloy", "new", "x", "--out", "no/x.toml"], "whose folder")
    refused(capsys, ["alloy", "old", "x"], "alloy new NAME")
    assert main(["alloy", "new", "mine", "--like", "WE43", "--out", "m.toml"]) == 0
    capsys.readouterr()
    refused(capsys, ["run", *PIN, "--immersion", "8w", "--out", "run", "--alloy", "m.toml"],
            "alloy mine has no corrosion constants")  # fmt: skip
    assert not (tmp_path / "run").exists()


def test_measured_losses_become_constants_begun_from_those_of_the_file(own, tmp_path, capsys):
    (tmp_path / "loss.csv").write_text("immersion time [w],volume loss [%]\n1,4\n2,6\n4,9\n")
    coarse = ["--spacing", "250um", "--horizon", "250um", "--radial-margin", "0.5mm"]
    coarse += ["--axial-margin", "0.5mm", "--free", "interface_diffusivity"]
    loss = f"ZX10={tmp_path / 'loss.csv'}"
    fit = tmp_path / "fit"
    arguments = ["calibrate", "--alloy", own, "--volume-loss", loss, *PIN, *coarse]
    assert main([*arguments, "--out", str(fit), "--quiet"]) == 0
    said = capsys.readouterr().out
    # chi-square of two degrees of freedom: 0.1026 and 5.991 (tables), sqrt(2/5.991), sqrt(2/0.1026)
    assert "(the true one is 0.58 to 4.4 times that, 5 to 95 %)" in said
    at_12w = re.search(r"volume loss at 12w: (\S+) %, later than the last measurement \(4 w", said)
    assert 9 < float(at_12w[1]) < 40  # above the loss of four weeks
    (path,) = fit.glob("*.toml")
    fitted = perilife_data.load_parameter_set(path).for_alloy("ZX10")
    assert fitted.interface_diffusivity.kind == "fitted"
    assert fitted.volume_loss_scale.si == 0.2
    scene = resolve_scene([own], ["8w"], parameter_set=str(path))
    found = scene.alloys[0].corrosion.interface_diffusivity
    assert found == fitted.interface_diffusivity.si != 3e-15
