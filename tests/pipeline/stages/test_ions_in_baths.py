"""Baths by options and by TOML alone: what a scene says, what the stage gives, what is refused."""

import argparse
import json
from pathlib import Path

import pytest

import perilife_data
from peri.engine.march.marching import TimeStepping
from peri.engine.omission import Omission
from peri.transport.chemistry.speciation import speciate
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.laws.feedback import FeedbackSettings
from pipeline.scene.laws.ions import resolve_ions
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import scene_from_json
from pipeline.stages.ions import corrode_with_ions, ion_numbers, medium_of, plan_ions, problem_of
from tests.pipeline.stages.test_ions import WEEK, pin

TYPED = ["--alloy", "Mg-5Gd", "--immersion", "0w", "1w", "--model", "nnpp"]

TRIS = """
[species.Tris]
charge_number = 0
composition = {{ C = 4, H = 11, N = 1, O = 3 }}
diffusivity.at_37_degC = {{ value = 0.9e-9, unit = "m^2/s", {known} }}

[species.HTris]
charge_number = 1
composition = {{ C = 4, H = 12, N = 1, O = 3 }}
diffusivity.at_37_degC = {{ value = 0.9e-9, unit = "m^2/s", {known} }}

[reactions.HTris]
stoichiometry = {{ Tris = 1, H = 1 }}
log_k.at_37_degC = {{ value = {pk}, unit = "1", {known} }}
"""
KNOWN = 'source = "hermann2024", where = "none", kind = "assumed"'


def typed(*more: str):
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    return scene_from_options(parser.parse_args([*TYPED, *more]))


def test_a_bath_is_typed_and_survives_its_file() -> None:
    scene = typed("--bath-volume", "50mL", "--exchange-every", "2d", "--open-to", "CO2")
    ions = scene.ions
    assert (ions.bath_volume, ions.exchange_every, ions.open_to) == (5e-5, 172800.0, ("CO2",))
    assert scene_from_json(json.loads(json.dumps(scene.to_json()))) == scene
    assert typed().ions.bath_volume is None
    assert typed().hash() != scene.hash()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--exchange-every", "2d"], "exchange every goes with a bath of finite volume"),
        (["--open-to", "CO2"], "open to goes with a bath of finite volume"),
        (["--feedback", "ph=1"], "feedback is 'ph=1'; write NAME=NUMBER"),
        (["--feedback", "ph_order=-1"], "feedback: ph_order is -1; it must be finite"),
        (["--feedback", "ph_reference=7"], "one of ph_order, chloride_order and layer_thickness"),
        (["--feedback", "layer_thickness=0"], "feedback: layer_thickness is 0; it must be above 0"),
        (["--bath-volume", "50"], "bath volume '50' is not understood; give a number and a unit"),
        (["--bath-volume", "0mL"], "bath volume '0mL' is 0; it must be above 0"),
        (["--bath-volume", "1L", "--open-to", "O2"], "open to is 'O2'; it must be a dissolved gas"),
    ],
)
def test_baths_that_cannot_be_are_refused(more: list[str], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        typed(*more)


@pytest.mark.slow
def test_the_stage_gives_the_ph_of_the_bath() -> None:
    ions = resolve_ions(
        minerals=[], closure="none", bath_volume=1e-6, exchange_every=0.4 * WEEK, open_to=("CO2",)
    )
    stepping = TimeStepping("sdirk2", step=0.2 * WEEK)
    result, _, outputs, problem = corrode_with_ions(
        pin(1e-6), ions, [0.0, WEEK], stepping, tolerance=1e-3, refused=()
    )
    numbers = ion_numbers(result, outputs, problem, ions, 1e-6)
    assert numbers["bath"] == "a stirred bath of 1 mL, exchanged every 2.8 days, open to CO2"
    first, last = numbers["rows"]
    assert first["bath_ph"] == pytest.approx(numbers["ph"], abs=1e-9)
    assert numbers["ph"] < last["bath_ph"] < last["ph_beside_metal"]
    assert last["balance"] < 1e-10
    assert 0.4 * WEEK in result.history["time"]


def test_a_march_that_follows_the_liquid_leaves_nothing_of_the_metals_out() -> None:
    alone = [Omission("liquid", "clean", 1e-6, True)]
    names = []
    for more in ({}, {"bath_volume": 1e-6}):
        ions = resolve_ions(minerals=[], closure="none", **more)
        names.append([o.name for o in plan_ions(pin(1e-6), ions, alone)])
    assert "liquid" in names[0] and "liquid" not in names[1]
    assert "the liquid's own content" in names[1]


def own(tmp_path, pk: float = 7.73) -> str:
    """A medium of Tris in saline, in two files of one's own."""
    folder = Path(perilife_data.__file__).parent
    reactions = (folder / "reactions" / "nacl.toml").read_text(encoding="utf-8")
    reactions = reactions.replace('components = ["H", ', 'components = ["H", "Tris", ')
    (tmp_path / "tris.toml").write_text(
        reactions.replace('name = "nacl"', 'name = "tris"') + TRIS.format(pk=pk, known=KNOWN),
        encoding="utf-8",
    )
    medium = (folder / "media" / "sodium-chloride-142.toml").read_text(encoding="utf-8")
    medium = medium.replace('reactions = "nacl"', 'reactions = "tris.toml"')
    medium = medium.replace('name = "sodium-chloride-142"', 'name = "tris-saline"')
    extra = 'source = "hermann2024"\nwhere = "none"\nkind = "assumed"\n'
    medium += (
        f'\n[bath_volume]\nvalue = 20\nunit = "mL"\n{extra}'
        f'\n[refresh_interval]\nvalue = 2\nunit = "d"\n{extra}'
    )
    for name, amount, charge in (("Tris", 25.0, 0), ("HTris", 25.0, 1)):
        medium += f'\n[species.{name}.charge_number]\nvalue = {charge}\nunit = "1"\n{extra}'
        medium += f"\n[species.{name}.total_concentration]\nvalue = {amount}\n"
        medium += f'unit = "mol/m^3"\n{extra}'
    medium = medium.replace('value = 142\nunit = "mol/m^3"', 'value = 167\nunit = "mol/m^3"', 2)
    medium = medium.replace("value = 167", "value = 142", 1)  # Na 142, Cl 142 + 25
    path = tmp_path / "tris-saline.toml"
    path.write_text(medium, encoding="utf-8")
    return str(path)


def test_another_buffer_takes_two_files_and_no_python(tmp_path) -> None:
    ions = resolve_ions(own(tmp_path))
    assert ions.bath_volume == pytest.approx(2e-5) and ions.exchange_every == 172800.0
    # Half of the buffer is HTris, so the pH is its pK (ideal activities).
    assert float(medium_of(ions).ph[0]) == pytest.approx(7.73, abs=1e-3)
    scene = resolve_scene(["Mg-5Gd"], ["0w", "1w"], ions=ions)
    assert scene_from_json(json.loads(json.dumps(scene.to_json()))) == scene
    with pytest.raises(FileNotFoundError):
        (tmp_path / "tris.toml").unlink()
        resolve_ions(str(tmp_path / "tris-saline.toml"))


def test_a_feedback_is_typed_and_a_layer_is_not_counted_twice() -> None:
    with pytest.raises(ValueError, match="the law of the volume loss already contains the layer"):
        typed("--feedback", "ph_order=0.5,layer_thickness=1e-5")
    ions = typed("--feedback", "layer_thickness=1e-5", "--kinetics", "constant").ions
    assert ions.feedback.in_words() == "minerals, half the rate at 10 um"
    asked = typed("--feedback", "ph_order=0.5,layer_thickness=1e-5,layer_twice=yes")
    assert scene_from_json(json.loads(json.dumps(asked.to_json()))) == asked
    law = problem_of(pin(1e-6), asked.ions).scene.kinetics
    assert law.ph_reference == pytest.approx(7.5724, abs=1e-3)
    assert law.chloride_reference == pytest.approx(109.9)


@pytest.mark.slow
def test_a_feedback_slows_the_metal_of_a_run() -> None:
    feedback = FeedbackSettings(ph_order=2.0)
    losses = []
    for more in ({}, {"feedback": feedback}):
        ions = resolve_ions(minerals=[], closure="none", **more)
        stepping = TimeStepping("sdirk2", step=0.2 * WEEK)
        result, *_ = corrode_with_ions(
            pin(1e-6), ions, [0.0, WEEK], stepping, tolerance=1e-3, refused=()
        )
        losses.append(result.volume_loss[-1])
    assert 0.5 * losses[0] < losses[1] < 0.98 * losses[0]


def test_the_shipped_medium_with_tris_needs_its_name_alone() -> None:
    ions = typed("--medium", "simulated-body-fluid-tris", "--minerals", "brucite").ions
    medium = medium_of(ions)
    assert medium.ph[0] == pytest.approx(7.40, abs=0.02)
    chemistry = medium.chemistry
    # 1 mol/m3 of Mg(OH)2 against 50.5 mol/m3 of Tris; in saline it raises the pH by 3.9.
    raised = medium.totals[:, 0].copy()
    raised[chemistry.components.index("Mg")] += 1.0
    after = speciate(chemistry, chemistry.neutral(raised))
    assert after.ph[0] - medium.ph[0] == pytest.approx(0.087, abs=0.002)
    assert any("diffusivity" in name and "Tris" in name for name in ions.assumed)
