"""The scene: checked once, stored as JSON without loss, hashed stage by stage."""

import argparse
import dataclasses
import json
import re

import pytest

from pipeline.record.stage_hashes import (
    STAGE_REVISION,
    corrosion_hash,
    geometry_hash,
    map_hash,
    pull_hash,
)
from pipeline.scene.command.options import add_scene_options, scene_from_options
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.laws.rate_law import KINETICS
from pipeline.scene.loads import LOADS
from pipeline.scene.mechanics import DAMAGE_UPDATES
from pipeline.scene.resolve import resolve_scene
from pipeline.scene.scene import (
    AlloyScene,
    CorrosionParameters,
    CorrosionSettings,
    DomainSettings,
    HoldScene,
    LatticeSettings,
    MaterialParameters,
    MeshSettings,
    Scene,
    SceneError,
    ScrewGeometry,
    SolidFile,
    TensileScene,
    scene_from_json,
)
from pipeline.scene.screw import ScrewParameters
from pipeline.scene.units import (
    format_bytes,
    format_seconds,
    metres,
    parse_immersion_times,
    parse_time,
)
from tests.fem.meshes import box


def _alloy(name: str = "Mg-A") -> AlloyScene:
    return AlloyScene(
        name=name,
        corrosion=CorrosionParameters(66082.4, 0.6608, 8.6822e-9, 2.8779e-15, 0.2355),
        material=MaterialParameters(43e9, 0.3, 130e6, 120e6, 10.0),
        source="a test",
    )


@pytest.fixture
def scene() -> Scene:
    return Scene(
        resolution="quick",
        parameter_set="a test",
        geometry=ScrewGeometry(),
        immersion=parse_immersion_times(["1w", "8w"]),
        alloys=(_alloy("Mg-A"), _alloy("Mg-B")),
        lattice=LatticeSettings(100e-6, 200e-6),
        domain=DomainSettings(),
        corrosion=CorrosionSettings(),
        holds=(HoldScene("shank", MeshSettings(0.3e-3, 0.2e-3), TensileScene()),),
    )


@pytest.mark.parametrize(
    "text, seconds",
    [("8w", 4838400.0), ("56d", 4838400.0), ("36h", 129600.0), ("1.5d", 129600.0), ("0w", 0.0)],
)
def test_times_are_read_with_their_unit(text, seconds):
    time = parse_time(text)
    assert (time.label, time.seconds) == (text, seconds)
    assert time.days == seconds / 86400


@pytest.mark.parametrize("text", ["8", "8 months", "w", "", "-1w", "1e999d", "nan d", "8W"])
def test_wrong_times_are_named(text):
    with pytest.raises(ValueError, match="immersion time") as refusal:
        parse_time(text)
    assert repr(text) in str(refusal.value)


def test_unsorted_and_repeated_times_are_refused():
    with pytest.raises(ValueError, match="must rise"):
        parse_immersion_times(["8w", "1w"])
    with pytest.raises(ValueError, match="the same time"):
        parse_immersion_times(["7d", "1w"])
    with pytest.raises(ValueError, match="at least one"):
        parse_immersion_times([])


def test_lengths_need_a_known_unit():
    assert metres(2.0, "mm") == 2.0e-3
    with pytest.raises(ValueError, match="unit 'furlong'.*m, cm, mm, um, nm, inch"):
        metres(1.0, "furlong", "the solid")


def test_numbers_for_readers():
    assert [format_seconds(t) for t in (0.84, 42.2, 192, 7500)] == [
        "0.8 s",
        "42 s",
        "3 min 12 s",
        "2 h 05 min",
    ]
    assert [format_bytes(n) for n in (12, 3.4e6, 1.2e9)] == ["12 B", "3.4 MB", "1.2 GB"]


@pytest.mark.parametrize("solid", [ScrewGeometry(), SolidFile("part.stl", "mm", "0" * 64)])
def test_json_round_trip_gives_an_equal_scene(scene, solid):
    scene = dataclasses.replace(scene, geometry=solid)
    restored = scene_from_json(json.loads(json.dumps(scene.to_json())))
    assert restored == scene
    assert restored.hash() == scene.hash()
    assert type(restored.geometry) is type(solid)


def test_unknown_missing_and_mistyped_fields_are_named(scene):
    content = scene.to_json()
    content["lattice"]["colour"] = "red"
    with pytest.raises(SceneError, match=r"colour.*scene\.lattice"):
        scene_from_json(content)
    content = scene.to_json()
    del content["holds"][0]["mesh"]["size"]
    with pytest.raises(SceneError, match=r"'size' of scene\.holds\[0\]\.mesh is missing"):
        scene_from_json(content)
    content = scene.to_json()
    content["lattice"]["spacing"] = "100 um"
    with pytest.raises(SceneError, match=r"scene\.lattice\.spacing is '100 um'"):
        scene_from_json(content)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: dataclasses.replace(_alloy().material, poisson_ratio=0.5), "Poisson ratio is 0.5"),
        (lambda: dataclasses.replace(_alloy().material, young_modulus=-1.0), "Young modulus is -1"),
        (
            lambda: dataclasses.replace(_alloy().corrosion, liquid_diffusivity=float("nan")),
            "liquid",
        ),
        (lambda: dataclasses.replace(_alloy().corrosion, saturation_concentration=7e4), "below"),
        (lambda: LatticeSettings(100e-6, 50e-6), "horizon is 50 um"),
        (lambda: LatticeSettings(10e-6, 200e-6), "horizon is 200 um"),
        (lambda: LatticeSettings(0.0, 200e-6), "lattice spacing is 0.0"),
        (lambda: MeshSettings(1e-4, 2e-4), "fine mesh size is 200 um"),
        (lambda: CorrosionSettings(step=0.0), "corrosion step is 0.0"),
        (lambda: CorrosionSettings(saturation="maybe"), "saturation is 'maybe'"),
        (lambda: CorrosionSettings(kinetics="linear"), "kinetics is 'linear'"),
        (lambda: CorrosionSettings(kinetics="constant:a=1"), "numbers of constant must be none"),
        (lambda: CorrosionSettings(kinetics="tafel:slope=0.1"), "must be overpotential, slope"),
        (lambda: CorrosionSettings(kinetics="tafel:slope=x"), "must be number=value"),
        (lambda: CorrosionSettings(kinetics="volume_loss:"), "must be number=value"),
        (
            lambda: CorrosionSettings(kinetics="tafel:slope=0.1,overpotential=0.02, slope=0.2"),
            "slope must be given once",
        ),
        (
            lambda: CorrosionSettings(keep=("solid_core",)),
            "keep is 'solid_core'; it must be one of liquid, far_liquid",
        ),
        (lambda: CorrosionSettings(saturation="as_published"), "time scheme is sdirk2"),
        (
            lambda: CorrosionSettings("backward_euler", saturation="as_published"),
            "corrosion step is controlled; it must be a fixed one where saturation is as_pub",
        ),
        (
            lambda: CorrosionSettings(
                "backward_euler", saturation="as_published", dissolution="faradaic"
            ),
            "saturation is as_published; it must be complementarity or none",
        ),
        (lambda: TensileScene(final_strain=0.0), "final strain is 0.0"),
        (lambda: TensileScene(increment=0.5), "tensile increment is 0.5"),
        (lambda: DomainSettings(shape="cube"), "domain shape is 'cube'"),
        (
            lambda: TensileScene(mapping="skin"),
            "mapping is 'skin'; it must be one of auto, nodes, exposures",
        ),
        (
            lambda: resolve_scene(
                ["Mg-5Gd"], ["8w"], corrosion={"classes": 0}, tensile={"mapping": "exposures"}
            ),
            "mapping is exposures; it must be nodes or auto without rate classes",
        ),
    ],
)
def test_values_out_of_range_are_refused_with_one_sentence(make, words):
    with pytest.raises(SceneError, match=words) as refusal:
        make()
    assert "must be" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def hashes(scene: Scene) -> list[str]:
    """Of geometry, both marches, a map of the first alloy and a pull of both."""
    time = scene.immersion[1]
    return [
        geometry_hash(scene),
        corrosion_hash(scene, "Mg-A"),
        corrosion_hash(scene, "Mg-B"),
        map_hash(scene, "Mg-A", time, scene.holds[0]),
        pull_hash(scene, "Mg-A", time, scene.holds[0]),
        pull_hash(scene, "Mg-B", time, scene.holds[0]),
    ]


def test_each_stage_depends_on_its_own_numbers_only(scene):
    """Changing one number must repeat exactly the stages that it enters."""

    def changed(**fields) -> list[bool]:
        other = dataclasses.replace(scene, **fields)
        return [a != b for a, b in zip(hashes(scene), hashes(other), strict=True)]

    def held(**fields) -> tuple[HoldScene, ...]:
        return (dataclasses.replace(scene.holds[0], **fields),)

    strong = dataclasses.replace(
        scene.alloys[0],
        material=dataclasses.replace(scene.alloys[0].material, initial_yield_stress=200e6),
    )
    slow = dataclasses.replace(
        scene.alloys[0],
        corrosion=dataclasses.replace(scene.alloys[0].corrosion, volume_loss_scale=0.3),
    )
    assert len(set(hashes(scene))) == 4  # the two alloys have the same numbers here
    finer = held(mesh=MeshSettings(0.2e-3, 0.1e-3))
    assert changed(holds=finer) == [True, False, False, True, True, True]
    assert changed(corrosion=CorrosionSettings(step=1e4)) == [False, True, True, True, True, True]
    assert changed(holds=held(tensile=TensileScene(increment=0.01))) == [False] * 4 + [True] * 2
    other = held(tensile=TensileScene(bottom_grip=1e-3))
    assert changed(holds=other) == [False] * 3 + [True] * 3
    # a second way of holding with the same mesh changes nothing of the first
    second = dataclasses.replace(other[0], name="own")
    assert changed(holds=(*scene.holds, second)) == [False] * 6
    assert changed(alloys=(strong, scene.alloys[1])) == [False] * 4 + [True, False]
    assert changed(alloys=(slow, scene.alloys[1])) == [False, True, False, True, True, False]
    assert changed(geometry=ScrewGeometry(ScrewParameters(length=5e-3))) == [True] * 6


@pytest.mark.parametrize(
    ("stage", "changed"),
    [
        ("geometry", [True, False, False, True, True, True]),
        ("corrode", [False, True, True, True, True, True]),
        ("map", [False] * 3 + [True] * 3),
        ("pull", [False] * 4 + [True] * 2),
    ],
)
def test_a_new_revision_of_a_stage_repeats_it_and_what_builds_on_it(
    scene, monkeypatch, stage, changed
):
    before = hashes(scene)
    monkeypatch.setitem(STAGE_REVISION, stage, STAGE_REVISION[stage] + 1)
    assert [a != b for a, b in zip(before, hashes(scene), strict=True)] == changed


def test_a_solid_file_counts_by_content_not_by_place(scene):
    def with_file(path: str, digest: str) -> Scene:
        return dataclasses.replace(scene, geometry=SolidFile(path, "mm", digest))

    here = with_file("a.stl", "0" * 64)
    assert geometry_hash(here) == geometry_hash(with_file("b.stl", "0" * 64))
    assert geometry_hash(here) != geometry_hash(with_file("a.stl", "1" * 64))


def test_time_zero_is_added_in_front_for_the_strength_ratio(scene):
    assert [t.seconds for t in scene.with_intact()] == [0.0, 604800.0, 4838400.0]
    started = dataclasses.replace(scene, immersion=parse_immersion_times(["0d", "8w"]))
    assert started.with_intact() == started.immersion
    assert scene.time("0d") == scene.with_intact()[0] and scene.time("56d").label == "8w"
    with pytest.raises(ValueError, match="'4w' .*it has 0w, 1w, 8w"):
        scene.time("4w")


def test_laws_of_the_rate_take_the_numbers_of_peri():
    # written down once more, so that a law's numbers do not change by accident
    assert KINETICS["volume_loss"] == ("length?",) and KINETICS["constant"] == ()
    assert KINETICS["tafel"] == ("overpotential", "slope")
    assert KINETICS["butler_volmer"][:2] == ("overpotential", "charge_number?")


def test_the_ways_in_which_f_grows_are_those_of_fem():
    from fem import settings

    assert DAMAGE_UPDATES == settings.DAMAGE_UPDATES
    assert TensileScene().damage == settings.TensileSettings().damage


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"damage": "nodal"}, "damage is 'nodal'; it must be one of point, cell, implicit"),
        ({"damage_length": -1e-4}, "damage length is -0.0001; it must be at least 0"),
        ({"damage_length": float("nan")}, "damage length is nan; it must be at least 0"),
        (
            {"damage": "point", "damage_length": 1e-4},
            "damage is point; it must be cell where a damage length is given",
        ),
    ],
)
def test_a_growth_of_f_that_cannot_be_computed_is_refused(fields, sentence):
    with pytest.raises(SceneError, match=re.escape(sentence)):
        TensileScene(**fields)


def test_what_a_stored_test_does_not_say_is_the_default(scene):
    content = scene.to_json()
    for name in ("damage", "damage_length", "load", "bending_azimuth"):
        del content["holds"][0]["tensile"][name]
    assert scene_from_json(content) == scene


def test_a_scene_of_an_earlier_version_is_refused(scene):
    with pytest.raises(SceneError, match="schema version of the scene is 1; it must be 2"):
        scene_from_json({**scene.to_json(), "schema_version": 1})


def test_the_growth_of_f_comes_from_the_command_line():
    parser = argparse.ArgumentParser()
    add_scene_options(parser)
    words = "--alloy Mg-5Gd --immersion 8w --damage-length 100um --damage".split()
    tensile = scene_from_options(parser.parse_args([*words, "cell"])).tensile
    assert (tensile.damage, tensile.damage_length) == ("cell", pytest.approx(1e-4))
    assert scene_from_options(parser.parse_args(words[:-1])).tensile.damage == "cell"
    with pytest.raises(SceneError, match="damage is implicit; it must be cell"):
        scene_from_options(parser.parse_args([*words, "implicit"]))


def test_the_grips_reach_a_horizon_below_the_slot_unless_told_otherwise():
    test = resolve_scene(["Mg-5Gd"], ["8w"]).tensile
    assert test.bottom_grip == test.top_grip == pytest.approx(0.7e-3)  # slot 0.5 mm, horizon 0.2
    test = resolve_scene(["Mg-5Gd"], ["8w"], horizon=0.3e-3, spacing=0.1e-3).tensile
    assert test.bottom_grip == test.top_grip == pytest.approx(0.8e-3)
    test = resolve_scene(["Mg-5Gd"], ["8w"], tensile={"bottom_grip": 0.0}).tensile
    assert (test.bottom_grip, test.top_grip) == (0.0, pytest.approx(0.7e-3))


def test_each_way_of_holding_has_its_grips_and_its_mesh():
    scene = resolve_scene(["Mg-5Gd"], ["8w"], hold=["all"])
    grips = {h.name: (h.tensile.bottom_grip, h.tensile.top_grip) for h in scene.holds}
    assert grips["shank"] == pytest.approx((0.7e-3, 0.7e-3))
    assert grips["slot"] == pytest.approx((0.7e-3, 0.3e-3))
    assert grips["faces"] == (0.0, 0.0)
    # cells at pulled faces: 50 um with every preset, as wide as asked for; four nodes
    assert [h.mesh.size_ends for h in scene.holds] == [(None, None)] * 2 + [(5e-5, 5e-5)]
    assert [h.tensile.element for h in scene.holds] == ["P2-Fbar", "P2-Fbar", "P1"]
    assert list(scene.meshes()) == ["", "faces"]
    assert [scene.mesh_folder(h) for h in scene.holds] == ["", "", "faces"]
    assert set(grips) < set(HOLDINGS)
    finer = resolve_scene(["Mg-5Gd"], ["8w"], hold=["faces"], mesh_size=33e-6)
    assert finer.mesh.size_ends == (None, None)  # fine enough everywhere
    better = resolve_scene(["Mg-5Gd"], ["8w"], "standard", hold=["faces"])
    assert better.mesh.size_ends == (5e-5, 5e-5)
    thin = resolve_scene(["Mg-5Gd"], ["8w"], hold=["all"], mesh_size_faces=33e-6)
    assert [h.mesh.size_ends for h in thin.holds] == [(None, None)] * 2 + [(33e-6, 33e-6)]
    with pytest.raises(SceneError, match="bottom mesh size is 1 mm; it must be at most"):
        resolve_scene(["Mg-5Gd"], ["8w"], hold=["faces"], mesh_size_faces=1e-3)
    chosen = resolve_scene(["Mg-5Gd"], ["8w"], hold=["faces"], tensile={"element": "P2"})
    assert chosen.tensile.element == "P2"


def test_depths_that_have_a_name_are_called_by_it():
    def name(**depths) -> str:
        return resolve_scene(["Mg-5Gd"], ["8w"], tensile=depths).holds[0].name

    assert name(bottom_grip=0.0, top_grip=0.0) == "faces"
    assert name(bottom_grip=0.7e-3, top_grip=0.3e-3) == "slot"
    assert name(top_grip=0.7e-3) == "shank"
    assert name(top_grip=0.4e-3) == "own"
    pulled = resolve_scene(["Mg-5Gd"], ["8w"], tensile={"top_grip": 0.0}).holds[0]
    assert pulled.mesh.size_ends == (None, 5e-5) and pulled.tensile.element == "P1"


def test_ways_of_holding_that_a_solid_does_not_allow_are_refused():
    plain = ScrewGeometry(ScrewParameters(slot_width=0.0, slot_depth=0.0))
    with pytest.raises(SceneError, match="hold is 'slot' and the solid has no slot"):
        resolve_scene(["Mg-5Gd"], ["8w"], hold=["slot"], geometry=plain)
    every = resolve_scene(["Mg-5Gd"], ["8w"], hold=["all"], geometry=plain)
    assert [h.name for h in every.holds] == ["shank", "faces"]
    shallow = ScrewGeometry(ScrewParameters(slot_depth=0.3e-3))
    with pytest.raises(SceneError, match="slot is 0.3 mm deep"):
        resolve_scene(["Mg-5Gd"], ["8w"], hold=["slot"], geometry=shallow)
    for hold, words in (
        (["head"], "hold is 'head'; it must be one of shank, slot, faces, all"),
        (["all", "slot"], "all must stand alone"),
        (["slot", "slot"], "without repetition"),
    ):
        with pytest.raises(SceneError, match=words):
            resolve_scene(["Mg-5Gd"], ["8w"], hold=hold)
    with pytest.raises(SceneError, match="left out where --top-grip is given"):
        resolve_scene(["Mg-5Gd"], ["8w"], hold=["slot"], tensile={"top_grip": 1e-3})


def test_the_loads_are_those_of_fem_and_called_as_there():
    from fem import loading, settings
    from fem.solid import Held

    assert tuple(LOADS) == loading.LOADS
    assert TensileScene().load == settings.TensileSettings().load
    points, cells = box((1, 1, 1), (1e-3, 1e-3, 1e-3))
    for name, names in LOADS.items():
        load = loading.make_load(name, 0.0, points, cells, Held(0.0, 1e-3, 1e-3))
        assert names.reaction == load.reaction and names.unit == load.unit.replace(" ", "_")
        assert names.abscissa == load.motion


def test_the_load_comes_from_the_command_line_and_only_the_test_depends_on_it():
    parser = argparse.ArgumentParser()
    add_scene_options(parser)

    def scene_of(*words: str) -> Scene:
        given = ["--alloy", "Mg-5Gd", "--immersion", "8w", *words]
        return scene_from_options(parser.parse_args(given))

    pulled, bent = scene_of(), scene_of("--load", "bending", "--bending-azimuth", "30deg")
    assert (pulled.tensile.load, pulled.tensile.bending_azimuth) == ("axial", None)
    assert (bent.tensile.load, bent.tensile.lateral) == ("bending", "clamped")
    assert bent.tensile.bending_azimuth == pytest.approx(0.5235987755982988, rel=1e-15)
    assert scene_of("--load", "bending").tensile.bending_azimuth == 0.0
    assert scene_of("--load", "torsion").tensile.bending_azimuth is None
    assert scene_from_json(bent.to_json()) == bent
    time = bent.immersion[0]
    test = ("Mg-5Gd", time, pulled.holds[0])
    assert map_hash(bent, *test) == map_hash(pulled, *test)
    assert pull_hash(bent, "Mg-5Gd", time, bent.holds[0]) != pull_hash(pulled, *test)
