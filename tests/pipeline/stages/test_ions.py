"""The scene's ions, the joined corrosion stage, its files and numbers, and the report's section."""

import argparse
import dataclasses
import json
import re

import h5py
import pytest

from peri.corrosion.kinetics import VolumeLossLaw
from peri.corrosion.run import corrode
from peri.corrosion.scene import CorrosionScene
from peri.engine.lattice import box_lattice, cylinder
from peri.engine.march.marching import TimeStepping
from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import AlloyResult
from pipeline.report.ions import ion_section
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.laws.ions import IonSettings, resolve_ions
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import DomainSettings, SceneError, scene_from_json
from pipeline.stages.ions import corrode_with_ions, ion_numbers, medium_of, write

WEEK = 604800.0


def pin(flux: float) -> CorrosionScene:
    h = 0.1e-3
    lattice = box_lattice([-0.8e-3] * 2 + [-1e-3], [0.8e-3] * 2 + [1e-3], h)
    return CorrosionScene(
        lattice,
        2 * h,
        cylinder(lattice, (0, 0, 0), 0.3e-3, 0.8e-3),
        cylinder(lattice, (0, 0, 0), 0.8e-3, 2e-3),
        solid_concentration=66082.4,
        saturation_concentration=0.66,
        liquid_diffusivity=8.7e-9,
        dissolution_flux=flux,
        kinetics=VolumeLossLaw(0.2355),
    )


def joined(ions: IonSettings, flux: float, times=(0.0, WEEK), **options):
    how = {"tolerance": 1e-3, "refused": (), **options}
    stepping = TimeStepping("sdirk2", step=0.5 * WEEK)
    return corrode_with_ions(pin(flux), ions, list(times), stepping, **how)


# --- the scene ----------------------------------------------------------------------------


def test_a_scene_with_ions_survives_its_file() -> None:
    scene = resolve_scene(["Mg-5Gd"], ["0w", "1w"], ions=resolve_ions())
    content = json.loads(json.dumps(scene.to_json()))
    assert scene_from_json(content) == scene
    assert scene.ions.minerals == ("brucite", "calcite", "hydroxyapatite")
    assert scene.ions.temperature == pytest.approx(310.15)
    without = resolve_scene(["Mg-5Gd"], ["0w", "1w"])
    assert "ions" not in without.to_json()
    assert without.hash() != scene.hash()


def test_assumed_values_of_minerals_that_cannot_form_are_not_listed() -> None:
    names = resolve_ions(minerals=["calcite"]).assumed
    assert any("minerals.calcite" in n for n in names)
    assert not any("minerals.hydroxyapatite" in n for n in names)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"medium": "rat-tibia"}, "medium is 'rat-tibia', whose ions are not listed; those with"),
        ({"minerals": ["halite"]}, "mineral 'halite' is not in the set 'sbf'; it holds brucite"),
        ({"minerals": ["bobierrite"]}, "log_k of bobierrite is not known at 37 degC"),
        ({"balance": "CO2"}, "balance is 'CO2'; it must be an ion of the set, one of H, CO3"),
        ({"closure": "neutral"}, "closure is 'neutral'; it must be one of electroneutral"),
        ({"activity": "davies"}, "activity is 'davies'; it must be one of fixed, wateq, ideal"),
        ({"closure": "as_published"}, "as_published know no mineral in equilibrium, such as bruc"),
        ({"flux_form": "as_published"}, "--minerals without it leaves it out"),
        ({"medium": "seawater"}, "medium 'seawater' is unknown"),
    ],
)
def test_ions_that_cannot_be_resolved_are_refused(arguments: dict, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        resolve_ions(**arguments)


def test_a_medium_that_is_not_neutral_names_the_ion_that_would_balance_it() -> None:
    ions = resolve_ions("sodium-chloride-142")
    salty = dataclasses.replace(ions, totals={"Na": 142.0, "Cl": 140.0})
    with pytest.raises(ValueError, match=r"carries \+2 mol/m\^3 of charge .* --balance Cl"):
        medium_of(salty)
    assert medium_of(resolve_ions("sodium-chloride-142", balance="Cl")).ph[0] == pytest.approx(
        6.811, abs=1e-3
    )


def test_a_strong_medium_is_refused_with_davies_and_allowed_as_ideal() -> None:
    ions = dataclasses.replace(
        resolve_ions("sodium-chloride-142"), totals={"Na": 1500.0, "Cl": 1500.0}
    )
    assert medium_of(ions).ph[0] == pytest.approx(6.81, abs=0.01)  # `nacl` is ideal by itself
    with pytest.raises(ValueError, match="ionic strength of 1.5 mol/L.*use 'ideal'"):
        medium_of(dataclasses.replace(ions, activity="fixed"))


def test_closed_vessels_with_a_bath_and_faradaic_bonds_are_refused() -> None:
    closed = DomainSettings(boundary="no_flux")
    for options, why in (
        ({"bath_volume": 1e-6}, "and the medium is a bath, which is beyond it"),
        ({"closure": "poisson"}, "with closure poisson"),
    ):
        with pytest.raises(SceneError, match=f"refreshed where the model is nnpp {why}"):
            resolve_scene(["Mg-5Gd"], ["1w"], ions=resolve_ions(**options), domain=closed)
    with pytest.raises(SceneError, match="saturation is 'complementarity'; it must be none where"):
        resolve_scene(["Mg-5Gd"], ["1w"], ions=resolve_ions(), domain=closed)
    scene = resolve_scene(
        ["Mg-5Gd"], ["1w"], ions=resolve_ions(), domain=closed, corrosion={"saturation": "none"}
    )
    assert scene.domain.boundary == "no_flux"
    with pytest.raises(SceneError, match="proportional where the model is nnpp"):
        resolve_scene(
            ["Mg-5Gd"], ["1w"], ions=resolve_ions(), corrosion={"dissolution": "faradaic"}
        )


# --- the stage ----------------------------------------------------------------------------


def test_without_minerals_the_metal_is_marched_as_ever_and_ph_is_there(tmp_path) -> None:
    ions = resolve_ions(closure="none", minerals=[])
    result, omissions, outputs, problem = joined(ions, 1e-6)
    alone = corrode(pin(1e-6), [0.0, WEEK], TimeStepping("sdirk2", step=0.5 * WEEK))
    # The lean march leaves the liquid out; its bound is 1e-5 of V_L.
    assert result.volume_loss == pytest.approx(alone.volume_loss, rel=1e-2)
    names = {o.name for o in omissions if o.applied}
    assert {"minerals", "the potential", "the liquid's own content"} <= names
    assert not problem.follows_minerals
    files, numbers = _write(tmp_path, ions, result, outputs, problem)
    first, last = numbers["rows"]
    assert first["ph_beside_metal"] > last["ph_beside_metal"] > numbers["ph"] + 0.005
    assert last["profile_ph"][0] > last["profile_ph"][-1] == pytest.approx(numbers["ph"], abs=1e-6)
    assert last["balance"] < 1e-9 and last["net_charge"] < 1e-12 and last["lowest"] >= 0
    assert last["hydrogen_mol"] > 0
    json.dumps(numbers, allow_nan=False)
    with h5py.File(files[0]) as file:
        assert file["ph"].shape == (2, 16, 16, 20)
        assert file["species"].attrs["dimensions"] == "time, species, x, y, z"
        assert file["species"].attrs["unit"] == "mol/m3"
        assert file["species"].shape[1] == len(file["species_names"]) == 24
    assert (tmp_path / "ions_001.vti").is_file()
    assert "ions_001.vti" in files[1].read_text()


def test_minerals_are_followed_where_one_can_form(tmp_path) -> None:
    ions = resolve_ions("sodium-chloride-142", closure="none")
    result, _, outputs, problem = joined(ions, 2e-5, times=(0.0, 0.05 * WEEK, WEEK))
    alone = corrode(pin(2e-5), result.times, TimeStepping("sdirk2", step=0.5 * WEEK))
    assert problem.follows_minerals
    assert result.volume_loss == pytest.approx(alone.volume_loss, rel=1e-9)
    _, numbers = _write(tmp_path, ions, result, outputs, problem)
    amounts = [row["minerals"]["brucite"]["amount_mol"] for row in numbers["rows"]]
    assert amounts[0] == 0.0 and amounts[1] > 0
    index = numbers["rows"][1]["minerals"]["brucite"]["highest_index"]
    assert index == pytest.approx(0.0, abs=1e-6)


def _write(folder, ions, result, outputs, problem):
    files, numbers = write(folder, result, outputs, problem, ions, 2e-6)
    assert numbers == ion_numbers(result, outputs, problem, ions, 2e-6)
    return files, numbers


def test_the_report_shows_ph_minerals_and_the_published_features(tmp_path) -> None:
    ions = resolve_ions(closure="none", minerals=["brucite"])
    result, _, outputs, problem = joined(ions, 1e-6)
    corrosion = RunFolder(tmp_path).corrosion("Mg-5Gd")
    corrosion.mkdir(parents=True)
    _, numbers = _write(corrosion, ions, result, outputs, problem)

    class Run:
        folder = tmp_path
        alloys = (AlloyResult("Mg-5Gd", {}, (), {"ions": numbers}),)

    section = ion_section(Run)
    (alloy,) = section["alloys"]
    assert section["ph"] == "7.572" and section["species"] == ["Mg", "H", "HCO3", "HPO4", "Ca"]
    assert len(alloy["rows"]) == 2 and "<svg" in alloy["plot"]
    assert all(f">{n}, " in alloy["maps"] for n in ("Mg", "H", "HCO3", "HPO4"))
    assert not alloy["reads"] and not alloy["potential"]
    (corrosion / "ions.h5").unlink()
    assert ion_section(Run)["alloys"][0]["maps"] == ""
    assert alloy["rows"][0]["minerals"] == "none"
    assert alloy["features"][0].startswith("pH rises towards the metal (Fig. 5.9): found, by +0.")
    assert "hydrogen ions are depleted beside the metal (Fig. 5.10): found" in alloy["features"][1]
    # Hydrogen phosphate pairs with magnesium instead of piling up.
    assert "hydrogen phosphate accumulates" in alloy["features"][3]

    class Bare:
        alloys = (AlloyResult("Mg-5Gd", {}, ()),)

    assert ion_section(Bare) == {}


def test_the_command_line_builds_the_scene_and_refuses_ions_without_the_model() -> None:
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    base = ["--alloy", "Mg-5Gd", "--immersion", "1w"]
    scene = scene_from_options(
        parser.parse_args([*base, "--model", "nnpp", "--medium", "sodium-chloride-142"])
    )
    assert scene.ions is not None and scene.ions.activity == "ideal"
    assert scene_from_options(parser.parse_args(base)).ions is None
    with pytest.raises(ValueError, match="--closure goes with --model nnpp"):
        scene_from_options(parser.parse_args([*base, "--closure", "none"]))
