"""Runs over each other: what differs by name, what is comparable, and what is refused."""

import base64
import csv
import dataclasses
import io
import re
import shutil

import pytest

from pipeline.cli import main
from pipeline.compare.differences import differences
from pipeline.compare.plots import swatch
from pipeline.compare.runs import read_runs, times, way_of, ways
from pipeline.report.drawing import MOST_LINES
from pipeline.scene.image import ImageFile
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.scene import SolidFile
from tests.pipeline.command_line import refused
from tests.pipeline.report.run_folders import Page, pin_mesh, scene_of, write_run

SHORT = (["Mg-5Gd"], ["0w", "28d", "6w"])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Runs that differ in resolution, times, load, holding and strain at the end."""
    place, mesh = tmp_path_factory.mktemp("compare"), pin_mesh(1e-3)
    for name, scene in {
        "first": scene_of(hold=["shank", "slot"]),
        "finer": scene_of(resolution_name="standard"),
        "short": scene_of(*SHORT, tensile={"final_strain": 0.3}),
        "twisted": scene_of(["Mg-10Gd"], tensile={"load": "torsion"}),
    }.items():
        write_run(place / name, scene, *mesh)
    return place


def compare(place, *names, more=()):
    """The page that the command writes."""
    page = place / "page.html"
    page.unlink(missing_ok=True)
    assert main(["compare", *(str(place / n) for n in names), "--out", str(page), *more]) == 0
    return page.read_text()


def by_name(*scenes):
    return {(d.group, d.name): d.values for d in differences(scenes)}


def test_differences_are_named_and_shown_as_a_reader_writes_them():
    smaller = {"increment": 0.0025}
    quick, fine = scene_of(), scene_of(resolution_name="standard", tensile=smaller)
    found = by_name(quick, fine, quick)
    assert found[("Run", "Resolution")] == ("quick", "standard", "quick")
    assert found[("Lattice", "Spacing")] == ("66.67 µm", "50 µm", "66.67 µm")
    assert found[("Test (shank)", "Increment")] == ("2 %", "0.25 %", "2 %")
    assert {group for group, _ in found} == {"Run", "Lattice", "Mesh (shank)", "Test (shank)"}
    assert by_name(quick, scene_of()) == {}


def test_a_part_that_only_some_have_is_named_once():
    found = by_name(scene_of(), scene_of(["Mg-5Gd"], hold=["slot"]))
    assert set(found) == {("Run", "Alloys"), ("Run", "Ways of holding")}
    assert found[("Run", "Ways of holding")] == ("shank", "slot")


def test_solids_of_files_and_images_are_told_by_name_and_content():
    scene = scene_of()
    part = dataclasses.replace(scene, geometry=SolidFile("/a/part.step", "mm", "ab" * 32))
    same = dataclasses.replace(scene, geometry=SolidFile("/b/part.step", "mm", "ab" * 32))
    scan = ImageFile("/a/scan.mha", "cd" * 32, threshold=0.5)
    assert by_name(part, same) == {}
    found = by_name(scene, part, dataclasses.replace(scene, geometry=scan))
    assert found[("Geometry", "Solid")] == ("a screw by its measures", "part.step", "scan.mha")
    assert found[("Geometry", "Content")] == ("–", "SHA-256 abababababab", "SHA-256 cdcdcdcdcdcd")


def test_what_rounding_would_hide_is_written_in_full():
    scene = scene_of()
    alloy = scene.alloys[0]
    nearly = dataclasses.replace(
        alloy, material=dataclasses.replace(alloy.material, young_modulus=43.000001e9)
    )
    other = dataclasses.replace(scene, alloys=(nearly, *scene.alloys[1:]))
    assert by_name(scene, other) == {
        ("Mg-5Gd", "Young modulus"): ("43000000000.0", "43000001000.0")
    }


def test_the_page_lays_the_runs_over_each_other(place):
    text = compare(place, "first", "finer")
    page = Page(text)
    assert page.open == [] and page.loads == []
    strength = page.sections["strength"]
    assert "4 weeks" in strength and "24 weeks" in strength
    # Mg-5Gd keeps 71 %, Mg-10Gd 82 %: 11 points more than the first row, in both runs
    assert strength.count("(+11)") == 3 and strength.count("(±0)") == 3
    for preset in ("quick", "standard"):
        known = RESOLUTIONS[preset].tensile_error
        error = max(map(known.of, known.alloys))
        assert f"± {100 * error:.1f} %" in strength
    assert "66.67 µm" in page.sections["differences"] and "50 µm" in page.sections["differences"]
    titles = re.findall(r"<title>(.*?)</title>", text)
    assert "first, Mg-5Gd, 8 weeks: 43.0 %, 197 N" in titles
    assert "finer, Mg-10Gd: carries nothing" not in titles
    assert "first, Mg-5Gd: carries nothing" in titles  # severed after 24 weeks, the last time
    assert text.count("<svg class=") == 2 * 2 + 1 + text.count('<svg class="swatch"')


def test_other_times_loads_holdings_and_ends_are_said(place):
    text = compare(place, "first", "short", "twisted")
    page = Page(text)
    runs = page.sections["runs"]
    assert "immersion times are not the same" in runs and "short: 0w, 28d, 6w" in runs
    assert "loads are not the same (axial, torsion)" in runs
    assert "the slotted section (axial): first;" in runs
    assert "the shank (torsion): twisted)" in runs
    assert "first 10 %, short 30 %, twisted 10 %" in runs
    # 4w and 28d are one time: the last that most runs were tested after
    assert "No curve after" not in runs
    assert "after 4 weeks" in page.sections["strength"]
    columns = re.findall(r'<th class="n">(\d+ weeks)</th>', text)
    # of the shank, of the slotted section, of the shank in torsion, of the volume loss
    assert " ".join(columns).replace(" weeks", "") == "4 6 8 24 4 8 24 4 8 24 4 6 8 24"
    page = Page(compare(place, "first", "short", more=["--time", "8w"]))
    assert "No curve after 8 weeks: short, Mg-5Gd." in page.sections["runs"]


def test_all_results_can_be_kept(place):
    text = compare(place, "first", "twisted")
    packed = re.search(r'download="comparison.csv" href="data:[^,]*,([^"]*)"', text).group(1)
    rows = list(csv.DictReader(io.StringIO(base64.b64decode(packed).decode())))
    assert len(rows) == 2 * 2 * 4 + 4
    last = rows[-2]
    assert (last["run"], last["alloy"], last["load"]) == ("twisted", "Mg-10Gd", "torsion")
    assert (last["immersion_days"], last["strength_ratio"]) == ("56", "0.64")
    assert {row["reaction_unit"] for row in rows} == {"N", "N_m"}


def test_the_key_tells_every_line_apart():
    shown = {str(swatch(n)) for n in range(MOST_LINES)}
    assert len(shown) == MOST_LINES


def test_grips_of_other_depths_are_no_common_way(place, tmp_path):
    for name, depth in (("a", 0.4e-3), ("b", 0.5e-3)):
        scene = scene_of(["Mg-5Gd"], ["0w", "4w"], tensile={"bottom_grip": depth})
        write_run(tmp_path / name, scene, *pin_mesh(1e-3))
    lines = read_runs([tmp_path / "a", tmp_path / "b"])
    assert [line.label for line in lines] == ["a", "b"]
    found = ways(lines)
    assert [way.part for way in found] == [
        "the part between the grips (bottom 400 µm, top 700 µm)",
        "the part between the grips (bottom 500 µm, top 700 µm)",
    ]
    assert lines[0].held(found[1]) is None
    assert lines[1].held(found[1]).immersions[1].strength_ratio == 0.71
    assert way_of(lines[0].run.scene.holds[0]) == found[0]


def test_runs_of_one_name_are_told_apart_by_their_folders(place, tmp_path):
    shutil.copytree(place / "short", tmp_path / "other" / "short")
    labels = {line.label for line in read_runs([place / "short", tmp_path / "other" / "short"])}
    assert labels == {f"{place.name}/short", "other/short"}


def test_one_time_in_two_units_is_one():
    assert times([28 * 86400.0, 0.0, 4 * 604800.0 * (1 + 1e-12)]) == [0.0, 28 * 86400.0]


def test_what_cannot_be_compared_is_refused(place, tmp_path, capsys):
    first, second = str(place / "first"), str(place / "finer")
    page = tmp_path / "page.html"
    out = ["--out", str(page)]
    refused(capsys, ["compare", first, *out], "1 run folder", "at least 2")
    refused(capsys, ["compare", first, f"{first}/../first", *out], "twice")
    refused(capsys, ["compare", first, str(tmp_path / "none"), *out], "does not exist")
    refused(capsys, ["compare", first, str(tmp_path), *out], "scene.json", "no run folder")
    (tmp_path / "begun").mkdir()
    shutil.copy(place / "first" / "scene.json", tmp_path / "begun")
    refused(capsys, ["compare", first, str(tmp_path / "begun"), *out], "no results", "--resume")
    more = ["--time", "5w"]
    refused(capsys, ["compare", first, second, *out, *more], "--time is 5 weeks", "8 weeks")
    refused(capsys, ["compare", first, second, *out, "--time", "soon"], "--time 'soon'")
    text = str(tmp_path / "page.txt")
    refused(capsys, ["compare", first, second, "--out", text], "ends in .html")
    report = str(place / "first" / "report.html")
    refused(capsys, ["compare", first, second, "--out", report], "report of a run")
    lost = str(tmp_path / "no" / "page.html")
    refused(capsys, ["compare", first, second, "--out", lost], "whose folder does not exist")
    (tmp_path / "folder.html").mkdir()
    refused(capsys, ["compare", first, second, "--out", str(tmp_path / "folder.html")], "a folder")
    assert not page.exists() and not (place / "first" / "report.html").exists()


def test_more_lines_than_can_be_told_apart_are_refused(place, tmp_path, capsys):
    names = [str(tmp_path / f"{n}") for n in range(MOST_LINES // 2 + 1)]
    for name in names:
        shutil.copytree(place / "finer", name)
    arguments = ["compare", *names, "--out", str(tmp_path / "page.html")]
    refused(capsys, arguments, f"{MOST_LINES + 2} results", f"at most {MOST_LINES}")
