"""What the page holds for its scripts: the solid that turns, tables to keep, values to read."""

import base64
import csv
import io
import json
import re
import zlib

import numpy as np
import pytest

from pipeline.geometry.mesh import refine_tetrahedra
from pipeline.record.run_results import read_run
from pipeline.record.summary import read_summary, write_summary
from pipeline.report import doubts, drawing, picture_set, plots, provenance, report, solid_view
from pipeline.report.downloads import downloads
from pipeline.report.pictures import damage_at_points
from tests.pipeline.report.run_folders import RATIOS, pin_mesh, scene_of, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = write_run(tmp_path_factory.mktemp("page") / "run", scene_of(hold=["all"]), *pin_mesh())
    return read_run(path)


def unpacked(view):
    """Points, cells and damage by state, as the page's script reads them."""
    content = zlib.decompress(base64.b64decode(view.packed))
    n, cells = 3 * view.about["points"], 4 * view.about["cells"]
    points = np.frombuffer(content, "<f4", n).reshape(-1, 3)
    corners = np.frombuffer(content, "<u4", cells, 4 * n).reshape(-1, 4)
    damage = np.frombuffer(content, "u1", -1, 4 * (n + cells))
    return points, corners, damage.reshape(len(view.about["states"]), -1)


def test_the_page_holds_the_mesh_and_the_damage_of_every_time(run, monkeypatch):
    monkeypatch.setattr(picture_set, "ENOUGH_CELLS", 9 * len(run.cells))
    view = solid_view.solid_view(run)
    points, cells, damage = unpacked(view)
    np.testing.assert_allclose(points, 1e3 * run.points, atol=1e-6)  # mm, single precision
    assert np.array_equal(cells, run.cells) and not view.simplified
    states = view.about["states"]
    assert [s["seconds"] for s in states] == 2 * [0.0, 4 * 604800, 8 * 604800, 24 * 604800]
    assert [s["alloy"] for s in states] == 4 * [0] + 4 * [1]
    assert states[1]["caption"] == "71 % left"
    finer = run.points, run.cells
    for _ in range(view.refined):
        finer = refine_tetrahedra(*finer)
    assert view.refined == 2 and damage.shape == (8, len(finer[0]))
    field = run.alloys[0].immersions[2].damage.mean(axis=1)
    wanted = damage_at_points(*finer, np.repeat(field, 8**view.refined)) / 0.97
    # half a step of the byte
    np.testing.assert_allclose(damage[2] / 255, np.clip(wanted, 0, 1), atol=0.5 / 255 + 1e-9)
    assert damage[0].max() == 0 < damage[2].max()


def test_a_large_mesh_is_simplified_and_stays_closed():
    points, cells = pin_mesh(spacing=2e-4)
    fewer, left = solid_view.simplified(points, cells, 400)
    assert 200 < len(fewer) <= 400 < len(points)
    assert {tuple(p) for p in fewer} <= {tuple(p) for p in points}
    faces = np.sort(left[:, [(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    skin = unique[count % 2 == 1]
    edges = np.sort(skin[:, [(0, 1), (1, 2), (0, 2)]].reshape(-1, 2), axis=1)
    assert len(skin) > 100 and (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()
    np.testing.assert_allclose(np.ptp(fewer, axis=0), np.ptp(points, axis=0), rtol=0.1)
    same = solid_view.simplified(points, cells, len(points))
    assert same[0] is points and same[1] is cells


def test_tables_in_the_page_are_those_of_the_run(run):
    files = {file.name: file.address for file in downloads(run)}
    assert list(files) == ["summary.csv", "curves.csv", "history.csv"]
    text = {n: base64.b64decode(a.partition(",")[2]).decode() for n, a in files.items()}
    assert text["summary.csv"] == (run.folder / "summary.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text["curves.csv"])))
    assert len(rows) == 2 * 3 * 4 * 21  # alloys, ways of holding, times, increments
    one = [float(r["force_N"]) for r in rows if tuple(r.values())[:3] == ("Mg-5Gd", "slot", "8w")]
    curve = run.held["slot"][0].immersions[2].curve["force_N"]
    np.testing.assert_allclose(one, curve, rtol=1e-7)  # eight digits are written
    history = list(csv.DictReader(io.StringIO(text["history.csv"])))
    assert [r["alloy"] for r in history] == 40 * ["Mg-5Gd"] + 40 * ["Mg-10Gd"]


def test_the_intact_solid_has_a_row_where_it_was_only_pulled(tmp_path):
    path = write_run(tmp_path / "run", scene_of(("Mg-5Gd",), ("0w", "8w")), *pin_mesh(1e-3))
    rows = read_summary(path / "summary.csv")
    write_summary(path / "summary.csv", [row for row in rows if row.immersion_days > 0])
    (path / "scene.json").write_text(json.dumps(scene_of(("Mg-5Gd",), ("8w",)).to_json()))
    (path / "geometry" / "mesh.h5").unlink()  # no pictures
    text = report.write_report(path).read_text()
    table = text[text.index('<section id="table">') : text.index('<section id="pictures">')]
    rows = [re.sub("<[^>]*>", "|", row) for row in re.findall("<tr>.*?</tr>", table, re.DOTALL)]
    cells = [[cell for cell in row.split("|") if cell.strip()] for row in rows[1:]]
    assert [row[:4] for row in cells] == [
        ["Mg-5Gd", "0 weeks", "100 %", "458 N"],  # 500 (1 - exp(-60 e)) (1 - e), as written
        ["8 weeks", "71 %", "325 N", "4.5 %"],
    ]


def test_no_name_of_the_code_and_no_noise_is_shown(run):
    names = {entry["what"] for entry in doubts.omissions(run)}
    assert "solid core" in names and not any("_" in name for name in names)
    shown = [text for group in provenance.settings(run.scene).values() for _, text in group]
    assert "nothing" in shown and not {"()", "[]", "None"} & set(shown)
    assert doubts._small(0.0) == "0" and doubts._small(3e-13) == "3e-13"


def test_values_can_be_read_off_the_curves(run):
    drawing = plots.strength_plot(run.alloys)
    for name, ratios in RATIOS.items():
        for time, ratio in zip((0, 4, 8, 24), ratios, strict=True):
            assert f"<title>{name}, {time} weeks: {100 * ratio:.1f} % left, " in drawing
    assert drawing.count('<circle class="value"') == 8
    # at 24 weeks and at 0 the axes end: 0 % lies below 100 %
    places = [c.split('"') for c in drawing.split('<circle class="value" ')[1:]]
    (x0, y0), (x3, y3) = ((float(places[n][1]), float(places[n][3])) for n in (0, 3))
    assert x3 > x0 and y3 > y0
    force = plots.load_plot(run.alloys[1], "0", 500.0)
    assert force.count('<circle class="value"') == 4 * 21


@pytest.mark.parametrize("error", [None, 0.025])
def test_the_error_is_a_band_where_it_was_measured(run, error):
    filled = plots.strength_plot(run.alloys, error=error).count("FillBetween")
    assert (filled > 0) == (error is not None)


def test_names_of_lines_do_not_lie_over_one_another():
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    axes.set_ylim(0, 105)
    ends = [(88.0, "a", "k"), (77.0, "b", "k"), (76.0, "c", "k"), (2.0, "d", "k"), (1.0, "e", "k")]
    plots.name_lines(axes, ends, apart=5.0)
    places = sorted(text.xyann[1] for text in axes.texts)
    assert min(np.diff(places)) > 4.9 and places[0] > -0.1
    assert max(abs(text.xyann[1] - text.xy[1]) for text in axes.texts) < 6


@pytest.mark.parametrize(
    "count, columns, rows", [(5, 3, "abcde"), (6, 3, "abcdef"), (2, 2, "ab"), (7, 3, "abcdefg")]
)
def test_legends_read_row_by_row(count, columns, rows):
    filled = drawing.by_rows(list(rows), columns)
    # as matplotlib fills: column by column, the first ones with one more where it does not come out
    height, more = divmod(count, columns)
    table, at = [], 0
    for column in range(columns):
        size = height + (column < more)
        table.append(filled[at : at + size])
        at += size
    read = [c[n] for n in range(height + 1) for c in table if n < len(c)]
    assert "".join(read) == rows
