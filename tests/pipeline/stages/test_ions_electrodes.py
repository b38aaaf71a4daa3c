"""Electrodes and inhibitors as a scene says them: typed, kept, marched, refused."""

import dataclasses
import json
from pathlib import Path

import pytest

import perilife_data
from peri.corrosion.electrode_kinetics import ElectrodeKinetics
from peri.corrosion.inhibition import Inhibited
from peri.engine.march.marching import TimeStepping
from pipeline.scene.laws.ions import resolve_ions
from pipeline.scene.scene import scene_from_json
from pipeline.stages.ions import corrode_with_ions, ion_numbers, problem_of
from tests.pipeline.stages.test_ions import WEEK, pin
from tests.pipeline.stages.test_ions_in_baths import KNOWN, typed

DATA = Path(perilife_data.__file__).parent
FREE = "anodic=1e-3,cathodic=1e-2,potential=-2.0,hydrogen_potential=-0.9"
INHIBITOR = """
[inhibitor]
component = "Cl"
adsorption_constant = { value = 10, unit = "L/mol", KNOWN }
efficiency = { value = 90, unit = "%", KNOWN }
""".replace("KNOWN", KNOWN)


def test_electrodes_are_typed_and_survive_their_file() -> None:
    scene = typed("--electrodes", f"balance=mixed,{FREE},ph_order=0.3")
    assert scene_from_json(json.loads(json.dumps(scene.to_json()))) == scene
    law = problem_of(pin(1e-6), dataclasses.replace(scene.ions)).scene.kinetics
    assert isinstance(law, ElectrodeKinetics) and law.balance == "mixed"
    # What is left out is the medium's.
    assert law.ph_reference == pytest.approx(7.5724, abs=1e-3)
    assert law.temperature == pytest.approx(310.15)
    assert typed("--electrodes", FREE).ions.electrodes.balance == "local"


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--electrodes", "balance=mixed"], "electrodes is 'balance=mixed'; write balance=local"),
        (["--electrodes", f"{FREE},anode=1"], "NAME=NUMBER,... with numbers out of anodic, cath"),
        (["--electrodes", f"balance=all,{FREE}"], "electrodes: balance: 'all'; it must be one of"),
        (["--electrodes", f"balance=applied,{FREE}"], "electrodes: balance: 'applied' with 0 of"),
        (["--electrodes", FREE, "--kinetics", "constant"], "takes the place of --kinetics"),
        (["--electrodes", FREE, "--feedback", "ph_order=1"], "factors of the feedback do not"),
        (
            ["--electrodes", f"balance=mixed,{FREE}", "--closure", "none"],
            "closure is 'none' with electrodes of balance mixed",
        ),
        (
            ["--electrodes", f"balance=applied,applied_potential=-1.5,{FREE}"]
            + ["--bath-volume", "1mL"],
            "balance applied go without a bath of finite volume",
        ),
        (
            ["--electrodes", f"balance=applied,applied_potential=-1.5,{FREE}"]
            + ["--boundary", "no_flux"],
            "refreshed where the model is nnpp and a current is applied, which leaves through it",
        ),
        (["--feedback", "inhibitor=yes"], "inhibitor is yes, but the reaction set 'sbf' has none"),
        (["--feedback", "inhibitor=1"], "feedback: inhibitor is '1'; it must be yes or no"),
    ],
)
def test_electrodes_that_cannot_be_are_refused(more: list[str], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        typed(*more)


def test_an_applied_current_is_told_beside_hydrogen_and_magnesium() -> None:
    electrodes = typed("--electrodes", f"balance=applied,applied_potential=-1.55,{FREE}")
    ions = dataclasses.replace(electrodes.ions, feedback=None)
    done = corrode_with_ions(
        pin(1e-6), ions, [0.0, 0.1 * WEEK], TimeStepping("sdirk2", step=0.1 * WEEK),
        tolerance=1e-3, refused=(),
    )  # fmt: skip
    result, _, outputs, problem = done
    numbers = ion_numbers(result, outputs, problem, ions, area=1.5e-6)
    first, last = numbers["rows"]
    assert numbers["electrodes"] == "the metal held at -1.55 V against the medium"
    assert first["applied_charge"] == 0.0 < last["applied_charge"]
    assert last["metal_potential"] == -1.55
    # Held above its free potential the metal loses more than by the law of the scene.
    assert last["volume_loss"] == result.volume_loss[-1] > 2 * last["volume_loss_alone"] > 0
    lost = result.history["metal_amount"][0] - result.history["metal_amount"][-1]
    assert last["released_mol"] == pytest.approx(lost, rel=1e-9)
    assert last["hydrogen_mol"] < 0.5 * lost and last["balance"] < 1e-9


def test_an_inhibitor_is_data(tmp_path) -> None:
    shipped = (DATA / "reactions" / "nacl.toml").read_text(encoding="utf-8")
    (tmp_path / "held.toml").write_text(shipped.replace('"nacl"', '"held"') + INHIBITOR)
    medium = (DATA / "media" / "sodium-chloride-142.toml").read_text("utf-8")
    file = tmp_path / "held-medium.toml"
    file.write_text(
        medium.replace('"nacl"', '"held.toml"').replace("sodium-chloride-142", "held-medium")
    )
    scene = typed("--medium", str(file), "--feedback", "inhibitor=yes,ph_order=0.1")
    assert scene_from_json(json.loads(json.dumps(scene.to_json()))) == scene
    assert {"held: inhibitor.adsorption_constant", "held: inhibitor.efficiency"} <= set(
        scene.ions.assumed
    )
    law = problem_of(pin(1e-6), scene.ions).scene.kinetics
    assert isinstance(law, Inhibited) and law.base.ph_order == 0.1
    assert (law.inhibitor, law.constant, law.efficiency) == ("Cl", 0.01, 0.9)
    assert "the inhibitor of the reaction set" in scene.ions.feedback.in_words()
    (tmp_path / "held.toml").write_text(
        shipped.replace('"nacl"', '"held"') + INHIBITOR.replace('"Cl"', '"Zn"')
    )
    with pytest.raises(ValueError, match="inhibitor.component is 'Zn'"):
        resolve_ions(str(file))
