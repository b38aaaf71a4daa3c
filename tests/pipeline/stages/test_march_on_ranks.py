"""A march of a run on MPI ranks: the same numbers, refusals, and what a lost rank does."""

import json

import numpy as np
import pytest

from pipeline.api.life_cycle import LifeCycle
from pipeline.cli import main
from pipeline.scene.laws.ions import resolve_ions
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import SceneError
from pipeline.stages.march_on_ranks import MarchError, check_ranks, corrode_on_ranks
from tests.pipeline.calibration.test_calibrate import COARSE, PIN

RUN = ["--alloy", "Mg-10Gd", "--immersion", "0w", "2w", *PIN, "--spacing", "150um"]
RUN += ["--horizon", "150um", "--mesh-size", "0.8mm", "--final-strain", "0.02", "--quiet"]
RUN += ["--keep", "liquid", "far_liquid"]


def test_what_one_process_computes_is_refused_on_ranks(tmp_path, capsys):
    check_ranks(resolve_scene(["Mg-5Gd"], ["8w"], corrosion={"classes": 2}), 2)
    check_ranks(resolve_scene(["Mg-5Gd"], ["8w"], ions=resolve_ions()), 1)
    with pytest.raises(SceneError, match="with --model nnpp it must be 1"):
        check_ranks(resolve_scene(["Mg-5Gd"], ["8w"], ions=resolve_ions()), 2)
    # a march on ranks has rate classes as one in one process
    assert [LifeCycle("Mg-5Gd", "8w", ranks=n).scene.corrosion.classes for n in (1, 2)] == [3, 3]
    out = str(tmp_path / "run")
    assert main(["run", *RUN, "--ranks", "0", "--out", out]) == 2
    assert "--ranks is 0; it must be 1 to 4096" in capsys.readouterr().err
    assert main(["run", *RUN, "--ranks", "99", "--out", out]) == 2
    assert "--ranks is 99 and this process may use" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


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
