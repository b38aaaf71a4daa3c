"""A march of a run on MPI ranks: the same numbers, refusals, and what a lost rank does."""

import json

import numpy as np
import pytest

from pipeline.api.life_cycle import LifeCycle
from pipeline.cli import main
from pipeline.planning.plan import BASE_MEMORY, make_plan
from pipeline.scene.laws.feedback import FeedbackSettings
from pipeline.scene.laws.ions import resolve_ions
from pipeline.scene.resolve import resolve_scene
from pipeline.stages.corrosion import corrode_in_folder
from pipeline.stages.march_on_ranks import corrode_on_ranks
from pipeline.stages.on_ranks import MarchError
from tests.pipeline.calibration.test_calibrate import COARSE, PIN
from tests.pipeline.command_line import refused

RUN = ["--alloy", "Mg-10Gd", "--immersion", "0w", "2w", *PIN, "--spacing", "150um"]
RUN += ["--horizon", "150um", "--mesh-size", "0.8mm", "--final-strain", "0.02", "--quiet"]
RUN += ["--keep", "liquid", "far_liquid"]


def test_counts_of_ranks_that_cannot_be_are_refused(tmp_path, capsys):
    # a march on ranks has rate classes as one in one process
    assert [LifeCycle("Mg-5Gd", "8w", ranks=n).scene.corrosion.classes for n in (1, 2)] == [3, 3]
    out = str(tmp_path / "run")
    assert main(["run", *RUN, "--ranks", "0", "--out", out]) == 2
    assert "--ranks is 0; it must be 1 to 4096" in capsys.readouterr().err
    assert main(["run", *RUN, "--ranks", "99", "--out", out]) == 2
    assert "--ranks is 99 and this process may use" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_plan_says_what_each_rank_takes(capsys):
    scene = resolve_scene(["Mg-10Gd"], ["0w", "2w"], **COARSE)
    one, four = (make_plan(scene, march_ranks=n).tasks for n in (1, 4))
    (one,), (four,) = ([t for t in tasks if t.what == "Mg-10Gd"] for tasks in (one, four))
    assert "rank" not in one.size
    assert "4 ranks: " in four.size and "time on ranks is not measured" in four.size
    assert four.memory > one.memory + 3 * BASE_MEMORY  # three processes more
    plan = ["plan", "--alloy", "Mg-10Gd", "--immersion", "2w", "--ranks"]
    refused(capsys, [*plan, "0"], "--ranks is 0; it must be 1 to 4096")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The same run with its march in one process, and on two ranks."""
    place = tmp_path_factory.mktemp("ranks")
    for ranks in ("1", "2"):
        out = str(place / ranks)
        assert main(["run", *RUN, "--ranks", ranks, "--oversubscribe", "--out", out]) == 0
    return place / "1", place / "2"


@pytest.mark.slow
def test_two_ranks_give_the_same_run(folders):
    records = [
        json.loads((f / "Mg-10Gd" / "corrosion" / "corrode.stage.json").read_text())
        for f in folders
    ]
    losses = [np.array(record["numbers"]["volume_loss"]) for record in records]
    assert losses[0][-1] > 0.02 and records[0]["numbers"]["steps"] > 5
    omitted = {o["name"]: o["applied"] for o in records[0]["numbers"]["omissions"]}
    assert not omitted["liquid"] and not omitted["far_liquid"]
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-7)  # the solver's tolerance
    names = [sorted(p.name for p in (f / "Mg-10Gd" / "corrosion").iterdir()) for f in folders]
    assert names[0] == names[1] and "march.log" not in names[1]
    # on two ranks or on one, it is the same stage
    assert records[0]["inputs"] == records[1]["inputs"]


@pytest.mark.slow
def test_what_the_march_refuses_is_said_and_a_crash_too(folders, tmp_path):
    settings = {"scheme": "forward_euler", "step": 6e5, "saturation": "as_published"}
    scene = resolve_scene(
        ["Mg-10Gd"], ["2w"], corrosion={**settings, "keep": ("liquid",)}, **COARSE
    )
    place = folders[0] / "geometry"
    with pytest.raises(ValueError, match="step") as caught:
        corrode_on_ranks(scene, "Mg-10Gd", place, tmp_path, 2, lambda share, text: None)
    assert not isinstance(caught.value, MarchError)
    with pytest.raises(MarchError, match="march of Mg-10Gd on 2 ranks ended with exit status"):
        corrode_on_ranks(scene, "Mg-10Gd", tmp_path / "none", tmp_path, 2, lambda s, t: None)


ASKED = {
    "at the output times": {"minerals": []},
    "in the march": {"feedback": FeedbackSettings(ph_order=0.1)},
    "of an exchanged bath": {"bath_volume": 2e-5, "exchange_every": 5 * 86400.0},
}
"""Liquid that is computed when it is asked for, and that is marched."""


@pytest.mark.slow
@pytest.mark.parametrize("how", ASKED)
def test_ions_on_two_ranks_are_those_of_one_process(how, folders, tmp_path):
    scene = resolve_scene(["Mg-10Gd"], ["0w", "2w"], ions=resolve_ions(**ASKED[how]), **COARSE)
    given = (scene, "Mg-10Gd", folders[0] / "geometry")
    places = tmp_path / "one", tmp_path / "two"
    for place in places:
        place.mkdir()
    one = corrode_in_folder(*given, places[0])[1]
    two = corrode_on_ranks(*given, places[1], 2, lambda share, text: None)[1]
    assert one["ions"]["followed"] == (how != "at the output times")
    assert one["volume_loss"][-1] > 0.02 and one["steps"] == two["steps"]
    np.testing.assert_allclose(two["volume_loss"], one["volume_loss"], rtol=1e-7)
    rows = [numbers["ions"]["rows"][-1] for numbers in (one, two)]
    for name in ("highest_ph", "ph_beside_metal", "hydrogen_mol", "largest_potential"):
        assert rows[1][name] == pytest.approx(rows[0][name], rel=1e-6)  # fields in single precision
    assert rows[1]["beside_metal"] == pytest.approx(rows[0]["beside_metal"], rel=1e-6)
    assert rows[1]["minerals"].keys() == rows[0]["minerals"].keys()
    assert rows[1]["balance"] < 1e-10 and rows[1]["net_charge"] < 1e-12
    assert sorted(p.name for p in places[0].iterdir()) == sorted(
        p.name for p in places[1].iterdir()
    )
    assert [o["name"] for o in one["omissions"]] == [o["name"] for o in two["omissions"]]
