"""The report: everything a run holds is in one file, what it does not hold is said, nothing faked.

The run folders are synthetic and have exactly the layout that the pipeline writes.
"""

import io
import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PIL import Image

from pipeline.record.run_folder import RunFolder
from pipeline.record.run_results import AlloyResult, ImmersionResult, read_run
from pipeline.record.summary import SummaryRow, read_summary, write_summary
from pipeline.record.until import FOUND, UNTIL_FILE, UntilRow, write_until
from pipeline.report import doubts, picture_set, pictures, plots, provenance, report, wording
from pipeline.scene.holding import HOLDINGS
from pipeline.scene.resolution import RESOLUTIONS
from pipeline.scene.units import format_seconds
from tests.pipeline.report.run_folders import RATIOS, Page, pin_mesh, scene_of, write_run


def page_of(path):
    """Write the report of a run folder and read it again."""
    target = report.write_report(path)
    assert target == path / "report.html"
    text = target.read_text(encoding="utf-8")
    return Page(text), text


TOO_WEAK = UntilRow(
    "Mg-5Gd", "shank", "axial", FOUND, 0.8, 361.6, 83.0, 0.801, 362.0, 0.19, 1.4, 13.0, 2
)


@pytest.fixture(scope="module", autouse=True)
def _coarser_pictures():
    """A sixth of the time."""
    small = partial(pictures.render_pictures, size=(105, 154))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture_set, "ENOUGH_CELLS", 5000)
        patch.setattr(picture_set, "render_pictures", small)
        yield


@pytest.fixture(scope="module")
def mesh():
    return pin_mesh()


@pytest.fixture(scope="module")
def full(tmp_path_factory, mesh):
    """A complete run with measured points for one alloy, and its report."""
    path = tmp_path_factory.mktemp("report") / "run"
    data = path.parent / "mine.csv"
    data.write_text(
        "immersion time [w], volume loss [%], standard deviation [%]\n4, 9.5, 1\n8,14,2\n"
    )
    scene = scene_of(measured_volume_loss={"Mg-5Gd": str(data)})
    write_run(path, scene, *mesh)
    write_until(path / UNTIL_FILE, [TOO_WEAK])
    return path, *page_of(path)


def test_it_says_when_the_part_is_too_weak(full):
    _, page, _ = full
    assert "from 11.9 weeks on, ± 1.4 days by the search" in page.sections["until"]


def test_the_page_stands_alone_and_is_well_formed(full):
    _, page, text = full
    assert page.loads == []
    assert not re.search(r"<script[^>]*src|@import|url\((?!#)|fetch\(|XMLHttp|WebSocket", text)
    assert "default-src 'none'; img-src data:" in text  # its own policy, which browsers enforce
    assert len(text) < 5e6
    assert page.open == []  # every tag is closed


def test_the_answer_comes_first_one_sentence_for_each_alloy(full):
    _, page, _ = full
    top = page.sections["header"]
    assert (
        "Mg-5Gd: the shank keeps 43 % of its strength after 8 weeks and none after 24 weeks" in top
    )
    assert (
        "Mg-10Gd: the shank keeps 64 % of its strength after 8 weeks and 21 % after 24 weeks" in top
    )
    # between 8 weeks (0.64) and 24 weeks (0.21): 8 + 16 * 0.14 / 0.43 = 13.2 weeks
    assert "gone after about 13 weeks" in top
    assert "17 values are assumed, fitted or known to be wrong" in top
    assert "The stages took 3 min 03 s in sum" in top  # 3 + 2 (40 + 4 (0.5 + 12))


def test_table_pictures_and_curves_are_complete(full):
    path, page, text = full
    assert "Known from its text" not in text  # no end face is pulled
    assert all(word in page.sections["table"] for word in ("Mg-5Gd", "severed", "21 %", "8 weeks"))
    assert len(page.pictures) == 2 * 4 * 2  # alloys, times, whole and cut
    assert all(picture["alt"] for picture in page.pictures)
    assert text.count("<svg") == 4  # strength, volume loss, two sets of force-elongation curves
    assert "Mg-5Gd, measured" in text and "Mg-10Gd, measured" not in text
    assert "missing" not in page.sections
    with Image.open(path / "overview.png") as picture:
        assert picture.size[0] > 1000 and np.asarray(picture.convert("L")).std() > 10


def test_every_assumed_value_and_only_used_sources_are_listed(full):
    path, page, _ = full
    scene = read_run(path).scene
    rows = provenance.parameter_rows(scene)
    listed = provenance.to_be_listed(rows)
    assert {row.kind for row in listed} == {"assumed", "fitted", "published_uncorrected"}
    names = [row.name for row in listed]
    assert names.count("Yield stress") == 2 and names.count("Interface diffusivity") == 2
    assert f"These {len(listed)} values" in page.sections["assumed"]
    for row in listed:
        assert row.value in page.sections["assumed"] and row.source and row.where
    sources = {row.source for row in rows if row.source}
    assert set(provenance.references(rows, scene)) == sources
    assert page.sections["references"].count("doi:") <= len(sources)


def test_doubt_and_cost_are_stated(full):
    _, page, _ = full
    sure = page.sections["sure"]
    error = RESOLUTIONS["quick"].tensile_error.of("Mg-5Gd")
    assert f"strength left of the shank is off by about {100 * error:.1f} % for Mg-5Gd" in sure
    assert "3e-13" in sure and "1.23 %" in sure and "0.20 %" in sure  # balance, map, energy
    quick = RESOLUTIONS["quick"].corrosion_error
    for alloy in ("Mg-5Gd", "Mg-10Gd"):
        assert f"{100 * quick.of(alloy):.1f} % for {alloy}" in sure
    assert f"1 min 20 s → {format_seconds(80 * quick.half_error_cost)}" in sure  # 2 x 40 s
    assert "measured up to 8 weeks in this very scene" in sure
    assert "beyond reach" in sure and "0.042 % of the volume loss" in sure
    assert "7 of 3,698" in sure  # cells let go
    assert "Largest force, by its increments" in sure and "0.31 %" in sure
    highest = max(ratio for ratios in RATIOS.values() for ratio in ratios[1:])
    assert f"{90 * highest:.0f} % against {100 * highest:.0f} %" in sure  # the weakest section
    assert "needed" not in sure  # what was not left out is not listed
    assert "+0.54 %" in page.sections["made"]  # 9.3 / 9.25


def test_a_run_that_departs_from_its_preset_does_not_bear_its_name_alone():
    assert doubts.settings_name(scene_of()) == "“quick”"
    assert doubts.settings_name(scene_of(mesh_size=0.19e-3)) == "“quick”, changed"


def test_a_value_set_by_hand_is_not_given_a_source():
    scene = scene_of(alloys=("Mg-5Gd",))
    alloy = scene.alloys[0]
    changed = replace(alloy.corrosion, interface_diffusivity=1e-15)
    rows = provenance.parameter_rows(scene)
    kept = next(row for row in rows if row.name == "Interface diffusivity")
    assert kept.kind == "fitted" and kept.value == "2.8779e-15"
    by_hand = provenance.parameter_rows(replace(scene, alloys=(replace(alloy, corrosion=changed),)))
    row = next(row for row in by_hand if row.name == "Interface diffusivity")
    assert (row.kind, row.source, row.value) == ("set by hand", "", "1e-15")
    assert "2.8779e-15" in row.remark


@pytest.mark.parametrize(
    ("law", "listed", "remark"),
    [
        ("volume_loss", True, None),
        ("volume_loss:length=0.1", False, "D_int was fitted with the l of the parameter set"),
        ("constant", False, "D_int was fitted with a rate that falls with the volume loss (l)"),
        ("tafel:overpotential=0.02,slope=0.1", False, "D_int was fitted with a rate that falls"),
        ("butler_volmer:overpotential=0.01", False, "D_int was fitted with a rate that falls"),
    ],
)
def test_the_length_of_the_fit_is_listed_only_where_the_law_uses_it(law, listed, remark):
    scene = scene_of(alloys=("Mg-5Gd",))
    scene = replace(scene, corrosion=replace(scene.corrosion, kinetics=law))
    rows = provenance.parameter_rows(scene)
    assert any(row.symbol == "D_int" for row in rows)
    assert any(row.symbol == "l" for row in rows) == listed
    remarks = [row.remark for row in rows if row.name == "Law of the rate"]
    assert (not remarks) if remark is None else remarks[0].startswith(remark)


def test_values_of_the_alloys_stand_side_by_side():
    row = provenance.ParameterRow("S", "A", "n", "", "1", "m", "fitted", "key", "Table 1", "x; low")
    other = replace(row, alloy="B", value="2", remark="x; high")
    alone = replace(row, alloy="B", kind="set by hand", value="3")
    whole = replace(row, section="T", alloy="", remark="y")
    found = provenance.side_by_side([row, other, alone, whole], ["A", "B"])
    assert [r.values for r in found["S"]] == [("1", "2"), ("–", "3")]
    assert found["S"][0].remark == "A: low; B: high; x"
    assert found["T"][0].values == ("1",) and found["T"][0].remark == "y"


@pytest.mark.parametrize(
    ("load", "reaction", "done"), [("torsion", "torque", "twisted"), ("bending", "moment", "bent")]
)
def test_a_turned_solid_is_reported_in_words_and_units_of_its_load(tmp_path, load, reaction, done):
    scene = scene_of(alloys=("Mg-5Gd",), weeks=("0w", "8w"), tensile={"load": load})
    path = write_run(tmp_path / "run", scene, *pin_mesh(spacing=1e-3))
    (path / "geometry" / "mesh.h5").unlink()  # no pictures
    header = (path / "summary.csv").read_text().splitlines()[0]
    assert f"peak_{reaction}_N_m,strength_ratio,strain_at_peak" in header
    page, text = page_of(path)
    assert f"71 % of its strength in {load} after 8 weeks" in page.sections["header"]
    assert f"the largest {reaction} it bears up to 10 % nominal strain" in page.sections["header"]
    table = " ".join(page.sections["table"].split())
    # 500 (1 - exp(-60 e)) (1 - e) is largest at e = 0.065, 458 N; times 0.2 mm, in N mm
    assert (
        "92 N mm" in table and f"Peak {reaction}" in table and f"{load.capitalize()} test" in table
    )
    assert f"{done} to the end" in table
    curves = page.sections["curves"]
    assert f"{reaction} against angle" in curves
    assert "Angle (°)" in text and f"{reaction.capitalize()} (N mm)" in text
    assert f"Strength in {load} left (%)" in text
    sure, settings = page.sections["sure"], page.sections["parameters"]
    assert f"has been measured of tensile tests only, not of {load} tests" in sure
    assert not re.search(r"strength left is off|of the strength left \d", text)
    assert ("Axis of bending from x" in settings) == (load == "bending")
    for section in ("header", "table", "curves"):
        assert not re.search("tensile|force|elongation|pull", page.sections[section], re.IGNORECASE)


def test_each_way_of_holding_has_its_question_its_table_and_its_curves(tmp_path, mesh):
    scene = scene_of(alloys=("Mg-5Gd",), weeks=("0w", "8w"), hold=["all"])
    path = write_run(tmp_path / "run", scene, *mesh)
    (path / "geometry" / "mesh.h5").unlink()  # no pictures
    # what is weaker held in another way
    rows = read_summary(path / "summary.csv")
    shares = {"shank": 1.0, "slot": 0.5, "faces": 0.1}
    weaker = [replace(r, strength_ratio=r.strength_ratio * shares[r.hold]) for r in rows]
    write_summary(path / "summary.csv", weaker)
    page, text = page_of(path)
    top = page.sections["header"]
    assert "Mg-5Gd: the shank keeps 71 % of its strength after 8 weeks" in top
    assert "the slotted section 36 % after 8 weeks, the layer at the end faces 7 %" in top
    ways = " ".join(page.sections["holds"].split())
    for name in shares:
        assert HOLDINGS[name].question in ways and HOLDINGS[name].part in ways
    assert "bottom 700 µm, top 300 µm" in ways and "bottom its face, top its face" in ways
    assert text.count('<table class="summary">') == 3
    assert text.count("<svg") == 3 + 1 + 3  # strength, volume loss, force-elongation
    sure = page.sections["sure"]
    assert "of the slotted section is off by about 2.3 % for Mg-5Gd (2.0 % by mesh, 0.3 %" in sure
    assert "layer at the end faces is off by about 78.3 % for Mg-5Gd" in sure
    assert "screw with cells of 33 µm at the faces in place of 50 µm: `perilife run" in sure
    assert "not been measured" not in sure
    error = RESOLUTIONS["quick"].tensile_error.of("Mg-5Gd")
    assert (
        f"strength left of the shank up to {100 * error:.1f} %, "
        "of the slotted section up to 2.3 %, of the layer at the end faces up to 78.3 %"
    ) in top
    assert "773,005 cells" in ways and "horizon of the run on the 50 µm lattice" in ways


@pytest.mark.parametrize(
    ("states", "words"),
    [
        (("past_peak", "severed"), " until it gives way"),
        (("completed", "past_peak"), ", some until they give way"),
        (("completed", "completed"), ""),
        ((), ""),
    ],
)
def test_it_gives_way_only_where_it_did(states, words):
    items = tuple(ImmersionResult("1w", 1.0, tensile={"status": s}) for s in states)
    assert wording.until_it_gives_way([AlloyResult("A", {}, items)]) == words


def test_missing_parts_are_said(tmp_path, mesh):
    path = write_run(tmp_path / "run", scene_of(weeks=("0w", "4w")), *mesh)
    (path / "Mg-10Gd" / "4w" / "shank" / "tensile.csv").unlink()
    (path / "Mg-10Gd" / "corrosion" / "history.csv").unlink()
    stopped = json.dumps({"status": "stopped: no convergence at strain 0.02"})
    (path / "Mg-5Gd" / "4w" / "shank" / "tensile.json").write_text(stopped)
    (path / "geometry" / "mesh.h5").unlink()
    page, text = page_of(path)
    said = page.sections["missing"]
    assert "the tensile test of Mg-10Gd after 4w" in said
    assert "the course of corrosion of Mg-10Gd" in said
    assert "the end of the tensile test of Mg-5Gd after 4w" in said
    assert "all pictures" in said and page.pictures == []
    assert "There are no pictures" in page.sections["pictures"]


def test_a_run_with_nothing_but_a_scene_has_an_honest_report(tmp_path):
    folder = RunFolder(tmp_path)
    folder.scene_file.write_text(json.dumps(scene_of(alloys=("Mg-5Gd",), weeks=("8w",)).to_json()))
    page, text = page_of(tmp_path)
    assert "No tensile test of Mg-5Gd is in this run." in page.sections["header"]
    assert "no table of results yet" in page.sections["table"]
    assert "<svg" not in text and page.pictures == []


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"holds no scene\.json"):
        report.write_report(tmp_path)


def test_failing_graphics_leave_a_report_that_says_so(tmp_path, mesh, monkeypatch):
    path = write_run(tmp_path / "run", scene_of(alloys=("Mg-5Gd",), weeks=("0w",)), *mesh)
    monkeypatch.setattr(pictures.sys, "executable", "/bin/false")
    page, _ = page_of(path)
    assert "rendering ended with exit status 1" in page.sections["missing"]
    assert page.pictures == [] and not (path / "overview.png").exists()
    assert "was tested only before immersion; the intact solid carries" in page.sections["header"]


def test_a_picture_shows_less_metal_after_more_corrosion(mesh):
    points, cells = mesh
    radius = np.hypot(points[:, 0], points[:, 1])
    shown = []
    for limit in (2e-3, 7e-4, 3e-4):
        damage = 2 / 3 + (radius - limit) / 1e-3  # linear, so that the mesh holds it exactly
        image = pictures.screw_picture(points, cells, damage, outline=False, size=(120, 176))
        assert image.shape == (176, 120, 4)
        shown.append(int((image[..., 3] > 128).sum()))
    # measured 8300, 5500, 2000 pixels of 21120
    assert shown[0] > 1.3 * shown[1] > 1.3**2 * shown[2] > 0
    gone = pictures.screw_picture(points, cells, np.full(len(cells), 2 / 3), outline=False)
    assert (gone[..., 3] > 128).sum() == 0


def test_average_at_points_keeps_a_constant_and_the_bounds(mesh):
    points, cells = mesh
    constant = pictures.damage_at_points(points, cells, np.full((len(cells), 4), 0.3))
    # measured 1e-16: a weighted mean of equal numbers
    np.testing.assert_allclose(constant, 0.3, rtol=1e-13)
    field = np.random.default_rng(1).uniform(0, 2 / 3, len(cells))
    values = pictures.damage_at_points(points, cells, field)
    assert field.min() <= values.min() < values.max() <= field.max()


@pytest.mark.parametrize(
    "seconds, words",
    [(604800, "1 week"), (56 * 86400, "8 weeks"), (86400, "1 day"), (5400, "5400 seconds")],
)
def test_durations_are_written_in_the_largest_whole_unit(seconds, words):
    assert wording.duration(seconds) == words


def test_small_remains_do_not_read_as_none_and_small_losses_not_as_all():
    assert wording.percent(0.004) == "0.4 %"
    assert wording.percent(0.9991) == "99.9 %"
    assert wording.percent(0.0) == "0 %" and wording.percent(1.0) == "100 %"


def test_drawing_leaves_matplotlib_as_it_was():
    import matplotlib

    before = dict(matplotlib.rcParams)
    row = SummaryRow("A", "shank", 7.0, 0.1, 0.1, 100.0, 0.5, 0.05, "completed", "axial", 0.25)
    alloy = AlloyResult("A", {}, (ImmersionResult("1w", 604800.0, summary=row),))
    svg = plots.strength_plot([alloy])
    assert dict(matplotlib.rcParams) == before
    assert "Strength left (%)" in svg and "Immersion time (days)" in svg
    assert "var(--s0)" in svg and not re.search(r"#a1b[1-3]c", svg)


def test_one_png_is_written_whole_or_not_at_all(tmp_path):
    image = np.zeros((8, 6, 4), np.uint8)
    pictures.write_png(image, tmp_path / "new" / "a.png")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.png"]
    with Image.open(io.BytesIO((tmp_path / "new" / "a.png").read_bytes())) as picture:
        assert picture.size == (6, 8)
