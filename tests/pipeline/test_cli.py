"""The command line refuses a scene in one sentence, exit code 2, and leaves nothing behind."""

import re
from pathlib import Path

import pytest

import perilife_data
from pipeline.planning.sizes import with_fitting_spacing
from pipeline.record import machine
from pipeline.scene.resolution import RESOLUTIONS
from tests.pipeline.command_line import COARSE, PIN, SCENE, changed, refused, scene_of


@pytest.mark.parametrize(
    "scene, words",
    [
        (["--alloy", "Mg-7Gd", "--immersion", "8w"], ["Mg-7Gd", "Mg-5Gd", "Mg-10Gd"]),
        (["--alloy", "Mg-5Gd", "Mg-5Gd", "--immersion", "8w"], ["Mg-5Gd", "without repetition"]),
        (["--alloy", "Mg-5Gd", "--immersion=-1w"], ["-1w", "negative", "at least 0"]),
        (["--alloy", "Mg-5Gd", "--immersion", "-1w"], ["-1w", "negative", "at least 0"]),
        (["--alloy", "Mg-5Gd", "--immersion", "5300w"], ["5300w, 101.6 years", "100 years"]),
        (["--alloy", "Mg-5Gd", "--immersion", "1e400w"], ["1e400w", "infinite"]),
        (["--alloy", "mg5gd", "--immersion", "8w"], ["'mg5gd'", "did you mean Mg-5Gd?"]),
        (["--alloy", "Mg-5Gd", "--immersion", "0.1w", "16.8h"], ["16.8h", "same time"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8w", "1w"], ["1w", "8w", "must rise"]),
        (["--alloy", "Mg-5Gd", "--immersion", "7d", "1w"], ["7d", "1w", "same time"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8 months"], ["8 months", "unit out of s, min"]),
        (["--alloy", "Mg-5Gd", "--immersion", "8"], ["'8'", "unit"]),
        (["--alloy", "absent.toml", "--immersion", "8w"], ["absent.toml", "no such file"]),
        (changed("--resolution", "medium"), ["medium", "quick, standard, fine"]),
        (changed("--parameters", "table-9"), ["table-9", "table-5.1"]),
        (changed("--saturation", "maybe"), ["maybe", "complementarity"]),
        (changed("--kinetics", "tafel:overpotential=0.1,slope=-1"), ["slope: -1.0", "positive"]),
        (changed("--kinetics", "tafel"), ["'tafel'", "overpotential, slope"]),
        (changed("--dissolution", "linear"), ["'linear'", "one of proportional, faradaic"]),
        (
            changed("--dissolution", "faradaic", "--saturation", "as_published")
            + ["--scheme", "backward_euler"],
            ["as_published", "complementarity or none where dissolution is faradaic"],
        ),
        (
            changed("--dissolution", "faradaic", "--scheme", "forward_euler"),
            ["forward_euler", "sdirk2 or backward_euler where dissolution is faradaic"],
        ),
        (changed(*COARSE), ["300 um", "at most 250 um", "--spacing 250um, or --spacing auto"]),
        (changed(*COARSE, "--slot-depth", "20um"), ["--spacing 10um --horizon 80um"]),
        (changed("--spacing", "100"), ["spacing '100'", "100um"]),
        (changed("--spacing", "100furlong"), ["100furlong", "m, cm, mm, um, nm, inch"]),
        (changed("--horizon", "50um"), ["horizon is 50 um", "1 to 8"]),
        (changed("--radial-margin", "100um"), ["radial margin is 100 um", "266.7 um"]),
        (changed("--step", "0s"), ["step is 0.0", "above 0"]),
        (changed("--step", "1e99h"), ["step is 3.6e+102 s", "at most the longest immersion time"]),
        (changed("--step", "1e-99h"), ["step is 3.6e-96 s", "at least 4.8384 s, a millionth"]),
        (changed("--rate-change", "2"), ["rate change is 2.0"]),
        (changed("--diameter=-2mm"), ["diameter '-2mm' is negative"]),
        (changed("--diameter", "-2mm"), ["diameter '-2mm' is negative"]),
        (changed("--mesh-size", "-.2mm"), ["mesh size '-.2mm' is not understood"]),
        (changed("--step", "-1d"), ["step '-1d' is negative"]),
        (changed("--top-grip", "-1mm"), ["top grip '-1mm' is negative"]),
        (changed("--load", "bending", "--bending-azimuth", "1e400deg"), ["1e400deg", "infinite"]),
        (changed("--resolution", "quik"), ["did you mean quick?"]),
        (changed("--element", "p2"), ["did you mean P2?"]),
        (changed("--thread", "helix"), ["did you mean helical?"]),
        (changed("--kinetics", "taffel:slope=1"), ["did you mean tafel?"]),
        (changed("--spacng", "1um"), ["--spacng", "did you mean --spacing?"]),
        (changed("--slot-width", "3mm"), ["slot", "3"]),
        (changed("--thread", "left"), ["'left'", "helical"]),
        (changed("--final-strain", "0"), ["final strain is 0.0"]),
        (changed("--increment", "0.5"), ["increment is 0.5", "0.1"]),
        (changed("--element", "Q1"), ["'Q1'", "P2"]),
        (changed("--load", "shear"), ["load is 'shear'", "axial, torsion, bending"]),
        (changed("--load", "torsion", "--lateral", "free"), ["'free'", "clamped", "torsion"]),
        (changed("--load", "bending", "--bending-azimuth", "30"), ["'30'", "rad, deg"]),
        (
            changed("--load", "torsion", "--bending-azimuth", "1rad"),
            ["azimuth is 1rad", "left out where the load is torsion"],
        ),
        (
            changed("--bending-azimuth", "30deg"),
            ["30deg", "left out where the load is axial"],
        ),
        (changed("--mesh-size", "100um", "--mesh-size-fine", "200um"), ["200 um", "100 um"]),
        (changed("--np", "0"), ["--np is 0"]),
        (changed("--np", "3"), ["--np is 3", "2 cores", "at most 2", "--oversubscribe"]),
        (changed("--pulls", "3"), ["--pulls is 3 and", "at most 2", "--oversubscribe"]),
        (changed("--np", "2", "--pulls", "2"), ["--pulls is 2 of 2 ranks each", "at most 1"]),
        (changed("--ranks", "two"), ["--ranks is 'two'; it must be a whole number"]),
        (changed("--until-left", "80%"), ["--until-left is '80%'; it must be a number without"]),
        (changed("--unit", "mm"), ["--unit", "--solid"]),
        (changed("--volume-loss", "mine.csv"), ["mine.csv", "ALLOY=FILE.csv"]),
        (changed("--volume-loss", "Mg-5Gd=absent.csv"), ["absent.csv", "no such file"]),
        (changed("--frobnicate"), ["--frobnicate"]),
        (["--immersion", "8w"], ["--alloy"]),
    ],
)
def test_a_scene_that_cannot_be_computed_is_refused(tmp_path, capsys, monkeypatch, scene, words):
    monkeypatch.setattr(machine, "processor_cores", lambda: 2)
    out = tmp_path / "run"
    refused(capsys, ["run", "--out", str(out), *scene], *words)
    assert not out.exists()


@pytest.mark.parametrize("command", ["geometry", "plan"])
def test_other_commands_refuse_the_same_scene(tmp_path, capsys, command):
    out = tmp_path / "run"
    folder = [] if command == "plan" else ["--out", str(out)]
    refused(capsys, [command, *folder, *changed(*COARSE)], "300 um", "250 um")
    assert not out.exists()


def _facet(a, b, c) -> str:
    corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in (a, b, c))
    return f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"


def _tetrahedron(shift: float = 0.0, open_: bool = False) -> str:
    p = [(shift + x, y, z) for x, y, z in ((0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4))]
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    return "".join(_facet(*(p[i] for i in face)) for face in faces[: 3 if open_ else 4])


def _solid(*parts: str) -> str:
    return "solid part\n" + "".join(parts) + "endsolid part\n"


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("open.stl", _solid(_tetrahedron(open_=True)), ["open.stl"]),
        ("crossing.stl", _solid(_tetrahedron(), _tetrahedron(shift=1.0)), ["crossing.stl"]),
        ("empty.stl", "", ["empty.stl"]),
        ("part.step", "this is no STEP file\n", ["part.step"]),
        ("part.obj", "v 0 0 0\n", ["part.obj", ".step, .stp, .brep, .stl"]),
    ],
)
def test_a_file_that_bounds_no_solid_is_refused(tmp_path, capsys, name, text, words):
    path, out = tmp_path / name, tmp_path / "run"
    path.write_text(text)
    base = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", str(out)]
    refused(capsys, [*base, "--solid", str(path)], *words)
    assert not out.exists()


@pytest.mark.parametrize("kind", ["binary", "text", "neither"])
def test_a_surface_of_too_many_triangles_is_refused_unread(tmp_path, capsys, kind):
    path, out = tmp_path / "huge.stl", tmp_path / "run"
    count = 6_000_000
    if kind == "text":
        facets = _tetrahedron().encode()
        size = len(facets) // 4 * count
        begin = b"solid part\n" + 5000 * facets
    else:
        size = 84 + 50 * count
        begin = bytes(80) + count.to_bytes(4, "little") if kind == "binary" else b"x" * 84
    with path.open("wb") as file:  # a sparse file: its size is told, its blocks are not there
        file.write(begin)
        file.truncate(size)
    arguments = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--solid", str(path), "--out", str(out)]
    said = refused(capsys, ["run", *arguments], "huge.stl", "triangles", "at most 5,000,000")
    if kind == "binary":
        assert "has 6,000,000" in said
    if kind == "text":  # the first MiB says how long a facet is
        found = int(re.search(r"about ([\d,]+) triangles", said)[1].replace(",", ""))
        assert found == pytest.approx(count, rel=0.01)
    assert not out.exists()


def test_a_data_file_without_end_is_refused(tmp_path, capsys):
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    scene = ["--alloy", str(tmp_path / "deep.toml"), "--immersion", "8w"]
    refused(capsys, ["plan", *scene], "deep.toml", "nested too deeply")


def test_lengths_typed_in_two_units_are_the_same_scene():
    """In doubles 70 * 1e-6 is not 0.07 * 1e-3, but what was typed is."""
    a = scene_of([*SCENE, "--mesh-size", "300um", "--spacing", "70um", "--diameter", "2.1mm"])
    b = scene_of([*SCENE, "--mesh-size", "0.3mm", "--spacing", "0.07mm", "--diameter", "2100um"])
    assert 70 * 1e-6 != 0.07 * 1e-3 and 2100 * 1e-6 != 2.1 * 1e-3
    assert a.hash() == b.hash()
    scene_of([*SCENE, "--mesh-size", "0.3mm", "--mesh-size-fine", "300um"])


def test_a_missing_file_or_a_wrong_unit_of_a_solid_is_refused(tmp_path, capsys):
    base = ["run", "--alloy", "Mg-5Gd", "--immersion", "8w", "--out", str(tmp_path / "run")]
    refused(capsys, [*base, "--solid", "absent.stl"], "absent.stl", "no such file")
    (tmp_path / "part.stl").write_text(_solid(_tetrahedron()))
    part = ["--solid", str(tmp_path / "part.stl")]
    refused(capsys, [*base, *part, "--unit", "furlong"], "furlong", "m, cm, mm, um, nm, inch")
    refused(capsys, [*base, *part, "--pitch", "0.3mm"], "--pitch", "--solid")
    assert not (tmp_path / "run").exists()


def test_a_solid_read_in_another_unit_is_refused_by_its_size(tmp_path, capsys):
    path = tmp_path / "part.stl"
    path.write_text(_solid(_tetrahedron()))
    plan = ["plan", "--alloy", "Mg-5Gd", "--immersion", "8w", "--solid", str(path), "--unit"]
    for unit, length in (("m", "4000 mm"), ("um", "4 um")):
        words = f"part.stl is {length} long; it must be 100 um to 1000 mm", "--unit"
        refused(capsys, [*plan, unit], *words)


@pytest.mark.parametrize(
    "more, words",
    [
        (["--strength-tolerance", "0.1"], ["--strength-tolerance goes with --samples"]),
        (["--surrogate", "5"], ["--surrogate goes with --samples"]),
        (["--mesh-size-faces", "0mm"], ["mesh size", "above 0"]),
        (["--mesh-size-faces", "1m"], ["mesh size is 1000 mm", "at most the mesh size"]),
        (["--bottom-grip", "1e-9mm"], ["bottom grip", "0mm (the end face) or at least 1 um"]),
        (["--kinetics", "volume_loss:length=0"], ["'volume_loss:length=0'; its length: 0.0"]),
        (["--pitch", "１mm"], ["pitch '１mm' is not understood"]),
    ],
)
def test_options_out_of_range_are_refused_where_they_do_nothing_too(more, words, tmp_path, capsys):
    out = tmp_path / "run"
    refused(capsys, ["run", *SCENE, *more, "--out", str(out)], *words)
    assert not out.exists()


def test_a_poisson_ratio_of_one_half_in_an_own_alloy_is_refused(tmp_path, capsys):
    folder = Path(perilife_data.__file__).parent / "alloys"
    text = (folder / "mg-5gd.toml").read_text()
    changed, count = re.subn(r"(\[poisson_ratio\]\s*\nvalue = )\S+", r"\g<1>0.5", text)
    assert count == 1
    own = tmp_path / "own.toml"
    own.write_text(changed)
    out = tmp_path / "run"
    arguments = ["run", "--alloy", str(own), "--immersion", "8w", "--out", str(out), *PIN]
    refused(capsys, arguments, "poisson_ratio is 0.5", "below 0.5")
    assert not out.exists()


def test_the_spacing_that_a_refusal_offers_will_do_and_auto_takes_it(capsys):
    for pitch, offered in (("0.25mm", "62.5um"), ("0.24mm", "60um"), ("0.2222mm", "55.5um")):
        screw = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--pitch", pitch]
        message = refused(capsys, ["plan", *screw, "--spacing", "120um"], "--spacing auto")
        assert f"(--spacing {offered}, or" in message
        fitted, _ = with_fitting_spacing(scene_of([*screw, "--spacing", "auto"]))
        assert fitted.hash() == scene_of([*screw, "--spacing", offered]).hash()
    # the preset's will do
    assert with_fitting_spacing(scene_of([*SCENE, "--spacing", "auto"]))[0] == scene_of(SCENE)


def test_auto_looks_for_the_smallest_feature_of_a_solid_from_a_file(tmp_path, capsys):
    path = tmp_path / "part.stl"
    path.write_text(_solid(_tetrahedron()))
    scene = ["--alloy", "Mg-5Gd", "--immersion", "8w", "--solid", str(path), "--spacing", "auto"]
    found, solid = with_fitting_spacing(scene_of(scene))
    preset = RESOLUTIONS["quick"]
    assert solid.smallest_feature > 0.2e-3 and found.lattice.spacing == preset.spacing
    small = [*scene, "--unit", "um"]
    refused(capsys, ["plan", *small], "smallest feature", "at most 8 of them (--horizon")
